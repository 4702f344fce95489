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


Events = DistractorSeen


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    behind, within = distinct_texts(event.behind_nats, event.within_nats)
    turning = round_away(event.behind_nats, decimals(event.behind_nats, event.within_nats), up=False)
    return (
        f"look-alike at {event.x:.4g}, {event.y:.4g}, {event.away_box:.2g} box sides away, only {behind} < "
        f"{within} nats less likely than the target → score at most 0.5 for {event.hold} frames; ignored "
        f"with within_nats ≤ {turning}"
    )
