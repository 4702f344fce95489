"""Beliefs of several targets as what an expression is evaluated at: weighted states, or moments where exact.

A group holds T >= 1 targets with the same fields. What it answers of a target never depends on the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from statistics import NormalDist
from typing import Protocol

import numpy as np

from bayesnet_track.belief.contract import Posterior
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.grid.cells import AXIS, GridBelief
from bayesnet_track.belief.motion.modes import Modes
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.numerics.arrays import Floats

NODES = 1024
"""Nodes of an expectation over a Gaussian that has no closed form."""
Fields = Mapping[str, Floats]
"""Field -> its values, broadcastable to (T, N)."""


class BeliefGroup(Protocol):
    """The beliefs of T targets."""

    @property
    def ids(self) -> Sequence[str]:
        """The targets."""

    def nodes(self, names: Sequence[str]) -> tuple[Fields, Floats]:
        """Fields of N weighted states of each target, and their weights (T, N), which sum to 1."""

    def moments(self, factors: Mapping[str, float]) -> tuple[Floats, Floats] | None:
        """(T,) means and variances of a linear form that is normal; None where it is not."""

    def take(self, row: int) -> BeliefGroup:
        """One of the targets."""


@dataclass(frozen=True, eq=False)
class WeightedGroup:
    """Targets held by particles: states (T, N, D) and weights (T, N)."""

    ids: Sequence[str]
    fields: Sequence[str]
    states: Floats
    weights: Floats
    modes: Modes | None = None

    def nodes(self, names: Sequence[str]) -> tuple[Fields, Floats]:
        """The hypotheses."""
        return {name: self._values(name) for name in names}, self.weights

    def _values(self, name: str) -> Floats:
        if self.modes is not None and name in self.modes.index:
            return self.modes.fields(self.states[:, :, -1])[name]
        return np.asarray(self.states[:, :, self.fields.index(name)])

    def moments(self, factors: Mapping[str, float]) -> None:
        """Nothing: hypotheses are counted."""
        return

    def take(self, row: int) -> WeightedGroup:
        """One of the targets."""
        row_only = slice(row, row + 1)
        return WeightedGroup(
            [self.ids[row]], self.fields, self.states[row_only], self.weights[row_only], self.modes
        )


@dataclass(frozen=True, eq=False)
class GaussianGroup:
    """Targets with one Gaussian each: means (T, D) and covariances (T, D, D)."""

    ids: Sequence[str]
    fields: Sequence[str]
    means: Floats
    covariances: Floats

    def nodes(self, names: Sequence[str]) -> tuple[Fields, Floats]:
        """`quadrature.NODES` fixed points over the fields that are asked for, equally weighted."""
        columns = [self.fields.index(name) for name in names]
        if not columns:
            return {}, np.ones((len(self.ids), 1))
        part = self.covariances[:, columns][:, :, columns]
        variances, vectors = np.linalg.eigh(part)
        roots = vectors * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
        points = normal_nodes(len(columns))
        states = self.means[:, columns, None] + roots @ points.T  # (T, K, N)
        weights = np.full((len(self.ids), NODES), 1.0 / NODES)
        return {name: states[:, k] for k, name in enumerate(names)}, weights

    def moments(self, factors: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Mean and variance of a linear form, exact."""
        form = np.array([factors.get(name, 0.0) for name in self.fields])
        means = np.sum(self.means * form, axis=1)
        return means, np.maximum(np.sum(self.covariances * np.outer(form, form), axis=(1, 2)), 0.0)

    def take(self, row: int) -> GaussianGroup:
        """One of the targets."""
        row_only = slice(row, row + 1)
        return GaussianGroup([self.ids[row]], self.fields, self.means[row_only], self.covariances[row_only])


@dataclass(frozen=True, eq=False)
class SingleGroup:
    """One target with a belief of another kind: a grid, or Gaussians of modes."""

    ids: Sequence[str]
    belief: GridBelief | ModalPosterior
    modes: Modes | None = None

    def nodes(self, names: Sequence[str]) -> tuple[Fields, Floats]:
        """Its cells, summed over what is not asked for; of modes, the points of each Gaussian."""
        belief = self.belief
        return _cells(belief, names) if isinstance(belief, GridBelief) else _points(belief, self.modes, names)

    def moments(self, factors: Mapping[str, float]) -> None:
        """Nothing: neither cells nor a mixture are normal."""
        return

    def take(self, row: int) -> SingleGroup:
        """The target."""
        return self

    @cached_property
    def fields(self) -> Sequence[str]:
        """Names of the columns of a state."""
        return self.belief.fields


def _cells(belief: GridBelief, names: Sequence[str]) -> tuple[Fields, Floats]:
    axes = sorted({AXIS[name] for name in names})
    mass = belief.mass.sum(axis=tuple({0, 1, 2, 3, 4} - {*axes}))
    values = dict(zip(belief.fields, belief.values, strict=True))
    fields = {}
    for name in names:
        shape = [1] * len(axes)
        shape[axes.index(AXIS[name])] = -1
        fields[name] = np.broadcast_to(values[name].reshape(shape), mass.shape).reshape(1, -1)
    weights = np.asarray(mass).reshape(1, -1)
    return fields, weights / weights.sum()


def _points(belief: ModalPosterior, modes: Modes | None, names: Sequence[str]) -> tuple[Fields, Floats]:
    discrete = {} if modes is None else modes.index
    moving = [name for name in names if name not in discrete]
    group = GaussianGroup(
        [""] * len(belief.parts),
        belief.fields,
        np.array([part.mean for part in belief.parts]),
        np.array([part.covariance for part in belief.parts]),
    )
    fields, weights = group.nodes(moving)
    shares = belief.mode_probabilities / belief.mode_probabilities.sum()
    shared = (weights * shares[:, None]).reshape(1, -1)
    values = {name: values.reshape(1, -1) for name, values in fields.items()}
    for name in names:
        if name in discrete:
            repeated = np.repeat(discrete[name].astype(np.float64), weights.shape[1])
            values[name] = repeated.reshape(1, -1)
    return values, shared


def groups_of(beliefs: Iterable[tuple[str, Posterior]], modes: Modes | None = None) -> list[BeliefGroup]:
    """Beliefs of targets as groups: those that are alike together, each kind in the order given.

    `modes` are those of the targets, so that queries may read them and what the targets are.
    """
    members_by_kind: dict[tuple[object, ...], list[tuple[str, Posterior]]] = {}
    for target, belief in beliefs:
        key: tuple[object, ...] = (target,)
        if isinstance(belief, ParticleSet):
            key = (ParticleSet, belief.fields, belief.states.shape)
        elif isinstance(belief, GaussianPosterior):
            key = (GaussianPosterior, belief.fields)
        members_by_kind.setdefault(key, []).append((target, belief))
    return [_group(members, modes) for members in members_by_kind.values()]


def _group(members: Sequence[tuple[str, Posterior]], modes: Modes | None) -> BeliefGroup:
    ids, first = [target for target, _ in members], members[0][1]
    if isinstance(first, ParticleSet):
        sets = [member for _, member in members if isinstance(member, ParticleSet)]
        states = np.array([member.states for member in sets])
        weights = np.array([member.weights.weights for member in sets])
        return WeightedGroup(ids, first.fields, states, weights, modes)
    if isinstance(first, GaussianPosterior):
        means, covariances = (
            [member.mean for _, member in members],
            [member.covariance for _, member in members],
        )
        return GaussianGroup(ids, first.fields, np.array(means), np.array(covariances))
    if isinstance(first, GridBelief | ModalPosterior):
        return SingleGroup(ids, first, modes)
    raise TypeError(f"no queries of a {type(first).__name__}")


# ------------------------------------------------------------------------------------ nodes


@lru_cache(maxsize=32)
def uniform_nodes(dimensions: int, count: int = NODES) -> Floats:
    """(count, dimensions) evenly spread points of the unit cube, always the same.

    The additive recurrence of the generalised golden ratio (Roberts, 2018); of one dimension the midpoints of
    equal intervals, whose error is of order 1 / count.

    >>> uniform_nodes(1, 4)[:, 0].tolist()
    [0.125, 0.375, 0.625, 0.875]
    """
    number = np.arange(count, dtype=np.float64)
    if dimensions == 1:
        points = ((number + 0.5) / count)[:, None]
    else:
        ratio = 2.0
        for _ in range(64):
            ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
        steps = (1.0 / ratio) ** np.arange(1, dimensions + 1)
        points = (0.5 + (number[:, None] + 1.0) * steps) % 1.0
    points.setflags(write=False)
    return np.asarray(points)


@lru_cache(maxsize=32)
def normal_nodes(dimensions: int, count: int = NODES) -> Floats:
    """(count, dimensions) points that stand for a standard normal distribution, always the same."""
    inverse = NormalDist().inv_cdf
    points = np.vectorize(inverse)(np.clip(uniform_nodes(dimensions, count), 1e-12, 1.0 - 1e-12))
    points.setflags(write=False)
    return np.asarray(points, dtype=np.float64)
