"""Number of hypotheses of a weighted sample: the methods of thesis 5.4, and the decision of a frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evidence, Report
from bayesnet_track.graph.settings.beliefs import AdaptiveSize, BinnedSize, NormalSize
from bayesnet_track.journal.events.beliefs import ParticlesResized
from bayesnet_track.numerics import resampling
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses

LEAST_EFFECTIVE = 10.0
"""A sample of fewer effective hypotheses cannot measure its own variance, and is no reason to save any."""


@dataclass(frozen=True)
class SampleSize:
    """Size that a sample asks for.

    Attributes:
        particles: how many hypotheses, not rounded and not kept in bounds; 0 for as few as may be.
        ess: effective hypotheses of the sample that asks, 0 when its weights are degenerate.
        field: the field that asks for the most, or empty when the method looks at none.
        bins: occupied bins of that field, for the methods that count them.
        worth: hypotheses of the sample that are worth one drawn from the posterior.
        sd_px: sd of that field in the posterior, for the method that bounds the error of the mean.
    """

    particles: float
    ess: float
    field: str = ""
    bins: int | None = None
    worth: float | None = None
    sd_px: float | None = None

    def asks(self, previous: int) -> float:
        """The number asked for after `previous` hypotheses: no fewer when the sample is too poor to tell."""
        return self.particles if self.ess >= LEAST_EFFECTIVE else max(self.particles, float(previous))


@dataclass(frozen=True)
class SizeMemory:
    """Memory of an adaptive size of a frame.

    Attributes:
        first_pass: hypotheses of the first pass.
        reported: the number that was last written down.
        wanted: what all of them asked for.
    """

    first_pass: int
    reported: int
    wanted: SampleSize


def find_sample_size(
    size: AdaptiveSize, states: Floats, fields: tuple[str, ...], prior_log: Floats, log_likelihood: Floats
) -> SampleSize:
    """Sample size that hypotheses (N, D) of prior log-weights and log-likelihoods (N,) need, over all fields.

    Degenerate weights (none positive, or one not a finite number) ask for nothing and have no effective
    hypotheses, so that `SampleSize.asks` keeps the number that there was.
    """
    with np.errstate(invalid="ignore"):  # -inf + inf is NaN, a degenerate weight
        log = prior_log + log_likelihood
    top = float(np.max(log))
    if not np.isfinite(top):
        return SampleSize(0.0, 0.0)
    weights = np.exp(log - top)
    ess = len(weights) / resampling.simple_inflation(weights)
    if size.likelihood_sum is not None:
        share = prior_log - np.logaddexp.reduce(prior_log)
        weighted = len(log) * np.exp(share + log_likelihood)
        return SampleSize(resampling.likelihood_sum(weighted, size.likelihood_sum.threshold), ess)
    wishes = [
        _size_by_field(size, name, states[:, fields.index(name)], weights, ess)
        for name in size.settings.fields
    ]
    return max(wishes, key=lambda wish: wish.particles)


def _size_by_field(size: AdaptiveSize, field: str, values: Floats, weights: Floats, ess: float) -> SampleSize:
    if isinstance(size.settings, NormalSize):
        return _normal_size(size, size.settings, field, values, weights, ess)
    settings: BinnedSize = size.settings
    bins = resampling.occupied_bins(values, weights, settings.bin_px)
    inflation = _WORTH[size.kind](values, weights)
    particles = resampling.kld_revised(bins, settings.error, settings.confidence, inflation)
    return SampleSize(particles, ess, field, bins, inflation)


def _normal_size(
    size: AdaptiveSize, settings: NormalSize, field: str, values: Floats, weights: Floats, ess: float
) -> SampleSize:
    _, error = size.tolerance
    sd, inflation = np.sqrt(resampling.variance(values, weights)), resampling.inflation(values, weights)
    # Relative to the posterior's sd the variance is divided by Var_p, which leaves the worth alone.
    spread = inflation if settings.error_px is None else resampling.importance_variance(values, weights)
    particles = resampling.asymptotic_normal(spread, error, settings.confidence)
    return SampleSize(particles, ess, field, None, inflation, float(sd))


_WORTH: dict[str, Callable[[Floats, Floats], float]] = {
    "kld": lambda values, weights: 1.0,
    "kld_revised": resampling.inflation,
    "kld_revised_simplified": lambda values, weights: resampling.simple_inflation(weights),
}


ENLARGED = 1.25
"""A half is enlarged when it is asked for this many times its number: a second evaluation costs time."""

NOTABLE = 1.25
"""A number is written down when it is this factor above or below the one that was written last."""


@dataclass(frozen=True)
class SizeDecision:
    """All that one frame's number of hypotheses depends on.

    Attributes:
        size: the method.
        before: the last frame.
        halves_wanted: what each half of this frame's first hypotheses asked for.
        low: the least number.
        high: the largest number.
    """

    size: AdaptiveSize
    before: SizeMemory
    halves_wanted: tuple[SampleSize, SampleSize]
    low: int
    high: int

    @property
    def begin(self) -> int:
        """Hypotheses drawn before this frame is looked at: what the last one asked for."""
        return begin_with(self.before, self.low, self.high)

    @property
    def halves(self) -> tuple[int, int]:
        """Number of them in each half."""
        return halve(self.begin)

    @property
    def more(self) -> tuple[int, int]:
        """By how many each half is enlarged: a function of what the other half asks for, never of its own."""
        first, second = self.halves
        most_first, most_second = halve(self.high)
        return (
            self._enlarge(self.halves_wanted[1], most_first, first) - first,
            self._enlarge(self.halves_wanted[0], most_second, second) - second,
        )

    @property
    def particles(self) -> int:
        """This frame's number."""
        return self.begin + sum(self.more)

    @property
    def is_notable(self) -> bool:
        """True when the number has moved away from the one that was last written down."""
        return not self.before.reported / NOTABLE <= self.particles <= self.before.reported * NOTABLE

    @property
    def cause(self) -> SampleSize:
        """Wish behind the number: this frame's where it was enlarged, else the last frame's."""
        if not any(self.more):
            return self.before.wanted
        mean = (self.halves_wanted[0].particles + self.halves_wanted[1].particles) / 2
        larger = max(self.halves_wanted, key=lambda wish: wish.particles)
        return replace(larger, particles=mean, ess=self.halves_wanted[0].ess + self.halves_wanted[1].ess)

    def _enlarge(self, wish: SampleSize, largest: int, count: int) -> int:
        needed = wish.asks(self.begin)
        return count if needed <= ENLARGED * self.begin else max(count, min(largest, math.ceil(needed / 2)))

    def scale(self, factor: float) -> SizeDecision:
        """The wishes of both frames times `factor`."""
        first, second = (_scale(wish, factor) for wish in self.halves_wanted)
        previous = replace(self.before, wanted=_scale(self.before.wanted, factor))
        return replace(self, before=previous, halves_wanted=(first, second))


def _scale(wish: SampleSize, factor: float) -> SampleSize:
    return replace(wish, particles=factor * wish.particles)


def begin_with(memory: SizeMemory, low: int, high: int) -> int:
    """The number that a frame begins with: what the last one asked for, rounded up and kept in bounds."""
    needed = memory.wanted.asks(memory.first_pass)
    return low if needed <= low else high if needed >= high else math.ceil(needed)


def halve(count: int) -> tuple[int, int]:
    """Two halves of a whole number, the first the larger one."""
    return count - count // 2, count // 2


def make_report(sizing: SizeDecision) -> Report:
    """The event that says which number became which, and why."""
    cause, (setting, level) = sizing.cause, sizing.size.tolerance
    return lambda frame, target: ParticlesResized(
        frame=frame,
        target=target,
        particles=sizing.particles,
        before=sizing.before.reported,
        method=sizing.size.kind,
        need=cause.particles,
        limit=find_limit(sizing),
        early=any(sizing.more),
        field=cause.field,
        ess=cause.ess,
        bins=cause.bins,
        bin_px=getattr(sizing.size.settings, "bin_px", None),
        worth=cause.worth,
        sd_px=cause.sd_px,
        setting=setting,
        level=level,
        turning=find_turning(sizing),
    )


def find_limit(sizing: SizeDecision) -> str:
    """Limit that kept the number from the wish: max, min, ess (too few effective to save any), or nothing."""
    wish, particles = sizing.cause, sizing.particles
    if wish.particles > particles:
        return "max"
    # A half that is asked for less keeps what was drawn; and each half is rounded up.
    if any(sizing.more) or wish.particles > particles - 2:
        return ""
    return "min" if particles == sizing.low else "ess"


def find_turning(sizing: SizeDecision) -> float | None:
    """The value of the setting at which the number would not have moved notably; None when no value is it."""
    reported, has_risen = sizing.before.reported, sizing.particles > sizing.before.reported

    def stays(log_factor: float) -> bool:
        particles = sizing.scale(math.exp(log_factor)).particles
        return particles <= reported * NOTABLE if has_risen else particles >= reported / NOTABLE

    steady, moves = (-_WIDEST if has_risen else _WIDEST), 0.0
    if not stays(steady):
        return None
    for _ in range(_HALVINGS):
        middle = (steady + moves) / 2
        steady, moves = (middle, moves) if stays(middle) else (steady, middle)
    setting, level = sizing.size.tolerance
    power = {"error": -1.0, "threshold": 1.0}.get(setting, -0.5)  # N is proportional to setting^(1 / power)
    return level * math.exp(power * steady)


_WIDEST = math.log(1e6)
_HALVINGS = 50


ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class WeightedSample:
    """Hypotheses drawn in one go and what the net said of them.

    Attributes:
        states: (N, D) hypotheses.
        prior_log: (N,) log beta, the weights that make them a sample of the prior: 1/N when they were drawn
            from it, p(x) / (N g(x)) when they were drawn from g. sum beta is 1 on average, not exactly.
        ancestors: (N,) the parent that each moved from.
        evidence: the net's answer.
    """

    states: Floats
    prior_log: Floats
    ancestors: NDArray[np.intp]
    evidence: Evidence

    def __len__(self) -> int:
        return len(self.states)


@dataclass(frozen=True, eq=False)
class FrameSample:
    """The hypotheses of a frame so far.

    Attributes:
        whole: the hypotheses, weighted as a sample of the prior, and their evidence.
        size_memory: what an adaptive size remembers.
        reports: what is to be told.
        log_evidence: the frame's, where it is not to be taken from the weights of `whole`.
    """

    whole: WeightedSample
    size_memory: SizeMemory | None = None
    reports: tuple[Report, ...] = ()
    log_evidence: float | None = None


def concatenate(first: WeightedSample, second: WeightedSample, share: float) -> WeightedSample:
    """Both passes as one: `share` of the prior weight is the first's, the rest the second's.

    The evidence sum beta L stays unbiased as long as `share` was fixed before the first pass was drawn, and
    the second pass happens whatever the first one gave. When other agents failed in the second pass than in
    the first, their evidence is of different nets, so only the first is kept.
    """
    if second.evidence.faults.keys() != first.evidence.faults.keys():
        return first
    return WeightedSample(
        np.concatenate([first.states, second.states]),
        np.concatenate([first.prior_log + np.log(share), second.prior_log + np.log1p(-share)]),
        np.concatenate([first.ancestors, second.ancestors]),
        _concatenate_evidence(first.evidence, second.evidence),
    )


def prior_of(sample: WeightedSample) -> LogWeights:
    """beta, normalised: the prior weights that measures use. Unchanged when normalised but for rounding."""
    equal = LogWeights.uniform(len(sample))
    if sample.prior_log is equal.log:  # as after resampling
        return equal
    beta, log_total = LogWeights.normalise(sample.prior_log)
    return LogWeights(sample.prior_log) if abs(log_total) < ROUNDING else beta


def _concatenate_evidence(first: Evidence, second: Evidence) -> Evidence:
    """The evidence of both, end to end. Gaussian messages are those of the first: one place was measured."""
    return Evidence(
        np.concatenate([first.log_likelihood, second.log_likelihood]),
        _concatenate_arrays(first.messages, second.messages),
        {node: _concatenate_hypotheses(first.latent[node], second.latent[node]) for node in first.latent},
        first.faults,
        first.gaussians,
        None
        if first.sampled is None or second.sampled is None
        else np.concatenate([first.sampled, second.sampled]),
        first.measured,
        _concatenate_arrays(first.factors, second.factors),
    )


def _concatenate_arrays(first: Mapping[str, Floats], second: Mapping[str, Floats]) -> dict[str, Floats]:
    return {name: np.concatenate([values, second[name]]) for name, values in first.items()}


def _concatenate_hypotheses(first: Hypotheses, second: Hypotheses) -> Hypotheses:
    return Hypotheses(
        np.concatenate([first.boxes, second.boxes]), _concatenate_arrays(first.fields, second.fields)
    )
