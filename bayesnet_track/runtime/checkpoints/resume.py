"""Go on with a run that was broken off: in the end there is that of an unbroken run, byte for byte."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.engine.step import Engine
from bayesnet_track.journal import disk
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.events.runs import MachineChanged
from bayesnet_track.journal.reader import Notice, read_inputs
from bayesnet_track.journal.writer import PART, OutputError, write_atomically
from bayesnet_track.observation import plugins
from bayesnet_track.observation.cue_files import GivenCue
from bayesnet_track.observation.planes import Frame
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.arguments import (
    held_files,
    make_checkpointer,
    opaque_agents,
    place_cues,
)
from bayesnet_track.runtime.checkpoints.checkpoint import (
    EVERY_S,
    Checkpoint,
    CheckpointError,
    newest_checkpoint,
    read_checkpoint,
    remove,
    write_checkpoint,
)
from bayesnet_track.runtime.checkpoints.origins import (
    describe_machine,
    file_sha256,
    name_differences,
    steady,
    versions,
)
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.checkpoints.standing import (
    ResumeError,
    check_cues,
    check_files,
    check_outputs,
    check_same,
    standing,
)
from bayesnet_track.runtime.executors import Executing, make_executor
from bayesnet_track.runtime.pace import Deadline
from bayesnet_track.runtime.recording.manifest import finish_run, lock_run, settle, settle_broken, tidy
from bayesnet_track.runtime.recording.record import FilePositions, Recorder
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
from bayesnet_track.runtime.run import Resumed, RunPosition, run
from bayesnet_track.runtime.session import prepare, set_recorder
from bayesnet_track.runtime.stop import closed_at_exit

__all__ = ["ResumeError", "resume"]


@closed_at_exit
def resume(
    path: str | PathLike[str],
    *,
    source: FrameSource | None = None,
    motion: MotionModel | None = None,
    sinks: Sequence[Sink] = (),
    summary: Summary | None = None,
    inputs: str | PathLike[str] | InputsAt | None = None,
    checkpoint_every: float = EVERY_S,
    executor: str | Executing = "serial",
    workers: int | None = None,
    allow_plugins: Iterable[str] = (),
    cues: Iterable[GivenCue] = (),
    allow_other_machine: bool = False,
    notice: Notice | None = None,
) -> Generator[Result, None, None]:
    """Go on with the run in a run directory, yielding one result per frame from its checkpoint on.

    It goes on after the last checkpoint, or begins anew where there is none; where it is finished there is
    nothing to do. What came from outside after the checkpoint (``inputs.jsonl``) comes again. A budget stays.

    Args:
        path: the run directory.
        source: in place of the recipe's source, from its first frame: one of one's own.
        motion: the motion model of one's own, where the run had one.
        sinks: further observers, of the frames that are tracked now.
        summary: filled in, with what was before.
        inputs: what comes from outside after that; see `track`.
        checkpoint_every: as for `track`.
        executor: as for `track`; changes no result.
        workers: as for `track`.
        allow_plugins: as for `track`. What the run had is not allowed by that alone: its directory is data,
            and may come from elsewhere.
        cues: the cues of one's own that the run had, as for `track`: the same files, or objects of the same
            code.
        allow_other_machine: go on although the machine, its instruction sets or a library is another, which
            gives other last digits than an unbroken run has; the journal says so (`machine_changed`).
        notice: told of what is worth knowing: a torn line, a run that begins anew and why.

    Raises (when the first result is asked for; nothing is changed then):
        RecipeError: it is no run that can be done again.
        CheckpointError: the checkpoint is damaged, or not of this run.
        ResumeError: an output, the source or a version is not as it was.
        RunDirectoryError: another process is writing the run.
        SourceError: the source is gone.
        OutputError: an output cannot be written (later, too).
    """
    plugins.allow(allow_plugins)
    directory = RunDirectory(Path(path))
    settle_broken(directory)
    recipe = Recipe.read(directory)
    say: Notice = notice if notice is not None else lambda text: None
    with ExitStack() as stack:
        stack.enter_context(lock_run(directory))
        settle(directory)
        totals = summary if summary is not None else Summary()
        if standing(path).is_finished:
            tidy(directory)
            totals.complete, totals.reason = True, "end_of_source"
            return
        _check_plain(directory)
        cues = tuple(cues)
        check_cues(recipe, cues)
        read_whole = (*recipe.detection_files.values(), recipe.inputs, *recipe.models.values())
        check_steady = stack.enter_context(steady([file.place for file in read_whole if file is not None]))
        check_files(recipe)
        graph = recipe.load_graph(directory, cues)
        executing = make_executor(executor, workers=workers) if isinstance(executor, str) else executor
        at_hosts = executing.hosts != "engine" and bool(recipe.origin.cameras)
        check_same(recipe, source, motion, at_hosts)
        checkpoint = _checkpoint(directory, say)
        moves = _permit_move(recipe, checkpoint, allow_other_machine, say)
        open_camera = executing.open_camera if at_hosts else None
        opened = stack.enter_context(recipe.opened(open_camera)) if source is None else source
        files = {camera: file.place for camera, file in recipe.detection_files.items()}
        prepared = prepare(graph, opened, recipe.max_side, files, recipe.seed, motion)
        budget_ms = recipe.budget_ms
        engine = place_cues(stack, executing, prepared.engine, opened, budget_ms)
        chosen_inputs = recipe.inputs.place if inputs is None and recipe.inputs is not None else inputs
        earlier_inputs = inputs_before(directory)
        external_inputs = _external_inputs(earlier_inputs, as_inputs(chosen_inputs))
        check_steady()
        anew = _why_anew(checkpoint, engine)
        if anew:
            say(f"it begins anew: {anew}")
            checkpoint = None
        resumed: Resumed | None = None
        if checkpoint is not None:
            check_outputs(directory, checkpoint, say)
            reach = partial(_reach, checkpoint, engine, prepared.resizing)
            resumed = replace(_skip(opened, checkpoint.frame, reach, totals, say), events=moves)
        # From here on files are changed.
        _keep_pending(directory, earlier_inputs, -1 if checkpoint is None else checkpoint.frame)
        _clear(directory, checkpoint)
        if checkpoint is not None and "mot" in checkpoint.written.positions and not directory.mot.exists():
            checkpoint = _without_mot(directory, checkpoint)
        small_files = held_files(directory, getattr(opened, "truth_text", None))
        written = None if checkpoint is None else checkpoint.written
        recorder = Recorder(directory, graph, interval_of(opened), recipe.optional, written)
        stack.enter_context(recorder)
        set_recorder(recorder, recipe, replace(prepared, engine=engine), written)
        if checkpoint is not None and recipe.has_video:
            with recipe.opened() as reopened:
                recorder.redraw((item for item in reopened if isinstance(item, Frame)), checkpoint.frame)
        checkpointer = make_checkpointer(directory, engine, recorder, recipe, checkpoint_every)
        if checkpointer is not None:
            stack.enter_context(checkpointer)
        results = run(
            graph,
            opened,
            recipe.starts,
            seed=recipe.seed,
            sinks=[*sinks, recorder],
            summary=totals,
            engine=engine,
            inputs={file.path: file.sha256 for file in recipe.detection_files.values()},
            external_inputs=external_inputs,
            deadline=(
                None
                if budget_ms is None
                else Deadline(budget_ms, executing.processes, known_until=max(earlier_inputs, default=-1))
            ),
            checkpointer=checkpointer,
            after=resumed,
            max_side=recipe.max_side,
        )
        yield from results if resumed is None else _first_guarded(results, resumed.reached.frame.index)
        if totals.frames:
            finish_run(directory, recorder.finish(), small_files)


def _permit_move(
    recipe: Recipe, checkpoint: Checkpoint | None, is_allowed: bool, say: Notice
) -> tuple[MachineChanged, ...]:
    """The event to write where the run goes on elsewhere; raises ResumeError if that is not allowed."""
    if checkpoint is None:
        changes = name_differences(recipe.versions, versions())
    else:
        changes = name_differences(checkpoint.machine, describe_machine())
    if not changes:
        return ()
    reason = "; ".join(changes)
    if not is_allowed:
        raise ResumeError(
            "it was computed on another machine or with other libraries, which give other last digits: "
            f"{reason}; {setting('--allow-other-machine')} goes on all the same, and the result equals no "
            "unbroken run's"
        )
    say(f"it goes on although the machine or libraries differ: {reason}")
    return () if checkpoint is None else (MachineChanged(checkpoint.frame + 1, changes),)


def _check_plain(directory: RunDirectory) -> None:
    """Refuse files that are links or no files: what is written here must not end up elsewhere.

    Raises:
        ResumeError: names the file.
    """
    for name in FILES.values():
        path = directory.path / name
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise ResumeError(f"{path}: it is a link or no plain file; put the file itself there")


def _keep_pending(directory: RunDirectory, earlier: Mapping[int, Sequence[Input]], frame: int) -> None:
    """Write down what came for the frames after `frame`.

    Raises:
        OutputError: it cannot be written.
    """
    later = [entry for index, entries in sorted(earlier.items()) if index > frame for entry in entries]
    if later or directory.ahead.exists():
        write_atomically(directory.ahead, "".join(f"{to_json(entry)}\n" for entry in later).encode("utf-8"))


def _first_guarded(results: Generator[Result, None, None], frame: int) -> Generator[Result, None, None]:
    """The same results; a state with which the first one cannot be computed is an error of the checkpoint.

    Raises:
        CheckpointError: it cannot.
    """
    try:
        first = next(results, None)
    except Exception as error:
        if type(error).__module__.startswith("bayesnet_track") or isinstance(error, OSError):
            raise
        text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        raise CheckpointError(
            f"no frame can be tracked from the checkpoint of frame {frame}: {text}; its state was edited, or "
            "this is an error in bayesnet-track; without its checkpoints the run begins anew"
        ) from error
    if first is None:
        return
    try:
        yield first
    except GeneratorExit:
        results.close()
        raise
    yield from results


def _why_anew(checkpoint: Checkpoint | None, engine: Engine) -> str:
    opaque = opaque_agents(engine)
    if opaque:
        return f"what {', '.join(opaque)} keeps cannot be stored"
    return "there is no checkpoint" if checkpoint is None else ""


def _checkpoint(directory: RunDirectory, say: Notice) -> Checkpoint | None:
    checkpoint = newest_checkpoint(directory, say)
    if checkpoint is not None and checkpoint.recipe != file_sha256(directory.recipe):
        raise CheckpointError(f"{directory.recipe}: another recipe than that of the checkpoint beside it")
    return checkpoint


def _reach(checkpoint: Checkpoint, engine: Engine, resizing: Resizing, frame: Frame) -> RunPosition:
    return checkpoint.reached(engine, resizing.frame(frame))


def _skip(
    source: FrameSource,
    checkpoint_frame: int,
    reach: Callable[[Frame], RunPosition],
    summary: Summary,
    say: Notice,
) -> Resumed:
    """Read the source up to the checkpoint's frame, and take up the state after it.

    Raises:
        ResumeError: there is no such frame, or the checkpoint does not go with it.
    """
    items = iter(source)
    for item in items:
        if not isinstance(item, Frame):
            summary.notices.append(item)
        elif item.index == checkpoint_frame:
            say(f"it goes on after frame {item.index}")
            return Resumed(reach(item), items)
        elif item.index > checkpoint_frame:
            break
    raise ResumeError(f"the source has no frame {checkpoint_frame} any more, after which the run was")


def _external_inputs(earlier: Mapping[int, Sequence[Input]], later: InputsAt) -> InputsAt:
    """External inputs of the frames that had them, then those that come `later`."""
    return lambda frame: earlier[frame] if frame in earlier else later(frame)


def _without_mot(directory: RunDirectory, checkpoint: Checkpoint) -> Checkpoint:
    """The checkpoint of a run that has no ``tracks.txt`` any more, a long run of a crowd; raises OutputError.

    It takes the place of both that are there, before the records are cut off by which it is known.
    """
    positions = {key: place for key, place in checkpoint.written.positions.items() if key != "mot"}
    without = replace(checkpoint, written=FilePositions(positions))
    for _ in range(2):
        write_checkpoint(directory, without)
    return without


def _clear(directory: RunDirectory, checkpoint: Checkpoint | None) -> None:
    """Remove what no part of the run up to the checkpoint is; raises OutputError.

    Checkpoints go first where there is no going on from them: they must not outlive their outputs.
    """
    kept_files = {"recipe", "graph", "truth", "ahead"}
    if checkpoint is not None:
        kept_files |= {"checkpoint", "previous", *checkpoint.written.positions}
        _drop_damaged(directory)
    else:
        for path in (directory.checkpoint, directory.previous):
            if path.exists():
                remove(path)
    try:
        for key, name in FILES.items():
            disk.unlink(directory.path / (name + PART))
            # An empty journal says that here is a run.
            if key not in (*kept_files, "journal"):
                disk.unlink(directory.path / name)
    except OSError as error:
        raise OutputError(error.errno, f"cannot remove: {error.strerror}", str(error.filename)) from error


def _drop_damaged(directory: RunDirectory) -> None:
    """Remove checkpoints that cannot be read: a new one must not push a good one out by renaming them.

    Raises:
        OutputError: one cannot be removed.
    """
    for path in (directory.checkpoint, directory.previous):
        try:
            if path.exists():
                read_checkpoint(path)
        except CheckpointError:
            remove(path)


def inputs_before(directory: RunDirectory) -> Mapping[int, Sequence[Input]]:
    """External inputs, by frame.

    Raises:
        OSError: a file cannot be read.
        JournalError: it is damaged; says file and line.
    """
    by_frame = _by_frame(directory.ahead)
    for frame, inputs in _by_frame(directory.inputs).items():
        # A frame that was tracked again has what it was given then, unless that is only the first part of
        # what it had before: then the run was broken off while it was written again.
        if by_frame.get(frame, [])[: len(inputs)] != inputs:
            by_frame[frame] = inputs
    return by_frame


def _by_frame(path: Path) -> dict[int, list[Input]]:
    by_frame: dict[int, list[Input]] = {}
    for line in read_inputs(path) if path.exists() else ():
        by_frame.setdefault(line.frame, []).append(line)
    return by_frame
