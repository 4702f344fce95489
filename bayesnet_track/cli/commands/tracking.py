"""The commands that track: `demo` and `run`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import (
    INCOMPLETE,
    OK,
    UsageError,
    complain,
    say,
    unheard,
    users_mistake,
)
from bayesnet_track.cli.commands.start_boxes import parse_start, read_start
from bayesnet_track.cli.commands.viewing import begin, viewed
from bayesnet_track.cli.options.arguments import whole_number
from bayesnet_track.cli.options.outside import add_outside_options
from bayesnet_track.cli.options.plugins import add_plugins
from bayesnet_track.cli.options.rerun import add_rerun_option
from bayesnet_track.cli.options.runs import add_run_options
from bayesnet_track.cli.options.sources import add_depth_options, add_window_options
from bayesnet_track.cli.options.view import add_view_options
from bayesnet_track.numerics.compile_watch import WATCH

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.executors import Executing
    from bayesnet_track.runtime.live_view.view import LiveView
    from bayesnet_track.runtime.progress import Progress
    from bayesnet_track.runtime.results import FrameSource, Result, Summary
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.runtime.stop import StopRequest
    from bayesnet_track.sources.frames import Source

SCENE_GRAPHS = {
    "ball_between_children": "ball_between_children",
    "carried_box": "carried_box",
    "crowd": "crowd",
    "crowd_of_fifty": "crowd",
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
}
"""Scenes that do not run with the graph `two_squares`."""

SHOWN_NOTICES = 5

STOPPED = 130
"""Exit code of a run that a person stopped."""

ENDINGS = {
    "source_truncated": "the source is truncated",
    "source_damaged": "the source is damaged",
    "frame_size_changed": "stopped where the pictures change size",
    "interrupted": "interrupted",
}


def demo(options: argparse.Namespace) -> int:
    """Track in a built-in scene, then tell what happened and how well it went."""
    with viewed(options) as view:
        return _demo(options, view)


def _demo(options: argparse.Namespace, view: LiveView | None) -> int:
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.evaluate.runs import score_run
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.journal.reader import read_events
    from bayesnet_track.journal.text.explain import explain, has_several_targets
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.sources.scene_source import SceneSource

    with users_mistake():
        source = SceneSource.named(options.scene, options.seed, options.end)
    scene = source.scene
    graph = load_graph(options.graph or SCENE_GRAPHS.get(options.scene, "two_squares"))
    # Only what an earlier demo wrote there is replaced without being asked to.
    out = Path(options.out or f"runs/{options.scene}")
    options.overwrite = options.overwrite or options.out is None
    starts = [Start(box, plate) for plate, box in scene.starts if plate in graph.targets]
    starts = [] if has_births(graph) else starts or [Start(scene.start_box)]
    code = _track(options, graph, source, starts, out, video=True, view=view)
    if code != OK:
        return code
    directory = RunDirectory.open(out)
    say("\nwhat was decided, and why:")
    events = list(read_events(directory.journal))
    name_target = has_several_targets(events)
    for event in events:
        say(explain(event, name_target))
    if starts:
        say(f"\nagainst the true boxes{' of target 1' if name_target else ''}:")
        say(score_run(out, directory.truth, target="1").text(explained=True))
    told = min(29, source.expected_frames - 1)
    say(
        f"\nopen {directory.video} to watch it; `bayesnet-track report {out}` makes a page of it; "
        f"`bayesnet-track log {out} --why {told}` explains a frame"
    )
    return code


def run(options: argparse.Namespace) -> int:
    """Track in a video."""
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.graph.text.load import load_graph

    if options.end is not None and options.end <= options.start:
        raise UsageError(f"--end {options.end} must be greater than --start {options.start}")
    graph = load_graph(options.graph)
    if options.init_from is not None:
        starts = [read_start(Path(options.init_from), options.start)]
    else:
        starts = [parse_start(text) for text in options.init or ()]
    if not starts and not has_births(graph) and options.view is None:
        raise UsageError(
            "no start box: give --init X,Y,W,H or --init-from FILE, or --view to draw it, or a graph with "
            "`birth`, whose detectors find the targets"
        )
    out = Path(options.out)
    with viewed(options) as view, _opened(options) as source:
        code = _track(options, graph, source, starts, out, video=options.video, view=view)
    if code in (OK, INCOMPLETE) and sys.stdout.isatty() and not options.quiet:
        say(f"`bayesnet-track report {out}` makes a page, `bayesnet-track log {out}` tells its decisions")
    return code


def _opened(options: argparse.Namespace) -> Source:
    """The source, with depth where the options name a second eye or another sensor."""
    from bayesnet_track.sources.sources import open_source
    from bayesnet_track.sources.stereo_source import open_stereo_source

    window = (options.start, options.end, options.allow_network, options.on_resize)
    if options.right is None and options.stereo is None and options.depth is None:
        if options.calibration is not None:
            raise UsageError("--calibration is of a pair: give --right, --stereo or --depth, too")
        return open_source(options.source, *window, isolate_decoder=options.isolate_decoder)
    return open_stereo_source(
        options.source,
        *window,
        right=options.right,
        depth=options.depth,
        side_by_side=options.stereo is not None,
        calibration=options.calibration,
        isolate_decoder=options.isolate_decoder,
    )


def _track(
    options: argparse.Namespace,
    graph: CheckedGraph,
    source: FrameSource,
    starts: Sequence[Start],
    out: Path,
    video: bool,
    view: LiveView | None = None,
) -> int:
    from bayesnet_track.runtime.inputs import replayed
    from bayesnet_track.runtime.recording.rerun_sink import rerun_sinks
    from bayesnet_track.runtime.results import Summary
    from bayesnet_track.runtime.session import track
    from bayesnet_track.sources.detection_files import file_detector

    detections = getattr(options, "detections", None)
    if detections is not None:
        with users_mistake():
            file_detector(detections)
    inputs = getattr(options, "inputs", None)
    if inputs is not None:
        with users_mistake():
            replayed(Path(inputs))
    if view is not None:
        chosen = begin(options, view, graph, source, starts, out)
        if chosen is None:
            return options.stop.exit_code or STOPPED
        starts = chosen
    opaque = _opaque(graph)
    if opaque and options.checkpoint_every > 0:
        complain(
            f"{out}: what {', '.join(opaque)} keeps cannot be stored: `resume` would begin this run anew"
        )
    summary = Summary()
    with rerun_sinks(getattr(options, "rerun", None), graph.spec.name, options.overwrite) as sinks:
        results = track(
            graph,
            source,
            starts or None,
            out=out,
            seed=options.seed,
            overwrite=options.overwrite,
            video=video,
            executor=executor_of(options),
            sinks=sinks if view is None else [*sinks, view],
            summary=summary,
            detections=detections,
            inputs=view if inputs is None else inputs,
            budget_ms=_budget_ms(options, source),
            checkpoint_every=options.checkpoint_every,
        )
        return follow(options, results, summary, source.expected_frames, out, view)


def _opaque(graph: CheckedGraph) -> list[str]:
    """Agents that keep what no checkpoint can hold."""
    from bayesnet_track.observation.cue import installed_cues

    agents = {name: one.agent(name).agent.cue for one in graph.targets.values() for name in one.agents}
    cues = installed_cues(agents.values())
    return sorted(name for name, cue in agents.items() if cue in cues and cues[cue].opaque)


def _budget_ms(options: argparse.Namespace, source: FrameSource) -> float | None:
    """What a frame may take, where the options say so."""
    if getattr(options, "realtime", False):
        return 1000.0 * source.frame_interval_s
    budget: float | None = getattr(options, "budget_ms", None)
    return budget


def follow(
    options: argparse.Namespace,
    results: Generator[Result, None, None],
    summary: Summary,
    expected: int | None,
    out: Path,
    view: LiveView | None = None,
) -> int:
    """Track to the end or until a signal, showing how far it is of the frames `expected`; the exit code.

    A `view` may hold it between two frames, and stop it.
    """
    from bayesnet_track.engine.starts import StartError
    from bayesnet_track.observation.detector import DetectorError
    from bayesnet_track.runtime.executors import PlacingError
    from bayesnet_track.runtime.progress import Progress

    progress = Progress(sys.stderr, expected, sys.stderr.isatty(), options.log_json)
    stop: StopRequest = options.stop
    with ExitStack() as stack:
        if not options.quiet:
            stack.callback(unheard, progress.finish)
        stack.callback(results.close)
        try:
            for result in results:
                if not options.quiet:
                    _show(progress, summary, result)
                # Before the first frame is done there is nothing to finish: until then, signals act at once.
                if stop.between_frames():
                    break
                if view is not None and (view.hold(lambda: stop.signal is not None) or stop.between_frames()):
                    break
        except (StartError, DetectorError, PlacingError) as error:
            raise UsageError(str(error)) from error
    _say_end(out, summary)
    if stop.signal is not None:
        return stop.exit_code
    stop.is_patient = False
    if view is not None and view.controls.has_stopped:
        return STOPPED
    return OK if summary.complete else INCOMPLETE


def executor_of(options: argparse.Namespace) -> Executing:
    """How agents are asked, by the options of `add_executor_options`; raises UsageError."""
    from bayesnet_track.runtime.executors import Limits, PlacingError, make_executor, parse_places
    from bayesnet_track.runtime.system import NO_WORKERS, has_workers

    if options.executor == "processes" and not has_workers():
        raise UsageError(NO_WORKERS)
    patience, least = options.agent_timeout, Limits()
    limits = Limits(
        least.answer_s if patience is None else patience,
        max(least.first_s, patience or 0.0),
        options.agent_memory or 0,
    )
    try:
        places = parse_places(options.place)
    except PlacingError as error:
        raise UsageError(str(error)) from error
    return make_executor(
        options.executor,
        workers=options.workers,
        places=places,
        limits=limits,
    )


def _show(progress: Progress, summary: Summary, result: Result) -> None:
    active = dict.fromkeys(agent for metrics in result.targets for agent in metrics.active)
    lost = [metrics.target for metrics in result.targets if metrics.status == "lost"]
    status = ("tracking" if result.targets else "no target") if not lost else "lost"
    if not lost and any(metrics.status == "uncertain" for metrics in result.targets):
        status = "uncertain"
    if lost and len(result.targets) > 1:
        status = f"lost: {', '.join(lost)} of {len(result.targets)}"
    ud_px2 = max((metrics.ud_px2 for metrics in result.targets), default=0.0)
    # As if no time passed while kernels are compiled: the rate is that of frames.
    now = time.monotonic() - WATCH.seconds
    unheard(partial(progress.update, now, summary.frames, tuple(active), ud_px2, status))


def _say_end(out: Path, summary: Summary) -> None:
    from bayesnet_track.journal.text.explain import explain

    for notice in summary.notices[:SHOWN_NOTICES]:
        complain(explain(notice))
    if len(summary.notices) > SHOWN_NOTICES:
        complain(
            f"... and {len(summary.notices) - SHOWN_NOTICES} more; `bayesnet-track log {out}` tells them all"
        )
    at_work = summary.seconds - summary.compiling_s
    rate = f"{summary.frames / at_work if at_work > 0 else 0.0:.0f} per second"
    if summary.compiling_s >= 0.05:
        rate += f" without {summary.compiling_s:.1f} s of compiling"
    parts = [f"{_count(summary.frames, 'frame')} in {summary.seconds:.1f} s ({rate})"]
    parts.append(_count(summary.reconfigurations, "reconfiguration"))
    if summary.lost_frames:
        parts.append(f"lost in {_count(summary.lost_frames, 'frame')}")
    if not summary.complete:
        parts.append(ENDINGS[summary.reason])
    say(f"{out}: {', '.join(parts)}")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def add_demo(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    demo = commands.add_parser("demo", help="track in a built-in synthetic scene; nothing to download")
    demo.add_argument(
        "scene", nargs="?", default="two_squares", metavar="SCENE", help="default two_squares; see `list`"
    )
    demo.add_argument("--graph", help="graph to use instead of the scene's own")
    demo.add_argument(
        "--out", metavar="RUN", help="run directory (default runs/SCENE, replaced if it exists)"
    )
    demo.add_argument("--end", type=whole_number(1), metavar="N", help="frame to stop before")
    add_run_options(demo)
    add_view_options(demo)
    add_plugins(demo)


def add_run(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    run = commands.add_parser(
        "run",
        help="track in a video with a graph",
        epilog="`run --what-if RUN ...` is `what-if RUN ...`: an earlier run again with something changed.",
    )
    run.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    run.add_argument(
        "--source", required=True, help="video file, folder of images, glob, camera index, or URL"
    )
    run.add_argument("--out", metavar="RUN", required=True, help="run directory to write")
    add_depth_options(run)
    start = run.add_mutually_exclusive_group()
    start.add_argument(
        "--init",
        action="append",
        metavar="X,Y,W,H",
        help="start box in the first frame, top-left corner, px; PLATE:X,Y,W,H names the plate; "
        "give it again for a further target; needed unless the graph has `birth`",
    )
    start.add_argument(
        "--init-from", metavar="FILE", help="ground-truth file; its box of the first frame is the start box"
    )
    run.add_argument(
        "--detections", metavar="FILE", help="detections (MOT, JSON Lines) for a graph with births by them"
    )
    run.add_argument("--video", action="store_true", help="write the annotated video too (video.mkv)")
    add_outside_options(run)
    add_rerun_option(run)
    add_window_options(run)
    add_run_options(run)
    add_view_options(run)
    add_plugins(run)
