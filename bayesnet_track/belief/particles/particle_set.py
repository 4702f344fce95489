"""Weighted hypotheses as a belief, of one target and of many as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesnet_track.belief.contract import Evaluate, MotionModel, Stream, hypotheses_of
from bayesnet_track.belief.particles.sample_size import SizeMemory
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import weighted_mass_in_disc
from bayesnet_track.numerics.log_weights import LogWeights, column_index, uncertainty_deviation
from bayesnet_track.numerics.resampling import resample
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import read_only


@dataclass(frozen=True, eq=False)
class ParticleSet:
    """N weighted hypotheses.

    Attributes:
        states: (N, D) float64, the box (x, y, w, h; centre, px) first.
        fields: names of the D columns.
        weights: their normalised log-weights.
        size_memory: what an adaptive size remembers; None for a fixed one and at the start.
    """

    states: Floats
    fields: tuple[str, ...]
    weights: LogWeights
    size_memory: SizeMemory | None = None

    def __len__(self) -> int:
        return int(self.states.shape[0])

    @property
    def boxes(self) -> Floats:
        """(N, 4) centre boxes."""
        return self.states[:, :4]

    @property
    def hypotheses(self) -> Hypotheses:
        """Hypotheses that cues see of it: the boxes, and the further fields by name."""
        return hypotheses_of(self.states, self.fields)

    @property
    def mean(self) -> Floats:
        """(D,) weighted mean, which lies between the modes of a bimodal belief."""
        return np.asarray(self.weights.weights @ self.states)

    @property
    def covariance(self) -> Floats:
        """(D, D) sum w (x - mean)(x - mean)'; zeros when one hypothesis holds all weight.

        Without the correction for degrees of freedom, which divides by zero there.
        """
        weights = self.weights.weights
        deviations = self.states - weights @ self.states
        return np.asarray((deviations * weights[:, None]).T @ deviations)

    def uncertainty(self, reference: Floats, columns: Sequence[int]) -> float:
        """UD = sum w |s - about|^2 over the columns of the state."""
        selection = column_index(columns)
        return uncertainty_deviation(self.states[:, selection], self.weights.weights, reference[selection])

    def mass_within(self, centre: Floats, radius: float) -> tuple[float, float]:
        """Share of the weight within `radius` px of `centre` (2,), known by so many effective draws."""
        share = weighted_mass_in_disc(self.states[:, :2], self.weights.weights, centre, radius)
        return share, self.weights.ess

    def regions(self, shares: Sequence[float]) -> Floats:
        """(S, 4) x_low, x_high, y_low, y_high, px: the central share of the centre's weight on each axis."""
        tails = np.array([[(1.0 - share) / 2.0, (1.0 + share) / 2.0] for share in shares])
        bounds = np.empty((len(tails), 4))
        for axis, (ordered, cumulative) in enumerate(self._ordered):
            bounds[:, 2 * axis : 2 * axis + 2] = ordered[cumulative.searchsorted(tails * cumulative[-1])]
        return bounds

    @cached_property
    def _ordered(self) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """x, then y: values in ascending order and their cumulative weights. One sort for all regions."""
        weights = self.weights.weights
        return _order(self.states[:, 0], weights), _order(self.states[:, 1], weights)

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 4) boxes of hypotheses, drawn systematically."""
        return self.boxes[resample("systematic", self.weights.weights, size, rng)]


def _order(values: Floats, weights: Floats) -> tuple[Floats, Floats]:
    order = values.argsort()
    return values[order], weights[order].cumsum()


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of every pass of a frame.

    Attributes:
        prior: the belief after the last frame.
        motion: how its states move.
        dt: time since then, in frame intervals.
        evaluate: what the net says of hypotheses.
        stream: the frame's random streams, by purpose.
    """

    prior: ParticleSet
    motion: MotionModel
    dt: float
    evaluate: Evaluate
    stream: Stream


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
        """Clouds of beliefs, one at least, with the same fields and as many hypotheses each."""
        return cls(
            np.array([belief.states for belief in beliefs]),
            beliefs[0].fields,
            np.array([belief.weights.log for belief in beliefs]),
            np.array([belief.weights.weights for belief in beliefs]),
        )

    def __len__(self) -> int:
        return len(self.states)

    def belief(self, row: int) -> ParticleSet:
        """One target's, without copying."""
        weights = LogWeights(read_only(self.log[row]))
        weights.__dict__["weights"] = read_only(self.weights[row])
        return ParticleSet(self.states[row], self.fields, weights)

    def extended(self, clouds: Clouds) -> Clouds:
        """These, then others with the same fields and as many hypotheses each."""
        return Clouds(
            np.concatenate([self.states, clouds.states]),
            self.fields,
            np.concatenate([self.log, clouds.log]),
            np.concatenate([self.weights, clouds.weights]),
        )

    def take(self, rows: Sequence[int]) -> Clouds:
        """Rows of some targets."""
        index = some(rows)
        return Clouds(self.states[index], self.fields, self.log[index], self.weights[index])

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
        deviations = self.states - np.matmul(self.weights[:, None], self.states)
        return np.asarray(np.matmul((deviations * self.weights[:, :, None]).swapaxes(1, 2), deviations))


def some(rows: Sequence[int]) -> slice | list[int]:
    """Index that chooses rows from an array: the first ones without a copy.

    >>> some([0, 1, 2]), some([1, 2])
    (slice(None, 3, None), [1, 2])
    """
    return slice(len(rows)) if list(rows) == [*range(len(rows))] else list(rows)
