"""Where what comes from outside comes from: an earlier run's file, or people who watch a live one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from queue import Empty, SimpleQueue

from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.events.load import Released, Toggled
from bayesnet_track.journal.reader import Notice, read_inputs

InputsAt = Callable[[int], Sequence[Input]]
"""Frame index -> what came from outside for it; asked once, right before the frame."""


def nothing(frame: int) -> Sequence[Input]:
    """Nothing comes from outside."""
    return ()


def replay_inputs(path: Path, notice: Notice | None = None) -> InputsAt:
    """What came from outside in an earlier run, by its ``inputs.jsonl``.

    Raises:
        OSError: the file cannot be read.
        JournalError: it is damaged; says file and line.
    """
    by_frame: dict[int, list[Input]] = {}
    for one in read_inputs(path, notice):
        by_frame.setdefault(one.frame, []).append(one)
    known: Mapping[int, Sequence[Input]] = by_frame
    return lambda frame: known.get(frame, ())


def as_inputs(given: str | PathLike[str] | InputsAt | None) -> InputsAt:
    """A file as `replay_inputs`, a function as it is, nothing for None."""
    if given is None:
        return nothing
    return given if callable(given) else replay_inputs(Path(given))


class Switchboard:
    """Takes what people ask for while a run goes on, from any thread, and hands it to the next frame.

    >>> board = Switchboard()
    >>> board.switch("1", "motion", on=False)
    >>> board(7)
    (Toggled(frame=7, target='1', node='motion', on=False),)
    >>> board(8)
    ()
    """

    def __init__(self) -> None:
        self._asked: SimpleQueue[Callable[[int], Input]] = SimpleQueue()

    def switch(self, target: str, agent: str, on: bool) -> None:
        """Switch an agent on or off, until it is released."""
        self._asked.put(lambda frame: Toggled(frame, target, agent, on))

    def release(self, target: str, agent: str) -> None:
        """Give an agent back to the rules."""
        self._asked.put(lambda frame: Released(frame, target, agent))

    def __call__(self, frame: int) -> Sequence[Input]:
        """All that was asked for since the last frame, in order."""
        asked: list[Input] = []
        while True:
            try:
                asked.append(self._asked.get_nowait()(frame))
            except Empty:
                return tuple(asked)
