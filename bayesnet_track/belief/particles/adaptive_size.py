"""The first pass of a frame: how many hypotheses are drawn from the motion model, and from which parents.

An adaptive size draws as many as the last frame asked for, in two halves from independent streams. When a
half finds that the frame asks for more, the *other* half is enlarged. Each half's number then depends on the
last frame and the other half alone, so its mean likelihood has the frame's evidence as its mean, and so has
the mean of the two: sum beta L with beta = 1 / (2 N_half). (A half that were enlarged on its own account
would be biased: it grows when it happens to fit badly.) No hypothesis is thrown away, and no second
evaluation is needed while frames ask for the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.motion.jumps import Jumping, jumped, jumping_of, reappeared
from bayesnet_track.belief.particles.particle_set import Inputs, ParticleSet
from bayesnet_track.belief.particles.passes import Drawn, Pass, joined
from bayesnet_track.belief.particles.resized import Sizing, begin_with, halved, report_of
from bayesnet_track.belief.particles.sample_size import Need, Sized, need_of
from bayesnet_track.belief.states import hypotheses_of
from bayesnet_track.graph import spec
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.resampling import resample

Floats = NDArray[np.float64]
Ancestors = NDArray[np.intp]


def start_size(settings: spec.Particles) -> int:
    """How many hypotheses a target starts with."""
    return settings.size if isinstance(settings.size, int) else settings.least


WillRepeat = Callable[[Floats, Floats], bool]
"""(prior log-weights, log-likelihoods) of a half -> whether it calls for a second pass of the frame."""


def fixed_size(settings: spec.Particles, size: int, inputs: Inputs) -> Drawn:
    """So many hypotheses drawn from the motion model, with their evidence."""
    jumping = jumping_of(inputs.motion)
    if jumping is not None:
        return _with_jumps(settings, inputs, size, jumping)
    ancestors, beta = _of_last(settings, inputs, size)
    return Drawn(evaluated(inputs, moved(inputs, ancestors, "propagate"), beta.log, ancestors))


def resized_by(settings: spec.Particles, inputs: Inputs, whole: Pass, sized: Sized | None) -> Sized | None:
    """What an adaptive size remembers of a frame whose passes are `whole`."""
    if sized is None or isinstance(settings.size, int):
        return sized
    return replace(sized, need=_need(settings.size, inputs, whole, slice(None)))


def _with_jumps(settings: spec.Particles, inputs: Inputs, size: int, jumping: Jumping) -> Drawn:
    """The same where some jump, and what is told when they hold the belief."""
    ancestors, beta = _of_last(settings, inputs, size)
    jumps = jumped(inputs, jumping, ancestors, beta.log)
    scaled = LogWeights.normalise(jumps.prior_log)[0].log
    one = replace(evaluated(inputs, jumps.states, scaled, ancestors), prior_log=jumps.prior_log)
    try:
        weights, _ = LogWeights.normalise(jumps.prior_log + one.evidence.log_likelihood)
    except DegenerateWeights:
        return Drawn(one)
    told = reappeared(jumping, jumps, weights, inputs.prior.mean)
    if told is None:
        return Drawn(one)
    return Drawn(one, reports=(lambda frame, target: replace(told, frame=frame, target=target),))


def _of_last(settings: spec.Particles, inputs: Inputs, size: int) -> tuple[Ancestors, LogWeights]:
    """The hypotheses of the last frame that those of this one move from, and their weights."""
    prior = inputs.prior
    if must_resample(settings, prior, size):
        return parents(settings, inputs, size, "resample"), LogWeights.uniform(size)
    return np.arange(len(prior)), prior.weights


def adaptive_size(
    settings: spec.Particles, size: spec.AdaptiveSize, will_repeat: WillRepeat, inputs: Inputs
) -> Drawn:
    """As many hypotheses drawn from the motion model as the frame asks for, with their evidence.

    The number is not enlarged on account of a half that calls for a second pass, whose hypotheses are better
    placed (`resized_by` looks at both).
    """
    low, high = settings.least, settings.most
    before = inputs.prior.sized or Sized(low, low, Need(low, 0.0))
    halves = halved(begin_with(before, low, high))
    one = _drawn(settings, inputs, halves, "")
    first, second = (
        _need_unless(will_repeat, size, inputs, one, part)
        for part in (slice(halves[0]), slice(halves[0], None))
    )
    sizing = Sizing(size, before, (first, second), low, high)
    if any(sizing.more):
        one = _enlarged(one, _drawn(settings, inputs, sizing.more, " more"), halves, sizing.more)
    need = _need(size, inputs, one, slice(None))
    if not sizing.is_notable or len(one) != sizing.particles:  # the second look may not have joined the first
        return Drawn(one, Sized(len(one), before.told, need))
    return Drawn(one, Sized(len(one), sizing.particles, need), (report_of(sizing),))


def _need(size: spec.AdaptiveSize, inputs: Inputs, one: Pass, part: slice) -> Need:
    likelihood = one.evidence.log_likelihood[part]
    return need_of(size, one.states[part], inputs.prior.fields, one.prior_log[part], likelihood)


def _need_unless(
    will_repeat: WillRepeat, size: spec.AdaptiveSize, inputs: Inputs, one: Pass, part: slice
) -> Need:
    """The need of a part; no more than there are where it calls for a second pass."""
    need = _need(size, inputs, one, part)
    if will_repeat(one.prior_log[part], one.evidence.log_likelihood[part]):
        return replace(need, particles=min(need.particles, float(len(one))))
    return need


def _drawn(settings: spec.Particles, inputs: Inputs, counts: tuple[int, int], again: str) -> Pass:
    """One pass of two halves that share no random number."""
    streams = [(f"{half}{again}", count) for half, count in zip(("", " half"), counts, strict=True) if count]
    drawn = [parents(settings, inputs, count, f"resample{name}") for name, count in streams]
    states = [moved(inputs, drawn[n], f"propagate{name}") for n, (name, _) in enumerate(streams)]
    beta = LogWeights.uniform(sum(counts))
    return evaluated(inputs, np.concatenate(states), beta.log, np.concatenate(drawn))


def _enlarged(one: Pass, more: Pass, halves: tuple[int, int], counts: tuple[int, int]) -> Pass:
    """Both passes as one, each half with half of the prior weight; the first alone where they do not join."""
    whole = joined(one, more, 0.5)
    if len(whole) == len(one):
        return whole
    log_beta = [-np.log(2.0 * (start + added)) for start, added in zip(halves, counts, strict=True)]
    return replace(whole, prior_log=np.repeat(log_beta * 2, (*halves, *counts)))


def must_resample(settings: spec.Particles, prior: ParticleSet, size: int) -> bool:
    """True when the settings ask for new parents, given the weights of the last posterior.

    So does a number other than `size`: each second pass would add to it, and each rejection take away.
    """
    when = settings.when
    if not isinstance(when, spec.EssBelow) or len(prior) != size:
        return True
    return prior.weights.ess < when.ess_below * size


def parents(settings: spec.Particles, inputs: Inputs, size: int, purpose: str) -> Ancestors:
    """(size,) indices of hypotheses of the prior, each drawn `size` times its weight on average."""
    rng = inputs.stream(purpose)
    return resample(settings.resample, inputs.prior.weights.weights, size, rng).astype(np.intp, copy=False)


def moved(inputs: Inputs, ancestors: Ancestors, purpose: str) -> Floats:
    """(N, D) states of the frame: the parents', moved by the motion model."""
    return inputs.motion.propagate(inputs.prior.states, inputs.dt, inputs.stream(purpose), ancestors)


def evaluated(inputs: Inputs, states: Floats, prior_log: Floats, ancestors: Ancestors) -> Pass:
    """One pass: what the net says of `states` (N, D) of normalised prior log-weights (N,)."""
    evidence = inputs.evaluate(hypotheses_of(states, inputs.prior.fields), prior_log)
    return Pass(states, prior_log, ancestors, evidence)
