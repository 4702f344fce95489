"""What happens to beliefs: degenerate, reset, gated."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


@dataclass(frozen=True)
class DegenerateBelief:
    """No hypothesis had a positive, finite weight; the prior was kept as the belief.

    Attributes:
        frame: the frame.
        target: target id.
        reason: what was wrong with the weights.
    """

    frame: int
    target: str
    reason: str

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"no hypothesis of target {self.target} can be used: {self.reason}; the prediction stays"


@dataclass(frozen=True)
class BeliefReset:
    """A grid's evidence was not feasible under its prediction: gamma fell below a threshold.

    Attributes:
        frame: the frame.
        target: target id.
        gamma: mean likelihood under the prediction, divided by its mean over the region.
        below: threshold of gamma below which this happens.
        region: belief (the bounding box of the prediction) or image.
        region_px2: area of the region, px^2.
        action: reset (the belief starts again from the likelihood over the region) or ignore (the prediction
            stays).
    """

    frame: int
    target: str
    gamma: float
    below: float
    region: str
    region_px2: float
    action: str

    def describe(self) -> str:
        """A belief that was reset."""
        gamma, below = distinct_texts(self.gamma, self.below)
        over = "the belief's bounding box" if self.region == "belief" else "the image"
        then = (
            f"the belief of target {self.target} starts again from the frame's likelihood"
            if self.action == "reset"
            else "the frame's evidence is ignored"
        )
        turning = round_away(self.gamma, decimals(self.gamma, self.below), up=False)
        found = f"γ {gamma} < {below} over {over} ({self.region_px2:.0f} px²)"
        return f"{found} → {then}; would not have happened at below ≤ {turning}"


@dataclass(frozen=True)
class MeasurementGated:
    """A Gaussian belief did not use what an agent measured: it lies too far from the prediction.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent that measured, or the latent node that summed up its agents.
        d2: squared Mahalanobis distance of the measurement from the prediction.
        limit: largest that is used: the chi-square quantile of `gate`.
        gate: share of right measurements that the gate lets pass.
        degrees: number of fields measured, the degrees of freedom of chi-square.
        turning: gate from which on it would have been used; 1 when only no gate would.
        used: measurements of the same frame that were used; with 0 and no other evidence the belief is
            only predicted.
    """

    frame: int
    target: str
    node: str
    d2: float
    limit: float
    gate: float
    degrees: int
    turning: float
    used: int

    def describe(self) -> str:
        """A measurement that is taken for another object."""
        d2, limit = distinct_texts(self.d2, self.limit)
        of = plural(self.degrees, "degree")
        then = "" if self.used else "; nothing else was measured near the prediction"
        # Rounded up, so that the gate named does let it pass.
        digits = min(max(2, math.ceil(-math.log10(max(1.0 - self.turning, 1e-300)))), 12)
        turning = math.ceil(self.turning * 10.0**digits) / 10.0**digits
        gate = f"gate ≥ {turning:.12g}" if turning < 1 else "gate: 1"
        return (
            f"{self.node} measured d² {d2} > {limit} from the prediction (gate {self.gate:g}, {of} of "
            f"freedom) → not used{then}; would have been used at {gate}"
        )


Events = DegenerateBelief | BeliefReset | MeasurementGated
