"""What happens to the beliefs and references of a target: degenerate, reset, resized, gated, guarded."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DegenerateBelief:
    """No hypothesis had a positive, finite weight; the prior was kept as the belief.

    Attributes:
        frame: the frame.
        target: target id.
        reason: the weights' fault.
    """

    frame: int
    target: str
    reason: str


@dataclass(frozen=True)
class BeliefReset:
    """A grid's evidence was not feasible under its prediction: gamma fell below a level.

    Attributes:
        frame: the frame.
        target: target id.
        gamma: mean likelihood under the prediction, divided by its mean over the region.
        below: level of gamma below which it happens.
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
class ParticlesResized:
    """The number of hypotheses of an adaptive size is now a quarter above or below the one last written.

    Attributes:
        frame: the frame.
        target: target id.
        particles: the number of this frame.
        before: the number that was last written, or the one at the start.
        method: kld, kld_revised, kld_revised_simplified, asymptotic_normal or likelihood_sum.
        need: the number that the method asked for, before rounding and bounds.
        limit: what kept the number away from the need: max, min, or ess (too few effective hypotheses to
            save any); empty when nothing did. With `early`, max may hold one half of the hypotheses only.
        early: true when this frame's own evidence asked for more than the last frame's: more were drawn in
            the same frame.
        field: the field that asked for the most; empty for likelihood_sum.
        ess: effective hypotheses of the sample that asked.
        bins: occupied bins of the field, where the method counts them.
        bin_px: width of a bin.
        worth: hypotheses that are worth one drawn from the posterior; absent for likelihood_sum.
        sd_px: sd of the field in the posterior, for asymptotic_normal.
        setting: the setting that the number depends on: error, error_px, error_sd or threshold.
        level: its value.
        turning: its value at which the number would not have been written; null when no value is one.
    """

    frame: int
    target: str
    particles: int
    before: int
    method: str
    need: float
    limit: str
    early: bool
    field: str
    ess: float
    bins: int | None
    bin_px: float | None
    worth: float | None
    sd_px: float | None
    setting: str
    level: float
    turning: float | None


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


@dataclass(frozen=True)
class SecondPass:
    """A frame surprised the belief: further hypotheses were drawn where the first ones found the target.

    Attributes:
        frame: the frame.
        target: target id.
        method: second_pass or iterated.
        kl: KL(posterior || prior) of the first pass, nats; the larger one of its two halves.
        above_kl: level above which a second pass is paid for.
        first: hypotheses of the first pass.
        particles: hypotheses drawn in addition.
        ess_first: effective hypotheses of the first pass.
        ess: effective hypotheses with the second pass.
    """

    frame: int
    target: str
    method: str
    kl: float
    above_kl: float
    first: int
    particles: int
    ess_first: float
    ess: float


@dataclass(frozen=True)
class ReferenceGuarded:
    """An agent's reference and its slow one parted, or agree again: learning stopped, or goes on.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent.
        parted: true when they parted in this frame, false when they agree again.
        own: log-likelihood of the estimate by the agent's own reference, nats.
        slow: the same by its slow reference.
        apart_nats: difference from which on they have parted.
        pull: share of the slow reference that is mixed into the agent's own per frame while they are parted.
        frames: for how many learning frames they were parted; 0 when they part.
    """

    frame: int
    target: str
    node: str
    parted: bool
    own: float
    slow: float
    apart_nats: float
    pull: float
    frames: int
