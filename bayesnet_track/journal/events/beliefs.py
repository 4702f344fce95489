"""What happens to beliefs: degenerate, reset, gated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import assert_never

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


Events = DegenerateBelief | BeliefReset | MeasurementGated


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    match event:
        case DegenerateBelief():
            return f"no hypothesis of target {event.target} can be used: {event.reason}; the prediction stays"
        case BeliefReset():
            return _describe_reset(event)
        case MeasurementGated():
            return _describe_gated(event)
        case _:
            assert_never(event)


def _describe_reset(event: BeliefReset) -> str:
    """A belief that was reset."""
    gamma, below = distinct_texts(event.gamma, event.below)
    over = "the belief's bounding box" if event.region == "belief" else "the image"
    then = (
        f"the belief of target {event.target} starts again from the frame's likelihood"
        if event.action == "reset"
        else "the frame's evidence is ignored"
    )
    turning = round_away(event.gamma, decimals(event.gamma, event.below), up=False)
    found = f"γ {gamma} < {below} over {over} ({event.region_px2:.0f} px²)"
    return f"{found} → {then}; would not have happened at below ≤ {turning}"


def _describe_gated(event: MeasurementGated) -> str:
    """A measurement that is taken for another object."""
    d2, limit = distinct_texts(event.d2, event.limit)
    of = plural(event.degrees, "degree")
    then = "" if event.used else "; nothing else was measured near the prediction"
    # Rounded up, so that the gate named does let it pass.
    digits = min(max(2, math.ceil(-math.log10(max(1.0 - event.turning, 1e-300)))), 12)
    turning = math.ceil(event.turning * 10.0**digits) / 10.0**digits
    gate = f"gate ≥ {turning:.12g}" if turning < 1 else "gate: 1"
    return (
        f"{event.node} measured d² {d2} > {limit} from the prediction (gate {event.gate:g}, {of} of freedom) "
        f"→ not used{then}; would have been used at {gate}"
    )
