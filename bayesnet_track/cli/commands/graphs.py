"""Commands about graphs and installed parts: `validate`, `graph`, `schema`, `list`, `init`, `completion`."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import BAD_GRAPH, OK, UsageError, add_plugins, complain, say, users_output
from bayesnet_track.graph.text.messages import GraphError, nearest

if TYPE_CHECKING:
    from bayesnet_track.engine.compiled import Stage
    from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget


SCENE_GRAPHS = {
    "ball_between_children": "ball_between_children",
    "carried_box": "carried_box",
    "crowd": "crowd",
    "orange_and_gray": "orange_and_gray",
    "gray_square": "gray_square",
    "flying_ball": "kalman_ball",
    "person_and_board": "person_shape",
    "person_parts": "person_parts",
    "person_stereo": "person_stereo",
    "glass_wall": "person_stereo",
    "person_color_stereo": "person_color_stereo",
    "person_same_clothes": "person_same_clothes",
    "person_same_clothes_nearer": "person_same_clothes",
    "two_people_color_stereo_shape": "two_people_color_stereo_shape",
    "street": "street",
}
"""Scenes that do not run with the graph `two_squares`."""


def _validate(options: argparse.Namespace) -> int:
    """Check graph files; all errors of all files."""
    from bayesnet_track.graph.checks.motion import describe_still_axes
    from bayesnet_track.graph.text.explain import describe_error
    from bayesnet_track.graph.text.load import load_graph

    code = OK
    for name in options.graphs:
        try:
            graph = load_graph(name)
        except GraphError as error:
            complain(describe_error(error))
            code = BAD_GRAPH
            continue
        nodes = sum(len(plate.order) + len(plate.factors) for plate in graph.targets.values())
        agents = sum(len(plate.agents) for plate in graph.targets.values())
        say(f"{name}: ok ({graph.spec.name}: {nodes} nodes, {agents} of them agents)")
        for plate in graph.targets.values():
            for sentence in describe_still_axes(plate):
                say(f"  {sentence}")
        opaque = ", ".join(_opaque(graph))
        if opaque:
            say(
                f"  opaque: {opaque} cannot be stored; a run repeats from its start only, not from its middle"
            )
    return code


def _opaque(graph: CheckedGraph) -> list[str]:
    from bayesnet_track.graph.checks.run import cues_named
    from bayesnet_track.observation.cue import installed_cues

    cues = installed_cues(cues_named(graph.spec))
    return [
        f"{agent} ({cue})"
        for plate in graph.targets.values()
        for agent in plate.agents
        if cues[cue := plate.agent(agent).agent.cue].opaque
    ]


def _graph(options: argparse.Namespace) -> int:
    """Show plan, formula and picture of a graph."""
    from bayesnet_track.graph.text.load import load_graph

    loaded = load_graph(options.graph)
    plates = _plates(loaded, options.target)
    if options.plan:
        from bayesnet_track.engine.compiled import compile_graph
        from bayesnet_track.engine.step import compile_stages

        say("\n".join(_stages(compile_stages(compile_graph(loaded)), "")))
        return OK
    text = _density if options.formula or options.latex else _plan
    if options.formula or options.latex or not (options.svg or options.png):
        texts = [text(plate, _active(plate), options.latex) for plate in plates]
        say("\n\n".join([*texts, *_joins(loaded, plates, options)]))
    plate, active = plates[0], _active(plates[0])
    if options.svg is not None:
        from bayesnet_track.view.graph_picture import graph_svg

        _write(Path(options.svg), graph_svg(plate, active).encode())
    if options.png is not None:
        import cv2

        from bayesnet_track.view.graph_picture import graph_image

        _write(Path(options.png), cv2.imencode(".png", graph_image(plate, active))[1].tobytes())
    return OK


def _stages(stages: Iterable[Stage], indent: str) -> Iterator[str]:
    """A line for each stage, with the module and name of each function that does its work."""
    for number, stage in enumerate(stages, 1):
        places = (
            (call.__module__.removeprefix("bayesnet_track."), call.__qualname__) for call in stage.calls
        )
        yield f"{indent}{number}. {stage.name}: {', '.join(map('.'.join, places))}"
        if isinstance(stage.run, partial):
            yield f"{indent}   in a frame that does not fit rows:"
            yield from _stages(stage.run.args[0], f"{indent}   ")


def _active(plate: CheckedTarget) -> frozenset[str]:
    return frozenset(agent for agent in plate.agents if plate.agent(agent).active)


def _density(plate: CheckedTarget, active: frozenset[str], as_latex: bool) -> str:
    from bayesnet_track.graph.text.formula import formula_latex, formula_text

    return formula_latex(plate, active) if as_latex else formula_text(plate, active)


def _joins(loaded: CheckedGraph, plates: list[CheckedTarget], options: argparse.Namespace) -> list[str]:
    """The densities of the joins of these plates, where densities are asked for."""
    from bayesnet_track.graph.text.formula import join_latex, join_text

    if not (options.formula or options.latex):
        return []
    kinds = {plate.name for plate in plates}
    selected = [join for join in loaded.spec.joins if join.between is None or kinds & set(join.between)]
    return [(join_latex if options.latex else join_text)(join) for join in selected]


def _plan(plate: CheckedTarget, active: frozenset[str], as_latex: bool) -> str:
    from bayesnet_track.inference.compile import compile_plan, describe_plan
    from bayesnet_track.observation.cue import installed_cues, make_cue

    agents = {agent: plate.agent(agent) for agent in plate.agents}
    cues = installed_cues(agent.agent.cue for agent in agents.values())
    cue_instances = {
        name: make_cue(cues[checked.agent.cue], plate.parameters[name]) for name, checked in agents.items()
    }
    return describe_plan(compile_plan(plate, active, cue_instances), agents)


def _plates(loaded: CheckedGraph, name: str | None) -> list[CheckedTarget]:
    if name is None:
        return list(loaded.targets.values())
    if name not in loaded.targets:
        suggestion = nearest(name, loaded.targets)
        hint = f"; nearest: {suggestion}" if suggestion else ""
        raise UsageError(f"no target {name!r}; there are {', '.join(loaded.targets)}{hint}")
    return [loaded.targets[name]]


def _write(path: Path, content: bytes) -> None:
    with users_output(path):
        path.write_bytes(content)
    say(f"wrote {path}")


def _schema(options: argparse.Namespace) -> int:
    """Print the JSON Schema of graph files."""
    import json

    from bayesnet_track.graph.text.write import graph_schema

    say(json.dumps(graph_schema(), indent=2))
    return OK


def _list_installed(options: argparse.Namespace) -> int:
    """List graphs, cues, detectors and scenes."""
    from bayesnet_track.graphs import graph_folder, graphs_about
    from bayesnet_track.observation.cue import ENTRY_POINT_GROUP as CUES
    from bayesnet_track.observation.cue import installed_cues
    from bayesnet_track.observation.detector import ENTRY_POINT_GROUP as DETECTORS
    from bayesnet_track.observation.detector import installed_detectors
    from bayesnet_track.observation.plugins import allowed, others
    from bayesnet_track.sources.scenes import scene_names
    from bayesnet_track.sources.scenes.people import ROOMS

    word = (options.word or "").lower()
    scenes = ", ".join(scene for scene in (*scene_names(), *ROOMS) if word in scene)
    sections = {
        f"graphs (in {graph_folder()}; `bayesnet-track init --from NAME` copies one)": [
            f"{graph:29} {summary}" for graph, summary in graphs_about().items()
        ],
        "scenes (for `demo`)": wrap(scenes, 100, break_on_hyphens=False),
        "cues": [f"{cue.name:22} {cue.summary}" for cue in installed_cues(allowed()).values()],
        "detectors": [f"{each.name:21} {each.summary}" for each in installed_detectors(allowed()).values()],
    }
    for group, kind in ((CUES, "cues"), (DETECTORS, "detectors")):
        title = f"{kind} of other packages, not loaded (--allow-plugins NAME lets a graph use one)"
        packages = others(group).items()
        sections[title] = [f"{name:21} {package}" for name, package in packages if name not in allowed()]
    matching = {title: [line for line in lines if word in line.lower()] for title, lines in sections.items()}
    if not any(matching.values()):
        raise UsageError(f"no graph, scene, cue or detector with {options.word!r} in its name or description")
    for title, lines in matching.items():
        if lines:
            say("\n  ".join([f"{title}:", *lines]))
    return OK


def _add_validate(commands: argparse._SubParsersAction[Any]) -> None:
    validate = commands.add_parser("validate", help="check graph files; every error with line and column")
    validate.add_argument("graphs", nargs="+", metavar="GRAPH", help="path of a YAML file, or name")
    add_plugins(validate)


def _add_graph(commands: argparse._SubParsersAction[Any]) -> None:
    graph = commands.add_parser("graph", help="show what a graph compiles to")
    graph.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    graph.add_argument(
        "--target", metavar="NAME", help="the target type to show (default: all; in a drawing, the first)"
    )
    graph.add_argument("--plan", action="store_true", help="print the stages that a frame goes through")
    graph.add_argument("--formula", action="store_true", help="print the density that the net stands for")
    graph.add_argument("--latex", action="store_true", help="print it as LaTeX")
    graph.add_argument("--svg", metavar="FILE", help="draw the net")
    graph.add_argument("--png", metavar="FILE", help="draw the net")
    add_plugins(graph)


def _add_schema(commands: argparse._SubParsersAction[Any]) -> None:
    add_plugins(commands.add_parser("schema", help="print the JSON Schema of graph files, for editors"))


def _add_list(commands: argparse._SubParsersAction[Any]) -> None:
    listing = commands.add_parser("list", help="list the installed graphs, cues, detectors and scenes")
    listing.add_argument("word", nargs="?", metavar="WORD", help="only lines with this word (default: all)")
    add_plugins(listing)


HEAD = """\
# A copy of the graph {source}. Try it, look at the result and at why agents were switched, then change one
# thing at a time:
#   bayesnet-track run {path} --source VIDEO --init X,Y,W,H --out runs/{name}
#   bayesnet-track report runs/{name} --open
#   bayesnet-track what-if runs/{name} --set KEY.KEY=VALUE --truth TRUTH
"""
NO_NAMES = frozenset({"null", "true", "false"})
"""Words that YAML takes for something else."""


def _init(options: argparse.Namespace) -> int:
    """Copy a graph of the library."""
    from bayesnet_track.graph.checks.run import check
    from bayesnet_track.graph.text.load import read_graph
    from bayesnet_track.graphs import find_graph

    path = Path(options.file)
    with users_output(path):
        if path.exists() and not options.overwrite:
            raise UsageError(f"{path} is there already; `--overwrite` replaces it")
    try:
        text = find_graph(options.source).read_text(encoding="utf-8")
    except KeyError as error:
        raise UsageError(str(error.args[0])) from None
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)[:60]
    name = name if name[:1].isalpha() and name.lower() not in NO_NAMES else f"graph_{name}"
    text = re.sub(r"(?m)^name: .*$", f"name: {name}", text, count=1)
    head = HEAD.format(source=options.source, path=path.as_posix().replace("\n", " "), name=name)
    check(*read_graph(head + text, str(path)))
    with users_output(path):
        path.write_text(head + text, encoding="utf-8")
    say(f"wrote {path}, a copy of the graph {options.source}")
    complain(
        f"next: `bayesnet-track run {path} --source VIDEO --init X,Y,W,H --out runs/{name}` tracks with it"
    )
    return OK


def _add_init(commands: argparse._SubParsersAction[Any]) -> None:
    parser = commands.add_parser(
        "init",
        help="write a commented graph, a copy of an installed one",
        description="Copy an installed graph, with its comments, as a start for your own. "
        "`bayesnet-track list` prints what each graph is for.",
    )
    parser.add_argument(
        "file", nargs="?", default="mine.yaml", metavar="FILE", help="graph file to write (default mine.yaml)"
    )
    parser.add_argument(
        "--from",
        dest="source",
        default="adaptive",
        metavar="GRAPH",
        help="installed graph to copy (default adaptive: one target, by color and edges)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it exists")


KINDS = {
    **dict.fromkeys(("RUN", "DIR", "DATA", "FOLDER"), "DIRECTORY"),
    **dict.fromkeys(("FILE", "SOURCE", "MODEL", "LEFT", "RIGHT", "source", "truth", "left", "right"), "FILE"),
    **dict.fromkeys(("GRAPH", "graph"), "graphs"),
    "SCENE": "scenes",
    "DETECTOR": "detectors",
}
"""Metavar or name of an argument -> what shtab completes there, or a function of the preamble."""


def _completion(options: argparse.Namespace) -> int:
    """Print the completion script of a shell."""
    import shtab

    from bayesnet_track.graphs import graph_names
    from bayesnet_track.observation.detector import installed_detectors
    from bayesnet_track.sources.scenes import scene_names
    from bayesnet_track.sources.scenes.people import ROOMS

    names = {"graphs": graph_names(), "scenes": (*scene_names(), *ROOMS), "detectors": installed_detectors()}
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
    for kind, choices in names.items():
        words = " ".join(choices)
        commands = files if kind == "graphs" else dict.fromkeys(files, "")
        preamble["bash"] += f"_bt_{kind}() {{\n  compgen -W '{words}' -- $1\n  {commands['bash']}\n}}\n"
        preamble["zsh"] += f"_bt_{kind}() {{\n  compadd -- {words}\n  {commands['zsh']}\n}}\n"
        preamble["fish"] += f"function _bt_{kind}\n  printf '%s\\n' {words}\n  {commands['fish']}\nend\n"
    say(shtab.complete(options.parser, shell=options.shell, preamble=preamble))
    return OK


def kind_of(action: argparse.Action) -> str | None:
    """The kind of `KINDS` to complete there; None where that is nothing, or the argument's own choices."""
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


def _add_completion(commands: argparse._SubParsersAction[Any]) -> None:
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


COMMANDS = {
    "validate": (_add_validate, _validate),
    "graph": (_add_graph, _graph),
    "schema": (_add_schema, _schema),
    "list": (_add_list, _list_installed),
    "init": (_add_init, _init),
    "completion": (_add_completion, _completion),
}
