"""The command `completion`: the parser's own description, with the names that are installed, as a script."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from typing import Any

from bayesnet_track.cli.commands.answer import OK, UsageError, say

FOLDERS = frozenset({"RUN", "DIR", "DATA", "FOLDER"})
FILES = frozenset({"FILE", "SOURCE", "MODEL", "LEFT", "RIGHT", "GRAPH"})
FILE_OPTIONS = frozenset({"source", "truth", "graph", "left", "right"})


def completion(options: argparse.Namespace) -> int:
    """Print the completion script of a shell."""
    say(completion_script(options.parser, options.shell))
    return OK


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script that completes the command line of `parser`, which is marked on the way.

    Raises:
        UsageError: the library that writes it is not installed.
    """
    try:
        import shtab
    except ImportError as error:
        raise UsageError("this needs the package shtab: pip install shtab") from error
    from bayesnet_track.graphs import graph_names
    from bayesnet_track.observation.detector import installed_detectors
    from bayesnet_track.sources.scenes import scene_names

    names = {
        "graphs": (tuple(graph_names()), True),
        "scenes": (tuple(scene_names()), False),
        "detectors": (tuple(installed_detectors()), False),
    }
    of = {word: _words(word, given, and_files) for word, (given, and_files) in names.items()}
    for action in _actions(parser):
        kind = _kind(action)
        if kind is not None:
            marked: Any = action
            marked.complete = of.get(kind) or getattr(shtab, kind)
    return str(shtab.complete(parser, shell=shell))


def _kind(action: argparse.Action) -> str | None:
    """What stands there: a group of names, or a file or directory, for shtab to complete."""
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    if action.nargs == 0 or action.choices is not None:
        return None
    if metavar == "GRAPH" or action.dest == "graph":
        return "graphs"
    if metavar == "SCENE":
        return "scenes"
    if metavar == "DETECTOR":
        return "detectors"
    if metavar in FOLDERS:
        return "DIRECTORY"
    return "FILE" if metavar in FILES or action.dest in FILE_OPTIONS else None


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)
        else:
            yield action


def _words(kind: str, names: Iterable[str], and_files: bool) -> dict[str, Any]:
    """shtab's description of a list of names, which are safe in every shell: letters, digits and `_`."""
    words, function = " ".join(names), f"_bayesnet_track_{kind}"
    files = {
        "bash": "\n  compgen -f -X '!*.yaml' -- $1\n  compgen -d -- $1",
        "zsh": "\n  _files -g '*.yaml'",
        "fish": "\n  __fish_complete_path (commandline -ct)",
    }
    after = files if and_files else dict.fromkeys(files, "")
    return {
        "bash": function,
        "zsh": function,
        "fish": f"({function})",
        "preamble": {
            "bash": f"{function}() {{\n  compgen -W '{words}' -- $1{after['bash']}\n}}\n",
            "zsh": f"{function}() {{\n  compadd -- {words}{after['zsh']}\n}}\n",
            "fish": f"function {function}\n  printf '%s\\n' {words}{after['fish']}\nend\n",
        },
    }


SHELLS = ("bash", "zsh", "fish")


def add_completion(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    completion = commands.add_parser(
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
    completion.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash, zsh or fish")
