"""Clocks of cameras, learnt from all targets together: each says what it has seen of them, as a message.

Targets are independent given the clocks, so that the joint Gaussian of clocks o and targets x_i is p(o) times
the product of p(x_i | o). In a frame each target is updated together with its own copy of o, from p(o) to
p(o | z_i). What it has seen is the ratio of these two, and p(o | all) is p(o) times all ratios: a frame's
evidence counts once. Then each target is given that marginal, with its p(x_i | o, z_i) kept (Jeffrey's rule).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import symmetric

LEAST_SEEN = 1e-9
"""A target that leaves all but so much of the variance of a clock has seen nothing of it."""

REPORTED = 0.5
"""A clock is reported when its sd has fallen to this share of that of the last report."""


class ClockMessage(NamedTuple):
    """Copy of the clocks of one target after it was updated by itself.

    Attributes:
        mean: (K,) of its own copy of the clocks.
        covariance: (K, K).
    """

    mean: Floats
    covariance: Floats


@dataclass(frozen=True)
class ClockReading:
    """A camera's clock: by how much the times of its frames are late, s, and its sd."""

    offset_s: float
    sd_s: float


@dataclass(frozen=True, eq=False)
class Clocks:
    """Gaussian of the clocks of cameras.

    Attributes:
        names: (camera, what of its clock) of each of the K numbers.
        offsets: camera -> place of its offset.
        rates: (place of an offset, place of the rate by which it grows per second), of those that do.
        mean: (K,) s, and s per s of rates.
        covariance: (K, K).
        reported: camera -> what was reported last; before that what the graph says.
    """

    names: tuple[tuple[str, str], ...]
    offsets: Mapping[str, int]
    rates: tuple[tuple[int, int], ...]
    mean: Floats
    covariance: Floats
    reported: Mapping[str, ClockReading] = field(default_factory=dict)

    def later(self, seconds: float) -> Clocks:
        """The clocks so much later."""
        ahead = np.eye(len(self.mean))
        for grown, rate in self.rates:
            ahead[grown, rate] = seconds
        return replace(self, mean=ahead @ self.mean, covariance=symmetric(ahead @ self.covariance @ ahead.T))

    def after(self, messages: Iterable[ClockMessage]) -> Clocks:
        """The clocks after a frame in which targets saw something of them.

        What a target has seen is taken in the directions in which it is surer than the prior; a mixture of
        associations may be less sure in some.
        """
        lower = np.linalg.cholesky(self.covariance)
        information, pull = np.eye(len(self.mean)), np.zeros(len(self.mean))
        for mean, covariance in messages:
            half = np.linalg.solve(lower, covariance)
            whitened = np.asarray(np.linalg.solve(lower, half.T), dtype=np.float64)
            variances, axes = np.linalg.eigh(symmetric(whitened))
            is_seen = variances < 1.0 - LEAST_SEEN
            if not is_seen.any():
                continue
            axes, precisions = axes[:, is_seen], 1.0 / np.maximum(variances[is_seen], 1e-12)
            information += (axes * (precisions - 1.0)) @ axes.T
            pull += axes @ (precisions * (axes.T @ np.linalg.solve(lower, mean - self.mean)))
        mean = self.mean + lower @ np.linalg.solve(information, pull)
        covariance = np.asarray(lower @ np.linalg.solve(information, lower.T), dtype=np.float64)
        return replace(self, mean=mean, covariance=symmetric(covariance))

    def reading(self, camera: str) -> ClockReading:
        """The clock of a camera."""
        place = self.offsets[camera]
        return ClockReading(float(self.mean[place]), float(np.sqrt(self.covariance[place, place])))

    def report(self) -> tuple[Clocks, dict[str, tuple[ClockReading, ClockReading]]]:
        """The clocks, and those to report: camera -> its clock, and as it was reported last.

        It is reported when it is much surer than last time, or when it is elsewhere.
        """
        news = {}
        for camera, last in self.reported.items():
            reading = self.reading(camera)
            moved = abs(reading.offset_s - last.offset_s)
            if reading.sd_s <= REPORTED * last.sd_s or moved > 3.0 * last.sd_s:
                news[camera] = reading, last
        if not news:
            return self, news
        reported = {**self.reported, **{camera: reading for camera, (reading, _) in news.items()}}
        return replace(self, reported=reported), news


@dataclass(frozen=True, eq=False)
class PlateClocks:
    """The clocks as fields of the states of a plate.

    Attributes:
        clocks: all of them.
        columns: of the states.
        places: of each column among the K numbers of the clocks.
        of_view: view -> the column of its camera's offset.
    """

    clocks: Clocks
    columns: Sequence[int]
    places: Sequence[int]
    of_view: Mapping[str, int]

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """Mean and covariance of the columns."""
        return self.clocks.mean[self.places], self.clocks.covariance[np.ix_(self.places, self.places)]

    def message(self, mean: Floats, covariance: Floats) -> ClockMessage:
        """Message of a target of the plate, N(mean, covariance) after its own update, on all clocks."""
        known, at = self.clocks, list(self.columns)
        if len(at) == len(known.mean) and list(self.places) == list(range(len(at))):
            return ClockMessage(mean[at], covariance[np.ix_(at, at)])
        # Of cameras that this plate has no view of it says nothing: they follow the others, as before.
        places = np.ix_(self.places, self.places)
        gain = np.linalg.solve(known.covariance[places], known.covariance[self.places, :]).T
        spread = covariance[np.ix_(at, at)] - known.covariance[places]
        moved = mean[at] - known.mean[self.places]
        return ClockMessage(known.mean + gain @ moved, symmetric(known.covariance + gain @ spread @ gain.T))

    def adopted(self, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """N(mean, covariance) of a state with the clocks' marginal in place of its own."""
        own, (target, spread) = np.ix_(self.columns, self.columns), self.moments
        scale = np.sqrt(np.diagonal(covariance)[self.columns])  # an offset of .1 s beside a rate of 1e-5
        by = covariance[:, self.columns] / scale
        gain = np.linalg.solve(covariance[own] / np.outer(scale, scale), by.T).T / scale
        after = symmetric(covariance + gain @ (spread - covariance[own]) @ gain.T)
        after[own] = spread
        moved = mean + gain @ (target - mean[self.columns])
        moved[self.columns] = target
        return moved, after

    def begun(self, view: str, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """States (N, D), now, that a frame of a view started, which shows them by its offset earlier.

        x = p + o v, with o and v independent as yet.
        """
        mean, covariance = mean.copy(), covariance.copy()
        target, spread = self.moments
        mean[:, self.columns] = target
        at = np.array(self.columns)
        covariance[:, at[:, None], at] = spread
        column = self.of_view.get(view)
        if column is None:
            return mean, covariance
        offset, variance = target[list(self.columns).index(column)], covariance[:, column, column]
        ahead = np.tile(np.eye(mean.shape[1]), (len(mean), 1, 1))
        second = [covariance[:, speed, speed] * variance for speed in (4, 5)]
        for place, speed in ((0, 4), (1, 5)):
            ahead[:, place, speed], ahead[:, place, column] = offset, mean[:, speed]
        mean[:, :2] += offset * mean[:, 4:6]
        covariance = ahead @ covariance @ np.swapaxes(ahead, 1, 2)
        for place, more in enumerate(second):
            covariance[:, place, place] += more
        return mean, covariance
