"""State of cameras: errors that their targets share, clocks and biases, and which camera was knocked.

Targets are independent given these errors e, so that the joint Gaussian of errors and targets x_i is p(e)
times the product of p(x_i | e). In a frame each target is updated together with its own copy of e, from p(e)
to p(e | z_i). What it has seen is the ratio of these two, and p(e | all) is p(e) times all ratios: a frame's
evidence counts once. Then each target is given that marginal, with its p(x_i | e, z_i) kept (Jeffrey's rule).
This is exact of errors that stay, and of linear measurements. Biases of cameras are learnt from each other: a
shift of the world that all of them share keeps the variance of its prior.

Cameras that were knocked: what all targets of one show at once, and what others do not.

In a frame each target's detection in a camera is off from where the target was expected by o, of a
calibration that is off at that place, of its detector, and of the expectation. The mean of o over the last L
frames less that of the frames before is d_i, whose spread s_L over targets and time is learnt. A knock shifts
all n targets alike: n |mean d_i|^2 / s_L^2 is as chi-square of 2 degrees without one. It is called a knock
where that exceeds `LEVEL`, by more than that of any other camera does, and half of it without any one target:
what people do moves them in every camera, and one who turns moves alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats
from bayesnet_track.numerics.gaussian import adopt, symmetric
from bayesnet_track.numerics.records import evolve

LEAST_SEEN = 1e-9
"""A target that leaves all but so much of the variance of an error has seen nothing of it."""

REPORTED = 0.5
"""A clock is reported when its sd has fallen to this share of that of the last report."""


class ErrorMessage(NamedTuple):
    """Copy of the errors of one target after it was updated by itself.

    Attributes:
        mean: (K,) of its own copy of the errors.
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
class CameraErrors:
    """Gaussian of the errors of cameras: of their clocks, and of where they see things.

    Each is an Ornstein-Uhlenbeck process.

    Attributes:
        names: (camera, axis) of each of the K numbers: of its clock, or x or y of its bias, px.
        offsets: camera -> place of the offset of its clock.
        rates: (place of an offset, place of the rate by which it grows per second), of those that do.
        sds: (K,) before anything is seen: s, s per s of rates, px.
        over_s: (K,) time in which their correlation falls to 1 / e, s.
        mean: (K,).
        covariance: (K, K).
        time_s: when; None before anything is seen.
        reported: camera -> what was reported of its clock last; before that what the graph says.
    """

    names: tuple[tuple[str, str], ...]
    offsets: Mapping[str, int]
    rates: tuple[tuple[int, int], ...]
    sds: Floats
    over_s: Floats
    mean: Floats
    covariance: Floats
    time_s: float | None = None
    reported: Mapping[str, ClockReading] = field(default_factory=dict)

    def at(self, time_s: float) -> CameraErrors:
        """The errors at a later time."""
        if self.time_s is None or self.time_s == time_s:
            return replace(self, time_s=time_s)
        seconds = time_s - self.time_s
        ahead = np.diag(np.exp(-seconds / self.over_s))
        for grown, rate in self.rates:
            ahead[grown, rate] = seconds
        drift = np.diag(-(self.sds**2) * np.expm1(-2.0 * seconds / self.over_s))
        covariance = symmetric(ahead @ self.covariance @ ahead.T + drift)
        return replace(self, mean=ahead @ self.mean, covariance=covariance, time_s=time_s)

    def after(self, messages: Iterable[ErrorMessage]) -> CameraErrors:
        """The errors after a frame in which targets saw something of them.

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

    def shifted(self, camera: str, knock: Knock) -> CameraErrors:
        """The errors after a knock of a camera, which is independent of all that was seen before it."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        for axis, shift in (("x", knock.x), ("y", knock.y)):
            place = self.names.index((camera, axis))
            mean[place] += shift
            covariance[place, place] += knock.variance
        return replace(self, mean=mean, covariance=covariance)

    def reading(self, camera: str) -> ClockReading:
        """The clock of a camera."""
        place = self.offsets[camera]
        return ClockReading(float(self.mean[place]), float(np.sqrt(self.covariance[place, place])))

    def report(self) -> tuple[CameraErrors, dict[str, tuple[ClockReading, ClockReading]]]:
        """The errors, and clocks to report: camera -> its clock, and as it was reported last.

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
class PlateErrors:
    """The errors of cameras as fields of the states of a plate.

    Attributes:
        errors: all of them.
        columns: of the states.
        places: of each column among the K numbers of the errors.
        clock_of: view -> the column of its camera's offset.
        bias_of: view -> the columns of its camera's bias.
        axes: columns of a place, each with that of its velocity.
    """

    errors: CameraErrors
    columns: Sequence[int]
    places: Sequence[int]
    clock_of: Mapping[str, int]
    bias_of: Mapping[str, Sequence[int]]
    axes: Sequence[tuple[int, int]] = ((0, 4), (1, 5))

    def moments(self, columns: Sequence[int]) -> tuple[Floats, Floats]:
        """Mean and covariance of some of the columns."""
        places = [self.places[self.columns.index(column)] for column in columns]
        return self.errors.mean[places], self.errors.covariance[np.ix_(places, places)]

    def message(self, mean: Floats, covariance: Floats, columns: Sequence[int]) -> ErrorMessage:
        """Message of a target, N(mean, covariance) after its own update, by some columns, on all errors.

        On those that it says nothing of, it is what follows from the others, as before.
        """
        prior, at = self.errors, list(columns)
        places = [self.places[self.columns.index(column)] for column in columns]
        if places == list(range(len(prior.mean))):
            return ErrorMessage(mean[at], covariance[np.ix_(at, at)])
        known = prior.covariance[np.ix_(places, places)]
        gain = np.linalg.solve(known, prior.covariance[places, :]).T
        spread = covariance[np.ix_(at, at)] - known
        moved = mean[at] - prior.mean[places]
        return ErrorMessage(prior.mean + gain @ moved, symmetric(prior.covariance + gain @ spread @ gain.T))

    def adopted(self, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """N(mean, covariance) of a state with the errors' marginal in place of its own."""
        return adopt(mean, covariance, self.columns, self.moments(self.columns))

    def begun(self, view: str, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """States (N, D), now, that a frame of a view started, which shows them by its offset earlier.

        They depend on the bias of the view alone as yet: x = p + o v, with o and v independent.
        """
        pairs = [self.adopted(*pair) for pair in zip(mean, covariance, strict=True)]
        if not pairs:
            return mean, covariance
        mean, covariance = (np.array(each) for each in zip(*pairs, strict=True))
        column = self.clock_of.get(view)
        if column is None:
            return mean, covariance
        offset, variance = float(mean[0, column]), covariance[:, column, column]
        ahead = np.tile(np.eye(mean.shape[1]), (len(mean), 1, 1))
        second = [covariance[:, speed, speed] * variance for _, speed in self.axes]
        for place, speed in self.axes:
            ahead[:, place, speed], ahead[:, place, column] = offset, mean[:, speed]
            mean[:, place] += offset * mean[:, speed]
        covariance = ahead @ covariance @ np.swapaxes(ahead, 1, 2)
        for (place, _), more in zip(self.axes, second, strict=True):
            covariance[:, place, place] += more
        return mean, covariance


LENGTHS = (1, 2, 4, 8)
"""Frames over which offsets are averaged, and twice as many before them, four at least and eight at most."""

LEVEL = 30.0
"""Chi-square of 2 degrees of freedom from which on it is a knock: one in 3e6 by chance."""

SETTLED = 12
"""Frames of a camera until its spread is known, and after which a new shift is learnt no more."""

FORGET = 0.05
"""What a frame counts in spreads and the usual offset."""

ALIKE = 0.3
"""Log-ratio of heights up to which a detection may be a target's; offsets up to this share of its height."""

WIDEST = 2.5
"""A detection is matched within so many spreads."""


@dataclass(frozen=True, eq=False)
class Offsets:
    """Offsets of T targets in a camera in the last frames.

    Attributes:
        names: of the targets.
        recent: (T, 16, 2) px, the latest last; nan where a target had no detection.
    """

    names: tuple[str, ...] = ()
    recent: Floats = field(default_factory=lambda: np.empty((0, 2 * LENGTHS[-1], 2)))

    def take(self, names: Sequence[str]) -> Offsets:
        """Offsets of targets, in their order; none of new ones."""
        if tuple(names) == self.names:
            return self
        at = {name: row for row, name in enumerate(self.names)}
        rows = np.array([at.get(name, len(self.names)) for name in names], dtype=np.intp)
        unknown = np.full((1, 2 * LENGTHS[-1], 2), np.nan)
        return Offsets(tuple(names), np.concatenate([self.recent, unknown])[rows])

    def extend(self, offsets: Floats) -> Offsets:
        """With those of a frame (T, 2)."""
        return Offsets(self.names, np.concatenate([self.recent[:, 1:], offsets[:, None]], axis=1))

    @cached_property
    def means(self) -> Floats:
        """(T, 2) means of the last frames; 0 of targets without an offset."""
        return np.nan_to_num(self._mean(slice(-LENGTHS[-1], None), 1))

    @cached_property
    def changes(self) -> Sequence[Floats]:
        """(N, 2) for each of `LENGTHS`: means of the last offsets less those before.

        Of targets that have at least half of each.
        """
        changes = []
        for length in LENGTHS:
            width = min(max(2 * length, 4), LENGTHS[-1])
            change = self._mean(slice(-length, None), (length + 1) // 2)
            change = change - self._mean(slice(-length - width, -length), width // 2)
            changes.append(change[np.isfinite(change[:, 0])])
        return changes

    @cached_property
    def _filled(self) -> tuple[Bools, Floats]:
        """(T, 16) whether a target had a detection, and (T, 16, 2) the offsets, 0 without one."""
        is_there = np.isfinite(self.recent[:, :, 0])
        return is_there, np.where(is_there[:, :, None], self.recent, 0.0)

    def _mean(self, frames: slice, fewest: int) -> Floats:
        """(T, 2) means over some frames; nan of targets that have fewer offsets than so many."""
        is_there, filled = self._filled
        count, total = is_there[:, frames].sum(axis=1), filled[:, frames].sum(axis=1)
        return np.where((count >= fewest)[:, None], total / np.maximum(count, 1)[:, None], np.nan)


@dataclass(frozen=True)
class Knock:
    """A shift of all that a camera sees.

    Attributes:
        x: px to the right.
        y: px down.
        frames: over how many frames it was seen.
        agree: targets that are off so.
        targets: of so many.
        chi_square: how unlikely it is by chance.
        variance: px^2 by which either may be wrong.
    """

    x: float
    y: float
    frames: int
    agree: int
    targets: int
    chi_square: float
    variance: float


@dataclass(frozen=True, eq=False)
class Watch:
    """State of where a camera points.

    Attributes:
        bias_px: sd of the error of its calibration, px.
        offsets: of its targets.
        spread: (4,) px^2 per axis, of the means of each of `LENGTHS`.
        looks: frames in which two targets or more told.
        learning: frames for which a knock is learnt yet.
    """

    bias_px: float = 0.0
    offsets: Offsets = field(default_factory=Offsets)
    spread: Floats = field(default_factory=lambda: np.zeros(len(LENGTHS)))
    looks: int = 0
    learning: int = 0

    def see(self, names: Sequence[str], expected: Floats, detections: Floats) -> Watch:
        """After a frame with targets expected as boxes (T, 4) and detections (N, 4)."""
        offsets = self.offsets.take(names)
        return evolve(self, offsets=offsets.extend(self._match(offsets, expected, detections)))

    def _match(self, offsets: Offsets, expected: Floats, detections: Floats) -> Floats:
        """(T, 2) offsets of the nearest detections; nan without one.

        Of a camera that was knocked far all are farther off: where less than half of its targets have one
        near, and a shift gives one to most, those are taken.
        """
        nothing = np.full((len(expected), 2), np.nan)
        if not len(detections) or not len(expected):
            return nothing
        gaps = detections[None, :, :2] - expected[:, None, :2]
        with np.errstate(divide="ignore", invalid="ignore"):
            unlike = ~(np.abs(np.log(detections[None, :, 3] / expected[:, None, 3])) < ALIKE)
        residuals = gaps - offsets.means[:, None]
        height = expected[:, 3:4]

        def match(shift: Floats) -> tuple[Floats, Bools]:
            distances = np.where(unlike, np.inf, np.linalg.norm(residuals - shift, axis=2))
            nearest = distances.argmin(axis=1)
            reach = ALIKE * height[:, 0]
            if self.looks >= SETTLED:
                reach = np.minimum(reach, max(3.0 * WIDEST * float(self.spread[0]) ** 0.5, 10.0))
            rows = np.arange(len(nearest))
            mutual = (distances.argmin(axis=0)[nearest] == rows) & (distances[rows, nearest] <= reach)
            return gaps[rows, nearest], mutual

        offset, is_near = match(np.zeros(2))
        visible = int((expected[:, 2] > 1.0).sum())
        if self.looks >= SETTLED and visible >= 2 and 2 * int(is_near.sum()) < visible:
            tries = residuals[~unlike][:400]
            counts = [int(match(shift)[1].sum()) for shift in tries]
            if counts and max(counts) >= max(2, 0.75 * visible, int(is_near.sum()) + 2):
                offset, is_near = match(tries[int(np.argmax(counts))])
        return np.where(is_near[:, None], offset, np.nan)

    def knock(self) -> Knock | None:
        """The most probable knock, by its chi-square; None while too little is known.

        What is not beyond the error of the calibration is none: intervals allow for it.
        """
        likeliest: Knock | None = None
        by_length = self.spread * (1.0 + SETTLED / max(self.looks, 1))  # as known from so many frames
        for length, spread, changes in zip(LENGTHS, by_length.tolist(), self.offsets.changes, strict=True):
            if len(changes) < 2 or self.looks < SETTLED:
                continue
            mean, count = changes.mean(axis=0), len(changes)
            without = (count * mean - changes) / (count - 1)
            chi = count * float(mean @ mean) / max(spread, 1e-6)
            smallest = (count - 1) * float((without**2).sum(axis=1).min()) / max(spread, 1e-6)
            is_beyond = float(np.hypot(*mean)) > self.bias_px
            if is_beyond and 2.0 * smallest >= LEVEL and (likeliest is None or chi > likeliest.chi_square):
                agree = int((changes @ mean > mean @ mean / 2.0).sum())
                variance = spread / count + float(mean @ mean) / 32.0  # wrong by a quarter of it
                likeliest = Knock(float(mean[0]), float(mean[1]), length, agree, count, chi, variance)
        return likeliest

    def settled(self) -> Watch:
        """After a frame without a knock: what is usual is learnt, but while a knock is."""
        if self.learning:
            return evolve(self, learning=self.learning - 1)
        spread, has_changes = self.spread.copy(), False
        share = max(FORGET, 1.0 / (self.looks + 1.0))
        for k, changes in enumerate(self.offsets.changes):
            if len(changes) >= 2:
                has_changes = True
                spread[k] += share * (float((changes**2).mean()) - spread[k])
        return evolve(self, spread=spread, looks=self.looks + 1) if has_changes else self

    def knocked(self) -> Watch:
        """After a knock: the last offsets are forgotten."""
        offsets = evolve(self.offsets, recent=np.full_like(self.offsets.recent, np.nan))
        return evolve(self, offsets=offsets, learning=SETTLED)
