"""A belief that finds its target again by a jump."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, round_away


@dataclass(frozen=True)
class Reappeared:
    """The target reappeared elsewhere.

    Hypotheses that jumped hold most of the belief; beside a Gaussian, agents found it more probable there.

    Attributes:
        frame: the frame.
        target: target id.
        by: what proposed the places: uniform, agents, or a detector's name; or the agents that looked there.
        hypotheses: how many jumped; 0 beside a Gaussian belief, where agents looked elsewhere.
        held: their share of the belief, or the probability of the other place against the belief's own.
        level: share above which this is reported.
        share: prior probability of reappearing in this frame.
        turning: largest prior probability with which they would hold no more than `level`.
        x: mean column of those hypotheses, or of what was seen there, px.
        y: the same, row.
        moved_px: how far that is from the last frame's mean.
        ud_px2: UD of the last frame.
        above_px2: threshold of UD above which reappearing is likely, in px^2; 0 when it is not known yet, or
            only a target that is lost, or long uncertain, is searched for.
        within_px: how far from the box that held it last they searched; None for the whole frame.
        fit: likelihood of the best hypothesis before they searched, as a share of the usual one; None unless
            that called for the search.
        below_fit: share below which it does.
    """

    frame: int
    target: str
    by: str
    hypotheses: int
    held: float
    level: float
    share: float
    turning: float
    x: float
    y: float
    moved_px: float
    ud_px2: float
    above_px2: float
    within_px: float | None = None
    fit: float | None = None
    below_fit: float | None = None

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        held, level = distinct_texts(self.held, self.level)
        ud, above = distinct_texts(self.ud_px2, self.above_px2)
        unsure = ""
        if self.above_px2 > 0:
            unsure = f"UD {ud} px² {'>' if self.ud_px2 > self.above_px2 else '≤'} {above}; "
        if self.fit is not None and self.below_fit is not None:
            fit, below = distinct_texts(self.fit, self.below_fit)
            unsure = f"fit {fit} < {below} of the usual one; "
        turning = round_away(self.turning, decimals(self.turning, self.share), up=False)
        how = "evenly" if self.by == "uniform" else f"by {self.by}"
        where = "the whole frame"
        if self.within_px is not None:
            where = f"up to {self.within_px:.0f} px around its last place"
        found = f"{self.by} searched {where} and found the target with probability {held} > {level}"
        if self.hypotheses > 0:
            who = f"{self.hypotheses} hypotheses searched {where}, {how}"
            found = f"{who}, and hold {held} > {level} of the belief"
        return (
            f"{unsure}{found} → target {self.target} reappears at "
            f"{self.x:.4g}, {self.y:.4g}, {self.moved_px:.3g} px away; would not have at share ≤ {turning}"
        )


Events = Reappeared
