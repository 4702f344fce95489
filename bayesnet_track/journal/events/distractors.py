"""A distractor, something that looks like the target, and the end of the doubt that it raised."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


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
        hold: frames for which the score is at most one half, unless motion shows which is followed.
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
        hold = plural(self.hold, "frame")
        return (
            f"look-alike at {self.x:.4g}, {self.y:.4g}, {self.away_box:.2g} box sides away, only {behind} < "
            f"{within} nats less likely than the target → score at most 0.5 for {hold}, or until motion "
            f"shows which is followed; ignored with within_nats ≤ {turning}"
        )


@dataclass(frozen=True)
class DoubtEnded:
    """Motion shows that it is the target that is followed, not the distractor: the score is not limited.

    Attributes:
        frame: the frame.
        target: target id.
        own_box: how far the estimate is from where the target was moving, roots of its area.
        other_box: the same, from where the distractor was moving.
        nearer: share of `other_box` below which `own_box` has to be.
        left: frames for which the score would have stayed limited.
    """

    frame: int
    target: str
    own_box: float
    other_box: float
    nearer: float
    left: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        own, least = distinct_texts(self.own_box, self.nearer * self.other_box)
        left = plural(self.left, "frame")
        return (
            f"target is {own} box sides from where it was heading, and {self.other_box:.3g} from where the "
            f"look-alike was → score no longer limited; at {least} it would have stayed so for {left}"
        )


Events = DistractorSeen | DoubtEnded
