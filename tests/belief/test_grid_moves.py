"""A grid's motion and evidence by enumeration of a few cells: each sum as its equation states it."""

import math

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.grid.belief import GridFilter, judge_in_box, judge_on_image
from bayesnet_track.belief.grid.cells import GridBelief, GridLimits, Lattice, Patch, log_gaussian
from bayesnet_track.belief.grid.motion import (
    Leap,
    Span,
    _bound,
    _change,
    _leapt,
    axis_steps,
    leapt,
    moving,
    predict_grid,
    scale_sd,
)
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.graph import spec
from bayesnet_track.numerics.distributions import spreading_matrix
from bayesnet_track.observation.cue import Measurement

VELOCITIES = np.array([-1.0, 0.0, 1.0])
LATTICE = Lattice((50.0, 40.0), 2.0, 3, -4, (20.0, 10.0), np.zeros(1), VELOCITIES)
DAMPED = {"sd_px": {"x": 3.0, "y": 2.0}, "sd_velocity_px": 0.7, "start_velocity_sd_px": 1.0, "damping": 0.25}


@pytest.fixture
def belief(rng):
    mass = rng.random((1, 3, 3, 2, 3))
    return GridBelief(mass / mass.sum(), LATTICE, np.full((3, 3), 1 / 9))


# ------------------------------------------------------------------------------------ motion


@pytest.mark.parametrize("dt", [1.0, 2.5])
@pytest.mark.parametrize("kind", ["constant_velocity", "damped_velocity"])
def test_three_steps_have_the_motions_drift_and_noise(kind, dt, motion_of):
    """x' = x + first v + e, v' = decay v + n, x'' = x' + second v'."""
    motion = motion_of(
        kind, **{k: v for k, v in DAMPED.items() if k != "damping" or kind == "damped_velocity"}
    )
    state = np.array([50.0, 40.0, 20.0, 10.0, 1.0, -1.0])
    drift, noise = motion.linearise(state, dt)
    steps, shares = axis_steps(motion, state, dt)
    assert shares.tolist() == [1.0]
    for axis, step in enumerate(steps):
        one, other = axis, 4 + axis
        assert step.first + step.second * step.decay == pytest.approx(drift[one, other])
        assert step.decay == pytest.approx(drift[other, other])
        assert step.sd_velocity**2 == pytest.approx(noise[other, other])
        assert step.second * step.sd_velocity**2 == pytest.approx(noise[one, other])
        assert step.variances[0] + step.second**2 * step.sd_velocity**2 == pytest.approx(noise[one, one])
        assert step.offset == 0.0


def test_a_walk_has_one_step_and_each_component_its_variance(motion_of):
    wide = motion_of("random_walk", sd_px={"x": 3.0, "y": 2.0}, heavy_tail={"weight": 0.2, "factor": 4.0})
    steps, shares = axis_steps(wide, np.array([50.0, 40.0, 20.0, 10.0]), 2.0)
    np.testing.assert_allclose(sorted(shares), [0.2, 0.8])
    by_share = [dict(zip(np.round(shares, 3), step.variances, strict=True)) for step in steps]
    assert by_share[0] == pytest.approx({0.8: 18.0, 0.2: 18.0 * 16})
    assert by_share[1] == pytest.approx({0.8: 8.0, 0.2: 8.0 * 16})
    assert all(step.first == step.second == step.decay == step.sd_velocity == 0.0 for step in steps)
    still = motion_of("random_walk", sd_px={"y": 2.0}, heavy_tail={"weight": 0.2, "factor": 4.0})
    steps, _ = axis_steps(still, np.array([50.0, 40.0, 20.0, 10.0]), 1.0)
    assert steps[0].variances == (0.0, 0.0) and sorted(steps[1].variances) == pytest.approx([4.0, 64.0])


def test_a_size_changes_by_its_scale_alone(motion_of):
    state = np.array([50.0, 40.0, 20.0, 10.0])
    assert scale_sd(
        motion_of("random_walk", sd_px={"x": 1.0}, sd_log={"scale": 0.1}), state, 4.0
    ) == pytest.approx(0.2)
    assert scale_sd(motion_of("random_walk", sd_px={"x": 1.0}), state, 4.0) == 0.0
    for bad in ({"sd_px": {"w": 1.0}}, {"sd_log": {"scale": 0.1, "aspect": 0.05}}):
        with pytest.raises(ValueError, match=r"sd_log\.scale"):
            scale_sd(motion_of("random_walk", **bad), state, 1.0)


def enumerated(belief, motion, dt):
    """Means and variances of x and y after one step, and the velocities' masses, cell by cell."""
    steps, _ = axis_steps(motion, belief.mean, dt)
    changes = [_change(step, VELOCITIES) for step in steps]
    x, y, *_ = belief.values
    total, first, second, speeds = 0.0, np.zeros(2), np.zeros(2), np.zeros((3, 3))
    for (_, b, a, row, column), mass in np.ndenumerate(belief.mass):
        for new_b in range(3):
            for new_a in range(3):
                share = mass * changes[1][new_b, b] * changes[0][new_a, a]
                at = np.array([
                    x[column] + steps[0].first * VELOCITIES[a] + steps[0].second * VELOCITIES[new_a],
                    y[row] + steps[1].first * VELOCITIES[b] + steps[1].second * VELOCITIES[new_b],
                ])  # fmt: skip
                total, speeds[new_b, new_a] = total + share, speeds[new_b, new_a] + share
                first, second = first + share * at, second + share * at**2
    assert total == pytest.approx(1.0)
    return first, second - first**2 + [steps[0].variances[0], steps[1].variances[0]], speeds


@pytest.mark.parametrize("dt", [1.0, 2.0])
def test_a_prediction_has_the_moments_of_its_cells(dt, belief, motion_of):
    motion = motion_of("damped_velocity", **DAMPED)
    mean, variance, speeds = enumerated(belief, motion, dt)
    found = predict_grid(belief, motion, dt, 64)
    np.testing.assert_allclose(found.mean[:2], mean, atol=1e-9)
    np.testing.assert_allclose(
        np.diag(found.covariance)[:2], variance, rtol=1e-5
    )  # narrow taps are negative here and there, and cut
    np.testing.assert_allclose(found.mass.sum(axis=(0, 3, 4)), speeds, atol=1e-12)
    assert found.mass.min() >= 0.0


def test_scales_spread_by_their_matrix_and_those_without_mass_are_filled(motion_of):
    lattice = Lattice((50.0, 40.0), 2.0, 0, 0, (20.0, 10.0), 0.1 * np.arange(-2.0, 3.0), np.zeros(1))
    mass = np.zeros((5, 1, 1, 1, 2))
    mass[2:4, 0, 0, 0] = [[0.5, 0.2], [0.2, 0.1]]
    belief = GridBelief(mass, lattice, np.ones((1, 1)))
    motion = motion_of("random_walk", sd_px={"x": 3.0, "y": 3.0}, sd_log={"scale": 0.15})
    found = predict_grid(belief, motion, 1.0, 64)
    expected = spreading_matrix(5, 1.0, 1.5) @ np.array([0.0, 0.0, 0.7, 0.3, 0.0])
    np.testing.assert_allclose(found.positions.sum(axis=(1, 2)), expected, atol=1e-12)
    assert found.mean[0] == pytest.approx(50.6) and found.mean[1] == pytest.approx(40.0)
    assert found.covariance[0, 0] == pytest.approx(9.0 + 4 * 0.3 * 0.7)


def test_wide_noise_is_a_mixture(motion_of):
    lattice = Lattice((50.0, 40.0), 2.0, 0, 0, (20.0, 10.0), np.zeros(1), np.zeros(1))
    belief = GridBelief(np.ones((1, 1, 1, 1, 1)), lattice, np.ones((1, 1)))
    motion = motion_of("random_walk", sd_px={"x": 3.0, "y": 2.0}, heavy_tail={"weight": 0.2, "factor": 3.0})
    found = predict_grid(belief, motion, 1.0, 64)
    assert found.covariance[0, 0] == pytest.approx(9 * (0.8 + 0.2 * 9), rel=1e-6)
    assert found.covariance[1, 1] == pytest.approx(4 * (0.8 + 0.2 * 9), rel=1e-6)
    line = found.positions.sum(axis=(0, 1))
    fourth = line @ (found.values[0] - 50.0) ** 4
    assert fourth == pytest.approx(3 * 81 * (0.8 + 0.2 * 81), rel=1e-4)


def test_a_spread_is_that_of_anywhere_in_the_image_at_most(belief, motion_of):
    motion = motion_of("constant_velocity", **{k: v for k, v in DAMPED.items() if k != "damping"})
    steps, shares = axis_steps(motion, belief.mean, 40.0)
    patch = Patch(belief.mass[0], 3, -4)
    change = _change(steps[0], VELOCITIES)
    for limits in (GridLimits((0, 20), (-10, 10), 64), GridLimits(None, None, 16)):
        step = _bound(0, patch, steps[0], (shares, change), LATTICE, limits)
        known = patch.mass.sum(axis=(0, 2))  # (V, columns)
        joint = change * known.sum(axis=1)
        old, new = VELOCITIES[None, :], VELOCITIES[:, None]
        start = 2.0 * (known.sum(axis=0) @ np.arange(3, 6))
        free = float((joint * (steps[0].first * old + steps[0].second * new)).sum())
        shifts = step.first * old + step.second * new + step.offset
        goal = start + free if limits.columns is None else np.clip(start + free, 0.0, 40.0)
        most = 32.0**2 if limits.columns is None else 42.0**2 / 12 + (goal - 20.0) ** 2
        assert start + float((joint * shifts).sum()) == pytest.approx(goal)
        spread = float((joint * (shifts - (joint * shifts).sum()) ** 2).sum()) + step.variances[0]
        assert spread == pytest.approx(most)
        assert step.second / step.first == pytest.approx(steps[0].second / steps[0].first)
    near = axis_steps(motion, belief.mean, 1.0)[0][1]
    assert _bound(1, patch, near, (shares, change), LATTICE, GridLimits((0, 20), (-10, 10), 64)) is near


# ------------------------------------------------------------------------------------ gaps


def normal(x, mean, sd):
    return np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * math.sqrt(2 * math.pi))


def test_mass_moves_to_cells_and_an_end_may_keep_what_passes_it():
    cells, centres = np.arange(-5, 8), np.array([[0.3, 6.5], [-4.0, 20.0]])
    open_ = moving(centres, 2.0, Span(-5, 7, (False, False)))
    np.testing.assert_allclose(open_, normal(cells, centres[..., None], 2.0), atol=1e-15)
    both = moving(centres, 2.0, Span(-5, 7, (True, True)))
    np.testing.assert_allclose(both.sum(axis=-1), 1.0, atol=1e-6)
    np.testing.assert_allclose(both[..., 1:-1], open_[..., 1:-1])
    below = 0.5 * (1 + math.erf((-5.5 + 4.0) / (2.0 * math.sqrt(2))))
    assert both[1, 0, 0] - open_[1, 0, 0] == pytest.approx(below, rel=0.05)
    assert both[1, 1, -1] == pytest.approx(1.0) and both[1, 1, 0] == pytest.approx(0.0, abs=1e-12)
    left = moving(centres, 2.0, Span(-5, 7, (True, False)))
    np.testing.assert_allclose(left[..., 0], both[..., 0])
    np.testing.assert_allclose(left[..., 1:], open_[..., 1:])
    right = moving(centres, 2.0, Span(-5, 7, (False, True)))
    np.testing.assert_allclose(right[..., -1], both[..., -1])
    np.testing.assert_allclose(right[..., :-1], open_[..., :-1])


def test_narrow_noise_keeps_mean_and_variance():
    centres = np.array([0.3, -2.0, 4.75])
    span = Span(-12, 15, (False, False))
    found, cells = moving(centres, 0.4, span), np.arange(-12, 16)
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    np.testing.assert_allclose(found @ cells, centres, atol=1e-12)
    np.testing.assert_allclose(
        [line @ (cells - c) ** 2 for line, c in zip(found, centres, strict=True)], 0.16
    )
    ends = moving(np.array([-12.0, 15.0, -40.0, 60.0]), 0.4, Span(-12, 15, (True, True)))
    np.testing.assert_allclose(ends.sum(axis=1), 1.0)
    assert ends[2, 0] == pytest.approx(1.0) and ends[3, -1] == pytest.approx(1.0)
    cut = moving(np.array([-12.0, 15.0, -40.0, 60.0]), 0.4, span)
    assert cut[2:].sum() == 0.0
    np.testing.assert_allclose(
        cut[:2].sum(axis=1), ends[:2].sum(axis=1) - [ends[0, 0] - cut[0, 0], ends[1, -1] - cut[1, -1]]
    )


@pytest.mark.parametrize("sd", [3.0, 12.0])
def test_a_leap_is_the_sum_over_old_and_new_velocities(sd, rng):
    leap = Leap(np.array([-4.0, 0.5, 6.0]), np.array([-9.0, 0.0, 11.0]), rng.dirichlet(np.ones(3), 3).T, sd)
    mass = rng.random((2, 3, 2, 4))
    span = Span(-60, 70, (False, False))
    found, cells = _leapt(mass, 5, leap, span), np.arange(-60, 71)
    expected = np.zeros(found.shape)
    for old in range(3):
        for new in range(3):
            centres = 5 + np.arange(4) + leap.first[old] + leap.second[new]
            expected[:, new] += leap.change[new, old] * mass[:, old] @ normal(cells, centres[:, None], sd)
    np.testing.assert_allclose(found, expected, atol=1e-7)
    shifts = leap.first[None, :] + leap.second[:, None]
    assert leap.reach == pytest.approx((shifts.min() - 7 * sd, shifts.max() + 7 * sd))


def test_a_leap_of_both_axes_keeps_all_mass_in_the_image(rng):
    change = rng.dirichlet(np.ones(3), 3).T
    across = Leap(np.array([-40.0, 0.5, 60.0]), np.array([-9.0, 0.0, 11.0]), change, 12.0)
    down = Leap(np.array([-3.0, 0.0, 3.0]), np.array([-1.0, 0.0, 1.0]), change, 4.0)
    mass = rng.random((3, 3, 3, 4))
    mass /= mass.sum()
    found = leapt(Patch(mass, 5, -2), [across], [down], np.ones(1), GridLimits((-10, 30), (-20, 20), 200))
    assert found.mass.sum() == pytest.approx(1.0, abs=1e-6)
    assert (found.column, found.mass.shape[3]) == (-10, 41)
    np.testing.assert_allclose(
        found.mass.sum(axis=(2, 3)),
        np.einsum("bd,ac,dc->ba", change, change, mass.sum(axis=(2, 3))),
        atol=1e-6,
    )
    rows = found.row + np.arange(found.mass.shape[2])
    inside = Patch(mass, 5, -2)
    at = inside.mass.sum(axis=(0, 1, 3)) @ (np.arange(3) - 2.0)
    slow = mass.sum(axis=(1, 2, 3))
    mean = at + slow @ down.first + (change @ slow) @ down.second
    assert found.mass.sum(axis=(0, 1, 3)) @ rows == pytest.approx(mean, abs=1e-4)
    two = leapt(
        Patch(mass, 5, -2),
        [across] * 2,
        [down] * 2,
        np.array([0.25, 0.75]),
        GridLimits((-10, 30), (-20, 20), 200),
    )
    np.testing.assert_allclose(two.mass, found.mass, atol=1e-12)
    free = leapt(Patch(mass, 5, -2), [across], [down], np.ones(1), GridLimits(None, None, 400))
    assert free.mass.sum() == pytest.approx(1.0, abs=1e-6) and free.mass.shape[3] > 41


# ------------------------------------------------------------------------------------ evidence


def seen(place, sd=2.0):
    return lambda hypotheses, prior_log: Evidence(
        -0.5 * ((hypotheses.boxes[:, :2] - place) ** 2).sum(1) / sd**2
    )


def test_bayes_rule_at_the_cells(motion_of, stream_of):
    motion = motion_of("random_walk", sd_px={"x": 3.0, "y": 2.0})
    chosen = GridFilter(spec.Grid(cell_px=2.0, cut=0.0, window=32))
    start = chosen.start(np.array([50.0, 40.0, 20.0, 10.0]), motion, stream_of(0, 0))
    assert start.mass.tolist() == [[[[[1.0]]]]] and start.mean.tolist() == [50.0, 40.0, 20.0, 10.0]
    prior = predict_grid(start, motion, 1.0, 32)
    stepped = chosen.step(start, motion, 1.0, seen(np.array([53.0, 38.0])), stream_of(0, 1))
    x, y = prior.values[:2]
    likelihood = np.exp(-0.125 * ((x - 53.0) ** 2 + (y[:, None] - 38.0) ** 2))
    posterior = prior.positions[0] * likelihood
    assert stepped.log_evidence == pytest.approx(np.log(posterior.sum()))
    np.testing.assert_allclose(stepped.posterior.positions[0], posterior / posterior.sum(), atol=1e-14)
    assert len(stepped.posterior) == posterior.size == len(stepped.support.weights)
    np.testing.assert_allclose(
        stepped.support.weights.weights, (posterior / posterior.sum()).ravel(), atol=1e-14
    )
    np.testing.assert_allclose(np.exp(stepped.prior.log), prior.positions.ravel(), atol=1e-14)
    assert stepped.map_state.tolist() == stepped.posterior.most_probable().tolist()
    assert stepped.degenerate is None and stepped.reports == ()


def test_a_start_is_inside_the_image_with_velocity_and_scale_around_nothing(motion_of, stream_of):
    noise = {"sd_px": {"x": 1.0, "y": 1.0}, "sd_log": {"scale": 0.1}, "sd_velocity_px": 0.7}
    motion = Confined(motion_of("constant_velocity", **noise, start_velocity_sd_px=1.0), 60, 30)
    chosen = GridFilter(spec.Grid(velocity_cells=5, velocity_cell_px=0.5, scale_cells=3, scale_cell=0.2))
    start = chosen.start(np.array([70.0, -4.0, 20.0, 10.0]), motion, stream_of(0, 0))
    assert start.lattice.anchor == (59.0, 0.0)
    assert start.lattice.velocities.tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0]
    np.testing.assert_allclose(start.lattice.log_scales, [-0.2, 0.0, 0.2])
    assert start.positions.ravel().tolist() == pytest.approx([0.0, 1.0, 0.0])
    line = spreading_matrix(5, 1.0, 2.0)[:, 2]
    np.testing.assert_allclose(start.mass[1, :, :, 0, 0], np.outer(line, line) / line.sum() ** 2)


def test_a_gaussian_message_has_its_floor():
    message = Measurement(("x", "vx"), np.array([10.0, 1.0]), np.array([[4.0, 1.0], [1.0, 2.0]]), 0.25)
    x, v = np.array([10.0, 12.0, 900.0]), np.array([1.0, 0.0, 1.0])
    inverse = np.array([[2.0, -1.0], [-1.0, 4.0]]) / 7.0
    d2 = [0.0, np.array([2.0, -1.0]) @ inverse @ np.array([2.0, -1.0]), np.inf]
    np.testing.assert_allclose(
        log_gaussian(message, [x, v]), np.log(0.25 + 0.75 * np.exp(-0.5 * np.array(d2)))
    )


def test_gamma_is_the_evidence_over_the_mean_likelihood(belief):
    box = np.array([[[0.1, 0.2, 0.1], [0.2, 0.3, 0.1]]])
    log = np.log(np.array([[[0.5, 0.1, 0.2], [0.1, 0.1, 0.4]]]))
    gamma = (box * np.exp(log)).sum() / np.exp(log).mean()
    rule = spec.Reset(region="belief", below=1.0)
    found = judge_in_box(rule, belief, box, log)
    event = found.report(3, "1")
    assert event.gamma == pytest.approx(gamma) and event.below == 1.0 and event.region_px2 == 24.0
    assert event.frame == 3 and event.target == "1" and event.region == "belief"
    assert found.mean == pytest.approx(np.log(np.exp(log).mean())) and found.peak is None
    assert (
        judge_in_box(spec.Reset(region="belief", below=float(gamma) * 0.99), belief, box, log).report is None
    )
    assert judge_in_box(rule, belief, box, np.full(box.shape, -np.inf)).report is None


def test_the_image_is_judged_at_places_of_its_own(belief):
    place, limits = np.array([60.0, 30.0]), GridLimits((-5, 10), (-8, 6), 32)
    asked = []

    def ask(states):
        asked.append(states)
        return Evidence(-0.5 * ((states[:, :2] - place) ** 2).sum(axis=1) / 16.0)

    found = judge_on_image(spec.Reset(region="image", below=1.0), belief, limits, np.log(0.02), ask)
    (states,) = asked
    assert (
        len(states) == 16 * 15
        and states[0, :2].tolist() == [40.0, 24.0]
        and states[-1, :2].tolist() == [70.0, 52.0]
    )
    np.testing.assert_allclose(states[:, 2:], np.tile(belief.mean[2:], (240, 1)))
    mean = np.exp(-0.5 * ((states[:, :2] - place) ** 2).sum(axis=1) / 16.0).mean()
    event = found.report(3, "1")
    assert event.gamma == pytest.approx(0.02 / mean) and event.region_px2 == 240 * 4
    assert found.mean == pytest.approx(np.log(mean)) and found.peak.tolist() == [60.0, 30.0]
    assert (
        judge_on_image(
            spec.Reset(region="image", below=1.0), belief, limits, np.log(1.001 * mean), ask
        ).report
        is None
    )
    free = judge_on_image(
        spec.Reset(region="image", below=1.0), belief, GridLimits(None, None, 32), -9.0, ask
    )
    assert free.report is None and len(asked) == 2
