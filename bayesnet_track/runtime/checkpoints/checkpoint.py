"""Checkpoints: where a run can go on from, written whole or not at all, read without trusting them.

A checkpoint says how far every output file is written, which bytes are in it, and what the engine's state is.
It is written whole or not at all, after the outputs have reached the disk, and removed once the run is
finished.
"""

from __future__ import annotations

import hashlib
import json
import time
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.step import Engine, State
from bayesnet_track.journal import disk
from bayesnet_track.journal.codec import describe_other
from bayesnet_track.journal.writer import OutputError, Position, write_atomically
from bayesnet_track.observation.planes import Frame, PointMap, RightEye
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.checkpoints.origins import describe_machine
from bayesnet_track.runtime.checkpoints.state_codec import (
    StateError,
    decode_state,
    encode_state,
    state_format,
)
from bayesnet_track.runtime.recording.record import FilePositions, Recorder
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory
from bayesnet_track.runtime.recording.videowriter import Background
from bayesnet_track.runtime.run import RunPosition

CHECKPOINT_FORMAT = 4
"""Raised when older programs cannot read what is written; each program reads its own format only."""
MAGIC = b"bayesnet_track checkpoint "

MOST_BYTES = 1 << 30
"""A thousand times what fifty targets take."""


class CheckpointError(ValueError):
    """A checkpoint that is damaged, of another version, or does not go with what lies beside it."""


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A point from which a run can go on.

    Attributes:
        recipe: SHA-256 of ``run.json``.
        frame: index of the last frame.
        pixels: checksum of its pixels.
        frames: frames that were tracked.
        reconfigurations: how many times an agent was switched on or off.
        lost_frames: frames in which a target was lost.
        written: how far the outputs are written.
        machine: what its numbers were computed on; see `runtime.checkpoints.origins`.
        state: the engine's state, as `encode_state` has it.
    """

    recipe: str
    frame: int
    pixels: int
    frames: int
    reconfigurations: int
    lost_frames: int
    written: FilePositions
    machine: Mapping[str, str]
    state: bytes

    def reached(self, engine: Engine, frame: Frame) -> RunPosition:
        """The position that it stands for, given its last frame, read again.

        Raises:
            CheckpointError: the frame has other pixels, or the state is of another version or graph.
        """
        try:
            state: State = decode_state(self.state, engine, frame)
        except StateError as error:
            raise CheckpointError(f"the checkpoint's state: {error}") from error
        if _pixels_of(frame, state.history.cameras.cameras) != self.pixels:
            raise CheckpointError(f"frame {frame.index} of the source has other pixels than it had")
        return RunPosition(frame, state, self.frames, self.reconfigurations, self.lost_frames)


def _pixels_of(frame: Frame, cameras: Sequence[str] = ()) -> int:
    """A checksum of all that a frame shows, of several cameras in those that are on, or in all."""
    if frame.cameras is not None:
        switched_on = cameras or tuple(frame.cameras)
        images = [image for camera, image in frame.cameras.items() if camera in switched_on]
        checksums = [_pixels_of(image) for image in images if image.is_readable]
        return zlib.crc32(np.array(checksums, np.uint32).tobytes())
    if frame.place is not None:
        return int(frame.place.checksum)
    planes: list[NDArray[Any]] = [frame.image]
    match frame.depth:
        case RightEye():
            planes.append(frame.depth.image)
        case PointMap():
            planes.append(frame.depth.points)
    checksum = 0
    for pixels in planes:
        checksum = zlib.crc32(np.ascontiguousarray(pixels), checksum)  # type: ignore[arg-type]
    return checksum


def write_checkpoint(directory: RunDirectory, checkpoint: Checkpoint) -> None:
    """Write it whole or not at all; the one before it is kept as `checkpoint.previous`.

    Raises:
        OutputError: it cannot be written; the one before it is as it was.
    """
    positions = checkpoint.written.positions
    header = {
        "state": state_format(),
        "machine": dict(checkpoint.machine),
        **{name: getattr(checkpoint, name) for name in _NUMBERS},
        "outputs": {name: [place.size, place.sha256] for name, place in positions.items()},
        "ids": dict(checkpoint.written.ids),
    }
    body = json.dumps(header).encode("ascii") + b"\n" + checkpoint.state
    seal = hashlib.sha256(body).hexdigest().encode("ascii")
    data = b"\n".join((MAGIC + str(CHECKPOINT_FORMAT).encode(), seal, body))
    write_atomically(directory.checkpoint, data, directory.previous)


def newest_checkpoint(directory: RunDirectory, say: Callable[[str], None] | None = None) -> Checkpoint | None:
    """The last checkpoint of a run, or the one before where that is damaged or gone; None without any.

    `say` is told when it is not the last one, and why.

    Raises:
        CheckpointError: there are only damaged ones, or ones of another version.
    """
    wrong: CheckpointError | None = None
    for path in (directory.checkpoint, directory.previous):
        try:
            checkpoint = read_checkpoint(path)
        except FileNotFoundError:
            continue
        except CheckpointError as error:
            wrong = wrong or error
            continue
        if wrong is not None and say is not None:
            say(f"{wrong}; the checkpoint before it is used, of frame {checkpoint.frame}")
        return checkpoint
    if wrong is not None:
        raise wrong
    return None


def read_checkpoint(path: Path) -> Checkpoint:
    """The checkpoint in a file.

    Raises:
        CheckpointError: it is damaged or of another version.
        OSError: it cannot be read.
    """
    if path.stat().st_size > MOST_BYTES:
        raise CheckpointError(f"{path}: more than {MOST_BYTES >> 20} MiB: not a checkpoint")
    magic, _, content = path.read_bytes().partition(b"\n")
    seal, _, body = content.partition(b"\n")
    if not magic.startswith(MAGIC):
        raise CheckpointError(f"{path}: not a checkpoint")
    if magic != MAGIC + str(CHECKPOINT_FORMAT).encode():
        version_text = magic[len(MAGIC) :][:20].decode("ascii", "replace")
        raise CheckpointError(
            _of_another(
                path, f"format {version_text} of checkpoints; this version reads format {CHECKPOINT_FORMAT}"
            )
        )
    if hashlib.sha256(body).hexdigest().encode("ascii") != seal:
        raise CheckpointError(f"{path}: it is damaged")
    line, _, state = body.partition(b"\n")
    try:
        header = json.loads(line)
        if header["state"] != state_format():
            raise CheckpointError(_of_another(path, "its state has other fields than this version stores"))
        positions = {name: Position(size, sha256) for name, (size, sha256) in header["outputs"].items()}
        numbers = {name: header[name] for name in _NUMBERS}
        ids, machine = header["ids"], header["machine"]
        are_right = (
            positions.keys() <= FILES.keys()
            and _are_counts([numbers[name] for name in _NUMBERS[1:]])
            and _are_counts([place.size for place in positions.values()])
            and _are_counts(ids.values())
            and all(isinstance(value, str) for value in machine.values())
        )
    except CheckpointError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        are_right = False
    if not are_right:
        raise CheckpointError(f"{path}: it is damaged or was edited")
    return Checkpoint(**numbers, written=FilePositions(positions, ids), machine=machine, state=state)


def _are_counts(values: Iterable[object]) -> bool:
    return all(type(value) is int and 0 <= value < 1 << 63 for value in values)


def _of_another(path: Path, fault: str) -> str:
    """Describe a checkpoint of another program version, and which one can resume it."""
    try:
        versions = json.loads((path.parent / FILES["recipe"]).read_bytes())["versions"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        versions = None
    sentence, anew = describe_other(fault, versions, "resume"), setting("--overwrite")
    return f"{path}: {sentence}, or start the run again with {anew}"


_NUMBERS = ("recipe", "frame", "pixels", "frames", "reconfigurations", "lost_frames")


def remove(path: Path) -> None:
    """Remove a checkpoint for good.

    Raises:
        OutputError: it cannot be removed.
    """
    try:
        disk.unlink(path)
        disk.sync_folder(path.parent)
    except OSError as error:
        raise OutputError(error.errno, f"cannot remove: {error.strerror}", str(path)) from error


EVERY_S = 1.0
"""Seconds between checkpoints: with the time of a frame and of the disk, less than 2 s of work are lost."""


def checkpoint_of(position: RunPosition, written: FilePositions, recipe: str) -> Checkpoint:
    """The checkpoint of a run that is so far.

    Raises:
        StateError: the state holds something that cannot be stored.
    """
    return Checkpoint(
        recipe,
        position.frame.index,
        _pixels_of(position.frame, position.state.history.cameras.cameras),
        position.frames,
        position.reconfigurations,
        position.lost_frames,
        written,
        describe_machine(),
        encode_state(position.state),
    )


class Checkpoints:
    """Makes checkpoints of a run as it goes on: a checkpointer of `run`.

    The state is taken between two frames; a thread waits for the disk, so that no frame does.

    Args:
        directory: of the run.
        recorder: who writes its outputs.
        recipe: SHA-256 of its ``run.json``.
        every_s: seconds between checkpoints.
        notice: told once when the state cannot be stored; the run goes on without checkpoints.
        clock: seconds, any origin.
    """

    def __init__(
        self,
        directory: RunDirectory,
        recorder: Recorder,
        recipe: str,
        every_s: float = EVERY_S,
        notice: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._directory, self._recorder, self._recipe = directory, recorder, recipe
        self._every_s, self._notice, self._clock = every_s, notice, clock
        self._due: float | None = clock() + every_s
        self._last: RunPosition | None = None
        describe_machine()  # takes some ms the first time: not between two frames
        self._writer = Background("checkpoints")
        self._writing: Future[None] | None = None

    def reached(self, position: RunPosition) -> None:
        """Make a checkpoint when one is due.

        Raises:
            OutputError: it, or an output before it, cannot be written.
        """
        self._last = position
        if self._due is None or self._clock() < self._due:
            return
        if self._writing is None or self._writing.done():
            self._make(position)

    def stopped(self) -> None:
        """Make one of the last frame; where that fails, the one before it is good enough."""
        if self._due is not None and self._last is not None:
            with suppress(OutputError):
                self._make(self._last)
                self._written()

    def ended(self) -> None:
        """Wait for the last one; it stays until the run is finished.

        Raises:
            OutputError: it cannot be written.
        """
        self._written()

    def close(self) -> None:
        """Wait for the disk; safe to call twice."""
        self._writer.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _written(self) -> None:
        """Wait until the last one is written; raises OutputError when it cannot be."""
        writing, self._writing = self._writing, None
        if writing is not None:
            writing.result()

    def _make(self, position: RunPosition) -> None:
        began = self._clock()
        checkpoint = self._made(position)
        if checkpoint is not None:
            self._writing = self._writer.submit(self._write, checkpoint)
            self._due = began + self._every_s

    def _made(self, position: RunPosition) -> Checkpoint | None:
        """The checkpoint of a frame, once the last one is written; None where the state cannot be stored."""
        self._written()
        try:
            return checkpoint_of(position, self._recorder.written, self._recipe)
        except StateError as error:
            self._due = None
            if self._notice is not None:
                self._notice(f"no checkpoints: {error}; if it is broken off, this run repeats from its start")
            return None

    def _write(self, checkpoint: Checkpoint) -> None:
        self._recorder.sync()
        write_checkpoint(self._directory, checkpoint)
