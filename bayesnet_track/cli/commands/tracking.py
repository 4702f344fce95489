"""The command that tracks in a video, `run`: with one seed, or with several and one summary of them."""

from __future__ import annotations

import argparse
import json
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from bayesnet_track.cli.arguments import (
    INCOMPLETE,
    OK,
    TRUTH_LINES,
    UsageError,
    add_plugins,
    add_set_option,
    add_truth_format,
    add_view_options,
    complain,
    free_folder,
    parse_start,
    read_start,
    run_folder,
    say,
    set_values,
    users_file,
    users_mistake,
    whole_number,
)
from bayesnet_track.cli.following import STOPPED, Narrator, begin_view, follow_run, open_view, users_start
from bayesnet_track.cli.options import (
    add_depth_options,
    add_outside_options,
    add_rerun_option,
    add_run_options,
    add_size_option,
    add_video_option,
    add_window_options,
    given_once_or_named,
    open_cameras_given,
    open_given,
    say_size,
)

if TYPE_CHECKING:
    from bayesnet_track.cli.batch.work import Row
    from bayesnet_track.evaluate.truth import TruthForm
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.executors import Executing
    from bayesnet_track.runtime.live_view.view import LiveView
    from bayesnet_track.runtime.results import FrameSource
    from bayesnet_track.runtime.run import Start


Cell = str | int | float | None


@dataclass(frozen=True)
class SeedSpread:
    """A measure over seeds.

    Attributes:
        seeds: how many seeds have it.
        mean: over them.
        low: lower end of the 95 % interval of the mean (Student's t), None of a single seed.
        high: its upper end.
        least: the smallest.
        most: the largest.
    """

    seeds: int
    mean: float
    low: float | None
    high: float | None
    least: float
    most: float


def seed_spread(values: Sequence[float], confidence: float = 0.95) -> SeedSpread:
    """Spread of values, one per seed; at least one.

    The interval is that of the mean over seeds, as if the values were normal, and for these videos only.

    >>> one = seed_spread([1.0, 2.0, 3.0])
    >>> one.mean, round(one.low, 3), round(one.high, 3)
    (2.0, -0.484, 4.484)
    """
    count, mean = len(values), math.fsum(values) / len(values)
    low = high = None
    if count > 1:
        from scipy.special import stdtrit

        variance = math.fsum((value - mean) ** 2 for value in values) / (count - 1)
        reach = float(stdtrit(count - 1, 0.5 + confidence / 2)) * math.sqrt(variance / count)
        low, high = mean - reach, mean + reach
    return SeedSpread(count, mean, low, high, min(values), max(values))


def spread_over_seeds(rows: Iterable[Mapping[str, Cell]], names: Sequence[str]) -> dict[str, SeedSpread]:
    """The measures `names` of rows with a `seed`; rows of one seed, such as its videos, count by their mean.

    Only videos that every seed has count, so that seeds are compared over the same ones.
    """
    all_rows = list(rows)
    seeds = {row["seed"] for row in all_rows}
    spreads = {}
    for name in names:
        by_video: dict[Cell, dict[Cell, float]] = defaultdict(dict)
        for row in all_rows:
            value = row.get(name)
            if isinstance(value, int | float):
                by_video[row.get("video")][row["seed"]] = float(value)
        complete = [of_video for of_video in by_video.values() if of_video.keys() == seeds]
        if complete:
            means = [
                math.fsum(of_video[seed] for of_video in complete) / len(complete)
                for seed in sorted(seeds, key=str)
            ]
            spreads[name] = seed_spread(means)
    return spreads


def spread_text(spreads: Mapping[str, SeedSpread]) -> str:
    """A table of them, one line each."""
    lines = [f"{'':18}{'mean':>10}  {'95 % interval':22}{'smallest':>10}{'largest':>10}"]
    for name, spread in spreads.items():
        interval = "" if spread.low is None else f"{spread.low:.4g} to {spread.high:.4g}"
        lines.append(f"{name:18}{spread.mean:>10.4g}  {interval:22}{spread.least:>10.4g}{spread.most:>10.4g}")
    return "\n".join(lines)


WITH_TRUTH = ("auc", "auc_strict", "precision20", "mean_iou", "lost_episodes", "mota", "idf1", "hota")
MEASURES = (*WITH_TRUTH, "score_mean", "lost_frames", "reconfigurations", "agents_per_frame", "fps")
"""Of a summary, in this order; what depends on ground truth first."""


def add_seeds_options(parser: argparse.ArgumentParser) -> None:
    """`--seeds`, `--truth`."""
    parser.add_argument(
        "--seeds",
        type=whole_number(1),
        metavar="N",
        help="N runs, with seeds from --seed on, in RUN/seed-0 ...; at the end a summary with intervals",
    )
    parser.add_argument("--truth", metavar="FILE", help="ground-truth file to score with; only with --seeds")


def run_seeds(options: argparse.Namespace, once: Callable[[argparse.Namespace], int]) -> int:
    """Call `once` for each seed, with its own --seed and --out; then summarise."""
    from bayesnet_track.evaluate.truth import is_mot

    for name in ("view", "rerun", "inputs"):
        if getattr(options, name, None) is not None:
            raise UsageError(f"--{name} is for one run; leave out --seeds")
    truth = options.truth or options.init_from
    if options.truth:
        with users_file("--truth", f"{TRUTH_LINES}, or MOT lines"):
            is_mot(options.truth, options.truth_format)  # a file that cannot be read is known at once
    rows, worst = [], OK
    for seed in range(options.seed, options.seed + options.seeds):
        folder = str(Path(options.out) / f"seed-{seed}")
        changes = {"seed": seed, "out": folder, "seeds": None, "truth": None, "json": False}
        changes["quiet"] = options.quiet or options.json
        code = once(argparse.Namespace(**{**vars(options), **changes}))
        if code not in (OK, INCOMPLETE):
            return code
        worst = max(worst, code)
        with users_mistake():
            rows.append(row_of_run(options.graph, seed, folder, truth, options.truth_format))
    say_summary(rows, options, {"run": options.out})
    return worst


def row_of_run(graph: str, seed: int, folder: str, truth: str | None, form: TruthForm | None = None) -> Row:
    """The measures of a run; raises OSError, ValueError where a file cannot be read."""
    from bayesnet_track.cli.batch.jobs import BatchVideo, Job
    from bayesnet_track.cli.batch.work import row_of
    from bayesnet_track.evaluate.runs import score_several
    from bayesnet_track.evaluate.truth import is_mot

    has_targets = truth is not None and is_mot(truth, form)
    video = BatchVideo(folder, "", truth=None if has_targets else truth)
    row = row_of(Job(graph, video, seed, folder, truth_format=form))
    if has_targets and truth is not None:
        scores = score_several(Path(folder), Path(truth), form)
        row |= {"mota": scores.mota, "idf1": scores.idf1, "hota": scores.hota}
    return row


def summary_of(rows: Sequence[Row]) -> dict[str, SeedSpread]:
    """The measures of runs over their seeds."""

    return spread_over_seeds(rows, MEASURES)


def say_summary(rows: Sequence[Row], options: argparse.Namespace, head: dict[str, object]) -> None:
    """The summary as text, or with --json as one object."""

    summary = summary_of(rows)
    if options.json:
        measures = {name: asdict(spread) for name, spread in summary.items()}
        say(json.dumps({**head, "seeds": [row["seed"] for row in rows], "summary": measures}))
    elif not options.quiet:
        seeds = sorted({row["seed"] for row in rows}, key=str)
        say(f"{head['run']}: {len(seeds)} seeds, {seeds[0]} to {seeds[-1]}\n{spread_text(summary)}")


NO_START = (
    "no start box: give --init X,Y,W,H or --init-from FILE, or --view to draw it, or a graph with `birth`, "
    "whose detectors find the targets"
)


def _run(options: argparse.Namespace) -> int:
    """Track in a video, with --seeds as often as there are seeds."""
    if options.out is None:
        options.out = str(free_folder(f"runs/{Path(options.graph).stem}", options.overwrite))
    if options.seeds is not None:
        return run_seeds(options, _run)
    if options.truth is not None:
        raise UsageError("--truth is for --seeds; `score RUN --truth FILE` scores one run")
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.runtime.given_scans import source_or_times

    if options.end is not None and options.end <= options.start:
        raise UsageError(f"--end {options.end} must be greater than --start {options.start}")
    if options.video_side is not None and not options.video:
        raise UsageError("--video-side is for --video, which is not given")
    folder = run_folder(options.out)
    graph = load_graph(options.graph)
    if options.set:
        graph = set_values(graph.text, options.set, True, graph.masks, graph.calibrations)
    if options.init_from is not None:
        starts = [read_start(Path(options.init_from), options.start, options.truth_format)]
    else:
        starts = [parse_start(text) for text in options.init or ()]
    if not starts and not has_births(graph) and options.view is None:
        raise UsageError(NO_START)
    options.source = given_once_or_named("--source", options.source, graph)
    options.detections = given_once_or_named("--detections", options.detections, graph)
    if graph.several_cameras:
        options.executing = executor_of(options)
        _check_detections(options, graph)
        with users_mistake(), open_cameras_given(options, graph, options.executing) as cameras:
            return track_source(options, graph, cameras, starts, folder, video=options.video)
    with users_mistake():
        options.source = str(source_or_times(options.source, graph, options.detections))
    _check_detections(options, graph)
    with open_view(options) as view, open_given(options) as source:
        say_size(options, source)
        return track_source(options, graph, source, starts, folder, video=options.video, view=view)


def _check_detections(options: argparse.Namespace, graph: CheckedGraph) -> None:
    """Read the files of --detections, before one stands for a source; raises UsageError."""
    from bayesnet_track.runtime.given_scans import given_detector
    from bayesnet_track.runtime.several_cameras import named_files
    from bayesnet_track.sources.mot_lines import COLUMNS

    kinds = f"a text file with MOT lines ({COLUMNS}), JSON Lines, or a CSV of what sensors measured"
    for camera, path in named_files(options.detections).items():
        with users_file(f"--detections of {camera}:" if camera else "--detections", kinds):
            given_detector(graph, str(path))


def track_source(
    options: argparse.Namespace,
    graph: CheckedGraph,
    source: FrameSource,
    starts: Sequence[Start],
    folder: Path,
    video: bool | Literal["mkv", "mp4"],
    view: LiveView | None = None,
) -> int:
    """Track from the start boxes and write the run to `folder`; the exit code."""
    from bayesnet_track.runtime.recording.rerun_sink import rerun_sinks
    from bayesnet_track.runtime.results import Summary, replay_inputs
    from bayesnet_track.runtime.session import track

    inputs = getattr(options, "inputs", None)
    if inputs is not None:
        with users_file("--inputs", "inputs.jsonl of an earlier run"):
            replay_inputs(Path(inputs))
    if view is not None:
        selected = begin_view(options, view, graph, source, starts, folder)
        if selected is None:
            return options.stop.exit_code or STOPPED
        starts = selected
    opaque = _opaque(graph)
    if opaque and options.checkpoint_every > 0:
        complain(
            f"{folder}: what {', '.join(opaque)} keeps cannot be stored: `resume` would begin this run anew"
        )
    summary = Summary()
    with rerun_sinks(getattr(options, "rerun", None), graph.spec.name, options.overwrite) as sinks:
        with users_start():
            results = track(
                graph,
                source,
                starts or None,
                out=folder,
                seed=options.seed,
                overwrite=options.overwrite,
                video=video,
                video_side=getattr(options, "video_side", None),
                keep_beliefs=getattr(options, "keep_beliefs", False),
                all_hypotheses=getattr(options, "all_hypotheses", False),
                tracks_csv=getattr(options, "tracks_csv", False),
                horizon=getattr(options, "horizon", 0),
                executor=getattr(options, "executing", None) or executor_of(options),
                sinks=[*sinks, *([] if view is None else [view]), *([Narrator()] if options.verbose else [])],
                summary=summary,
                detections=getattr(options, "detections", None),
                inputs=view if inputs is None else inputs,
                budget_ms=_budget_ms(options, source),
                checkpoint_every=options.checkpoint_every,
                max_side=getattr(options, "max_side", None),
            )
        return follow_run(options, results, summary, source.expected_frames, folder, view)


def _opaque(graph: CheckedGraph) -> list[str]:
    """Agents that keep what no checkpoint can hold."""
    from bayesnet_track.observation.cue import installed_cues

    agents = {
        name: target.agent(name).agent.cue for target in graph.targets.values() for name in target.agents
    }
    cues = installed_cues(agents.values())
    return sorted(name for name, cue in agents.items() if cue in cues and cues[cue].opaque)


def _budget_ms(options: argparse.Namespace, source: FrameSource) -> float | None:
    """Time that a frame may take, where the options limit it."""
    from bayesnet_track.runtime.results import interval_of

    if getattr(options, "realtime", False):
        return 1000.0 * interval_of(source)
    budget: float | None = getattr(options, "budget_ms", None)
    return budget


def executor_of(options: argparse.Namespace) -> Executing:
    """The executor that asks agents, by the options of `add_executor_options`; raises UsageError."""
    from bayesnet_track.runtime.executors import Limits, PlacingError, make_executor, parse_places
    from bayesnet_track.runtime.stop import has_workers, no_workers

    if (options.executor == "processes" or options.hosts != "engine") and not has_workers():
        raise UsageError(no_workers())
    patience, defaults = options.agent_timeout, Limits()
    limits = Limits(
        defaults.answer_s if patience is None else patience,
        max(defaults.first_s, patience or 0.0),
        options.agent_memory or 0,
        getattr(options, "allow_other_machine", False),
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
        hosts=options.hosts,
    )


def _add_run(commands: argparse._SubParsersAction[Any]) -> None:
    run = commands.add_parser(
        "run",
        help="track targets in a video with a graph",
        epilog="`run --what-if RUN ...` is `what-if RUN ...`, which repeats a run with something changed.",
    )
    run.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    run.add_argument(
        "--source",
        action="append",
        metavar="SOURCE",
        help="video file, folder of images, glob, camera index, or URL; needed unless --detections is a CSV "
        "of what sensors measured; CAMERA=SOURCE for each camera of a graph with several",
    )
    run.add_argument(
        "-o",
        "--out",
        metavar="RUN",
        help="run directory to write (default runs/GRAPH, or where that exists runs/GRAPH-2, ...)",
    )
    add_set_option(run)
    add_depth_options(run)
    add_size_option(run)
    start = run.add_mutually_exclusive_group()
    start.add_argument(
        "--init",
        action="append",
        metavar="X,Y,W,H",
        help="start box in the first frame that is read (frame N with --start N): left, top, width, height, "
        "px; CLASS:X,Y,W,H gives the target's class if the graph has several; "
        "of several cameras 'NORTH=X,Y SOUTH=X,Y', the point in the image of each, or boxes; "
        "repeat it for more targets; needed unless the graph has `birth`",
    )
    start.add_argument(
        "--init-from", metavar="FILE", help="ground-truth file; its box of the first frame is the start box"
    )
    add_truth_format(run)
    run.add_argument(
        "--detections",
        action="append",
        metavar="FILE",
        help="file of detections (MOT, JSON Lines; CSV for sensors of quantities) for a graph whose births "
        "use `detections`; CAMERA=FILE for each camera of a graph with several",
    )
    add_video_option(run)
    run.add_argument(
        "--keep-beliefs", action="store_true", help="keep every frame's beliefs, for `smooth` (beliefs.jsonl)"
    )
    run.add_argument(
        "--all-hypotheses",
        action="store_true",
        help="also in frames of more than 8 targets, write some hypotheses of each target, and all digits",
    )
    run.add_argument(
        "--tracks-csv",
        action="store_true",
        help="also write tracks.csv, a row per target and frame with status, score and UD; `export --format "
        "csv` makes one from any run",
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


COMMANDS = {"run": (_add_run, _run)}
