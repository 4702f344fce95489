"""The particles of many targets as arrays, a row each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.shared import read_only


@dataclass(frozen=True, eq=False)
class Clouds:
    """N weighted hypotheses of each of T targets.

    Attributes:
        states: (T, N, D) float64, the box (x, y, w, h; centre, px) first.
        fields: names of the D columns.
        log: (T, N) normalised log-weights.
        weights: (T, N) the weights.
    """

    states: Floats
    fields: tuple[str, ...]
    log: Floats
    weights: Floats

    @classmethod
    def of(cls, beliefs: Sequence[ParticleSet]) -> Clouds:
        """Those of beliefs, one at least, with the same fields and as many hypotheses each."""
        return cls(
            np.array([one.states for one in beliefs]),
            beliefs[0].fields,
            np.array([one.weights.log for one in beliefs]),
            np.array([one.weights.weights for one in beliefs]),
        )

    def __len__(self) -> int:
        return len(self.states)

    def belief(self, row: int) -> ParticleSet:
        """One target's, without copying."""
        own = LogWeights(read_only(self.log[row]))
        own.__dict__["weights"] = read_only(self.weights[row])
        return ParticleSet(self.states[row], self.fields, own)

    def extended(self, others: Clouds) -> Clouds:
        """These, then others with the same fields and as many hypotheses each."""
        return Clouds(
            np.concatenate([self.states, others.states]),
            self.fields,
            np.concatenate([self.log, others.log]),
            np.concatenate([self.weights, others.weights]),
        )

    def take(self, rows: Sequence[int]) -> Clouds:
        """Those of some targets."""
        chosen = some(rows)
        return Clouds(self.states[chosen], self.fields, self.log[chosen], self.weights[chosen])

    @property
    def means(self) -> Floats:
        """(T, D) weighted means."""
        return np.asarray(np.matmul(self.weights[:, None], self.states)[:, 0])

    @property
    def box_moments(self) -> tuple[Floats, Floats]:
        """(T, 4) means and (T, 4) variances of the centre boxes, px and px^2."""
        weights, boxes = self.weights[:, None], self.states[:, :, :4]
        means = np.matmul(weights, boxes)
        return means[:, 0], np.matmul(weights, np.square(boxes - means))[:, 0]

    @property
    def covariances(self) -> Floats:
        """(T, D, D), as `ParticleSet.covariance`."""
        away = self.states - np.matmul(self.weights[:, None], self.states)
        return np.asarray(np.matmul((away * self.weights[:, :, None]).swapaxes(1, 2), away))


def some(rows: Sequence[int]) -> slice | list[int]:
    """What chooses rows from an array: the first ones without a copy.

    >>> some([0, 1, 2]), some([1, 2])
    (slice(None, 3, None), [1, 2])
    """
    return slice(len(rows)) if list(rows) == [*range(len(rows))] else list(rows)
