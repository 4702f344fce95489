"""What each command does: call the rooms below, print. What is heavy is imported where it is used."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.graph.messages import GraphError

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
    from bayesnet_track.journal.events import Event
    from bayesnet_track.runtime.progress import Progress
    from bayesnet_track.runtime.run import FrameSource, Result, Start, Summary

OK, FAILED, USAGE, BAD_GRAPH, BAD_SOURCE, INCOMPLETE, BAD_OUTPUT = range(7)

SCENE_GRAPHS = {"orange_and_gray": "color_fusion", "gray_square": "color_fusion"}
"""Scenes that do not run with the graph `two_squares`."""


class UsageError(ValueError):
    """Arguments that make no sense together."""


def call(options: argparse.Namespace) -> int:
    """Carry out a parsed command line; the exit code. Expected errors become one clear message."""
    command: Callable[[argparse.Namespace], int] = COMMANDS[options.command]
    try:
        return command(options)
    except GraphError as error:
        return _complain(str(error), BAD_GRAPH)
    except UsageError as error:
        return _complain(f"bayesnet-track {options.command}: {error}", USAGE)
    except (OSError, ValueError) as error:
        return _complain(f"bayesnet-track {options.command}: {error}", _code_of(error))


def _code_of(error: Exception) -> int:
    from bayesnet_track.journal.writer import OutputError
    from bayesnet_track.runtime.frames import SourceError
    from bayesnet_track.runtime.rundir import RunDirectoryError

    if isinstance(error, SourceError):
        return BAD_SOURCE
    if isinstance(error, OutputError | RunDirectoryError):
        return BAD_OUTPUT
    return USAGE


def _complain(message: str, code: int) -> int:
    sys.stderr.write(message + "\n")
    return code


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")


# ------------------------------------------------------------------------------------ tracking


def demo(options: argparse.Namespace) -> int:
    """Track in a built-in scene, then tell what happened and how well it went."""
    from bayesnet_track.evaluate.runs import score_run
    from bayesnet_track.journal.explain import explain
    from bayesnet_track.journal.reader import read_events
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.runtime.rundir import RunDirectory
    from bayesnet_track.runtime.scene_source import SceneSource
    from bayesnet_track.scenes import make_scene, scene_names

    if options.scene not in scene_names():
        raise UsageError(f"no scene {options.scene!r}; there are {', '.join(scene_names())}")
    scene = make_scene(options.scene, seed=options.seed)
    out = Path(options.out or f"runs/{options.scene}")
    graph = options.graph or SCENE_GRAPHS.get(options.scene, "two_squares")
    source = SceneSource(scene, f"scene:{options.scene}")
    code = _track(options, graph, source, [Start(scene.start_box)], out, video=True)
    directory = RunDirectory.open(out)
    truth = "".join(",".join(f"{value:.3f}" for value in row) + "\n" for row in scene.truth)
    directory.write_text(directory.truth, truth)
    _say("")
    for event in read_events(directory.journal):
        _say(explain(event))
    _say("")
    _say(score_run(out, directory.truth).text())
    _say(f"\nopen {directory.video} to watch it; `bayesnet-track log {out} --why 29` explains a frame")
    return code


def run(options: argparse.Namespace) -> int:
    """Track in a video."""
    from bayesnet_track.evaluate.truth import read_truth
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.runtime.sources import open_source

    if options.init_from is not None:
        boxes = read_truth(Path(options.init_from))
        row = boxes[options.start or 0] if len(boxes) > (options.start or 0) else None
        if row is None or not (row == row).all():
            raise UsageError(f"{options.init_from}: it has no box for frame {options.start or 0}")
        starts = [Start((float(row[0]), float(row[1]), float(row[2]), float(row[3])))]
    else:
        starts = [parse_start(text) for text in options.init]
    with open_source(
        options.source, options.start, options.end, options.allow_network, options.on_resize
    ) as source:
        return _track(options, options.graph, source, starts, Path(options.out), video=options.video)


def parse_start(text: str) -> Start:
    """A start from ``x,y,w,h`` or ``plate:x,y,w,h`` (top-left corner, px).

    Raises:
        UsageError: it is something else.
    """
    from bayesnet_track.runtime.run import Start

    plate, _, numbers = text.rpartition(":")
    try:
        x, y, w, h = (float(part) for part in numbers.split(","))
    except ValueError:
        raise UsageError(f"--init {text!r}: four numbers X,Y,W,H are needed (top-left corner, px)") from None
    return Start((x, y, w, h), plate or None)


def _track(
    options: argparse.Namespace,
    graph_name: str,
    source: FrameSource,
    starts: Sequence[Start],
    out: Path,
    video: bool,
) -> int:
    from bayesnet_track.graph.load import load_graph
    from bayesnet_track.runtime.progress import Progress
    from bayesnet_track.runtime.run import Summary
    from bayesnet_track.runtime.session import track
    from bayesnet_track.runtime.stop import StopRequest

    graph = load_graph(graph_name)
    for start in starts:
        if start.plate is not None and start.plate not in graph.targets:
            raise UsageError(
                f"no plate {start.plate!r} in {graph_name}; there are {', '.join(graph.targets)}"
            )
    progress = Progress(sys.stderr, source.expected_frames, sys.stderr.isatty(), options.log_json)
    summary = Summary()
    with ExitStack() as stack:
        stop = stack.enter_context(StopRequest())
        results = track(
            graph,
            source,
            starts,
            out=out,
            seed=options.seed,
            overwrite=options.overwrite or options.command == "demo",
            video=video,
            summary=summary,
        )
        stack.callback(results.close)
        for result in results:
            if not options.quiet:
                _show(progress, summary, result)
            if stop.signal is not None:
                break
    if not options.quiet:
        progress.finish()
    _say_end(out, summary)
    if stop.signal is not None:
        return stop.exit_code
    return OK if summary.complete else INCOMPLETE


def _show(progress: Progress, summary: Summary, result: Result) -> None:
    first = result.targets[0]
    progress.update(time.monotonic(), summary.frames, first.active, first.ud_px2, first.status)


def _say_end(out: Path, summary: Summary) -> None:
    from bayesnet_track.journal.explain import explain

    rate = summary.frames / summary.seconds if summary.seconds > 0 else 0.0
    for notice in summary.notices:
        sys.stderr.write(explain(notice) + "\n")
    end = "" if summary.complete else f" ({summary.reason.replace('_', ' ')})"
    _say(f"{out}: {summary.frames} frames in {summary.seconds:.1f} s, {rate:.0f} frames per second{end}")


# ------------------------------------------------------------------------------------ graphs


def validate(options: argparse.Namespace) -> int:
    """Check graph files; all errors of all files."""
    from bayesnet_track.graph.load import load_graph

    code = OK
    for name in options.graphs:
        try:
            graph = load_graph(name)
        except GraphError as error:
            code = _complain(str(error), BAD_GRAPH)
            continue
        nodes = sum(len(plate.order) for plate in graph.targets.values())
        agents = sum(len(plate.agents) for plate in graph.targets.values())
        _say(f"{name}: ok ({graph.spec.name}: {nodes} nodes, {agents} of them agents)")
    return code


def graph(options: argparse.Namespace) -> int:
    """Show plan, formula and picture of a graph."""
    from bayesnet_track.graph.load import load_graph

    loaded = load_graph(options.graph)
    plate = _plate(loaded, options.target)
    active = frozenset(agent for agent in plate.agents if plate.agent(agent).active)
    if options.formula or options.latex:
        from bayesnet_track.graph.formula import formula_latex, formula_text

        _say(formula_latex(plate, active) if options.latex else formula_text(plate, active))
    if options.svg is not None:
        from bayesnet_track.view.graph_picture import graph_svg

        _write(Path(options.svg), graph_svg(plate, active).encode())
    if options.png is not None:
        import cv2

        from bayesnet_track.view.graph_picture import graph_image

        _write(Path(options.png), cv2.imencode(".png", graph_image(plate, active))[1].tobytes())
    if not (options.formula or options.latex or options.svg or options.png):
        from bayesnet_track.cue import installed_cues
        from bayesnet_track.inference.compile import compile_plan, describe_plan

        cues = installed_cues()
        made = {
            agent: cues[plate.agent(agent).agent.cue].make(plate.parameters[agent]) for agent in plate.agents
        }
        agents = {agent: plate.agent(agent) for agent in plate.agents}
        _say(describe_plan(compile_plan(plate, active, made), agents))
    return OK


def _plate(loaded: CheckedGraph, name: str | None) -> CheckedTarget:
    if name is None:
        return next(iter(loaded.targets.values()))
    if name not in loaded.targets:
        raise UsageError(f"no target {name!r}; there are {', '.join(loaded.targets)}")
    return loaded.targets[name]


def _write(path: Path, content: bytes) -> None:
    from bayesnet_track.journal.writer import OutputError

    try:
        path.write_bytes(content)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    _say(f"wrote {path}")


def schema(options: argparse.Namespace) -> int:
    """Print the JSON Schema of graph files."""
    import json

    from bayesnet_track.graph.schema import graph_schema

    _say(json.dumps(graph_schema(), indent=2))
    return OK


def list_installed(options: argparse.Namespace) -> int:
    """List graphs, cues and scenes."""
    from bayesnet_track.cue import installed_cues
    from bayesnet_track.graphs import graph_names
    from bayesnet_track.scenes import scene_names

    _say("graphs:  " + ", ".join(graph_names()))
    _say("scenes:  " + ", ".join(scene_names()))
    _say("cues:")
    for cue in installed_cues().values():
        _say(f"  {cue.name:18} {cue.summary}")
    return OK


# ------------------------------------------------------------------------------------ looking back


def log(options: argparse.Namespace) -> int:
    """Tell a run's reconfigurations."""
    from bayesnet_track.journal.codec import to_json
    from bayesnet_track.journal.explain import explain, why
    from bayesnet_track.journal.reader import read_events, read_metrics
    from bayesnet_track.runtime.rundir import RunDirectory

    directory = RunDirectory.open(options.run)
    events = list(read_events(directory.journal, _notice))
    if options.why is not None:
        _say(why(events, list(read_metrics(directory.frames, _notice)), options.why))
        return OK
    for event in chosen_events(events, options):
        _say(to_json(event) if options.json else explain(event))
    return OK


def chosen_events(events: Sequence[Event], options: argparse.Namespace) -> list[Event]:
    """The events that --node, --kind and --frames leave."""
    from bayesnet_track.journal.explain import Filter

    frames = None
    if options.frames is not None:
        first, separator, last = options.frames.partition(":")
        try:
            frames = (int(first or 0), int(last) if last else 2**62)
        except ValueError:
            raise UsageError(f"--frames {options.frames!r}: A:B with whole numbers is needed") from None
        if not separator:
            frames = (frames[0], frames[0] + 1)
    keep = Filter(node=options.node, kind=options.kind, frames=frames)
    return [event for event in events if keep.keeps(event)]


def score(options: argparse.Namespace) -> int:
    """Score a run against ground truth."""
    from bayesnet_track.evaluate.runs import score_run
    from bayesnet_track.runtime.rundir import RunDirectory

    directory = RunDirectory.open(options.run)
    truth = Path(options.truth) if options.truth else directory.truth
    if not truth.is_file():
        raise UsageError(f"no ground truth at {truth}; name one with --truth FILE")
    result = score_run(directory.path, truth)
    _say(result.json() if options.json else result.text())
    return OK


def _notice(message: str) -> None:
    sys.stderr.write(message + "\n")


COMMANDS = {
    "demo": demo,
    "run": run,
    "validate": validate,
    "graph": graph,
    "schema": schema,
    "list": list_installed,
    "log": log,
    "score": score,
}
