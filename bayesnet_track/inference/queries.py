"""Answers to queries from beliefs: probabilities of conditions, numbers, counts; of targets and of pairs.

Where a belief is Gaussian and the question linear in the state, answers are exact. Else they are sums over
weighted hypotheses or cells, or over the fixed points of `belief.asked`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from bayesnet_track.belief.asked import BeliefGroup, Fields, GaussianGroup, uniform_nodes
from bayesnet_track.graph.expressions.evaluate import Between, Linear, between_of, linear_of, values_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import FRAME_NAMES, FRAME_S, Term, names_in
from bayesnet_track.graph.settings.queries import Query
from bayesnet_track.inference.crossings import Trail
from bayesnet_track.journal.metrics import QueryAnswer
from bayesnet_track.numerics.arrays import Bools, Floats, Ints

MOST_PAIRINGS = 1 << 16
"""Pairs of hypotheses of two targets that are all looked at."""
PAIRINGS = 1 << 12
"""Pairs that stand for them where there are more."""


@dataclass(frozen=True, eq=False)
class QueryMemory:
    """Memory of the queries of a graph.

    Attributes:
        high: answers that are at or above their level: name of the query, then its targets.
        trails: (query, target) -> hypotheses with the automaton of a line, of live targets and of those that
            may return.
        ended: query -> distribution of the crossings of all targets that are gone.
    """

    high: frozenset[tuple[str, ...]] = frozenset()
    trails: Mapping[tuple[str, str], Trail] = field(default_factory=dict)
    ended: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class CompiledQuery:
    """A query ready to be answered.

    Attributes:
        name: its name.
        query: what is asked.
        term: its expression; None of a polygon or a line.
        reads: fields that it reads, such as `x`; of a pair `a.x`.
        fixed: names that are the same for all hypotheses of a frame.
        constants: those of them that are constants of the graph.
        corners: (C, 2) of its polygon; None without.
    """

    name: str
    query: Query
    term: Term | None
    reads: tuple[str, ...]
    fixed: tuple[str, ...]
    constants: Mapping[str, float]
    corners: Floats | None = None

    @property
    def reads_inputs(self) -> bool:
        """True where it reads time or an input, which smoothing and files of beliefs do not have."""
        return any(name not in (*self.constants, *FRAME_NAMES, FRAME_S) for name in self.fixed)

    @property
    def shares(self) -> tuple[float, float]:
        """Shares of a number's belief at or below the bounds of its interval."""
        tail = (1.0 - self.query.interval) / 2.0
        return tail, 1.0 - tail


def compile_query(
    name: str, query: Query, constants: Mapping[str, float], inputs: Collection[str] = ()
) -> CompiledQuery:
    """A query of a graph that passed the checks; `inputs` are further names of what a frame has."""
    texts = [text for _, text in query.texts]
    if texts:
        term = parse(texts[0])
        of_frame = {*FRAME_NAMES, FRAME_S, *inputs}
        fields = tuple(name for name in names_in(term) if name not in of_frame and name not in constants)
        fixed = tuple(name for name in names_in(term) if name not in fields and name != "pi")
        own_constants = {name: constants[name] for name in fixed if name in constants}
        return CompiledQuery(name, query, term, fields, fixed, own_constants)
    point = None if query.count is None else query.count.point
    reads = ("x", "y", "h") if point == "foot" else ("x", "y")
    corners = None if query.count is None else np.array(query.count.polygon, dtype=np.float64)
    return CompiledQuery(name, query, None, reads, (), {}, corners)


def probabilities(compiled: CompiledQuery, group: BeliefGroup, frame: Mapping[str, float]) -> Floats:
    """(T,) probabilities of the condition; `frame` has the values of the frame's names."""
    between = None if compiled.term is None else _forms(compiled, _values(compiled, frame))[1]
    moments = None if between is None else group.moments(between.factors)
    if between is not None and moments is not None:
        means, sds = moments[0], np.sqrt(moments[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = normal_between((between.low - means) / sds, (between.high - means) / sds)
        return np.asarray(np.where(sds > 0.0, exact, (between.low <= means) & (means <= between.high)))
    fields, weights = group.nodes(compiled.reads)
    holds = np.broadcast_to(_holds(compiled, fields, frame), weights.shape)
    return np.asarray(np.clip(np.sum(holds * weights, axis=1), 0.0, 1.0))


def query_numbers(compiled: CompiledQuery, group: BeliefGroup, frame: Mapping[str, float]) -> Floats:
    """(4, T) mean, sd, lower and upper bound of the number; NaN where no hypothesis has a value.

    Hypotheses without a value (0 / 0, the root of a negative number, an infinite one) are left out.
    """
    assert compiled.term is not None
    linear = _forms(compiled, _values(compiled, frame))[0]
    moments = None if linear is None else group.moments(linear.factors)
    if linear is not None and moments is not None:
        means, sds = moments[0] + linear.constant, np.sqrt(moments[1])
        reach = NormalDist().inv_cdf(compiled.shares[1]) * sds
        return np.stack([means, sds, means - reach, means + reach])
    fields, weights = group.nodes(compiled.reads)
    values = np.asarray(values_of(compiled.term, {**frame, **compiled.constants, **fields}), dtype=np.float64)
    if values.shape != weights.shape:
        values = np.broadcast_to(values, weights.shape)
    usable = np.isfinite(values)
    if not usable.all():
        weights, values = weights * usable, np.where(usable, values, 0.0)
    total = weights.sum(axis=1)
    weights = weights / np.where(total > 0.0, total, 1.0)[:, None]
    answers = np.empty((4, len(total)))
    answers[0] = (values * weights).sum(axis=1)
    answers[1] = np.sqrt(((values - answers[0][:, None]) ** 2 * weights).sum(axis=1))
    answers[2:] = weighted_quantiles(values, weights, compiled.shares).T
    answers[:, total <= 0.0] = math.nan
    return answers


def _values(compiled: CompiledQuery, frame: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(
        compiled.constants[name] if name in compiled.constants else frame[name] for name in compiled.fixed
    )


@lru_cache(maxsize=256)
def _forms(compiled: CompiledQuery, values: tuple[float, ...]) -> tuple[Linear | None, Between | None]:
    """The linear form that an expression is, and the bounds that a condition is; None where it is none."""
    assert compiled.term is not None
    fixed = dict(zip(compiled.fixed, values, strict=True))
    linear = linear_of(compiled.term, fixed) if compiled.query.kind == "value" else None
    return linear, between_of(compiled.term, fixed)


def _holds(compiled: CompiledQuery, fields: Fields, frame: Mapping[str, float]) -> Floats:
    if compiled.term is not None:
        return np.asarray(
            values_of(compiled.term, {**frame, **compiled.constants, **fields}), dtype=np.float64
        )
    assert compiled.corners is not None
    x, y = fields["x"], fields["y"]
    y = y + fields["h"] / 2.0 if "h" in fields else y
    return inside_polygon(compiled.corners, x, y).astype(np.float64)


def inside_polygon(corners: Floats, x: Floats, y: Floats) -> Bools:
    """Mask of points inside a polygon (C, 2), by the even-odd rule.

    >>> square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    >>> inside_polygon(square, np.array([1.0, 3.0]), np.array([1.0, 1.0])).tolist()
    [True, False]
    """
    is_inside = np.zeros(np.broadcast_shapes(x.shape, y.shape), dtype=np.bool_)
    for (left, top), (right, bottom) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if top == bottom:
            continue
        edge = left + (y - top) * ((right - left) / (bottom - top))
        is_inside ^= ((top > y) != (bottom > y)) & (x < edge)
    return is_inside


def count_of(compiled: CompiledQuery, distribution: Floats) -> QueryAnswer:
    """The number that a distribution (n,) over 0, 1, 2, ... is of."""
    low, high = (count_quantile(distribution, share) for share in compiled.shares)
    numbers = np.arange(len(distribution))
    mean = float(distribution @ numbers)
    return QueryAnswer(mean, math.sqrt(float(distribution @ (numbers - mean) ** 2)), low, high)


def normal_between(low: Floats, high: Floats) -> Floats:
    """(T,) probability of a standard normal variable between bounds, exact in either tail.

    >>> normal_between(np.array([-math.inf, 0.0]), np.array([0.0, math.inf])).tolist()
    [0.5, 0.5]
    """
    pairs = zip(low.tolist(), high.tolist(), strict=True)
    return np.array([_between(first, second) for first, second in pairs], dtype=np.float64)


def _between(low: float, high: float) -> float:
    if not low < high:
        return 0.0
    if low > 0.0:  # from the nearer tail: no difference of numbers close to 1
        low, high = -high, -low
    return 0.5 * (math.erfc(-high / math.sqrt(2.0)) - math.erfc(-low / math.sqrt(2.0)))


def weighted_quantiles(values: Floats, weights: Floats, shares: tuple[float, ...]) -> Floats:
    """(T, S) smallest of the values (T, N) with at least these shares of the weights (T, N) at or below.

    >>> weighted_quantiles(np.array([[3.0, 1.0, 2.0]]), np.array([[0.2, 0.4, 0.4]]), (0.1, 0.5)).tolist()
    [[1.0, 2.0]]
    """
    result = np.empty((len(values), len(shares)))
    for row, order in enumerate(values.argsort(axis=-1)):
        cumulative = weights[row][order].cumsum()
        levels = np.array(shares) * cumulative[-1]
        places = cumulative.searchsorted(levels * (1.0 - 1e-12))
        result[row] = values[row][order[np.minimum(places, len(order) - 1)]]
    return result


def sum_of_events(probabilities: Floats) -> Floats:
    """(n + 1,) distribution of the number of n independent events that happen (Poisson binomial), exact.

    >>> sum_of_events(np.array([0.5, 0.5])).tolist()
    [0.25, 0.5, 0.25]
    """
    result = np.ones(1)
    for probability in np.clip(probabilities, 0.0, 1.0).tolist():
        longer = np.zeros(len(result) + 1)
        longer[:-1] = result * (1.0 - probability)
        longer[1:] += result * probability
        result = longer
    return result


def count_quantile(distribution: Floats, share: float) -> float:
    """The smallest count with at least this share of the distribution at or below it.

    >>> count_quantile(np.array([0.25, 0.5, 0.25]), 0.5)
    1.0
    """
    cumulative = distribution.cumsum()
    return float(min(int(cumulative.searchsorted(share - 1e-12)), len(distribution) - 1))


# ------------------------------------------------------------------------------------ pairs


@dataclass(frozen=True, eq=False)
class PairGroup:
    """Two targets as one group: fields `a.x` of the first, `b.x` of the second, independent given all seen.

    Attributes:
        first: the first target.
        second: the second one.
    """

    first: BeliefGroup
    second: BeliefGroup

    @classmethod
    def from_groups(cls, first: BeliefGroup, second: BeliefGroup) -> BeliefGroup:
        """Two targets as one group; two Gaussians are a Gaussian."""
        if isinstance(first, GaussianGroup) and isinstance(second, GaussianGroup):
            fields = [*(f"a.{name}" for name in first.fields), *(f"b.{name}" for name in second.fields)]
            size, width = len(fields), len(first.fields)
            covariance = np.zeros((1, size, size))
            covariance[:, :width, :width], covariance[:, width:, width:] = (
                first.covariances,
                second.covariances,
            )
            means = np.concatenate([first.means, second.means], axis=1)
            return GaussianGroup([f"{first.ids[0]} {second.ids[0]}"], fields, means, covariance)
        return cls(first, second)

    @property
    def ids(self) -> Sequence[str]:
        """Both targets, as one name."""
        return [f"{self.first.ids[0]} {self.second.ids[0]}"]

    def nodes(self, names: Sequence[str]) -> tuple[Fields, Floats]:
        """All pairs of weighted states, or `PAIRINGS` of them where there are more than `MOST_PAIRINGS`."""
        (mine, first_weights), (theirs, second_weights) = (
            group.nodes([name[2:] for name in names if name.startswith(mark)])
            for mark, group in (("a.", self.first), ("b.", self.second))
        )
        if first_weights.size * second_weights.size <= MOST_PAIRINGS:
            first_index = np.repeat(np.arange(first_weights.size), second_weights.size)
            second_index = np.tile(np.arange(second_weights.size), first_weights.size)
            joint = (first_weights[0, first_index] * second_weights[0, second_index])[None]
        else:
            points = uniform_nodes(2, PAIRINGS)
            first_index, second_index = (
                _pick(first_weights[0], points[:, 0]),
                _pick(second_weights[0], points[:, 1]),
            )
            joint = np.full((1, PAIRINGS), 1.0 / PAIRINGS)
        fields = {
            f"a.{name}": np.broadcast_to(values, first_weights.shape)[:, first_index]
            for name, values in mine.items()
        }
        fields |= {
            f"b.{name}": np.broadcast_to(values, second_weights.shape)[:, second_index]
            for name, values in theirs.items()
        }
        return fields, joint

    def moments(self, factors: Mapping[str, float]) -> tuple[Floats, Floats] | None:
        """Moments of a linear form of two Gaussians."""
        parts = [
            group.moments({name[2:]: factor for name, factor in factors.items() if name.startswith(mark)})
            for mark, group in (("a.", self.first), ("b.", self.second))
        ]
        normals = [part for part in parts if part is not None]
        if len(normals) < 2:
            return None
        (mean, variance), (second_mean, second_variance) = normals
        return mean + second_mean, variance + second_variance

    def take(self, row: int) -> PairGroup:
        """The pair."""
        return self


def _pick(weights: Floats, points: Floats) -> Ints:
    cumulative = weights.cumsum()
    return np.asarray(np.minimum(cumulative.searchsorted(points * cumulative[-1]), len(weights) - 1))
