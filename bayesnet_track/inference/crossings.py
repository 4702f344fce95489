"""Crossings of a line: an automaton beside each hypothesis, moved along with it from frame to frame.

The automaton remembers the side on which the hypothesis was last surely (at least `hysteresis_px` away) and
whether its last change of side led through the segment. A crossing counts once it is surely across.

Successive positions are a particle and its ancestor. Of a Gaussian belief they are `TRACES` draws of its
trajectory: x_{t-1} is weighted by the likelihood of the frame; x_t is drawn given x_{t-1} by their covariance
(Rauch-Tung-Striebel). Where nothing is known of ancestors (grids, modes, a target that returns), draws are
coupled by the quantiles of their distance to the line, which no other coupling crosses less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesnet_track.belief.asked import BeliefGroup, Fields, GaussianGroup, WeightedGroup, uniform_nodes
from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.graph.settings.queries import Crossing
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.records import evolve

TRACES = 256
"""Trajectories that stand for a belief that has no particles."""


@dataclass(frozen=True, eq=False)
class Trail:
    """Hypotheses of a target with the automaton of one line.

    Attributes:
        places: (N, 2) the point that crosses, px.
        weights: (N,) of the hypotheses.
        side: (N,) side on which it was last surely: -1 left, 1 right, 0 none yet.
        through: (N,) whether the last change of side led through the segment.
        counts: (N,) crossings that count.
        states: (N, D) of a Gaussian belief, else (N, 0).
        mean: (D,) of that belief, else (0,).
        covariance: (D, D) of that belief, else (0, 0).
        exists: largest probability of existence that the target has had.
    """

    places: Floats
    weights: Floats
    side: Ints
    through: Bools
    counts: Ints
    states: Floats
    mean: Floats
    covariance: Floats
    exists: float = 1.0

    def take(self, rows: Ancestors) -> Trail:
        """Some of the hypotheses, in that order."""
        return evolve(
            self,
            places=self.places[rows],
            weights=self.weights[rows],
            side=self.side[rows],
            through=self.through[rows],
            counts=self.counts[rows],
        )

    @property
    def distribution(self) -> Floats:
        """Distribution of the number of crossings of the target, if it exists or not."""
        masses = np.bincount(self.counts, weights=self.weights)
        shares = masses / masses.sum() * self.exists
        shares[0] += 1.0 - self.exists
        return np.asarray(shares)


@dataclass(frozen=True, eq=False)
class Sample:
    """Weighted places of a target after a frame, and where they come from.

    Attributes:
        places: (N, 2) px.
        weights: (N,).
        ancestors: (N,) hypotheses of the frame before; None where unknown.
        states: (N, D) of a Gaussian belief, else (N, 0).
        mean: (D,) of that belief, else (0,).
        covariance: (D, D) of that belief, else (0, 0).
    """

    places: Floats
    weights: Floats
    ancestors: Ancestors | None
    states: Floats
    mean: Floats
    covariance: Floats


def advance_trail(line: Crossing, trail: Trail | None, sample: Sample, exists: float) -> Trail:
    """The trail with one frame more; without one before it begins."""
    distance = _signed_distance(line, sample.places)
    sure = np.where(np.abs(distance) >= line.hysteresis_px, np.sign(distance), 0).astype(np.int64)
    size = len(sample.places)
    if trail is None:
        return Trail(
            sample.places,
            sample.weights,
            sure,
            np.zeros(size, dtype=np.bool_),
            np.zeros(size, dtype=np.int64),
            sample.states,
            sample.mean,
            sample.covariance,
            exists,
        )
    ancestors = sample.ancestors
    if ancestors is None or (len(ancestors) and int(ancestors.max()) >= len(trail.places)):
        ancestors = _coupled(line, trail, distance, sample.weights)
    previous = trail.take(ancestors)
    through = _leads_through(line, previous, sample.places, distance)
    is_over = (sure != 0) & (previous.side != 0) & (sure != previous.side) & through
    counted = is_over & _counts(line, sure)
    return Trail(
        sample.places,
        sample.weights,
        np.where(sure != 0, sure, previous.side),
        through,
        previous.counts + counted,
        sample.states,
        sample.mean,
        sample.covariance,
        max(trail.exists, exists),
    )


def _signed_distance(line: Crossing, places: Floats) -> Floats:
    """(N,) distance from the line through both ends, px: negative on its left.

    >>> line = Crossing.model_validate({"line": [[0, 5], [10, 5]]})
    >>> _signed_distance(line, np.array([[3.0, 1.0], [3.0, 9.0]])).tolist()
    [-4.0, 4.0]
    """
    (x, y), (u, v) = line.line
    step_x, step_y = u - x, v - y
    area = step_x * (places[:, 1] - y) - step_y * (places[:, 0] - x)
    return np.asarray(area / np.hypot(step_x, step_y))


def _leads_through(line: Crossing, previous: Trail, places: Floats, distance: Floats) -> Bools:
    """(N,) whether the last change of side led through the segment, this step included."""
    start = _signed_distance(line, previous.places)
    changes = (start < 0.0) != (distance < 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(changes, start / (start - distance), 0.0)
    meeting = previous.places + share[:, None] * (places - previous.places)
    (x, y), (u, v) = line.line
    along = ((meeting[:, 0] - x) * (u - x) + (meeting[:, 1] - y) * (v - y)) / ((u - x) ** 2 + (v - y) ** 2)
    return np.asarray(np.where(changes, (along >= 0.0) & (along <= 1.0), previous.through))


def _counts(line: Crossing, side: Ints) -> Bools:
    """(N,) whether a crossing to this side counts."""
    direction = {"left": 1, "right": -1}.get(line.side)
    return np.ones(len(side), dtype=np.bool_) if direction is None else np.asarray(side == direction)


def _coupled(line: Crossing, trail: Trail, distance: Floats, weights: Floats) -> Ancestors:
    """(N,) hypotheses of the trail at the same quantiles of the distance to the line."""
    order = np.argsort(distance, kind="stable")
    ranks = np.empty(len(order))
    cumulative = np.cumsum(weights[order])
    ranks[order] = (cumulative - 0.5 * weights[order]) / cumulative[-1]
    trail_order = np.argsort(_signed_distance(line, trail.places), kind="stable")
    shares = np.cumsum(trail.weights[trail_order])
    rows = np.minimum(np.searchsorted(shares, ranks * shares[-1]), len(trail_order) - 1)
    return np.asarray(trail_order[rows], dtype=np.intp)


# ------------------------------------------------------------------------------------ samples

_NONE = np.empty((0, 0))


def sample_weighted(group: BeliefGroup, line: Crossing, ancestors: Ancestors | None) -> Sample:
    """The hypotheses of one target; of a grid or of modes `TRACES` draws at fixed quantiles."""
    names = ("x", "y", "h") if line.point == "foot" else ("x", "y")
    fields, weights = group.nodes(names)
    places = np.stack([fields["x"][0], _height_of(fields)], axis=1)
    shares = weights[0]
    if not isinstance(group, WeightedGroup) and len(shares) > TRACES:
        order = np.argsort(_signed_distance(line, places), kind="stable")
        cumulative = np.cumsum(shares[order])
        points = uniform_nodes(1, TRACES)[:, 0] * cumulative[-1]
        rows = order[np.minimum(np.searchsorted(cumulative, points), len(order) - 1)]
        places, shares = places[rows], np.full(TRACES, 1.0 / TRACES)
    size = len(places)
    return Sample(places, shares, ancestors, np.empty((size, 0)), np.empty(0), _NONE)


def _height_of(fields: Fields) -> Floats:
    y = fields["y"][0]
    return np.asarray(y + fields["h"][0] / 2.0 if "h" in fields else y)


def sample_gaussian(
    group: GaussianGroup,
    line: Crossing,
    trail: Trail | None,
    moves: tuple[MotionModel, float],
    stream: Callable[[str], np.random.Generator],
) -> Sample:
    """Draws of a Gaussian's trajectory one frame further than those of the trail.

    `moves` has the motion and the time since the frame before, in frame intervals.
    """
    mean, covariance = group.means[0], group.covariances[0]
    rng, width = stream("crossing"), len(group.means[0])
    noise = rng.standard_normal((TRACES, width))
    if trail is None or trail.states.shape != noise.shape:
        states, ancestors = mean + noise @ _root(covariance).T, None
    else:
        ancestors, centres, spread = _conditional(trail, mean, covariance, moves, rng)
        states = centres + noise @ _root(spread).T
    y = states[:, group.fields.index("y")]
    if line.point == "foot":
        y = y + states[:, group.fields.index("h")] / 2.0
    places = np.stack([states[:, group.fields.index("x")], y], axis=1)
    return Sample(places, np.full(TRACES, 1.0 / TRACES), ancestors, states, mean, covariance)


def _conditional(
    trail: Trail,
    mean: Floats,
    covariance: Floats,
    moves: tuple[MotionModel, float],
    rng: np.random.Generator,
) -> tuple[Ancestors, Floats, Floats]:
    """Ancestors by p(x_{t-1} | y_{1:t}), and of x_t given each of them means (N, D) and covariance (D, D)."""
    motion, dt = moves
    transition, noise = motion.linearise(trail.mean, dt)
    predicted = motion.drift(trail.mean[None], dt)[0]
    spread = transition @ trail.covariance @ transition.T + noise
    gain = trail.covariance @ transition.T @ np.linalg.pinv(spread, hermitian=True)
    smoothed = trail.mean + gain @ (mean - predicted)
    backward = trail.covariance + gain @ (covariance - spread) @ gain.T
    log = _log_normal(trail.states, smoothed, backward) - _log_normal(
        trail.states, trail.mean, trail.covariance
    )
    weights = np.exp(log - log.max())
    cumulative = np.cumsum(weights)
    points = (np.arange(TRACES) + rng.random()) / TRACES * cumulative[-1]
    ancestors = np.minimum(np.searchsorted(cumulative, points), TRACES - 1)
    cross = gain @ covariance
    regression = cross.T @ np.linalg.pinv(backward, hermitian=True)
    centres = mean + (trail.states[ancestors] - smoothed) @ regression.T
    return ancestors, centres, covariance - regression @ cross


def _log_normal(states: Floats, mean: Floats, covariance: Floats) -> Floats:
    """(N,) log density but for what is the same for all, over the directions that vary."""
    deviations = states - mean
    return np.asarray(
        -0.5 * np.sum(deviations @ np.linalg.pinv(covariance, hermitian=True) * deviations, axis=1)
    )


def _root(covariance: Floats) -> Floats:
    variances, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(variances, 0.0)))


def convolved(first: Floats, second: Floats) -> Floats:
    """Distribution of the sum of two independent counts, without a tail of less than 1e-12.

    >>> convolved(np.array([0.5, 0.5]), np.array([0.5, 0.5])).tolist()
    [0.25, 0.5, 0.25]
    """
    total = np.convolve(first, second)
    total = total[: int(np.flatnonzero(total > 1e-12)[-1]) + 1]
    return np.asarray(total / total.sum())
