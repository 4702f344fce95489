"""A question to an agent in a worker process, on its way."""

from __future__ import annotations

from bayesnet_track.runtime.deadline import Patience
from bayesnet_track.runtime.executors.questions import Answer, Call


class Pending:
    """A question on its way.

    Attributes:
        asked: of whom, and what.
        patience: for how long its answer is waited for; None for as long as it takes.
        is_sent: whether a worker has it.
        until: the moment by which the answer is needed, since it was sent.
        outcome: the answer, or why there is none.
        lost: why workers that had it gave none.
    """

    __slots__ = ("agent", "asked", "is_sent", "lost", "outcome", "patience", "sent_at", "until")

    def __init__(self, asked: Call, patience: Patience | None) -> None:
        self.agent = asked.agent
        self.asked, self.patience = asked, patience
        self.is_sent, self.sent_at = False, 0.0
        self.until: float | None = None
        self.outcome: Answer | Exception | None = None
        self.lost: list[str] = []

    def until_from(self, now: float) -> float | None:
        """The moment by which the answer is needed, when it is asked for `now`."""
        return None if self.patience is None else self.patience.until(self.agent, now)
