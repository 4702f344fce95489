"""Motion by expressions: the models that have a closed form, enumeration for those that have none."""

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.gaussian.belief import predict
from bayesnet_track.belief.grid.belief import GridFilter
from bayesnet_track.belief.grid.cells import predict_by_function
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.formulas import Undefined, derivative, make_formula_motion, undefined_in
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.graph import spec
from bayesnet_track.numerics.streams import Streams

BOX = np.array([160.0, 120.0, 40.0, 30.0])
VELOCITY = {
    "fields": {"vx": {"sd": 2}, "vy": {"start": 1, "sd": 1}},
    "drift": {"x": "x + vx * dt", "y": "y + vy * dt", "vx": "decay * vx", "vy": "vy + 0.5 * dt"},
    "sd": {"x": 3, "y": "2", "vx": 1.5, "vy": "0.1 * decay + 1"},
}
WAVE = {"drift": {"x": "x + 8 * sin(y / 9)", "y": "y + (x - 160) ** 2 / 60"}, "sd": {"x": 3, "y": 2.5}}
TURN = {
    "fields": {"speed": {"start": 4, "sd": 0.5}, "heading": {"sd": 0.3}},
    "drift": {"x": "x + speed * dt * cos(heading)", "y": "y + speed * dt * sin(heading)"},
    "sd": {"x": "0.02 * h + 0.1", "y": 0.5, "speed": 0.2, "heading": 0.1, "w": "0.05 * w"},
}


def motion_of(settings, **constants):
    return make_formula_motion(spec.ByExpressions.model_validate(settings), constants)


def linear(dt):
    """F, the constant part and Q of `VELOCITY` with decay 0.9."""
    transition = np.eye(6)
    transition[0, 4] = transition[1, 5] = dt
    transition[4, 4] = 0.9
    return (
        transition,
        np.array([0, 0, 0, 0, 0, 0.5 * dt]),
        dt * np.diag([3, 2, 0, 0, 1.5, 1.09]) ** 2.0,
    )


def stream(purpose):
    return Streams(4).of("1", "root", 1, purpose)


@pytest.mark.parametrize("filter_kind", ["extended", "unscented"])
def test_of_a_linear_motion_a_gaussian_is_exact(filter_kind):
    motion = motion_of(VELOCITY, decay=0.9)
    mean, covariance = motion.start_moments(BOX)
    assert motion.fields == ("x", "y", "w", "h", "vx", "vy") and mean[5] == 1
    for dt in (1.0, 2.5):
        transition, constant, noise = linear(dt)
        expected = transition @ mean + constant, transition @ covariance @ transition.T + noise
        mean, covariance = predict(mean, covariance, motion, dt, spec.Gaussian(filter=filter_kind))
        np.testing.assert_allclose(mean, expected[0], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(covariance, expected[1], rtol=1e-6, atol=1e-6)


def test_the_derivative_of_a_turn_is_the_textbooks():
    motion, state = motion_of(TURN), np.array([160.0, 120, 40, 30, 4.0, 0.7])
    found, noise = motion.linearise(state, 2.0)
    expected = np.eye(6)
    expected[0, 4:] = 2 * np.cos(0.7), -8 * np.sin(0.7)
    expected[1, 4:] = 2 * np.sin(0.7), 8 * np.cos(0.7)
    np.testing.assert_allclose(found, expected, atol=1e-8)
    np.testing.assert_allclose(np.diag(noise), 2 * np.array([0.7, 0.5, 2, 0, 0.2, 0.1]) ** 2)


def test_particles_are_drawn_from_the_density_that_they_have():
    motion = motion_of(TURN)
    old = motion.start(BOX, 1, np.random.default_rng(0))
    drawn = motion.propagate(np.repeat(old, 40_000, axis=0), 2.0, np.random.default_rng(1))
    transition = motion.transition(old, 2.0)
    points = transition.coordinates(drawn)[0]
    off = (points - transition.means) / transition.sds[0]
    np.testing.assert_allclose(off.mean(axis=0), 0, atol=5 / 200)
    np.testing.assert_allclose(off.std(axis=0), 1, atol=5 / 280)
    gaussians = -0.5 * np.sum(off**2, axis=1) - np.sum(np.log(transition.sds[0, 0] * np.sqrt(2 * np.pi)))
    np.testing.assert_allclose(motion.log_density(drawn, old, 2.0)[:, 0], gaussians, rtol=1e-12)
    np.testing.assert_allclose(transition.states(points, drawn), drawn)


def test_parents_are_those_asked_for():
    motion = motion_of(TURN)
    states = motion.start(BOX, 9, np.random.default_rng(0))
    parents = np.array([3, 3, 0, 8])
    one = motion.propagate(states, 1.0, np.random.default_rng(1), parents)
    np.testing.assert_array_equal(one, motion.propagate(states[parents], 1.0, np.random.default_rng(1)))


def see(boxes):
    return -0.5 * (((boxes[:, 0] - 168) / 5) ** 2 + ((boxes[:, 1] - 124) / 6) ** 2)


def enumerated():
    """Mean and log-evidence after two steps of `WAVE`, both seen, by a sum over pixels."""
    x, y = np.meshgrid(np.arange(135.0, 195), np.arange(100.0, 150))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    old, weights, log_evidence = BOX[None, :2], np.ones(1), 0.0
    for _ in range(2):
        means = np.stack(
            [old[:, 0] + 8 * np.sin(old[:, 1] / 9), old[:, 1] + (old[:, 0] - 160) ** 2 / 60], axis=1
        )
        prior = np.zeros(len(points))
        for some in np.array_split(np.flatnonzero(weights > 1e-5 * weights.max()), 10):
            across = np.exp(-0.5 * ((points[:, None, 0] - means[some, 0]) / 3) ** 2)
            down = np.exp(-0.5 * ((points[:, None, 1] - means[some, 1]) / 2.5) ** 2)
            prior += (across * down) @ weights[some]
        prior /= prior.sum()
        seen = prior * np.exp(see(points))
        log_evidence += np.log(seen.sum())
        old, weights = points, seen / seen.sum()
    return weights @ points, log_evidence


@pytest.fixture(scope="module")
def exact():
    return enumerated()


@pytest.mark.parametrize(
    ("belief", "to"),
    [
        (GridFilter(spec.Grid(cell_px=1, cut=0.00001)), 0.01),
        (ParticleFilter(spec.Particles(size=20_000)), 0.2),
    ],
    ids=["grid", "particles"],
)
def test_of_a_motion_that_is_not_linear_it_is_what_enumeration_says(belief, to, exact):
    motion, total = confined(motion_of(WAVE), 320, 240), 0.0
    known = belief.start(BOX, motion, stream)
    for frame in (1, 2):
        step = belief.step(
            known,
            motion,
            1.0,
            lambda hypotheses, _: Evidence(see(hypotheses.boxes), {"a": see(hypotheses.boxes)}),
            lambda purpose, frame=frame: Streams(4).of("1", "root", frame, purpose),
        )
        known, total = step.posterior, total + step.log_evidence
    np.testing.assert_allclose(known.mean[:2], exact[0], atol=to)
    assert total == pytest.approx(exact[1], abs=to)


def test_a_grid_of_velocities_moves_as_the_kalman_filter():
    motion = motion_of({**VELOCITY, "sd": {"x": 3, "y": 3, "vx": 1.5, "vy": 1.5}}, decay=0.9)
    belief = GridFilter(spec.Grid(cell_px=2.5, velocity_cells=15, velocity_cell_px=1.4))
    known = belief.start(BOX, motion, stream)
    mean, covariance = known.mean, known.covariance
    for dt in (1.0, 2.0):
        mean, covariance = predict(mean, covariance, motion, dt, spec.Gaussian(filter="extended"))
        known = belief.predict(known, motion, dt, stream("p"))
    np.testing.assert_allclose(known.mean, mean, atol=0.03)
    np.testing.assert_allclose(np.diag(known.covariance), np.diag(covariance), rtol=0.03, atol=1e-9)


def test_mass_is_kept_and_the_window_bounds_it():
    motion = motion_of({"drift": {"x": "x * 1e6"}, "sd": {"x": 3, "y": 3}})
    belief = GridFilter(spec.Grid())
    known = predict_by_function(belief.start(BOX, motion, stream), motion, 1.0, 40)
    assert known.mass.sum() == pytest.approx(1) and max(known.mass.shape[3:]) <= 40


def test_what_has_no_value_stays_and_is_told():
    motion = motion_of({"drift": {"x": "x + sqrt(y - 120)"}, "sd": {"x": "y - 119", "y": 1}})
    states = np.tile(BOX, (3, 1))
    states[:, 1] = 118, 120, 124
    moved = motion.drift(states, 1.0)
    assert moved[:, 0].tolist() == [160, 160, 162]
    assert motion.noise(states, 4.0)[:, 0].tolist() == [0, 2, 10]
    assert motion.undefined == {"drift x": Undefined(1, 3), "sd x": Undefined(1, 3)}
    fresh = confined(motion, 320, 240)
    assert undefined_in(fresh) == {} and undefined_in(None) == {}
    with pytest.raises(ValueError, match="positive"):
        motion.drift(states, 0.0)


def test_it_knows_the_frame():
    motion = confined(
        motion_of({"drift": {"x": "min(x + 9, frame_width - w / 2)"}, "sd": {"x": 1}}), 320, 240
    )
    assert motion.drift(np.array([[305.0, 9, 40, 40]]), 1.0)[0, 0] == 300
    numerical = derivative(lambda states: motion.drift(states, 1.0), np.array([50.0, 9, 40, 40]))
    np.testing.assert_allclose(numerical, np.eye(4), atol=1e-8)
