"""What is written down of beliefs besides their measures: spread, regions, surprise, a cloud of hypotheses.

Particles of many targets are summarised as arrays, with the bits that each target has alone, and only when
somebody asks for a line of metrics: no rule depends on it.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.belief.particles.particle_set import Clouds, ParticleSet
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.rows.filtered_rows import Together
from bayesnet_track.journal.encoder import written
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import effective, kl
from bayesnet_track.numerics.records import Found

Rows = list[tuple[float, ...]]

CLOUD_SIZE = 48
"""Hypotheses kept per frame, drawn from the posterior, so that they carry no weights."""

SHARES = (0.5, 0.9)
"""Of the centre's weight that lies in the regions."""


@dataclass(frozen=True, eq=False)
class Summary:
    """A belief in a few numbers.

    Attributes:
        variances: (D,) of the states.
        ess: effective number of hypotheses.
        surprise: KL of the belief from its prior, nats.
        regions: of `SHARES`: x_low, x_high, y_low, y_high in px.
        cloud: rounded boxes of some hypotheses.
    """

    variances: Floats
    ess: float
    surprise: float
    regions: Rows
    cloud: tuple[tuple[int, ...], ...]


def find_summaries(
    work: FrameWork, filtered: Mapping[str, Filtered], spreads: Mapping[str, Floats]
) -> Found[Summary]:
    """Target -> its belief in a few numbers, of which `spreads` are the covariances."""
    return Found(filtered, partial(_summarise, work, filtered, spreads))


def find_covariances(filtered: Mapping[str, Filtered]) -> Found[Floats]:
    """Target -> (D, D) covariance of its belief."""
    return Found(filtered, partial(_find_covariances, filtered))


def _summarise(
    work: FrameWork, filtered: Mapping[str, Filtered], spreads: Mapping[str, Floats]
) -> dict[str, Summary]:
    alike, alone = _alike(filtered)
    found = {target: summarise_one(work, target, filtered[target].step, spreads[target]) for target in alone}
    for targets in alike:
        steps = [filtered[target].step for target in targets]
        found |= _summarise_rows(work, targets, steps, np.array([spreads[target] for target in targets]))
    return found


def _find_covariances(filtered: Mapping[str, Filtered]) -> dict[str, Floats]:
    groups = filtered.groups if isinstance(filtered, Together) else ()
    found = dict(pair for group in groups for pair in zip(group.ids, group.clouds.covariances, strict=True))
    alike, alone = _alike(
        {target: one for target, one in filtered.items() if target not in found}
        if len(found) < len(filtered)
        else {}
    )
    found |= {target: filtered[target].step.posterior.covariance for target in alone}
    for targets in alike:
        clouds = Clouds.of([particles(filtered[target].step.posterior) for target in targets])
        found.update(zip(targets, clouds.covariances, strict=True))
    return found


def _alike(filtered: Mapping[str, Filtered]) -> tuple[list[list[str]], list[str]]:
    """Targets of a plate whose particles make an array; then the others."""
    alike: dict[Hashable, list[str]] = {}
    alone: list[str] = []
    for target, one in filtered.items():
        own = one.step.posterior
        if isinstance(own, ParticleSet) and one.step.support is own:
            alike.setdefault((one.plan.root, own.fields, own.states.shape), []).append(target)
        else:
            alone.append(target)
    return list(alike.values()), alone


def summarise_one(work: FrameWork, target: str, step: Step[Posterior], covariance: Floats) -> Summary:
    """The belief of a target after its step in a few numbers, of which the covariance (D, D) is known."""
    posterior, weights = step.posterior, step.support.weights
    cloud = posterior.draw(CLOUD_SIZE, work.stream(target, work.plate_of(target).plate.root)("cloud"))
    return Summary(
        covariance.diagonal(),
        weights.ess,
        kl(weights.log, step.prior.log),
        list(map(tuple, posterior.regions(SHARES).tolist())),
        _rounded(cloud),
    )


def _summarise_rows(
    work: FrameWork, targets: Sequence[str], steps: Sequence[Step[Posterior]], spreads: Floats
) -> dict[str, Summary]:
    from bayesnet_track.numerics.resampling import look_up_even_of_each

    states = np.array([step.support.states for step in steps])
    weights = np.array([step.support.weights.weights for step in steps])
    log = np.array([step.support.weights.log for step in steps])
    variances = np.diagonal(spreads, axis1=1, axis2=2)
    ess = effective(log).tolist()
    surprises = [kl(step.support.weights.log, step.prior.log) for step in steps]
    regions = np.concatenate([_regions(states[:, :, axis], weights) for axis in (0, 1)], axis=2).tolist()
    root = work.plate_of(targets[0]).plate.root
    shifts = work.engine.streams.uniforms(work.births_of(targets), root, work.moment, "cloud")
    chosen = look_up_even_of_each(weights, shifts, CLOUD_SIZE)
    clouds = np.rint(np.take_along_axis(states[:, :, :4], chosen[:, :, None], axis=1)).astype(np.int64)
    return {
        target: Summary(variances[t], ess[t], surprises[t], list(map(tuple, regions[t])), cloud)
        for t, (target, cloud) in enumerate(zip(targets, written(clouds), strict=True))
    }


def _regions(values: Floats, weights: Floats) -> Floats:
    """(T, S, 2) the central `SHARES` of the weight along an axis: values and weights (T, N)."""
    order = values.argsort(axis=1)
    ordered = np.take_along_axis(values, order, axis=1)
    cumulative = np.take_along_axis(weights, order, axis=1).cumsum(axis=1)
    tails = np.array([tail for share in SHARES for tail in ((1.0 - share) / 2.0, (1.0 + share) / 2.0)])
    levels = tails * cumulative[:, -1:]
    before = np.stack([(cumulative < levels[:, k, None]).sum(axis=1) for k in range(len(tails))], axis=1)
    return np.take_along_axis(ordered, before, axis=1).reshape(len(values), len(SHARES), 2)


def _rounded(boxes: Floats) -> tuple[tuple[int, ...], ...]:
    return tuple(map(tuple, np.rint(boxes).astype(np.int64).tolist()))
