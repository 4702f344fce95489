"""A pool of threads for the independent pieces of a frame; the caller works along."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, Generic, TypeVar, cast

Piece = TypeVar("Piece")
Made = TypeVar("Made")


class Threads:
    """Carries out pieces side by side in `workers` threads, the caller's included.

    The caller takes pieces as the others do. So a single piece never leaves its thread, pieces that are over
    before another thread wakes cost next to nothing, and work that asks for `each` itself cannot wait for a
    thread for ever.
    """

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise ValueError(f"{workers} workers: at least 1 is needed")
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
        batch = _Batch(work, pieces)
        for _ in range(min(len(pieces) - 1, len(self._helpers))):
            self._batches.put(batch)
        try:
            batch.carry_out()
            batch.finished.acquire()
        except BaseException:  # the caller is interrupted: what nobody began is dropped
            batch.left.clear()
            raise
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
            try:
                self.made[index] = self._work(piece)
            except BaseException as error:
                if not is_helper and not isinstance(error, Exception):
                    raise
                self.errors[index] = error
            with self._counting:
                self._count -= 1
                if self._count == 0:
                    self.finished.release()
