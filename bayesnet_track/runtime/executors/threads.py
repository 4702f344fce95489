"""A pool of threads for the independent pieces of a frame; the caller works along."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Lock, Thread
from time import perf_counter
from typing import Any, Generic, TypeVar, cast

Piece = TypeVar("Piece")
Made = TypeVar("Made")


HAND_OFF_S = 200e-6
"""Seconds that must be gained by handing pieces to other threads, which costs about as much."""
RECENT = 0.2
"""Weight of the last time in the running mean of what would be gained."""


class Threads:
    """Carries out pieces side by side in `workers` threads, the caller's included.

    The caller takes pieces as the others do. So a single piece never leaves its thread, pieces that are over
    before another thread wakes cost next to nothing, and work that asks for `each` itself cannot wait for a
    thread for ever. Where, by the last times that the same was done, little can be gained, the caller does
    all of it.
    """

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise ValueError(f"{workers} workers: at least 1 is needed")
        self._gains: dict[Any, float] = {}
        self._batches: SimpleQueue[_Batch[Any, Any] | None] = SimpleQueue()
        self._helpers = [
            Thread(target=self._help, name=f"agents {number}", daemon=True) for number in range(1, workers)
        ]
        for helper in self._helpers:
            helper.start()

    def each(self, work: Callable[[Piece], Made], pieces: Sequence[Piece]) -> list[Made]:
        """`work` done for every piece; the results in the order of the pieces.

        Of several errors that of the first piece is raised, when all pieces are done.
        """
        if len(pieces) < 2 or not self._helpers:
            return [work(piece) for piece in pieces]
        function = getattr(work, "func", work)  # of a partial one
        kind = getattr(function, "__code__", function), len(pieces)
        gain = self._gains.get(kind)
        batch = _Batch(work, pieces)
        if gain is None or gain > HAND_OFF_S:
            for _ in range(min(len(pieces) - 1, len(self._helpers))):
                self._batches.put(batch)
        try:
            batch.carry_out()
            batch.finished.acquire()
        except BaseException:  # the caller is interrupted: what nobody began is dropped
            batch.left.clear()
            raise
        now = sum(batch.seconds) - max(batch.seconds)
        self._gains[kind] = now if gain is None else gain + RECENT * (now - gain)
        for _, error in sorted(batch.errors.items()):
            raise error
        return cast("list[Made]", batch.made)

    def close(self) -> None:
        """End the threads; a piece that is being carried out is not waited for."""
        for _ in self._helpers:
            self._batches.put(None)
        self._helpers = []

    def _help(self) -> None:
        while (batch := self._batches.get()) is not None:
            batch.carry_out(is_helper=True)


class _Batch(Generic[Piece, Made]):
    """Pieces that are left, and what was made of the others."""

    def __init__(self, work: Callable[[Piece], Made], pieces: Sequence[Piece]) -> None:
        self.left = deque(enumerate(pieces))
        self.made: list[Made | None] = [None] * len(pieces)
        self.seconds = [0.0] * len(pieces)
        self.errors: dict[int, BaseException] = {}
        self.finished = Lock()
        self.finished.acquire()
        self._work, self._count, self._counting = work, len(pieces), Lock()

    def carry_out(self, is_helper: bool = False) -> None:
        while True:
            try:
                index, piece = self.left.popleft()
            except IndexError:
                return
            started = perf_counter()
            try:
                self.made[index] = self._work(piece)
            except BaseException as error:
                if not is_helper and not isinstance(error, Exception):
                    raise
                self.errors[index] = error
            self.seconds[index] = perf_counter() - started
            with self._counting:
                self._count -= 1
                if self._count == 0:
                    self.finished.release()
