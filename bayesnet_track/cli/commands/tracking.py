"""The command that tracks in a video: `run`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from bayesnet_track.cli.batch.seeds import add_seeds_options, run_seeds
from bayesnet_track.cli.commands.answer import (
    UsageError,
    complain,
    users_file,
    users_mistake,
)
from bayesnet_track.cli.commands.start_boxes import parse_start, read_start, run_folder
from bayesnet_track.cli.commands.viewing import begin, open_view
from bayesnet_track.cli.following import STOPPED, Narrator, follow, users_start
from bayesnet_track.cli.options.arguments import (
    add_plugins,
    add_set_option,
    add_truth_format,
    add_view_options,
    set_values,
    whole_number,
)
from bayesnet_track.cli.options.runs import (
    add_outside_options,
    add_rerun_option,
    add_run_options,
    add_video_option,
)
from bayesnet_track.cli.options.sources import (
    add_depth_options,
    add_size_option,
    add_window_options,
    open_given,
)

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.executors import Executing
    from bayesnet_track.runtime.live_view.view import LiveView
    from bayesnet_track.runtime.results import FrameSource
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.sources.frames import Source


def run(options: argparse.Namespace) -> int:
    """Track in a video, with --seeds as often as there are seeds."""
    if options.seeds is not None:
        return run_seeds(options, run)
    if options.truth is not None:
        raise UsageError("--truth is for --seeds; `score RUN --truth FILE` scores one run")
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.graph.text.load import load_graph

    if options.end is not None and options.end <= options.start:
        raise UsageError(f"--end {options.end} must be greater than --start {options.start}")
    if options.video_side is not None and not options.video:
        raise UsageError("--video-side is for --video, which is not given")
    out = run_folder(options.out)
    graph = load_graph(options.graph)
    if options.set:
        graph = set_values(graph.text, options.set, masks=graph.masks)
    if options.init_from is not None:
        starts = [read_start(Path(options.init_from), options.start, options.truth_format)]
    else:
        starts = [parse_start(text) for text in options.init or ()]
    if not starts and not has_births(graph) and options.view is None:
        raise UsageError(
            "no start box: give --init X,Y,W,H or --init-from FILE, or --view to draw it, or a graph with "
            "`birth`, whose detectors find the targets"
        )
    with open_view(options) as view, open_given(options) as source:
        _say_size(options, source)
        return track_source(options, graph, source, starts, out, video=options.video, view=view)


def track_source(
    options: argparse.Namespace,
    graph: CheckedGraph,
    source: FrameSource,
    starts: Sequence[Start],
    out: Path,
    video: bool | Literal["mkv", "mp4"],
    view: LiveView | None = None,
) -> int:
    """Track from the start boxes and write the run to `out`; the exit code."""
    from bayesnet_track.runtime.recording.rerun_sink import rerun_sinks
    from bayesnet_track.runtime.results import Summary, replay_inputs
    from bayesnet_track.runtime.session import track
    from bayesnet_track.sources.detection_files import file_detector
    from bayesnet_track.sources.mot_lines import COLUMNS

    detections = getattr(options, "detections", None)
    if detections is not None:
        with users_file("--detections", f"a text file with MOT lines ({COLUMNS}) or JSON Lines"):
            file_detector(detections)
    inputs = getattr(options, "inputs", None)
    if inputs is not None:
        with users_mistake():
            replay_inputs(Path(inputs))
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
        with users_start():
            results = track(
                graph,
                source,
                starts or None,
                out=out,
                seed=options.seed,
                overwrite=options.overwrite,
                video=video,
                video_side=getattr(options, "video_side", None),
                keep_beliefs=getattr(options, "keep_beliefs", False),
                all_hypotheses=getattr(options, "all_hypotheses", False),
                horizon=getattr(options, "horizon", 0),
                executor=executor_of(options),
                sinks=[
                    *sinks,
                    *([] if view is None else [view]),
                    *([Narrator()] if options.verbose else []),
                ],
                summary=summary,
                detections=detections,
                inputs=view if inputs is None else inputs,
                budget_ms=_budget_ms(options, source),
                checkpoint_every=options.checkpoint_every,
                max_side=getattr(options, "max_side", None),
            )
        return follow(options, results, summary, source.expected_frames, out, view)


def _say_size(options: argparse.Namespace, source: Source) -> None:
    """Which pixels are meant where, if frames are made smaller; raises UsageError where they cannot be."""
    from bayesnet_track.runtime.preparation import resizing_of

    with users_mistake():
        resizing = resizing_of(source, options.max_side)
    if not (resizing.is_none or options.quiet):
        (width, height), (columns, rows) = resizing.source, resizing.tracked
        complain(
            f"frames of {width}x{height} px are tracked at {columns}x{rows} px: boxes are in pixels of the "
            "source, UD and lengths in the graph in pixels of the smaller frames"
        )


def _opaque(graph: CheckedGraph) -> list[str]:
    """Agents that keep what no checkpoint can hold."""
    from bayesnet_track.observation.cue import installed_cues

    agents = {name: one.agent(name).agent.cue for one in graph.targets.values() for name in one.agents}
    cues = installed_cues(agents.values())
    return sorted(name for name, cue in agents.items() if cue in cues and cues[cue].opaque)


def _budget_ms(options: argparse.Namespace, source: FrameSource) -> float | None:
    """What a frame may take, where the options say so."""
    from bayesnet_track.runtime.results import interval_of

    if getattr(options, "realtime", False):
        return 1000.0 * interval_of(source)
    budget: float | None = getattr(options, "budget_ms", None)
    return budget


def executor_of(options: argparse.Namespace) -> Executing:
    """How agents are asked, by the options of `add_executor_options`; raises UsageError."""
    from bayesnet_track.runtime.executors import Limits, PlacingError, make_executor, parse_places
    from bayesnet_track.runtime.system import has_workers, no_workers

    if options.executor == "processes" and not has_workers():
        raise UsageError(no_workers())
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


def add_run(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    run = commands.add_parser(
        "run",
        help="track targets in a video with a graph",
        epilog="`run --what-if RUN ...` is `what-if RUN ...`: an earlier run again with something changed.",
    )
    run.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    run.add_argument(
        "--source", required=True, help="video file, folder of images, glob, camera index, or URL"
    )
    run.add_argument("-o", "--out", metavar="RUN", required=True, help="run directory to write")
    add_set_option(run)
    add_depth_options(run)
    add_size_option(run)
    start = run.add_mutually_exclusive_group()
    start.add_argument(
        "--init",
        action="append",
        metavar="X,Y,W,H",
        help="start box in the first frame that is read (frame N with --start N), top-left corner, px; "
        "CLASS:X,Y,W,H names the class of target, where the graph has several; "
        "repeat it for further targets; needed unless the graph has `birth`",
    )
    start.add_argument(
        "--init-from", metavar="FILE", help="ground-truth file; its box of the first frame is the start box"
    )
    add_truth_format(run)
    run.add_argument(
        "--detections",
        metavar="FILE",
        help="file of detections (MOT, JSON Lines) for a graph whose births use `detections`",
    )
    add_video_option(run)
    run.add_argument(
        "--keep-beliefs", action="store_true", help="keep every frame's beliefs, for `smooth` (beliefs.jsonl)"
    )
    run.add_argument(
        "--all-hypotheses",
        action="store_true",
        help="write some hypotheses of each target in every frame, not only in those of at most 8 targets",
    )
    add_seeds_options(run)
    run.add_argument(
        "--horizon",
        type=whole_number(1),
        default=0,
        metavar="K",
        help="write where each target is expected 1 to K frames ahead (forecasts.jsonl)",
    )
    add_outside_options(run)
    add_rerun_option(run)
    add_window_options(run)
    add_run_options(run)
    add_view_options(run)
    add_plugins(run)
