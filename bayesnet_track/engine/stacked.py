"""Joint Gaussian of several targets: what relates them is kept from frame to frame by their covariances."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import cast

import numpy as np

from bayesnet_track.belief.contract import MotionModel, Posterior, Step
from bayesnet_track.belief.gaussian.belief import (
    GaussianFilter,
    GaussianPosterior,
    cross_covariance,
    posterior_of,
)
from bayesnet_track.belief.gaussian.rows import update_by_normals
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.graph import spec
from bayesnet_track.graph.expressions.distributions import LinearNormal
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import root, symmetric
from bayesnet_track.numerics.records import evolve

Crosses = Mapping[tuple[str, str], Floats]
"""Two targets -> (D, D') covariance of the first one's state with the second one's."""


@dataclass(frozen=True, eq=False)
class _Member:
    """A target of the stack in one frame.

    Attributes:
        prior: its belief after the last frame.
        step: its belief's step in this one, by its own evidence.
        motion: how it moved.
        settings: of its filter.
        dt: frame intervals since the last frame.
    """

    prior: GaussianPosterior
    step: Step[GaussianPosterior]
    motion: MotionModel
    settings: spec.Gaussian
    dt: float


LinearFactors = Mapping[tuple[str, str], Sequence[LinearNormal]]
"""Two targets -> normal densities of linear forms of ``a.x`` of the first and ``b.x`` of the second."""


def relate_gaussians(
    work: FrameContext, factors: LinearFactors, crosses: Crosses, filtered: FilteredTargets
) -> tuple[dict[str, Step[Posterior]], dict[tuple[str, str], Floats]]:
    """Steps of Gaussian targets that `factors` relate, and the covariances of each two of them."""
    names = [name for name in filtered if any(name in pair for pair in factors)]
    steps, covariances = dict[str, Step[Posterior]](), dict[tuple[str, str], Floats]()
    for group in _connected(names, factors):
        members = {name: _member(work, filtered[name]) for name in group}
        group_factors = {pair: factors[pair] for pair in factors if pair[0] in members}
        group_steps, group_covariances = _step_together(members, crosses, group_factors)
        steps, covariances = {**steps, **group_steps}, {**covariances, **group_covariances}
    return steps, covariances


def _member(work: FrameContext, filtered: Filtered) -> _Member:
    belief = work.engine.plates[work.net.targets[filtered.target].template].belief
    prior = filtered.before.belief
    assert isinstance(belief, GaussianFilter) and isinstance(prior, GaussianPosterior)
    gaussian = cast(Step[GaussianPosterior], filtered.step)
    dt = work.frame.time - filtered.before.time
    return _Member(prior, gaussian, filtered.predicted.motion, belief.settings, dt)


def _step_together(
    members: Mapping[str, _Member], crosses: Crosses, factors: LinearFactors
) -> tuple[dict[str, Step[GaussianPosterior]], dict[tuple[str, str], Floats]]:
    """The steps of the members, and the covariances of each two of them, after the frame.

    With F of each motion the joint prediction has P-_ij = F_i P_ij F_j'. What its own evidence says of a
    target is the Gaussian by which its own step differs from its own prediction, precision P_i^-1 - P-_i^-1.
    The product with it and with `factors` is exact where motions and measurements are linear and Gaussian;
    gates and associations are those of each target by itself.

    Args:
        members: the targets, in the order of the stack.
        crosses: after the last frame; those that are missing are 0.
        factors: of pairs among them.
    """
    places, evidence = dict[str, slice](), list[_Evidence]()
    for name, member in members.items():
        start = sum(len(part.mean) for part in evidence)
        evidence.append(_evidence_of(member))
        places[name] = slice(start, start + len(evidence[-1].mean))
    mean, covariance = _product(evidence, _predicted(members, evidence, crosses))
    for (first, second), normals in factors.items():
        if not normals:
            continue
        letters = {first: "a.", second: "b."}
        fields = [
            f"{letters.get(name, name)}{field}"
            for name, member in members.items()
            for field in member.step.posterior.fields
        ]
        updated = update_by_normals(mean, covariance, fields, normals)
        mean, covariance = updated.mean, updated.covariance
    steps = {
        name: _stepped(member, mean[places[name]], covariance[places[name], places[name]])
        for name, member in members.items()
    }
    pairs = combinations(members, 2)
    return steps, {pair: covariance[places[pair[0]], places[pair[1]]] for pair in pairs}


@dataclass(frozen=True, eq=False)
class _Evidence:
    """A target's evidence, in coordinates u in which its prediction is N(0, 1): x = mean + lower u.

    Attributes:
        mean: (D,) predicted.
        lower: (D, K) root of the predicted covariance.
        whiten: (K, D) its inverse on the directions in which it spreads.
        precision: (K, K) that the evidence adds.
        shift: (K,) that precision times its mean.
        offset: (D,) by how much the step changed the mean in other directions.
    """

    mean: Floats
    lower: Floats
    whiten: Floats
    precision: Floats
    shift: Floats
    offset: Floats


def _evidence_of(member: _Member) -> _Evidence:
    posterior = member.step.posterior
    # Where its own evidence could not be used, its step is its prediction.
    predicted = member.step.predicted[0] if member.step.predicted else posterior
    lower = root(predicted.covariance)
    whiten = np.asarray(np.linalg.pinv(lower), dtype=np.float64)
    change = posterior.mean - predicted.mean
    place = whiten @ change
    posterior_precision = np.linalg.inv(symmetric(whiten @ posterior.covariance @ whiten.T))
    precision = posterior_precision - np.eye(len(place))
    return _Evidence(
        predicted.mean, lower, whiten, precision, posterior_precision @ place, change - lower @ place
    )


def _predicted(members: Mapping[str, _Member], evidence: Sequence[_Evidence], crosses: Crosses) -> Floats:
    """(K, K) joint covariance of the predictions, in the coordinates of each; the identity if it is none."""
    transitions = [
        part.whiten
        @ cross_covariance(member.prior, member.motion, member.dt, member.settings).T
        @ np.linalg.pinv(member.prior.covariance, rcond=1e-12, hermitian=True)
        for part, member in zip(evidence, members.values(), strict=True)
    ]
    joint = np.eye(sum(len(part.shift) for part in evidence))
    blocks = _blocks([len(part.shift) for part in evidence])
    for (i, first), (j, second) in combinations(enumerate(members), 2):
        if (first, second) in crosses:
            cross = transitions[i] @ crosses[first, second] @ transitions[j].T
            joint[blocks[i], blocks[j]], joint[blocks[j], blocks[i]] = cross, cross.T
    # A target that began anew since the last frame no longer has these covariances.
    return joint if np.linalg.eigvalsh(joint)[0] > -1e-9 else np.eye(len(joint))


def _blocks(widths: Sequence[int]) -> list[slice]:
    """Places of vectors of these widths that stand below each other."""
    ends = np.cumsum(widths).tolist()
    return [slice(end - width, end) for end, width in zip(ends, widths, strict=True)]


def _product(evidence: Sequence[_Evidence], prior: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of the prediction times the evidence: (prior^-1 + precision)^-1."""
    blocks = _blocks([len(part.shift) for part in evidence])
    rows = _blocks([len(part.mean) for part in evidence])
    precision, lower = np.zeros_like(prior), np.zeros((rows[-1].stop, len(prior)))
    for part, block, row in zip(evidence, blocks, rows, strict=True):
        precision[block, block], lower[row, block] = part.precision, part.lower
    spread = np.asarray(np.linalg.solve(np.eye(len(prior)) + prior @ precision, prior), dtype=np.float64)
    if np.linalg.eigvalsh(symmetric(spread))[0] <= 0.0:  # a search left a wider belief than the prediction
        spread = np.asarray(np.linalg.inv(np.eye(len(prior)) + precision), dtype=np.float64)
    shift = np.concatenate([part.shift for part in evidence])
    mean = np.concatenate([part.mean + part.offset for part in evidence])
    return mean + lower @ (spread @ shift), symmetric(lower @ spread @ lower.T)


def _stepped(member: _Member, mean: Floats, covariance: Floats) -> Step[GaussianPosterior]:
    """The member's own step with this belief instead."""
    fields, size = member.step.posterior.fields, member.step.posterior.size
    posterior = posterior_of(mean, covariance, fields, size, member.motion)
    return evolve(member.step, posterior=posterior, find_map=lambda: posterior.mean)


def _connected(names: Sequence[str], pairs: Iterable[tuple[str, str]]) -> list[list[str]]:
    """The groups of names that pairs connect, in order."""
    group = {name: frozenset((name,)) for name in names}
    for first, second in pairs:
        union = group[first] | group[second]
        group |= dict.fromkeys(union, union)
    return [[name for name in names if name in union] for union in dict.fromkeys(group.values())]
