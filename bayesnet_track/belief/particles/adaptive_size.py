"""First pass of a frame: the number of hypotheses drawn from the motion model, their parents and modes.

An adaptive size draws as many as the last frame asked for, in two halves from independent streams. When a
half finds that the frame asks for more, the *other* half is enlarged. Each half's number then depends on the
last frame and the other half alone, so its mean likelihood has the frame's evidence as its mean, and so has
the mean of the two: sum beta L with beta = 1 / (2 N_half). (A half that were enlarged on its own account
would be biased: it grows when it happens to fit badly.) No hypothesis is thrown away, and no second
evaluation is needed while frames ask for the same.

Unknown constants beside the hypotheses are kept by kernel shrinkage (Liu and West 2001). A field that
neither drifts nor has noise is only ever resampled: after a few frames all hypotheses share a few of its
first values. So each frame begins with new parents, whose values are drawn towards their mean and spread
anew, with the weighted mean and covariance V of the hypotheses, in each mode on its own, and the discount d::

    theta_i <- a theta_i + (1 - a) mean + N(0, V / (1 - sum w^2) - a^2 V),  a = (3 d - 1) / (2 d)

The mean is kept. So is the covariance, by its unbiased estimate V / (1 - sum w^2): V itself is too small by a
share of 1 / ESS, and kernels that kept it would narrow in each frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Ancestors, MotionModel, hypotheses_of
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.formulas import FormulaMotion
from bayesnet_track.belief.motion.jumps import Jumping, draw_jumps, jumping_of, modal_of, report_reappeared
from bayesnet_track.belief.motion.modes import Modal, draw_mode
from bayesnet_track.belief.motion.start_prior import StartPrior
from bayesnet_track.belief.particles.particle_set import Inputs, ParticleSet
from bayesnet_track.belief.particles.sample_size import (
    FrameSample,
    SampleSize,
    SizeDecision,
    SizeMemory,
    WeightedSample,
    begin_with,
    concatenate,
    find_sample_size,
    halve,
    make_report,
)
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.resampling import resample

EVENLY = 0.2
"""Share of the hypotheses that draw their mode evenly among those that can follow: weights are at most
1 / (1 - EVENLY)."""


@dataclass(frozen=True, eq=False)
class DrawnModes:
    """Hypotheses that have drawn the modes in which they are about to move.

    Attributes:
        inputs: with them as the belief before, and a motion that draws no modes any more.
        prior_log: (N,) log-weights that make them a sample of the prior.
    """

    inputs: Inputs
    prior_log: Floats


def draw_modes(inputs: Inputs, ancestors: NDArray[np.intp], beta_log: Floats) -> DrawnModes | None:
    """The modes of hypotheses that move from `ancestors`; None for a motion without modes.

    A mode that the chain enters once in a hundred frames would have a few hypotheses, and when it is entered
    the belief would be what those few are. So a mode is drawn from q = (1 - EVENLY) P + EVENLY U, U even
    among those that can follow, and the hypothesis is weighted by P / q.
    """
    modal = modal_of(inputs.motion)
    if modal is None:
        return None
    prior, rng = inputs.prior, inputs.stream("modes")
    states = prior.states[ancestors]
    chain = modal.chain.over(inputs.dt)
    can_follow = chain > 0
    drawn_by = (1.0 - EVENLY) * chain + EVENLY * can_follow / can_follow.sum(axis=1, keepdims=True)
    previous_modes, size = states[:, -1].astype(np.intp), len(states)
    modes = draw_mode(drawn_by[previous_modes], (rng.permutation(size) + rng.random(size)) / size)
    states[:, -1] = modes
    prior_log = beta_log + np.log(chain[previous_modes, modes] / drawn_by[previous_modes, modes])
    mode_inputs = replace(inputs, prior=replace(prior, states=states), motion=_settle(inputs.motion))
    return DrawnModes(mode_inputs, prior_log)


def _settle(motion: MotionModel) -> MotionModel:
    """The motion, drawing no modes."""
    match motion:
        case Modal():
            return replace(motion, settled=True)
        case Confined() | Jumping():
            return replace(motion, motion=_settle(motion.motion))
    return motion


def start_size(settings: spec.Particles) -> int:
    """Number of hypotheses at the start of a target."""
    return settings.size if isinstance(settings.size, int) else settings.least


WillRepeat = Callable[[Floats, Floats], bool]
"""(prior log-weights, log-likelihoods) of a half -> whether it calls for a second pass of the frame."""


def fixed_size(settings: spec.Particles, size: int, inputs: Inputs) -> FrameSample:
    """So many hypotheses drawn from the motion model, with their evidence."""
    jumping, ancestors, beta = jumping_of(inputs.motion), *_of_last(settings, inputs, size)
    modes = draw_modes(inputs, ancestors, beta.log)
    if modes is not None:
        sample = _with_modes(modes, jumping_of(modes.inputs.motion))
        return replace(sample, whole=replace(sample.whole, ancestors=ancestors))
    if jumping is not None:
        return _with_jumps(inputs, jumping, ancestors, beta.log)
    return FrameSample(evaluate_sample(inputs, move(inputs, ancestors, "propagate"), beta.log, ancestors))


def resize_by(
    settings: spec.Particles, inputs: Inputs, sample: WeightedSample, size_memory: SizeMemory | None
) -> SizeMemory | None:
    """Memory of an adaptive size of a frame whose passes are `sample`."""
    if size_memory is None or isinstance(settings.size, int):
        return size_memory
    return replace(size_memory, wanted=_find_size(settings.size, inputs, sample, slice(None)))


def _with_modes(modes: DrawnModes, jumping: Jumping | None) -> FrameSample:
    """The same where hypotheses have drawn their modes before they move."""
    parents = np.arange(len(modes.prior_log))
    if jumping is not None:
        return _with_jumps(modes.inputs, jumping, parents, modes.prior_log)
    states = move(modes.inputs, parents, "propagate")
    scaled = LogWeights.normalise(modes.prior_log)[0].log
    return FrameSample(
        replace(evaluate_sample(modes.inputs, states, scaled, parents), prior_log=modes.prior_log)
    )


def _with_jumps(inputs: Inputs, jumping: Jumping, ancestors: Ancestors, beta_log: Floats) -> FrameSample:
    """The same where some jump, and what is told when they hold the belief."""
    jumps = draw_jumps(inputs, jumping, ancestors, beta_log)
    scaled = LogWeights.normalise(jumps.prior_log)[0].log
    sample = replace(evaluate_sample(inputs, jumps.states, scaled, ancestors), prior_log=jumps.prior_log)
    try:
        weights, _ = LogWeights.normalise(jumps.prior_log + sample.evidence.log_likelihood)
    except DegenerateWeights:
        return FrameSample(sample)
    event = report_reappeared(jumping, jumps, weights, inputs.prior.mean)
    if event is None:
        return FrameSample(sample)
    return FrameSample(sample, reports=(lambda frame, target: replace(event, frame=frame, target=target),))


def _of_last(settings: spec.Particles, inputs: Inputs, size: int) -> tuple[Ancestors, LogWeights]:
    """The hypotheses of the last frame that those of this one move from, and their weights."""
    prior = inputs.prior
    if must_resample(settings, prior, size):
        ancestors, log = draw_parents(settings, inputs, size, "resample")
        return ancestors, LogWeights.uniform(size) if log is None else LogWeights.normalise(log)[0]
    return np.arange(len(prior)), prior.weights


def adaptive_size(
    settings: spec.Particles, size: spec.AdaptiveSize, will_repeat: WillRepeat, inputs: Inputs
) -> FrameSample:
    """Hypotheses drawn from the motion model, as many as the frame asks for, with their evidence.

    The number is not enlarged on account of a half that calls for a second pass, whose hypotheses are better
    placed (`resize_by` looks at both).
    """
    low, high = settings.least, settings.most
    memory = inputs.prior.size_memory or SizeMemory(low, low, SampleSize(low, 0.0))
    halves = halve(begin_with(memory, low, high))
    sample = _draw_halves(settings, inputs, halves, "")
    first, second = (
        _size_unless(will_repeat, size, inputs, sample, part)
        for part in (slice(halves[0]), slice(halves[0], None))
    )
    sizing = SizeDecision(size, memory, (first, second), low, high)
    if any(sizing.more):
        sample = _enlarge(sample, _draw_halves(settings, inputs, sizing.more, " more"), halves, sizing.more)
    wish = _find_size(size, inputs, sample, slice(None))
    # The second look may not have joined the first.
    if not sizing.is_notable or len(sample) != sizing.particles:
        return FrameSample(sample, SizeMemory(len(sample), memory.reported, wish))
    return FrameSample(sample, SizeMemory(len(sample), sizing.particles, wish), (make_report(sizing),))


def _find_size(size: spec.AdaptiveSize, inputs: Inputs, sample: WeightedSample, part: slice) -> SampleSize:
    likelihood = sample.evidence.log_likelihood[part]
    return find_sample_size(
        size, sample.states[part], inputs.prior.fields, sample.prior_log[part], likelihood
    )


def _size_unless(
    will_repeat: WillRepeat, size: spec.AdaptiveSize, inputs: Inputs, sample: WeightedSample, part: slice
) -> SampleSize:
    """Sample size that a part asks for; no more than there are where it calls for a second pass."""
    wish = _find_size(size, inputs, sample, part)
    if will_repeat(sample.prior_log[part], sample.evidence.log_likelihood[part]):
        return replace(wish, particles=min(wish.particles, float(len(sample))))
    return wish


def _draw_halves(
    settings: spec.Particles, inputs: Inputs, counts: tuple[int, int], suffix: str
) -> WeightedSample:
    """One pass of two halves that share no random number."""
    streams = [(f"{half}{suffix}", count) for half, count in zip(("", " half"), counts, strict=True) if count]
    draws = [draw_parents(settings, inputs, count, f"resample{name}") for name, count in streams]
    parents = [ancestors for ancestors, _ in draws]
    states = [move(inputs, parents[n], f"propagate{name}") for n, (name, _) in enumerate(streams)]
    beta = LogWeights.uniform(sum(counts))
    log_weights = [log + np.log(len(log) / sum(counts)) for _, log in draws if log is not None]
    if log_weights:
        beta = LogWeights.normalise(np.concatenate(log_weights))[0]
    return evaluate_sample(inputs, np.concatenate(states), beta.log, np.concatenate(parents))


def _enlarge(
    sample: WeightedSample, extra: WeightedSample, halves: tuple[int, int], counts: tuple[int, int]
) -> WeightedSample:
    """Both passes as one, each half with half of the prior weight; the first alone where they do not join."""
    joined = concatenate(sample, extra, 0.5)
    if len(joined) == len(sample):
        return joined
    log_beta = [-np.log(2.0 * (start + added)) for start, added in zip(halves, counts, strict=True)]
    return replace(joined, prior_log=np.repeat(log_beta * 2, (*halves, *counts)))


def must_resample(settings: spec.Particles, prior: ParticleSet, size: int) -> bool:
    """True when the settings ask for new parents, given the weights of the last posterior.

    So does a number other than `size`: each second pass would add to it, and each rejection take away.
    """
    when = settings.when
    if not isinstance(when, spec.EssBelow) or len(prior) != size:
        return True
    return prior.weights.ess < when.ess_below * size


def draw_parents(
    settings: spec.Particles, inputs: Inputs, size: int, purpose: str
) -> tuple[Ancestors, Floats | None]:
    """(size,) indices of hypotheses of the prior, each drawn `size` times its weight on average.

    What a target is and stays (`category`) is never drawn anew, so a value without hypotheses would be out
    for good. Hypotheses of each value are drawn with a share of at least `EVENLY` by their number, and keep
    the value's weight: then (size,) log-weights are given, too.
    """
    rng, weights = inputs.stream(purpose), inputs.prior.weights.weights
    modal = modal_of(inputs.motion)
    if modal is None or not modal.modes.constants:
        return resample(settings.resample, weights, size, rng).astype(np.intp, copy=False), None
    kinds = modal.modes.kinds[inputs.prior.states[:, -1].astype(np.intp)]
    shares = np.bincount(kinds, weights)
    alive = shares > 0.0
    drawn_shares = (1.0 - EVENLY) * shares + EVENLY * alive / alive.sum()
    factors = np.divide(drawn_shares, shares, out=np.zeros_like(shares), where=alive)
    ancestors = resample(settings.resample, weights * factors[kinds], size, rng).astype(np.intp, copy=False)
    counts = np.bincount(kinds[ancestors], minlength=len(shares))
    return ancestors, np.log(shares[kinds[ancestors]] / counts[kinds[ancestors]])


def move(inputs: Inputs, ancestors: Ancestors, purpose: str) -> Floats:
    """(N, D) states of the frame: the parents', moved by the motion model."""
    return inputs.motion.propagate(inputs.prior.states, inputs.dt, inputs.stream(purpose), ancestors)


def evaluate_sample(
    inputs: Inputs, states: Floats, prior_log: Floats, ancestors: Ancestors
) -> WeightedSample:
    """One pass: what the net says of `states` (N, D) of normalised prior log-weights (N,)."""
    evidence = inputs.evaluate(hypotheses_of(states, inputs.prior.fields), prior_log)
    return WeightedSample(states, prior_log, ancestors, evidence)


def static_fields(motion: MotionModel) -> tuple[str, ...]:
    """Fields that are uncertain when the target starts and that no motion changes, in any mode."""
    motions = list(formulas_in(motion))
    constants = [part.static(_prior_in(motion)) for part in motions]
    names = dict.fromkeys(name for fields in constants for name in fields)
    return tuple(name for name in names if all(name in fields for fields in constants))


def _prior_in(motion: object) -> StartPrior | None:
    """The start prior of a motion, confined or not."""
    while motion is not None and getattr(motion, "prior", None) is None:
        motion = getattr(motion, "motion", None)
    return getattr(motion, "prior", None)


def formulas_in(motion: object) -> Iterator[FormulaMotion]:
    """The motions by expressions in a motion: of each mode, confined or not."""
    if isinstance(motion, FormulaMotion):
        yield motion
        return
    parts = getattr(motion, "parts", None)
    inner_motions = parts if parts is not None else (getattr(motion, "motion", None),)
    for inner in inner_motions:
        if inner is not None:
            yield from formulas_in(inner)
