"""The command `completion`: the script by which a shell completes the command line, written by shtab."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from bayesnet_track.cli.commands.answer import OK, say

KINDS = {
    **dict.fromkeys(("RUN", "DIR", "DATA", "FOLDER"), "DIRECTORY"),
    **dict.fromkeys(("FILE", "SOURCE", "MODEL", "LEFT", "RIGHT", "source", "truth", "left", "right"), "FILE"),
    **dict.fromkeys(("GRAPH", "graph"), "graphs"),
    "SCENE": "scenes",
    "DETECTOR": "detectors",
}
"""Metavar or name of an argument -> what shtab completes there, or a function of the preamble."""


def completion(options: argparse.Namespace) -> int:
    """Print the completion script of a shell."""
    import shtab

    from bayesnet_track.graphs import graph_names
    from bayesnet_track.observation.detector import installed_detectors
    from bayesnet_track.sources.scenes import scene_names

    names = {"graphs": graph_names(), "scenes": scene_names(), "detectors": installed_detectors()}
    for action in actions(options.parser):
        kind = kind_of(action)
        if kind is not None:
            marked: Any = action
            marked.complete = (
                {"bash": f"_bt_{kind}", "zsh": f"_bt_{kind}", "fish": f"(_bt_{kind})"}
                if kind in names
                else getattr(shtab, kind)
            )
    files = {"bash": "compgen -f -X '!*.yaml' -- $1; compgen -d -- $1", "zsh": "_files -g '*.yaml'"}
    files["fish"] = "__fish_complete_path (commandline -ct)"
    preamble = dict.fromkeys(("bash", "zsh", "fish"), "")
    for kind, given in names.items():
        words = " ".join(given)
        after = files if kind == "graphs" else dict.fromkeys(files, "")
        preamble["bash"] += f"_bt_{kind}() {{\n  compgen -W '{words}' -- $1\n  {after['bash']}\n}}\n"
        preamble["zsh"] += f"_bt_{kind}() {{\n  compadd -- {words}\n  {after['zsh']}\n}}\n"
        preamble["fish"] += f"function _bt_{kind}\n  printf '%s\\n' {words}\n  {after['fish']}\nend\n"
    say(shtab.complete(options.parser, shell=options.shell, preamble=preamble))
    return OK


def kind_of(action: argparse.Action) -> str | None:
    """What is completed there, of `KINDS`; None where that is nothing, or the argument's own choices."""
    if action.nargs == 0 or action.choices is not None:
        return None
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    return KINDS["graph"] if action.dest == "graph" else KINDS.get(metavar) or KINDS.get(action.dest)


def actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Every argument of the parser and of its commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from actions(command)
        else:
            yield action


def add_completion(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "completion",
        help="print the script that completes commands, graphs, scenes and files in a shell",
        description="Print the completion script of a shell. It knows the graphs, scenes and detectors that "
        "are installed now: print it again after installing others.",
        epilog="bash:  bayesnet-track completion bash > "
        "~/.local/share/bash-completion/completions/bayesnet-track\n"
        "zsh:   bayesnet-track completion zsh > DIR/_bayesnet-track   (DIR is in $fpath)\n"
        "fish:  bayesnet-track completion fish > ~/.config/fish/completions/bayesnet-track.fish",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), metavar="SHELL", help="bash, zsh or fish")
