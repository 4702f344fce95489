"""Track through a source in one call: `for result in track(...)`."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial, wraps
from os import PathLike
from pathlib import Path
from typing import Any, Literal, ParamSpec, cast

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.engine.queries import check_forecasts
from bayesnet_track.engine.starting import CameraPoints
from bayesnet_track.engine.starts import Start, StartError, check_depth, check_given
from bayesnet_track.engine.step import Engine, make_engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.writer import LineFile, write_atomically
from bayesnet_track.numerics.boxes import CornerBox
from bayesnet_track.observation import plugins
from bayesnet_track.observation.cue_files import GivenCue
from bayesnet_track.runtime.arguments import (
    GivenFrames,
    check_video,
    frames_of,
    longest_side,
    make_checkpointer,
    milliseconds,
    place_cues,
    resizing_of,
    say_unused_by_cues,
    whole_argument,
)
from bayesnet_track.runtime.checkpoints.checkpoint import EVERY_S, Checkpoints
from bayesnet_track.runtime.checkpoints.origins import file_sha256, model_files, steady
from bayesnet_track.runtime.checkpoints.recipe import Recipe, make_recipe, options_of
from bayesnet_track.runtime.executors import Executing, make_executor
from bayesnet_track.runtime.given_scans import check_scans, given_detector, source_or_times
from bayesnet_track.runtime.pace import Deadline
from bayesnet_track.runtime.recording.beliefs import check_kept
from bayesnet_track.runtime.recording.manifest import finish_run, lock_run, replace_run, settle
from bayesnet_track.runtime.recording.record import FilePositions, Forecaster, Recorder
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import (
    FrameSource,
    InputsAt,
    Result,
    Sink,
    Summary,
    as_inputs,
    interval_of,
)
from bayesnet_track.runtime.run import run
from bayesnet_track.runtime.several_cameras import (
    Named,
    by_engine_names,
    check_named,
    named_files,
    open_cameras,
    source_of,
)
from bayesnet_track.runtime.stop import closed_at_exit
from bayesnet_track.sources.detection_files import FileDetector
from bayesnet_track.sources.scan_files import ScanFile
from bayesnet_track.sources.several import SeveralSources
from bayesnet_track.sources.sources import open_source

P = ParamSpec("P")


def prepare_at_call(
    make: Callable[P, Generator[Result | None, None, None]],
) -> Callable[P, Generator[Result, None, None]]:
    """A generator function whose first item, None, is taken at the call: what is wrong is raised there.

    Its `close` then closes what it opened, also where nobody asks for a result.
    """

    @wraps(make)
    def prepare(*args: P.args, **kwargs: P.kwargs) -> Generator[Result, None, None]:
        results = make(*args, **kwargs)
        next(results)
        return cast(Generator[Result, None, None], results)

    return prepare


@prepare_at_call
@closed_at_exit
def track(
    graph: str | PathLike[str] | GraphSpec | CheckedGraph,
    source: str | PathLike[str] | FrameSource | Named | None,
    box: CornerBox | CameraPoints | Sequence[Start] | None = None,
    *,
    out: str | PathLike[str] | None = None,
    seed: int = 0,
    motion: MotionModel | None = None,
    detections: str | PathLike[str] | Named | None = None,
    overwrite: bool = False,
    video: bool | Literal["mkv", "mp4"] = False,
    video_side: int | None = None,
    keep_beliefs: bool = False,
    all_hypotheses: bool = False,
    tracks_csv: bool = False,
    horizon: int = 0,
    executor: str | Executing = "serial",
    workers: int | None = None,
    allow_plugins: Iterable[str] = (),
    cues: Iterable[GivenCue] = (),
    stride: int = 1,
    allow_network: bool = False,
    live: bool | None = None,
    value_range: tuple[float, float] | None = None,
    max_side: int | None = None,
    sinks: Sequence[Sink] = (),
    summary: Summary | None = None,
    inputs: str | PathLike[str] | InputsAt | None = None,
    budget_ms: float | None = None,
    checkpoint_every: float = EVERY_S,
) -> Generator[Result | None, None, None]:
    """Track through `source` with `graph`, yielding one result per frame.

    Args:
        graph: an installed graph's name, a YAML path, or a graph in Python.
        source: a video file, a folder of images, a glob, or an opened source; None for the times of
            `detections`, where the graph looks at no image. Of several cameras a mapping of one for each.
        box: start box x, y, w, h in the first frame, top-left corner, px; or one `Start` per target; none
            are needed where the graph has `birth`. Of a target that several cameras see a mapping: camera
            -> the point x, y or the box x, y, w, h that its image shows.
        out: run directory to write; nothing is written when None.
        seed: seed of all randomness.
        motion: a motion model of one's own in place of every plate's, such as `FunctionMotion`.
        detections: a file of detections, MOT or JSON Lines, for births by `detections`. A warning says
            which of them will not be used. Of several cameras a mapping of one for each.
        overwrite: replace an earlier run in `out`, which stays as it is until the first frame is tracked.
        video: write the annotated video into `out` too: video.mkv (True, "mkv") or video.mp4 ("mp4").
        video_side: scale the annotated video down so that its longer side is at most so many px, 16 or more;
            1920 when None.
        keep_beliefs: keep every frame's beliefs in `out`, for `bayesnet-track smooth`.
        all_hypotheses: write some hypotheses of each target into `out` in every frame, not only in those of
            at most eight targets.
        tracks_csv: write tracks.csv into `out` too, where the graph's targets have boxes and it asks no
            queries; `export --format csv` makes it of any run.
        horizon: frames ahead for which forecasts of every target are written into `out`; 0 for none.
        executor: how agents are asked, which changes no result: serial, processes, or what
            `make_executor` made.
        workers: processes at work at a time; as many as there are processors when None.
        allow_plugins: cues and detectors of other packages that may be loaded, in this process from now on,
            where graphs name them.
        cues: cues of one's own that the graph may name: declarations, or paths of Python files with a
            ``CUE``, which are run; path and SHA-256 of files are recorded in `out`.
        stride: track every `stride`-th frame of a `source` that is a text; see `open_source`.
        allow_network: let a `source` that is a text be a URL.
        live: of a URL, whether the newest frame is read, or every one; see `open_source`.
        value_range: the values that become black and white in frames of 8 bits, of a `source` that is a text
            with more bits; all that their type holds when None.
        max_side: track in frames whose longer side is at most so many px, 16 or more; boxes stay in the
            source's pixels, lengths in the graph count those of the smaller frames.
        sinks: further observers.
        summary: filled in as the run goes on.
        inputs: what comes from outside: the inputs.jsonl of an earlier run, to repeat it, or a function that
            is asked before each frame, such as a `runtime.results.Switchboard`.
        budget_ms: wall-clock milliseconds that a frame may take; where frames take longer, agents that say
            little and then hypotheses are done without. None for as long as it takes.
        checkpoint_every: seconds after which it is kept in `out` how far the run is, for
            `runtime.checkpoints.resume.resume` to go on from there; 0 keeps nothing.

    Raises (at the call, when nothing is written yet; that no agent can start, with the first result):
        GraphError: every error of the graph.
        CueError: a cue cannot be loaded, or is not what its declaration says.
        SourceError: nothing can be read from the source, or it has no depth where the graph needs it.
        StartError: no target can start from the box, or no agent of any target in the first frame.
        DetectorError: a detector cannot be made, or the graph and the file of detections do not go together.
        OSError: the file of detections or of inputs cannot be read.
        ValueError: it is malformed (file and line); an argument is out of range, or does not fit another.
        RunDirectoryError: `out` holds something else.
        OutputError: an output cannot be written (later, too).

    Each result has `targets` (xywh, sd, UD, status, active agents, ...), `covariances` and `decisions`::

        for result in track("general", "video.mp4", (57, 21, 31, 45)):
            one = result.targets[0]
            print(result.frame.index, one.xywh, one.status, one.active)
    """
    seed, stride = whole_argument("seed", seed, 0), whole_argument("stride", stride, 1)
    horizon, max_side, budget_ms = (
        whole_argument("horizon", horizon, 0),
        longest_side(max_side),
        milliseconds(budget_ms),
    )
    video_side = check_video(video, video_side)
    plugins.allow(allow_plugins)
    totals = summary if summary is not None else Summary()
    checked = load_graph(graph, tuple(cues))
    if keep_beliefs:
        check_kept(checked.spec)
    if horizon:
        check_forecasts(checked.spec)
    starts = _starts(box)
    if budget_ms is not None and inputs is not None and not callable(inputs):
        raise ValueError("a run that is repeated from its inputs has no budget: they say what was late")
    with ExitStack() as stack:
        replayed = None if callable(inputs) else inputs
        check_named(checked, source, detections)
        files_given = named_files(detections)
        check_steady = stack.enter_context(steady([*model_files(checked), *files_given.values(), replayed]))
        read = {str(path): file_sha256(path) for path in files_given.values()}
        external_inputs = as_inputs(inputs)
        executing = make_executor(executor, workers=workers) if isinstance(executor, str) else executor
        how = {"allow_network": allow_network, "stride": stride, "live": live, "value_range": value_range}
        opened = _open_frames(stack, checked, source, detections, executing, how)
        check_given(checked, starts, opened.width, opened.height)
        prepared = prepare(checked, opened, max_side, files_given, seed, motion)
        for start in starts:
            prepared.resizing.start(start)  # raises before anything is written
        whole_image = prepared.detectors.get(""), files_given.get("")
        check_scans(prepared.resized, prepared.engine, opened, *whole_image, bool(video))
        given_frames = _say_unused(prepared, files_given)
        if video and executing.hosts != "engine":
            raise ValueError(
                "an annotated video beside hosts of cameras, which keep the pixels; leave one out"
            )
        engine = place_cues(stack, executing, prepared.engine, opened, budget_ms)
        prepared = replace(prepared, engine=engine)
        all_sinks: list[Sink] = list(sinks)
        checkpointer: Checkpoints | None = None
        recorder: Recorder | None = None
        files: dict[str, bytes] = {}
        if out is not None:
            directory = RunDirectory.create(str(out), overwrite)
            stack.enter_context(lock_run(directory))
            settle(directory)
            directory.refuse(overwrite)  # before the lock was taken, another process could have written here
            requested = {"beliefs": keep_beliefs, "hypotheses": all_hypotheses, "csv": tracks_csv}
            requested["mp4"] = video == "mp4"
            recipe = make_recipe(
                checked,
                opened,
                starts,
                seed,
                detections=files_given,
                has_video=bool(video),
                own_motion=motion is not None,
                inputs=replayed,
                options=options_of(
                    engine,
                    budget_ms,
                    {name for name, is_asked in requested.items() if is_asked},
                    horizon,
                    max_side,
                    video_side,
                ),
            )
            check_steady()
            small_texts = {
                "graph": checked.text,
                "truth": getattr(opened, "truth_text", None),
                "recipe": recipe.text(),
            }
            files = {key: text.encode() for key, text in small_texts.items() if text is not None}
            recorder = _open_recorder(stack, directory, files, recipe, prepared)
            all_sinks.append(recorder)
            checkpointer = make_checkpointer(directory, engine, recorder, recipe, checkpoint_every)
            if checkpointer is not None:
                stack.enter_context(checkpointer)
        yield None
        last_index: int | None = None
        for result in run(
            checked,
            opened,
            starts,
            seed=seed,
            sinks=all_sinks,
            summary=totals,
            engine=engine,
            inputs=read,
            external_inputs=external_inputs,
            deadline=None if budget_ms is None else Deadline(budget_ms, executing.processes),
            checkpointer=checkpointer,
            max_side=max_side,
        ):
            last_index = result.frame.index
            yield result
        if last_index is not None and not checked.several_cameras:
            for read_frames in given_frames:
                read_frames.say_at_end(last_index)
        if recorder is not None and totals.frames:
            finish_run(directory, recorder.finish(), files)


def _open_frames(
    stack: ExitStack,
    graph: CheckedGraph,
    source: Any,
    detections: Any,
    executing: Executing,
    how: dict[str, Any],
) -> FrameSource:
    """The source of a run, closed by `stack` where it is opened here; `how` is as of `open_source`."""
    frames = source if graph.several_cameras else source_or_times(source, graph, detections)
    if graph.several_cameras and not isinstance(frames, SeveralSources):
        return stack.enter_context(open_cameras(graph, frames, detections, executing, **how))
    if isinstance(frames, str | PathLike):
        return stack.enter_context(open_source(str(frames), **how))
    defaults = {"stride": 1, "live": None, "value_range": None}
    for option, default in defaults.items():
        if how[option] != default:
            raise ValueError(f"{option} is for a source that is opened here; this one is open already")
    if not hasattr(frames, "width"):
        raise TypeError(
            f"track: a source of type {type(frames).__name__}; allowed: the path of a video, a folder or "
            "a pattern of images, or what open_source gives; for frames in memory use Tracker.init and "
            "update"
        )
    opened: FrameSource = frames
    return opened


@dataclass(frozen=True, eq=False)
class Prepared:
    """A graph made ready for the frames of a source and its files of detections.

    Attributes:
        graph: in pixels of the source.
        resized: the same in pixels of the tracked frames.
        source: where frames come from.
        resizing: from the source's pixels to the tracked ones.
        detectors: camera -> detector of its file of detections; "" of a graph without named cameras.
        engine: made from `resized`.
    """

    graph: CheckedGraph
    resized: CheckedGraph
    source: FrameSource
    resizing: Resizing
    detectors: Mapping[str, FileDetector | ScanFile]
    engine: Engine


def prepare(
    graph: CheckedGraph,
    source: FrameSource,
    max_side: int | None,
    files: Mapping[str, str | PathLike[str]],
    seed: int,
    motion: MotionModel | None,
) -> Prepared:
    """Make the engine of a run, new or resumed; `files` are those of detections, by camera.

    Raises:
        DetectorError: a detector cannot be made, or the graph and a file do not go together.
        SourceError: an agent needs depth, which the source has not.
        ValueError: frames with depth, or quantities that are no boxes, would be resized.
    """
    resizing = resizing_of(source, max_side)
    resized = resizing.graph(graph)
    detectors = {
        camera: resizing.detector(given_detector(resized, Path(path))) for camera, path in files.items()
    }
    motions = None if motion is None else dict.fromkeys(resized.targets, motion)
    engine = make_engine(resized, seed, motion=motions, detectors=by_engine_names(detectors))
    check_depth(engine, source)
    return Prepared(graph, resized, source, resizing, detectors, engine)


def _say_unused(prepared: Prepared, files: Mapping[str, str | PathLike[str]]) -> list[GivenFrames]:
    """The frames of each file of detections, after notices of what in files and cues will not be used."""
    given_frames: list[GivenFrames] = []
    for camera, detector in prepared.detectors.items():
        if isinstance(detector, FileDetector):
            source = source_of(prepared.source, camera)
            of_camera = GivenFrames(Path(files[camera]), detector.found, frames_of(source))
            size = (source.width, source.height) if camera else prepared.resizing.tracked
            of_camera.say(prepared.resized, size)
            given_frames.append(of_camera)
    say_unused_by_cues(prepared.resized, prepared.source)
    return given_frames


def _open_recorder(
    stack: ExitStack,
    directory: RunDirectory,
    files: Mapping[str, bytes],
    recipe: Recipe,
    prepared: Prepared,
) -> Recorder:
    """The recorder of a new run, which takes the place of an earlier one with its first frame."""
    take_place: Callable[[], None] | None = None
    if directory.holds_run:
        take_place = partial(replace_run, directory, files)
    else:
        directory.clear()
        _begin(directory, files)
    recorder = Recorder(
        directory, prepared.graph, interval_of(prepared.source), recipe.optional, before_first=take_place
    )
    stack.enter_context(recorder)
    set_recorder(recorder, recipe, prepared)
    return recorder


def set_recorder(
    recorder: Recorder, recipe: Recipe, prepared: Prepared, written: FilePositions | None = None
) -> None:
    """Set size of the video and horizon of forecasts as the recipe of the run has them."""
    recorder.longest_side = recipe.video_side or recorder.longest_side
    if recipe.horizon:
        recorder.look_ahead(Forecaster(prepared.engine, recipe.horizon, prepared.resizing), written)


def _starts(box: CornerBox | CameraPoints | Sequence[Start] | None) -> list[Start]:
    if box is None:
        return []
    if isinstance(box, Mapping):
        return [Start(points=box)]
    starts = [part for part in box if isinstance(part, Start)]
    if not starts:
        return [Start(cast(CornerBox, box))]
    if len(starts) < len(box):
        raise StartError(f"start {box!r}: one box x, y, w, h, or one Start per target, not both")
    return starts


def _begin(directory: RunDirectory, files: Mapping[str, bytes]) -> None:
    """Write down what is asked for, before anything is done; the recipe comes last: with it all is there.

    Raises:
        OutputError: it cannot be written.
    """
    # What holds a journal counts as a run, which may be overwritten.
    LineFile(directory.journal).close()
    for key, data in files.items():
        write_atomically(directory.path / FILES[key], data)
