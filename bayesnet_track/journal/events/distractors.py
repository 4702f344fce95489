"""A distractor, something that looks like the target, and the end of the doubt that it raised."""

from __future__ import annotations

from dataclasses import dataclass, field

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
        turning_nats: the largest `behind_nats` of the frames in a row that raised the doubt; None in a
            journal that does not say.
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
    turning_nats: float | None = field(default=None, metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        behind, within = distinct_texts(self.behind_nats, self.within_nats)
        likely = f"only {behind} < {within} nats less likely than the target"
        if self.behind_nats < 0.0:
            likely = f"{behind.removeprefix('-')} nats more likely than the target"
        turning = self.behind_nats if self.turning_nats is None else self.turning_nats
        level = round_away(turning, decimals(turning, self.within_nats), up=False)
        ignored = f"ignored with within_nats ≤ {level}" if float(level) > 0.0 else "no within_nats ignores it"
        hold = plural(self.hold, "frame")
        return (
            f"look-alike at {self.x:.4g}, {self.y:.4g}, {self.away_box:.2g} box sides away, {likely} → score "
            f"at most 0.5 for {hold}, or until motion shows which is followed; {ignored}"
        )


@dataclass(frozen=True)
class DoubtEnded:
    """Motion shows that it is the target that is followed, not the distractor: the score is not limited.

    Attributes:
        frame: the frame.
        target: target id.
        own_box: how far the estimate is from where the target was heading, roots of its area.
        other_box: the same, from where the distractor was heading.
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
        level = self.nearer * self.other_box
        own = distinct_texts(self.own_box, level)[0]
        least = round_away(level, decimals(self.own_box, level), up=True)
        left = plural(self.left, "frame")
        return (
            f"target is {own} box sides from where it was heading, and {self.other_box:.3g} from where the "
            f"look-alike was heading → score no longer limited; at {least} it would have stayed so for {left}"
        )


Events = DistractorSeen | DoubtEnded
