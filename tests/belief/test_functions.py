"""Motion and measurement by functions: against the language's linear models, Monte Carlo and each other."""

import numpy as np
import pytest
from scipy import stats

from bayesnet_track.belief.gaussian.belief import GaussianFilter, predict
from bayesnet_track.belief.motion.formulas import (
    FunctionMotion,
    derivative,
    extended_update,
    unscented_update,
)
from bayesnet_track.belief.motion.models import linear_gaussian
from bayesnet_track.graph import spec
from bayesnet_track.numerics.gaussian import linear_update

FIELDS = ("x", "y", "w", "h", "speed", "heading", "rate")
STATE = np.array([100.0, 80.0, 20.0, 20.0, 5.0, 0.4, 0.15])


def turn(states, dt):
    """A target that turns at a constant rate, the arc taken as its chord's direction."""
    x, y, w, h, speed, heading, rate = states.T
    middle = heading + rate * dt / 2
    return np.stack(
        [
            x + speed * dt * np.cos(middle),
            y + speed * dt * np.sin(middle),
            w,
            h,
            speed,
            heading + rate * dt,
            rate,
        ],
        axis=1,
    )


def turn_jacobian(state, dt):
    speed, heading, rate = state[4:]
    middle = heading + rate * dt / 2
    moves = np.eye(7)
    moves[0, 4:] = dt * np.cos(middle), -speed * dt * np.sin(middle), -speed * dt**2 / 2 * np.sin(middle)
    moves[1, 4:] = dt * np.sin(middle), speed * dt * np.cos(middle), speed * dt**2 / 2 * np.cos(middle)
    moves[5, 6] = dt
    return moves


NOISE = np.diag([0.5, 0.5, 0.0, 0.0, 0.2, 0.05, 0.02]) ** 2


@pytest.fixture
def turning():
    return FunctionMotion(FIELDS, turn, NOISE, start_mean=(5.0, 0.4, 0.15), start_sd=(1.0, 0.3, 0.05))


def test_the_derivative_is_that_of_the_closed_form(turning):
    for dt in (0.5, 1.0, 3.0):
        moves, spread = turning.linearise(STATE, dt)
        np.testing.assert_allclose(moves, turn_jacobian(STATE, dt), atol=1e-8)
        np.testing.assert_allclose(spread, dt * NOISE)
    given = FunctionMotion(FIELDS, turn, NOISE, jacobian=lambda state, dt: np.full((7, 7), dt))
    np.testing.assert_array_equal(given.linearise(STATE, 2.0)[0], np.full((7, 7), 2.0))


def test_the_derivative_of_large_and_small_coordinates():
    found = derivative(lambda s: np.stack([s[:, 0] ** 2, s[:, 0] * s[:, 1]], axis=1), np.array([1e4, 1e-4]))
    np.testing.assert_allclose(found, [[2e4, 0], [1e-4, 1e4]], rtol=1e-8, atol=1e-6)


def test_a_linear_function_is_the_languages_motion(motion_of, stream_of):
    """The same F and Q by a function: predictions agree to 1e-9 by either filter, unscented included."""
    own = motion_of("constant_velocity")
    motion = FunctionMotion(
        own.fields,
        lambda states, dt: states @ linear_gaussian(own, dt)[0].T,
        lambda dt: linear_gaussian(own, dt)[1],
        start_sd=(4.0, 4.0),
    )
    mean, covariance = motion.start_moments(STATE[:4])
    np.testing.assert_allclose(covariance, own.start_moments(STATE[:4])[1])
    for kind in ("extended", "unscented"):
        there, spread = mean, covariance
        for dt in (1.0, 0.5, 2.5):
            there, spread = predict(there, spread, motion, dt, spec.Gaussian(filter=kind))
        expected = mean, covariance
        for dt in (1.0, 0.5, 2.5):
            expected = predict(*expected, own, dt, spec.Gaussian())
        np.testing.assert_allclose(there, expected[0], atol=1e-9)
        np.testing.assert_allclose(spread, expected[1], rtol=1e-7, atol=1e-9)


def test_unscented_is_nearer_to_monte_carlo_than_extended(turning):
    """Speed along an uncertain heading: the mean is dragged inwards, which a derivative cannot see."""
    covariance = np.diag([1.0, 1.0, 0.0, 0.0, 0.5, 0.5, 0.05]) ** 2
    rng = np.random.default_rng(0)
    lower = np.sqrt(np.diag(covariance))
    drawn = turning.drift(STATE + rng.standard_normal((400_000, 7)) * lower, 3.0)
    exact, spread = drawn.mean(axis=0), np.cov(drawn.T) + 3.0 * NOISE
    found = {
        kind: predict(STATE, covariance, turning, 3.0, spec.Gaussian(filter=kind))
        for kind in ("extended", "unscented")
    }
    errors = {kind: np.abs(mean - exact)[:2].max() for kind, (mean, _) in found.items()}
    # The mean of N draws is known to sd / sqrt(N) = .01 px; the extended one is off by 15 (1 - e^-.125).
    assert errors["extended"] > 1.0
    assert errors["unscented"] < 0.15
    unit = np.sqrt(np.diag(spread)) + 1e-12
    off = {
        kind: np.abs((given - spread) / np.outer(unit, unit))[:2, :2].max()
        for kind, (_, given) in found.items()
    }
    assert off["unscented"] < 0.5 * off["extended"]
    assert np.linalg.eigvalsh(found["unscented"][1]).min() > -1e-12


def test_the_unscented_mean_is_exact_to_second_order():
    """f = x^2: mean m^2 + P, and variance 4 m^2 P + 2 P^2 by the points at sqrt(3) sds or by beta 2."""
    motion = FunctionMotion(
        ("x", "y", "w", "h"),
        lambda s, dt: np.concatenate([s[:, :1] ** 2, s[:, 1:]], axis=1),
        np.zeros((4, 4)),
    )
    mean, covariance = np.array([3.0, 0.0, 9.0, 9.0]), np.diag([0.25, 0.0, 0.0, 0.0])
    for sigma in (spec.Unscented(), spec.Unscented(alpha=1e-3, beta=2.0, kappa=0.0)):
        there, spread = predict(mean, covariance, motion, 1.0, spec.Gaussian(filter="unscented", sigma=sigma))
        assert there[0] == pytest.approx(9.25)
        assert spread[0, 0] == pytest.approx(4 * 9 * 0.25 + 2 * 0.25**2, rel=1e-5)


def test_a_negative_weight_leaves_no_negative_variance():
    """f = |x - m| bends at the centre: with weights of 1 - D / 3 = -1/3 its variance would be negative."""
    motion = FunctionMotion(
        ("x", "y", "w", "h"),
        lambda s, dt: np.concatenate([np.sum((s - STATE[:4]) ** 2, axis=1)[:, None], s[:, 1:]], axis=1),
        np.zeros((4, 4)),
    )
    sharp = spec.Unscented(alpha=0.5, beta=0.0, kappa=0.0)
    for sigma in (spec.Unscented(), sharp):
        settings = spec.Gaussian(filter="unscented", sigma=sigma)
        _, covariance = predict(STATE[:4], np.eye(4), motion, 1.0, settings)
        assert np.linalg.eigvalsh(covariance).min() >= -1e-9


def test_draws_have_the_moments_and_the_density_of_the_noise(turning, rng):
    mixing = np.eye(7)
    mixing[0, 1] = 0.7
    motion = FunctionMotion(FIELDS, turn, mixing @ NOISE @ mixing.T)
    states = np.tile(STATE, (40_000, 1))
    new = motion.propagate(states, 2.0, rng)
    away = new - turn(states, 2.0)
    np.testing.assert_allclose(np.cov(away.T), 2 * mixing @ NOISE @ mixing.T, atol=4 * 0.75 / np.sqrt(40_000))
    keep = [0, 1, 4, 5, 6]
    exact = stats.multivariate_normal(
        np.zeros(5), (2 * mixing @ NOISE @ mixing.T)[np.ix_(keep, keep)]
    ).logpdf(away[:20][:, keep])
    found = motion.log_density(new[:20], STATE[None], 2.0)[:, 0]
    np.testing.assert_allclose(found, exact, atol=1e-6)


def test_sides_stay_a_pixel_wide(rng):
    noise = np.diag([0.0, 0.0, 100.0, 100.0])
    motion = FunctionMotion(("x", "y", "w", "h"), lambda s, dt: s, noise)
    assert motion.propagate(np.tile([5.0, 5.0, 2.0, 2.0], (500, 1)), 1.0, rng)[:, 2:].min() == 1.0


def test_particles_take_it_too(turning, stream_of):
    from bayesnet_track.belief.contract import Evidence
    from bayesnet_track.belief.particles.belief import ParticleFilter

    def seen(hypotheses, log_prior):
        assert set(hypotheses.fields) == set(FIELDS[4:])
        return Evidence(-0.5 * np.sum((hypotheses.boxes[:, :2] - (105, 82)) ** 2, axis=1))

    belief = ParticleFilter(spec.Particles(size=300))
    step = belief.step(belief.start(STATE[:4], turning, stream_of(0, 0)), turning, 1.0, seen, stream_of(0, 1))
    assert np.hypot(*(step.map_state[:2] - (105, 82))) < 3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"fields": ("x", "y", "h", "w")}, "x, y, w, h"),
        ({"fields": ("x", "y", "w", "h", "x")}, "x, y, w, h"),
        ({"noise": np.eye(3)}, "covariance, not of shape"),
        ({"noise": np.diag([1, 1, 1, -1, 1, 1, 1.0])}, "not symmetric and positive"),
        ({"noise": np.triu(np.ones((7, 7)))}, "not symmetric and positive"),
        ({"start_sd": (1.0,)}, "start_sd has 1 values for 3"),
    ],
)
def test_what_makes_no_motion_is_refused(change, said):
    with pytest.raises(ValueError, match=said):
        FunctionMotion(**{"fields": FIELDS, "function": turn, "noise": NOISE, **change})


def test_a_function_that_fails_says_so(stream_of):
    for function, said in (
        (lambda s, dt: s[:, :2], "shape"),
        (lambda s, dt: s * np.nan, "not finite"),
    ):
        motion = FunctionMotion(FIELDS, function, NOISE)
        with pytest.raises(ValueError, match=said):
            motion.drift(STATE[None], 1.0)
    with pytest.raises(ValueError, match="positive and finite"):
        FunctionMotion(FIELDS, turn, NOISE).linearise(STATE, 0.0)
    with pytest.raises(ValueError, match="extended or unscented"):
        GaussianFilter(spec.Gaussian(filter="kalman")).start(
            STATE[:4], FunctionMotion(FIELDS, turn, NOISE), stream_of(0, 0)
        )


# ------------------------------------------------------------------------------------ measurement functions

PRIOR = np.array([[9.0, 2.0, 1.0], [2.0, 4.0, 0.5], [1.0, 0.5, 1.0]])
MEAN, OBSERVE, R = (
    np.array([30.0, 40.0, 1.0]),
    np.array([[1.0, 0.0, 2.0], [0.0, 1.0, -1.0]]),
    np.diag([2.0, 3.0]),
)


@pytest.mark.parametrize("update", [extended_update, unscented_update])
def test_a_linear_measurement_is_kalmans(update):
    z = np.array([33.0, 37.0])
    exact = linear_update(MEAN, PRIOR, z - OBSERVE @ MEAN, OBSERVE, R)
    found = update(MEAN, PRIOR, z, R, lambda s: s @ OBSERVE.T)
    np.testing.assert_allclose(found.mean, exact.mean, atol=1e-9)
    np.testing.assert_allclose(found.covariance, exact.covariance, atol=1e-9)
    assert found.d2 == pytest.approx(exact.d2, rel=1e-9)
    assert found.log_likelihood == pytest.approx(exact.log_likelihood, rel=1e-9)


def test_unscented_measures_a_curved_function_better():
    """Range and bearing with a vague prior, against 1,000,000 weighted draws: errors in units of the sd."""

    def see(states):
        return np.stack(
            [np.hypot(states[:, 0], states[:, 1]), np.arctan2(states[:, 1], states[:, 0])], axis=1
        )

    prior, noise = np.diag([150.0, 150.0, 1.0]), np.diag([4.0, 0.01])
    z = see(MEAN[None])[0] + (-6.0, 0.2)
    drawn = np.random.default_rng(1).multivariate_normal(MEAN, prior, 1_000_000)
    away = z - see(drawn)
    weights = np.exp(-0.5 * np.sum(away**2 / np.diag(noise), axis=1))
    exact = weights @ drawn / weights.sum()
    spread = (drawn - exact).T @ ((drawn - exact) * weights[:, None]) / weights.sum()
    unit = np.sqrt(np.diag(spread))
    extended = extended_update(MEAN, prior, z, noise, see)
    unscented = unscented_update(MEAN, prior, z, noise, see)
    off = [np.abs((found.mean - exact) / unit).max() for found in (extended, unscented)]
    assert off[1] < 0.8 * off[0]
    assert np.linalg.eigvalsh(unscented.covariance).min() > 0
    # A jacobian by hand gives what differences give.
    r2 = MEAN[0] ** 2 + MEAN[1] ** 2
    by_hand = np.array([[30 / np.sqrt(r2), 40 / np.sqrt(r2), 0], [-40 / r2, 30 / r2, 0]])
    np.testing.assert_allclose(
        extended_update(MEAN, prior, z, noise, see, lambda s: by_hand).mean, extended.mean, atol=1e-7
    )


def test_a_known_state_learns_nothing():
    found = unscented_update(MEAN, np.zeros((3, 3)), np.array([1.0]), np.eye(1), lambda s: s[:, :1])
    np.testing.assert_array_equal(found.mean, MEAN)
    assert found.d2 == pytest.approx(29.0**2)
    assert found.log_likelihood == pytest.approx(-0.5 * 29.0**2)
