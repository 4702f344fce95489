"""Events of beliefs: degenerate, reset, gated, jumps, modes and numbers of hypotheses."""

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
        gamma, level = distinct_texts(self.gamma, self.below)
        over = "the belief's bounding box" if self.region == "belief" else "the image"
        effect = (
            f"the belief of target {self.target} starts again from the frame's likelihood"
            if self.action == "reset"
            else "the frame's evidence is ignored"
        )
        turning = round_away(self.gamma, decimals(self.gamma, self.below), up=False)
        evidence = f"γ {gamma} < {level} over {over} ({self.region_px2:.0f} px²)"
        return f"{evidence} → {effect}; would not have happened at below ≤ {turning}"


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
        degrees = plural(self.degrees, "degree")
        remark = "" if self.used else "; nothing else was measured near the prediction"
        # Rounded up, so that the gate named does let it pass.
        digits = min(max(2, math.ceil(-math.log10(max(1.0 - self.turning, 1e-300)))), 12)
        turning = math.ceil(self.turning * 10.0**digits) / 10.0**digits
        gate = f"gate ≥ {turning:.12g}" if turning < 1 else "gate: 1"
        return (
            f"{self.node} measured d² {d2} > {limit} from the prediction (gate {self.gate:g}, {degrees} of "
            f"freedom) → not used{remark}; would have been used at {gate}"
        )


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
        share, level = distinct_texts(self.held, self.level)
        ud, ud_level = distinct_texts(self.ud_px2, self.above_px2)
        unsure = ""
        if self.above_px2 > 0:
            unsure = f"UD {ud} px² {'>' if self.ud_px2 > self.above_px2 else '≤'} {ud_level}; "
        if self.fit is not None and self.below_fit is not None:
            fit, fit_level = distinct_texts(self.fit, self.below_fit)
            unsure = f"fit {fit} < {fit_level} of the usual one; "
        turning = round_away(self.turning, decimals(self.turning, self.share), up=False)
        how = "evenly" if self.by == "uniform" else f"by {self.by}"
        area = "the whole frame"
        if self.within_px is not None:
            area = f"up to {self.within_px:.0f} px around its last place"
        evidence = f"{self.by} searched {area} and found the target with probability {share} > {level}"
        if self.hypotheses > 0:
            who = f"{self.hypotheses} hypotheses searched {area}, {how}"
            evidence = f"{who}, and hold {share} > {level} of the belief"
        return (
            f"{unsure}{evidence} → target {self.target} reappears at "
            f"{self.x:.4g}, {self.y:.4g}, {self.moved_px:.3g} px away; would not have at share ≤ {turning}"
        )


@dataclass(frozen=True)
class ModeChanged:
    """Another mode is the most probable one.

    Attributes:
        frame: the frame.
        target: target id.
        mode: the mode that is most probable from this frame on.
        before: the one that was.
        probability: of `mode`, by all evidence so far.
        predicted: of `mode` before the evidence of this frame.
        nats: log of how much likelier the frame's evidence is in `mode` than in `before`.
        turning: nats up to which `before` would have stayed more probable.
        hidden: probability that the target cannot be seen; None where it always can.
        of: the category of which `mode` and `before` are values; empty where they are modes.
    """

    frame: int
    target: str
    mode: str
    before: str
    probability: float
    predicted: float
    nats: float
    turning: float
    hidden: float | None = None
    of: str = ""

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        if self.of:
            return self._describe_value()
        side = "higher" if self.nats >= 0 else "lower"
        turning = round_away(self.turning, decimals(self.turning, self.nats), up=False)
        hidden = "" if self.hidden is None else f"; hidden with probability {self.hidden:.2f}"
        return (
            f"the frame's evidence is {abs(self.nats):.3g} nats {side} in mode {self.mode} than in "
            f"{self.before} → target {self.target} in mode {self.mode} with probability "
            f"{self.probability:.2f}, predicted {self.predicted:.2g}{hidden}; would have stayed in "
            f"{self.before} at ≤ {turning} nats"
        )

    def _describe_value(self) -> str:
        turning = round_away(self.turning, decimals(self.turning, self.nats), up=False)
        side = "higher" if self.nats >= 0 else "lower"
        return (
            f"the frame's evidence is {abs(self.nats):.3g} nats {side} for {self.of} {self.mode} than for "
            f"{self.before} → {self.of} of target {self.target} is {self.mode} with probability "
            f"{self.probability:.2f}, predicted {self.predicted:.2g}; would have stayed {self.before} at ≤ "
            f"{turning} nats"
        )


@dataclass(frozen=True)
class ParticlesResized:
    """The number of hypotheses of an adaptive size is now a quarter above or below the one last reported.

    Attributes:
        frame: the frame.
        target: target id.
        particles: the number of this frame.
        before: the number last reported, or the one at the start.
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
        turning: its value at which nothing would have been reported; null when there is none.
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

    def describe(self) -> str:
        """The number of hypotheses that are asked for, and why."""
        settings = f"{self.method}, {self.setting} {self.level:g}"
        source = "this frame's evidence" if self.early else "the last frame's evidence"
        demand = f"{_why_so_many(self)}: {source} asks for {self.need:.0f} hypotheses ({settings})"
        bounds = {"max": ", held by max", "min": ", held by min", "ess": ", too few effective to reduce it"}
        number = f"{self.particles}{bounds.get(self.limit, '')}, {self.before} before"
        return f"{demand} → {number}{_not_resized(self)}"


@dataclass(frozen=True)
class SecondPass:
    """A frame surprised the belief: further hypotheses were drawn where the first ones found the target.

    Attributes:
        frame: the frame.
        target: target id.
        method: second_pass or iterated.
        kl: KL(posterior || prior) of the first pass, nats; the larger one of its two halves.
        above_kl: threshold above which a second pass is made.
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

    def describe(self) -> str:
        """Hypotheses drawn a second time."""
        kl, level = distinct_texts(self.kl, self.above_kl)
        how = "" if self.method == "second_pass" else f", by {self.method}"
        turning = round_away(self.kl, decimals(self.kl, self.above_kl), up=True)
        return (
            f"KL(posterior, prior) {kl} nats > {level} → second pass of {self.particles} hypotheses{how}, "
            f"{self.ess_first:.0f} effective before, {self.ess:.0f} after; "
            f"no second pass at above_kl ≥ {turning}"
        )


def _why_so_many(event: ParticlesResized) -> str:
    """The numbers that the need was computed from."""
    parts = []
    if event.bins is not None and event.bin_px is not None:
        parts.append(f"{event.field} spans {plural(event.bins, 'bin')} of {event.bin_px:g} px")
    if event.sd_px is not None:
        parts.append(f"{event.field} has an sd of {event.sd_px:.3g} px")
    if event.worth is not None and event.method != "kld":
        parts.append(f"{event.worth:.3g} hypotheses are worth one drawn from the posterior")
    return ", ".join([*parts, f"{event.ess:.0f} effective"])


def _not_resized(event: ParticlesResized) -> str:
    """The setting that would have prevented it: larger errors ask for fewer, larger thresholds for more."""
    if event.turning is None:
        return ""
    up = (event.particles > event.before) == (event.setting != "threshold")
    turning = round_away(event.turning, decimals(event.turning, event.level), up)
    return f"; would have stayed near {event.before} at {event.setting} {'≥' if up else '≤'} {turning}"


@dataclass(frozen=True)
class QueryPassed:
    """The probability of a query passed its level, `event_above`.

    Attributes:
        frame: frame whose beliefs it is of.
        target: target id; of a pair the first one.
        query: name of the query.
        probability: what the beliefs say.
        level: the level.
        reached: True when the probability reached it, False when it fell below.
        second: the second target of a pair; empty without.
    """

    frame: int
    target: str
    query: str
    probability: float
    level: float
    reached: bool
    second: str = ""

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        subject = f"targets {self.target} and {self.second}" if self.second else f"target {self.target}"
        probability, level = distinct_texts(self.probability, self.level)
        if not self.reached:
            return f"{self.query} of {subject} no longer probable: {probability} < {level}"
        turning = round_away(self.probability, decimals(self.probability, self.level), up=True)
        unless = "at any event_above" if float(turning) >= 1.0 else f"no event if event_above > {turning}"
        return f"{self.query} of {subject} probable: {probability} ≥ {level} ({unless})"
