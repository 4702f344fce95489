"""A distractor, something that looks like the target."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, round_away


@dataclass(frozen=True)
class DistractorSeen:
    """Something else is nearly as likely to be the target: the net may follow either from now on.

    Reported when the doubt begins; a distractor that is seen while it lasts prolongs it.

    Attributes:
        frame: the frame.
        target: target id.
        x: centre of the distractor's best hypothesis, px.
        y: the same, row.
        away_box: how far that is from the most probable hypothesis, roots of the estimate's area.
        behind_nats: how much less likely it is, nats.
        within_nats: difference below which it counts as a distractor.
        fit: how well the best hypothesis of all fits.
        hold: frames for which the score is at most one half.
    """

    frame: int
    target: str
    x: float
    y: float
    away_box: float
    behind_nats: float
    within_nats: float
    fit: float
    hold: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        behind, within = distinct_texts(self.behind_nats, self.within_nats)
        turning = round_away(self.behind_nats, decimals(self.behind_nats, self.within_nats), up=False)
        return (
            f"look-alike at {self.x:.4g}, {self.y:.4g}, {self.away_box:.2g} box sides away, only {behind} < "
            f"{within} nats less likely than the target → score at most 0.5 for {self.hold} frames; ignored "
            f"with within_nats ≤ {turning}"
        )


Events = DistractorSeen
