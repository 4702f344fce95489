"""Answers to queries against closed forms of Gaussians and against enumeration of cells and particles."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from bayesnet_track.belief.asked import GaussianGroup, SingleGroup, WeightedGroup, groups_of
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.grid.cells import GridBelief, Lattice
from bayesnet_track.graph.expressions.evaluate import between_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.spec import Query
from bayesnet_track.inference.queries import (
    PairGroup,
    compile_query,
    count_of,
    inside_polygon,
    probabilities,
    query_numbers,
    sum_of_events,
)

FRAME = {"frame_width": 320.0, "frame_height": 240.0, "dt": 1.0, "frame_s": 0.04}
FIELDS = ("x", "y", "w", "h", "vx", "vy")


def asked(constants=(), **words):
    return compile_query("q", Query(of="t", **words), dict(constants))


def gaussians(count=3, seed=1):
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(count, 6)) * 20.0 + 100.0
    halves = rng.normal(size=(count, 6, 6))
    covariances = halves @ halves.swapaxes(1, 2) * 9.0
    return GaussianGroup([str(k) for k in range(count)], FIELDS, means, covariances)


def cells(seed=2):
    rng = np.random.default_rng(seed)
    mass = rng.random((2, 3, 3, 4, 5))
    lattice = Lattice(
        (40.0, 30.0), 2.0, 0, 0, (10.0, 12.0), np.array([-0.1, 0.2]), np.array([-1.0, 0.0, 1.0])
    )
    return GridBelief(mass / mass.sum(), lattice, np.full((3, 3), 1 / 9))


def every_cell(belief):
    """(weight, state by name) of each cell, by enumeration."""
    x, y, w, h, vx, vy = belief.values
    for (s, j, i, r, c), mass in np.ndenumerate(belief.mass):
        yield mass, {"x": x[c], "y": y[r], "w": w[s], "h": h[s], "vx": vx[i], "vy": vy[j]}


def normal_cdf(value):
    return 0.5 * math.erfc(-value / math.sqrt(2.0))


def test_a_linear_condition_of_gaussians_is_exact():
    group = gaussians()
    found = probabilities(
        asked({"k": 4.0}.items(), probability="2 * x - y > 90 + k and 2 * x - y < 130"), group, FRAME
    )
    form = np.array([2.0, -1.0, 0, 0, 0, 0])
    for row in range(3):
        mean, sd = form @ group.means[row], math.sqrt(form @ group.covariances[row] @ form)
        expected = normal_cdf((130 - mean) / sd) - normal_cdf((94 - mean) / sd)
        assert found[row] == pytest.approx(expected, abs=1e-12)


def test_a_small_tail_of_a_gaussian_keeps_its_digits():
    group = GaussianGroup(["1"], FIELDS, np.zeros((1, 6)), np.eye(6)[None])
    (found,) = probabilities(asked(probability="x > 12"), group, FRAME)
    assert found == pytest.approx(0.5 * math.erfc(12 / math.sqrt(2)), rel=1e-12)


def test_a_gaussian_without_spread_is_in_or_out():
    group = GaussianGroup(["1", "2"], FIELDS, np.array([[5.0] * 6, [3.0] * 6]), np.zeros((2, 6, 6)))
    assert probabilities(asked(probability="x > 4"), group, FRAME).tolist() == [1.0, 0.0]
    assert probabilities(asked(probability="x * y > 10"), group, FRAME).tolist() == [1.0, 0.0]


def test_other_conditions_of_gaussians_are_within_a_hundredth():
    """A disc about the mean of an isotropic Gaussian, and a corner of two independent fields."""
    group = GaussianGroup(["1"], FIELDS, np.full((1, 6), 50.0), np.eye(6)[None] * 25.0)
    (disc,) = probabilities(asked(probability="hypot(x - 50, y - 50) < 6"), group, FRAME)
    assert disc == pytest.approx(1 - math.exp(-36 / 50), abs=0.005)
    (corner,) = probabilities(asked(probability="x > 53 and y < 49"), group, FRAME)
    assert corner == pytest.approx(normal_cdf(-0.6) * normal_cdf(-0.2), abs=0.005)


def test_a_linear_number_of_gaussians_is_exact():
    group = gaussians()
    found = query_numbers(asked(value="(vx - vy) / frame_s + 3", interval=0.5), group, FRAME)
    form = np.array([0, 0, 0, 0, 25.0, -25.0])
    for row in range(3):
        mean, sd = form @ group.means[row] + 3, math.sqrt(form @ group.covariances[row] @ form)
        reach = 0.6744897501960817 * sd
        assert found[:, row] == pytest.approx([mean, sd, mean - reach, mean + reach], rel=1e-9)


def test_a_speed_of_gaussians_is_that_of_a_rayleigh_distribution():
    group = GaussianGroup(["1"], FIELDS, np.zeros((1, 6)), np.eye(6)[None] * 4.0)
    mean, sd, low, high = query_numbers(asked(value="hypot(vx, vy)"), group, FRAME)[:, 0]
    assert mean == pytest.approx(2 * math.sqrt(math.pi / 2), rel=0.005)
    assert sd == pytest.approx(2 * math.sqrt(2 - math.pi / 2), rel=0.01)
    assert low == pytest.approx(2 * math.sqrt(-2 * math.log(0.95)), rel=0.02)
    assert high == pytest.approx(2 * math.sqrt(-2 * math.log(0.05)), rel=0.02)


@pytest.mark.parametrize("text", ["x + 3 * vx > 44 and not y > 33", "w * h < 110 or vy == 1"])
def test_a_condition_on_a_grid_is_the_sum_over_cells(text):
    belief, term = cells(), parse(text)
    (found,) = probabilities(asked(probability=text), SingleGroup(["1"], belief), FRAME)
    expected = sum(mass for mass, state in every_cell(belief) if _holds(term, state))
    assert 0.01 < expected < 0.99
    assert found == pytest.approx(expected, abs=1e-12)


def _holds(term, state):
    from bayesnet_track.graph.expressions.evaluate import values_of

    return bool(values_of(term, state))


def test_a_number_on_a_grid_is_the_sum_over_cells():
    belief = cells()
    mean, sd, low, high = query_numbers(asked(value="x * vy"), SingleGroup(["1"], belief), FRAME)[:, 0]
    pairs = [(mass, state["x"] * state["vy"]) for mass, state in every_cell(belief)]
    expected = sum(mass * value for mass, value in pairs)
    assert mean == pytest.approx(expected, abs=1e-10)
    assert sd == pytest.approx(math.sqrt(sum(m * (v - expected) ** 2 for m, v in pairs)), rel=1e-9)
    assert sum(m for m, v in pairs if v < low) <= 0.05 <= sum(m for m, v in pairs if v <= low) + 1e-9
    assert sum(m for m, v in pairs if v < high) <= 0.95 <= sum(m for m, v in pairs if v <= high) + 1e-9


def test_particles_are_weighed_and_a_row_does_not_depend_on_others():
    rng = np.random.default_rng(0)
    states, weights = rng.normal(size=(3, 40, 6)), rng.random((3, 40))
    weights /= weights.sum(axis=1, keepdims=True)
    group = WeightedGroup(["1", "2", "3"], FIELDS, states, weights)
    query, number = asked(probability="x > vy"), asked(value="x * y")
    whole, values = probabilities(query, group, FRAME), query_numbers(number, group, FRAME)
    for row in range(3):
        expected = weights[row][states[row, :, 0] > states[row, :, 5]].sum()
        assert whole[row] == pytest.approx(expected, abs=1e-12)
        assert probabilities(query, group.take(row), FRAME)[0] == whole[row]
        assert (query_numbers(number, group.take(row), FRAME)[:, 0] == values[:, row]).all()


def test_rows_of_gaussians_do_not_depend_on_others():
    group = gaussians(5)
    for query, find in (
        (asked(probability="x > 99"), probabilities),
        (asked(probability="hypot(x, y) > 140"), probabilities),
        (asked(value="hypot(vx, vy)"), query_numbers),
    ):
        whole = find(query, group, FRAME).reshape(-1, 5)
        for row in range(5):
            assert (find(query, group.take(row), FRAME).reshape(-1) == whole[:, row]).all()


def test_hypotheses_without_a_value_are_left_out():
    states = np.zeros((2, 4, 6))
    states[0, :, 0] = [4.0, 9.0, -1.0, 0.0]
    states[1, :, 0] = -1.0
    group = WeightedGroup(["1", "2"], FIELDS, states, np.full((2, 4), 0.25))
    found = query_numbers(asked(value="sqrt(x)"), group, FRAME)
    assert found[0, 0] == pytest.approx((2 + 3 + 0) / 3)
    assert np.isnan(found[:, 1]).all()


def test_modes_are_a_mixture():
    parts = tuple(
        GaussianPosterior(np.array([x, 0, 9, 9.0]), np.eye(4), ("x", "y", "w", "h"), 8) for x in (0.0, 10.0)
    )
    (group,) = groups_of([("1", ModalPosterior(parts, np.array([0.25, 0.75])))])
    (found,) = probabilities(asked(probability="x > 5"), group, FRAME)
    assert found == pytest.approx(0.75, abs=1e-3)
    assert query_numbers(asked(value="x"), group, FRAME)[0, 0] == pytest.approx(7.5, abs=1e-3)


def test_a_pair_of_grids_is_the_sum_over_pairs_of_cells():
    first, second = cells(3), cells(4)
    query = compile_query("q", Query(of=("t", "u"), probability="a.x - b.x > b.y - a.y"), {})
    pair = PairGroup.from_groups(SingleGroup(["1"], first), SingleGroup(["2"], second))
    (found,) = probabilities(query, pair, FRAME)
    own, other = _places(first), _places(second)
    expected = sum(p * q for (x, y), p in own.items() for (u, v), q in other.items() if x - u > v - y)
    assert found == pytest.approx(expected, abs=1e-12)


def _places(belief):
    found = {}
    for mass, state in every_cell(belief):
        key = state["x"], state["y"]
        found[key] = found.get(key, 0.0) + mass
    return found


def test_a_linear_pair_of_gaussians_is_exact():
    group = gaussians(2)
    query = compile_query("q", Query(of=("t", "t"), probability="a.x < b.x"), {})
    (found,) = probabilities(query, PairGroup.from_groups(group.take(0), group.take(1)), FRAME)
    gap = group.means[1, 0] - group.means[0, 0]
    sd = math.sqrt(group.covariances[0, 0, 0] + group.covariances[1, 0, 0])
    assert found == pytest.approx(normal_cdf(gap / sd), abs=1e-12)


def test_a_pair_of_many_particles_is_near_the_sum_over_all_pairs():
    rng = np.random.default_rng(5)
    states, weights = rng.normal(size=(2, 600, 6)) * 10, rng.random((2, 600))
    weights /= weights.sum(axis=1, keepdims=True)
    group = WeightedGroup(["1", "2"], FIELDS, states, weights)
    query = compile_query("q", Query(of=("t", "t"), probability="hypot(a.x - b.x, a.y - b.y) < 15"), {})
    (found,) = probabilities(query, PairGroup.from_groups(group.take(0), group.take(1)), FRAME)
    apart = np.hypot(*(states[0][:, None, k] - states[1][None, :, k] for k in (0, 1)))
    assert found == pytest.approx(float(weights[0] @ (apart < 15) @ weights[1]), abs=0.02)


def test_a_count_is_the_sum_over_all_subsets():
    events = np.array([0.1, 0.9, 0.5, 0.35])
    expected = np.zeros(5)
    for subset in itertools.product((0, 1), repeat=4):
        expected[sum(subset)] += math.prod(p if on else 1 - p for p, on in zip(events, subset, strict=True))
    assert sum_of_events(events) == pytest.approx(expected, abs=1e-15)
    found = count_of(asked(count={"condition": "x > 3"}), sum_of_events(events))
    assert found.mean == pytest.approx(expected @ np.arange(5))
    assert found.sd == pytest.approx(math.sqrt(expected @ (np.arange(5) - found.mean) ** 2))
    assert (found.low, found.high) == (1.0, 3.0)


def test_a_point_in_a_polygon_with_a_notch():
    corners = np.array([[0, 0], [10, 0], [10, 10], [5, 4], [0, 10]], dtype=float)
    x, y = np.array([2.0, 5.0, 8.0, 5.0, 11.0]), np.array([2.0, 8.0, 6.0, 3.0, 5.0])
    assert inside_polygon(corners, x, y).tolist() == [True, False, True, True, False]


@pytest.mark.parametrize(
    ("text", "bounds"),
    [
        ("3 < x < 8", (3.0, 8.0)),
        ("abs(x - 5) <= 2", (3.0, 7.0)),
        ("10 - 2 * x > 4", (-math.inf, 3.0)),
        ("x > 3 and y > 3", None),
        ("abs(x) < y", None),
        ("x > 3 or x < 1", None),
        ("x ** 2 > 3", None),
    ],
)
def test_conditions_that_are_bounds_of_one_form(text, bounds):
    found = between_of(parse(text), {})
    assert (None if found is None else (found.low, found.high)) == bounds


def test_a_condition_that_never_holds_has_probability_0():
    group = gaussians()
    assert probabilities(asked(probability="abs(x) < -1"), group, FRAME).tolist() == [0.0] * 3
    assert probabilities(asked(probability="x > 9 and x < 3"), group, FRAME).tolist() == [0.0] * 3
