"""Checkpoints: where a run can go on from, kept in the run directory while it goes on.

A checkpoint says how far every output file is written, which bytes are in it, and what the engine's state is.
It is written whole or not at all, after the outputs have reached the disk, and removed once the run is
finished.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Self

from bayesnet_track.journal.writer import OutputError
from bayesnet_track.runtime.checkpoints.checkpoint_file import (
    Checkpoint,
    pixels_of,
    write_checkpoint,
)
from bayesnet_track.runtime.checkpoints.origins import describe_machine
from bayesnet_track.runtime.checkpoints.state_codec import StateError, encode_state
from bayesnet_track.runtime.recording.background import Background
from bayesnet_track.runtime.recording.record import Recorder, Written
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.run import RunPosition

EVERY_S = 1.0
"""Seconds between checkpoints: with the time of a frame and of the disk, less than 2 s of work are lost."""


def checkpoint_of(now: RunPosition, written: Written, recipe: str) -> Checkpoint:
    """The checkpoint of a run that is so far.

    Raises:
        StateError: the state holds something that cannot be stored.
    """
    return Checkpoint(
        recipe,
        now.frame.index,
        pixels_of(now.frame),
        now.frames,
        now.reconfigurations,
        now.lost_frames,
        written,
        describe_machine(),
        encode_state(now.state),
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

    def reached(self, now: RunPosition) -> None:
        """Make a checkpoint when one is due.

        Raises:
            OutputError: it, or an output before it, cannot be written.
        """
        self._last = now
        if self._due is None or self._clock() < self._due:
            return
        if self._writing is None or self._writing.done():
            self._make(now)

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

    def _make(self, now: RunPosition) -> None:
        began = self._clock()
        made = self._made(now)
        if made is not None:
            self._writing = self._writer.submit(self._write, made)
            self._due = began + self._every_s

    def _made(self, now: RunPosition) -> Checkpoint | None:
        """The checkpoint of a frame, once the last one is written; None where the state cannot be stored."""
        self._written()
        try:
            return checkpoint_of(now, self._recorder.written, self._recipe)
        except StateError as error:
            self._due = None
            if self._notice is not None:
                self._notice(f"no checkpoints: {error}; if it is broken off, this run repeats from its start")
            return None

    def _write(self, made: Checkpoint) -> None:
        self._recorder.sync()
        write_checkpoint(self._directory, made)
