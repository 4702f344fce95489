"""The Gaussian belief against closed forms, its relatives and itself."""

import numpy as np
import pytest
from scipy import stats

from bayesnet_track.belief.contract import BOX_FIELDS, Evidence
from bayesnet_track.belief.gaussian.belief import GaussianFilter, GaussianPosterior, predict
from bayesnet_track.belief.gaussian.rows import take
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.composed import Lasting, Nested
from bayesnet_track.belief.motion.models import linear_gaussian
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.graph import spec
from bayesnet_track.observation.cue import Measurement

BOX = np.array([160.0, 120.0, 60.0, 50.0])
TIMES = [1.0, 1.0, 2.0, 0.5, 1.0, 3.0, 1.5, 1.0]
MEASURED = ("x", "y", "w")
R = np.array([[16.0, 3.0, 0.0], [3.0, 36.0, 1.0], [0.0, 1.0, 4.0]])
SHARP = spec.Unscented(alpha=1e-3, beta=2.0, kappa=0.0)
FILTERS = [
    spec.Gaussian(filter="kalman", gate=1),
    spec.Gaussian(filter="extended", gate=1),
    spec.Gaussian(filter="unscented", gate=1),
    spec.Gaussian(filter="unscented", gate=1, sigma=SHARP),
]


def measurements(motion, seed, times, noise=R):
    """(T, 3) measured x, y, w of one target that moves as the model says, and its (T, D) states."""
    rng = np.random.default_rng(seed)
    state, measured, states = motion.start(BOX, 1, rng), [], []
    for dt in times:
        state = motion.propagate(state, dt, rng)
        states.append(state[0])
        measured.append(rng.multivariate_normal(state[0, :3], noise))
    return np.array(measured), np.array(states)


def gaussian_messages(measured, also=None):
    """Evidence of one agent that measured, as the net hands it to a belief, and of `also` that scored."""

    def evaluate(hypotheses, log_prior):
        away = hypotheses.boxes[:, :3] - measured
        own = -0.5 * np.einsum("nk,nk->n", away @ np.linalg.inv(R), away)
        rest = np.zeros(len(hypotheses)) if also is None else also(hypotheses)
        messages = {"a": own} if also is None else {"a": own, "b": rest}
        gaussians = {"a": Measurement(MEASURED, measured, R)}
        return Evidence(own + rest, messages, gaussians=gaussians, sampled=rest)

    return evaluate


def likelihood(log_likelihood):
    return lambda hypotheses, log_prior: Evidence(
        log_likelihood(hypotheses), {"a": log_likelihood(hypotheses)}
    )


def quadratic(hypotheses, at=(162.0, 117.0), sd=(5.0, 7.0)):
    return -0.5 * np.sum(((hypotheses.boxes[:, :2] - at) / sd) ** 2, axis=1)


def reference(motion, measured, times):
    """Mean, covariance and log-evidence (of messages whose peak is 1) by the batch form.

    All states of the run are one Gaussian vector, conditioned on all measurements at once: nothing in it is
    recursive, so that it shares no step with a filter.
    """
    size, steps = len(motion.fields), len(times)
    mean, start = motion.start_moments(BOX)
    transfer, spreads = [], [start]
    for dt in times:
        moves, spread = linear_gaussian(motion, dt)
        transfer.append(moves)
        spreads.append(spread)
    # x_k = sum_j A_kj e_j with e_0 the start and e_j the noise of step j.
    rows = np.zeros((steps, size, (steps + 1) * size))
    now = np.zeros((size, (steps + 1) * size))
    now[:, :size] = np.eye(size)
    for k, moves in enumerate(transfer):
        now = moves @ now
        now[:, (k + 1) * size : (k + 2) * size] = np.eye(size)
        rows[k] = now
    joint = np.zeros(((steps + 1) * size,) * 2)
    for j, spread in enumerate(spreads):
        joint[j * size : (j + 1) * size, j * size : (j + 1) * size] = spread
    seen = rows[:, :3].reshape(3 * steps, -1)
    expected = seen @ np.r_[mean, np.zeros(steps * size)]
    s = seen @ joint @ seen.T + np.kron(np.eye(steps), R)
    cross = rows[-1] @ joint @ seen.T
    away = measured.ravel() - expected
    log = stats.multivariate_normal(expected, s).logpdf(measured.ravel())
    log += 0.5 * steps * np.linalg.slogdet(2 * np.pi * R)[1]
    at = rows[-1] @ np.r_[mean, np.zeros(steps * size)]
    return (
        at + cross @ np.linalg.solve(s, away),
        rows[-1] @ joint @ rows[-1].T - cross @ np.linalg.solve(s, cross.T),
        log,
    )


def run(belief, motion, evaluates, times, stream_of, seed=0):
    """The last posterior, the summed log-evidence and every step."""
    now, total, steps = belief.start(BOX, motion, stream_of(seed, 0)), 0.0, []
    for frame, (evaluate, dt) in enumerate(zip(evaluates, times, strict=True), start=1):
        steps.append(belief.step(now, motion, dt, evaluate, stream_of(seed, frame)))
        now, total = steps[-1].posterior, total + steps[-1].log_evidence
    return now, total, steps


# ------------------------------------------------------------------------------------ exactness


@pytest.mark.parametrize("settings", FILTERS, ids=["kalman", "extended", "unscented", "unscented-sharp"])
def test_every_filter_is_exact_for_every_linear_motion(settings, linear, stream_of):
    measured, _ = measurements(linear, 4, TIMES)
    mean, covariance, log = reference(linear, measured, TIMES)
    now, total, _ = run(
        GaussianFilter(settings), linear, [gaussian_messages(z) for z in measured], TIMES, stream_of
    )
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(now.mean / sd, mean / sd, atol=1e-8)
    np.testing.assert_allclose(now.covariance / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=1e-9)
    # The weights of sigma points grow with 1 / alpha², and rounding with them.
    is_sharp = settings.filter == "unscented" and settings.sigma.alpha < 0.01
    assert total == pytest.approx(log, abs=1e-7 if is_sharp else 1e-8)


def test_a_random_walk_is_the_scalar_filter(motion_of, stream_of):
    """p' = (p + q) r / (p + q + r), by hand."""
    motion = motion_of("random_walk", sd_px={"x": 2.0})
    mean, variance, now = 160.0, 0.0, None
    belief = GaussianFilter(spec.Gaussian(filter="kalman"))
    now = belief.start(BOX, motion, stream_of(0, 0))
    for frame, z in enumerate([161.0, 164.0, 158.5], start=1):
        message = Measurement(("x",), np.array([z]), np.array([[9.0]]))
        step = belief.step(
            now,
            motion,
            1.5,
            lambda h, p, m=message: Evidence(np.zeros(len(h)), gaussians={"a": m}, sampled=np.zeros(len(h))),
            stream_of(0, frame),
        )
        variance += 1.5 * 4.0
        gain = variance / (variance + 9.0)
        log = 0.5 * np.log(9.0 / (variance + 9.0)) - 0.5 * (z - mean) ** 2 / (variance + 9.0)
        mean, variance = mean + gain * (z - mean), (1 - gain) * variance
        now = step.posterior
        assert now.mean == pytest.approx(np.r_[mean, BOX[1:]])
        assert np.diag(now.covariance) == pytest.approx([variance, 0, 0, 0])
        assert step.log_evidence == pytest.approx(log)


@pytest.mark.parametrize("likelihood_by", ["samples", "sigma_points"])
def test_likelihoods_are_no_evidence_of_the_errors_of_cameras(motion_of, stream_of, likelihood_by):
    """The errors' marginal is that of the prediction, whatever samples say, and the covariance is one."""
    errors = (Lasting("view.x", 5.0, 50.0, True), Lasting("view.y", 5.0, 50.0, True))
    motion = Nested(motion_of("constant_velocity"), errors)
    belief = GaussianFilter(spec.Gaussian(likelihood=likelihood_by))
    mean, covariance = motion.start_moments(BOX)
    covariance = covariance + np.diag(np.r_[np.full(len(mean) - 2, 16.0), 0.0, 0.0])
    covariance[[0, -2], [-2, 0]] = covariance[
        [1, -1], [-1, 1]
    ] = -15.0  # it was seen where the camera shows it
    prior = belief.start(BOX, motion, stream_of(0, 0))
    prior = GaussianPosterior(mean, covariance, prior.fields, prior.size)

    def log_density(hypotheses):
        centres = hypotheses.boxes[:, :2] + np.stack(
            [hypotheses.fields[f"view.{axis}"] for axis in "xy"], axis=1
        )
        return -0.5 * (((centres - [170.0, 112.0]) / 3.0) ** 2).sum(axis=1)

    for seed in range(20):
        posterior = belief.step(prior, motion, 1.0, likelihood(log_density), stream_of(seed, 1)).posterior
        predicted = belief.predict(prior, motion, 1.0, np.random.default_rng(0))
        np.testing.assert_allclose(posterior.mean[-2:], predicted.mean[-2:], atol=1e-12)
        np.testing.assert_allclose(posterior.covariance[-2:, -2:], predicted.covariance[-2:, -2:], rtol=1e-12)
        assert np.linalg.eigvalsh(posterior.covariance)[0] > -1e-9
        assert posterior.mean[0] > predicted.mean[0] + 1.0

    # What the errors are learnt from is the belief as it would be without likelihoods, in every later frame
    scored = unscored = prior
    for seed, measured in enumerate([(164.0, 118.0, 61.0), (167.0, 121.0, 59.0), (165.0, 117.0, 60.0)]):
        also = log_density if seed != 1 else None
        step = belief.step(scored, motion, 1.0, gaussian_messages(measured, also), stream_of(seed, 2))
        scored = step.posterior
        unscored = belief.step(
            unscored, motion, 1.0, gaussian_messages(measured), stream_of(seed, 2)
        ).posterior
        assert unscored.measured is None
        np.testing.assert_allclose(scored.measured[0], unscored.mean, rtol=1e-12)
        np.testing.assert_allclose(scored.measured[1], unscored.covariance, rtol=1e-9, atol=1e-12)
        assert abs(scored.mean[0] - unscored.mean[0]) > 0.1


def test_two_messages_are_one_of_both(motion_of):
    """Updates one after the other, in either order, equal the joint one; the evidences add up."""
    motion = motion_of("constant_velocity")
    mean, covariance = predict(*motion.start_moments(BOX), motion, 1.0, spec.Gaussian())
    first = Measurement(("x", "y"), np.array([163.0, 119.0]), np.array([[9.0, 2.0], [2.0, 4.0]]))
    second = Measurement(("y", "w"), np.array([123.0, 61.0]), np.diag([16.0, 1.0]))
    one = take(mean, covariance, motion.fields, {"a": first, "b": second}, 1.0)
    other = take(mean, covariance, motion.fields, {"b": second, "a": first}, 1.0)
    observe = np.eye(len(mean))[[0, 1, 1, 2]]
    noise = np.zeros((4, 4))
    noise[:2, :2], noise[2:, 2:] = first.covariance, second.covariance
    s = observe @ covariance @ observe.T + noise
    away = np.r_[first.mean, second.mean] - observe @ mean
    gain = np.linalg.solve(s, observe @ covariance).T
    log = 0.5 * (np.linalg.slogdet(noise)[1] - np.linalg.slogdet(s)[1] - away @ np.linalg.solve(s, away))
    for found in (one, other):
        np.testing.assert_allclose(found.mean, mean + gain @ away, atol=1e-10)
        np.testing.assert_allclose(found.covariance, covariance - gain @ observe @ covariance, atol=1e-10)
        assert found.log_evidence == pytest.approx(log)


@pytest.mark.slow
def test_choices_give_the_moments_of_the_mixture(motion_of):
    motion = motion_of("constant_velocity", sd_velocity_px=1)
    mean, covariance = motion.start_moments(np.array([50.0, 60, 20, 30]))
    covariance = covariance + 4.0 * np.eye(len(mean))
    places = (52.0, 60.0), (44.0, 61.0)
    one, other = (Measurement(("x", "y"), np.array(at), 9.0 * np.eye(2)) for at in places)
    several = Measurement(("x", "y"), one.mean, one.covariance, 0.0, ((0.6, one), (0.3, other)))
    found = take(mean, covariance, motion.fields, {"a": several}, 0.5)  # such a gate would turn one away
    parts = [(0.1, mean, covariance)]
    for weight, single in several.choices:
        after = take(mean, covariance, motion.fields, {"a": single}, 1.0)
        parts.append((weight, after.mean, after.covariance))
    centre = sum(weight * m for weight, m, _ in parts)
    spread = sum(weight * (p + np.outer(m - centre, m - centre)) for weight, m, p in parts)
    np.testing.assert_allclose(found.mean, centre, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, spread, rtol=1e-9, atol=1e-9)
    assert not found.gated


@pytest.mark.parametrize("steps", [1_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_covariance_stays_positive_over_a_long_run(motion_of, steps):
    """With measurements a thousand times sharper than the prediction, and long gaps."""
    motion = motion_of("constant_acceleration")
    mean, covariance = motion.start_moments(BOX)
    settings = spec.Gaussian(filter="kalman", gate=1)
    one = {"a": Measurement(("x", "y"), BOX[:2], np.diag([1e-4, 1e-4]))}
    least = np.inf
    for k in range(steps):
        mean, covariance = predict(mean, covariance, motion, 50.0 if k % 1000 == 0 else 1.0, settings)
        if k % 10 < 8:
            found = take(mean, covariance, motion.fields, one, 1.0)
            mean, covariance = found.mean, found.covariance
        if k % 500 < 12:
            sd = np.sqrt(np.diag(covariance))
            least = min(least, float(np.linalg.eigvalsh(covariance / np.outer(sd, sd))[0]))
            assert np.array_equal(covariance, covariance.T)
    assert least > 0
    assert np.isfinite(mean).all()


def test_log_evidence_is_that_of_particles(motion_of, stream_of):
    """Particles see the same message as a likelihood: sum beta L, for 100,000 of them."""
    motion, times = motion_of("constant_velocity"), TIMES[:4]
    measured, _ = measurements(motion, 8, times)
    evaluates = [gaussian_messages(z) for z in measured]
    exact, _, _ = run(GaussianFilter(FILTERS[0]), motion, evaluates, times, stream_of)
    total = run(GaussianFilter(FILTERS[0]), motion, evaluates, times, stream_of)[1]
    cloud, estimated, steps = run(
        ParticleFilter(spec.Particles(size=100_000)), motion, evaluates, times, stream_of
    )
    # The log-evidence of a frame has the variance 1 / ESS; 4 of the root of their sum, doubled for errors
    # handed on from frame to frame.
    sd = np.sqrt(sum(1 / step.posterior.weights.ess for step in steps))
    assert abs(estimated - total) < 8 * sd < 0.2
    unit = np.sqrt(np.diag(exact.covariance))
    np.testing.assert_allclose(cloud.mean / unit, exact.mean / unit, atol=8 * sd)
    ratio = cloud.covariance / np.outer(unit, unit) - exact.covariance / np.outer(unit, unit)
    np.testing.assert_allclose(ratio, 0, atol=12 * sd)


# ------------------------------------------------------------------------------------ consistency and gate


def test_errors_are_as_large_as_the_covariance_says(linear, stream_of):
    """NEES and NIS over 60 runs lie in the central 99.9 % of their chi-squares.

    Over the directions in which the state varies: runs start in a known box.
    """
    belief = GaussianFilter(FILTERS[0])
    nees, nis = [], []
    for seed in range(60):
        measured, states = measurements(linear, 100 + seed, TIMES[:5])
        now = belief.start(BOX, linear, stream_of(seed, 0))
        for frame, (z, dt) in enumerate(zip(measured, TIMES[:5], strict=True), start=1):
            step = belief.step(now, linear, dt, gaussian_messages(z), stream_of(seed, frame))
            mean, covariance = predict(now.mean, now.covariance, linear, dt, FILTERS[0])
            innovation = z - mean[:3]
            nis.append(innovation @ np.linalg.solve(covariance[:3, :3] + R, innovation))
            now = step.posterior
        error = now.mean - states[-1]
        nees.append(error @ np.linalg.solve(now.covariance, error))
    for values, degrees in ((nees, len(linear.fields)), (nis, 3)):
        low, high = stats.chi2.ppf([0.0005, 0.9995], degrees * len(values))
        assert low < sum(values) < high


@pytest.mark.slow
@pytest.mark.parametrize("gate", [0.9, 0.99])
def test_the_gate_turns_away_its_share_of_right_measurements(gate, motion_of):
    """Of 3000 independent measurements; binomial, 4 sds."""
    motion, rng = motion_of("damped_velocity"), np.random.default_rng(2)
    mean, covariance = predict(*motion.start_moments(BOX), motion, 1.0, spec.Gaussian())
    away = rng.multivariate_normal(np.zeros(3), covariance[:3, :3] + R, 3000)
    refused = sum(
        len(take(mean, covariance, motion.fields, {"a": Measurement(MEASURED, mean[:3] + v, R)}, gate).gated)
        for v in away
    )
    assert abs(refused - 3000 * (1 - gate)) < 4 * np.sqrt(3000 * gate * (1 - gate))


def test_a_gated_measurement_is_told_and_leaves_the_prediction(motion_of, stream_of):
    motion = motion_of("constant_velocity")
    belief = GaussianFilter(spec.Gaussian(filter="kalman", gate=0.99))
    start = belief.start(BOX, motion, stream_of(0, 0))
    far = belief.step(start, motion, 1.0, gaussian_messages(np.array([260.0, 20.0, 60.0])), stream_of(0, 1))
    mean, covariance = predict(start.mean, start.covariance, motion, 1.0, belief.settings)
    np.testing.assert_allclose(far.posterior.mean, mean)
    np.testing.assert_allclose(far.posterior.covariance, covariance)
    np.testing.assert_allclose(far.support.weights.log, far.prior.log)
    assert far.log_evidence == pytest.approx(0.0, abs=1e-12)
    (report,) = far.reports
    event = report(7, "1")
    s = covariance[:3, :3] + R
    d2 = (np.array([260.0, 20.0, 60.0]) - mean[:3]) @ np.linalg.solve(
        s, np.array([260.0, 20.0, 60.0]) - mean[:3]
    )
    assert (event.frame, event.target, event.node, event.used, event.degrees) == (7, "1", "a", 0, 3)
    assert event.d2 == pytest.approx(d2)
    assert event.limit == pytest.approx(stats.chi2.ppf(0.99, 3))
    assert event.turning == pytest.approx(stats.chi2.cdf(d2, 3))
    near = belief.step(start, motion, 1.0, gaussian_messages(mean[:3]), stream_of(0, 1))
    assert near.reports == ()


def test_gates_do_not_depend_on_the_order_of_agents(motion_of):
    """Each is compared with the prediction, not with what the agents before it made of it."""
    motion = motion_of("random_walk")
    mean, covariance = predict(*motion.start_moments(BOX), motion, 4.0, spec.Gaussian())
    there = {
        "a": Measurement(("x",), mean[:1] + 9.0, np.array([[1.0]])),
        "b": Measurement(("x",), mean[:1] - 9.0, np.array([[1.0]])),
    }
    for order in (["a", "b"], ["b", "a"]):
        found = take(mean, covariance, motion.fields, {name: there[name] for name in order}, 0.9)
        assert set(found.used) == {"a", "b"} and not found.gated


# ------------------------------------------------------------------------------------ sampled likelihoods


def exact_after(motion, dt=1.0):
    """The belief after one frame of `quadratic`, exactly."""
    mean, covariance = predict(*motion.start_moments(BOX), motion, dt, spec.Gaussian())
    message = Measurement(("x", "y"), np.array([162.0, 117.0]), np.diag([25.0, 49.0]))
    return take(mean, covariance, motion.fields, {"a": message}, 1.0)


def errors_of(samples, motion, stream_of, seeds):
    """Errors of mean, covariance (in units of the exact sds) and log-evidence over seeds."""
    exact = exact_after(motion)
    sd = np.sqrt(np.diag(exact.covariance))
    belief = GaussianFilter(spec.Gaussian(samples=samples))
    start = belief.start(BOX, motion, stream_of(0, 0))
    means, spreads, logs = [], [], []
    for seed in range(seeds):
        step = belief.step(start, motion, 1.0, likelihood(quadratic), stream_of(seed, 1))
        means.append((step.posterior.mean - exact.mean) / sd)
        spreads.append((step.posterior.covariance - exact.covariance) / np.outer(sd, sd))
        logs.append(step.log_evidence - exact.log_evidence)
    return np.array(means), np.array(spreads), np.array(logs)


def test_moments_of_samples_approach_the_exact_ones_as_one_over_the_root_of_their_number(linear, stream_of):
    """Sixteen times the samples, a quarter of the error; each rms of 60 runs is known to 10 %."""
    few, many = (errors_of(n, linear, stream_of, 60) for n in (100, 1600))
    for coarse, fine in zip(few, many, strict=True):
        ratio = np.sqrt(np.mean(coarse**2) / np.mean(fine**2))
        # 4 by theory; the covariance's floor, 1 / N, and the fewest samples make it larger by a little.
        assert 4 / 1.4 < ratio < 4 * 1.8
    # The weights' variance, 1 / ESS - 1 / N, is below 2 / N for this likelihood.
    assert np.sqrt(np.mean(many[0] ** 2)) < 2 * np.sqrt(2 / 1600)
    # The bias is of the order 1 / N: the mean over runs stays within 4 of its own error and 8 / N.
    for values in (many[0], many[1]):
        assert np.all(np.abs(values.mean(axis=0)) < 4 * values.std(axis=0) / np.sqrt(60) + 8 / 1600 + 1e-9)


def test_a_sampled_likelihood_joins_a_measurement(motion_of, stream_of):
    """Likelihood first, then Kalman: the same as both as Gaussian messages."""
    motion = motion_of("constant_velocity")
    z = np.array([158.0, 124.0, 59.0])
    sampled = exact_after(motion)
    exact = take(sampled.mean, sampled.covariance, motion.fields, {"a": Measurement(MEASURED, z, R)}, 1.0)
    belief = GaussianFilter(spec.Gaussian(samples=20_000, gate=1))
    start = belief.start(BOX, motion, stream_of(0, 0))
    step = belief.step(start, motion, 1.0, gaussian_messages(z, quadratic), stream_of(3, 1))
    sd = np.sqrt(np.diag(exact.covariance))
    bound = 5 * np.sqrt(2 / 20_000)
    np.testing.assert_allclose(step.posterior.mean / sd, exact.mean / sd, atol=bound)
    np.testing.assert_allclose(
        step.posterior.covariance / np.outer(sd, sd), exact.covariance / np.outer(sd, sd), atol=2 * bound
    )
    assert step.log_evidence == pytest.approx(sampled.log_evidence + exact.log_evidence, abs=2 * bound)
    # Its weighted hypotheses are the posterior, too.
    weights = step.support.weights
    np.testing.assert_allclose(
        (weights.weights @ step.support.states) / sd, exact.mean / sd, atol=5 / np.sqrt(weights.ess)
    )


def test_sigma_points_are_exact_for_a_gaussian_likelihood_along_the_axes(linear, stream_of):
    exact = exact_after(linear)
    belief = GaussianFilter(spec.Gaussian(likelihood="sigma_points"))
    start = belief.start(BOX, linear, stream_of(0, 0))
    step = belief.step(start, linear, 1.0, likelihood(quadratic), stream_of(0, 1))
    np.testing.assert_allclose(step.posterior.mean, exact.mean, atol=1e-9)
    np.testing.assert_allclose(step.posterior.covariance, exact.covariance, atol=1e-9)
    assert step.log_evidence == pytest.approx(exact.log_evidence)
    assert len(step.support.states) == len(step.posterior) == 2 * len(linear.fields) + 1


def test_sigma_points_of_a_narrow_likelihood_with_a_floor_err_on_the_wide_side(motion_of, stream_of):
    motion = motion_of("constant_velocity")
    belief = GaussianFilter(spec.Gaussian(likelihood="sigma_points"))
    start = belief.start(BOX, motion, stream_of(0, 0))

    def narrow(hypotheses):
        away = hypotheses.boxes[:, :2] - BOX[:2]
        return np.logaddexp(np.log(0.02), np.log(0.98) - 0.5 * np.sum(away**2, axis=1))

    step = belief.step(start, motion, 1.0, likelihood(narrow), stream_of(0, 1))
    mean, covariance = predict(start.mean, start.covariance, motion, 1.0, belief.settings)
    assert 1.0 < step.posterior.covariance[0, 0] < covariance[0, 0]
    np.testing.assert_allclose(step.posterior.mean, mean, atol=1e-9)


@pytest.mark.parametrize("choice", ["samples", "sigma_points"])
def test_a_flat_likelihood_changes_nothing(choice, linear, stream_of):
    belief = GaussianFilter(spec.Gaussian(likelihood=choice))
    start = belief.start(BOX, linear, stream_of(0, 0))
    step = belief.step(start, linear, 2.0, likelihood(lambda h: np.full(len(h), -3.0)), stream_of(0, 1))
    mean, covariance = predict(start.mean, start.covariance, linear, 2.0, belief.settings)
    np.testing.assert_allclose(step.posterior.mean, mean, atol=1e-12)
    np.testing.assert_allclose(step.posterior.covariance, covariance, atol=1e-12)
    assert step.log_evidence == pytest.approx(-3.0)
    # Its hypotheses have the prediction's moments exactly.
    weights = step.support.weights.weights
    np.testing.assert_allclose(weights @ step.support.states, mean, atol=1e-9)


def test_one_hypothesis_moves_the_mean_and_leaves_the_spread(motion_of, stream_of):
    """Effective sample size 1: nothing is known of the spread, so it must not collapse."""
    motion = motion_of("constant_velocity")
    belief = GaussianFilter(spec.Gaussian(samples=100))
    start = belief.start(BOX, motion, stream_of(0, 0))
    _, covariance = predict(start.mean, start.covariance, motion, 1.0, belief.settings)
    for dead in (-np.inf, -1e6):

        def spike(hypotheses, dead=dead):
            log = np.full(len(hypotheses), dead)
            log[17] = 0.0
            return log

        step = belief.step(start, motion, 1.0, likelihood(spike), stream_of(0, 1))
        np.testing.assert_allclose(step.posterior.mean, step.support.states[17])
        np.testing.assert_allclose(step.posterior.covariance, covariance)
        assert step.support.weights.ess == pytest.approx(1.0)


@pytest.mark.parametrize("value", [-np.inf, np.nan])
@pytest.mark.parametrize("choice", ["samples", "sigma_points"])
def test_evidence_that_cannot_be_used_keeps_the_prediction(value, choice, motion_of, stream_of):
    motion = motion_of("damped_velocity")
    belief = GaussianFilter(spec.Gaussian(likelihood=choice))
    start = belief.start(BOX, motion, stream_of(0, 0))
    step = belief.step(start, motion, 1.0, likelihood(lambda h: np.full(len(h), value)), stream_of(0, 1))
    mean, covariance = predict(start.mean, start.covariance, motion, 1.0, belief.settings)
    assert step.degenerate is not None and step.log_evidence == -np.inf
    np.testing.assert_allclose(step.posterior.mean, mean)
    np.testing.assert_allclose(step.posterior.covariance, covariance)
    np.testing.assert_array_equal(step.support.weights.log, step.prior.log)


# ------------------------------------------------------------------------------------ prediction


def test_unscented_and_extended_predict_the_size_in_logarithms(motion_of):
    """Against 200,000 draws of the motion: first order is right for the small steps it is meant for.

    The mean of exp(s), exp(sd^2 / 2), is left out: .08 % for an sd of .04, and the same share of the sd.
    """
    motion = motion_of("random_walk", sd_px={"x": 2.0}, sd_log={"scale": 0.04, "aspect": 0.03})
    start = np.diag([4.0, 4.0, 9.0, 6.0])
    rng = np.random.default_rng(0)
    states = motion.propagate(rng.multivariate_normal(BOX, start, 200_000), 1.0, rng)
    for kind in ("extended", "unscented"):
        mean, covariance = predict(BOX, start, motion, 1.0, spec.Gaussian(filter=kind))
        np.testing.assert_allclose(mean, states.mean(axis=0), rtol=2e-3)
        # A variance of N draws is known to sqrt(2 / N) = .3 %; 4 of it, and 1 % for the order left out.
        np.testing.assert_allclose(np.diag(covariance), states.var(axis=0), rtol=0.025)
        sd = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(
            covariance / np.outer(sd, sd), np.corrcoef(states.T), atol=4 / np.sqrt(200_000) + 0.01
        )


def test_predictions_compose(linear):
    """Two half steps are one: any dt may follow any other."""
    start = linear.start_moments(BOX)
    whole = predict(*start, linear, 3.0, spec.Gaussian())
    halves = predict(*predict(*start, linear, 1.25, spec.Gaussian()), linear, 1.75, spec.Gaussian())
    np.testing.assert_allclose(halves[0], whole[0], atol=1e-9)
    np.testing.assert_allclose(halves[1], whole[1], atol=1e-9)


def test_without_evidence_the_belief_widens_and_stays_where_the_camera_sees(motion_of, stream_of):
    motion = Confined(motion_of("constant_velocity"), 320, 240)
    belief = GaussianFilter(spec.Gaussian())
    now = belief.start(BOX, motion, stream_of(0, 0))
    spread, windows = 0.0, []
    nothing = likelihood(lambda h: np.zeros(len(h)))
    for frame in range(1, 400):
        step = belief.step(now, motion, 1.0, nothing, stream_of(0, frame))
        boxes = step.support.boxes
        assert boxes[:, 0].min() >= 0 and boxes[:, 0].max() <= 319
        assert boxes[:, 1].min() >= 0 and boxes[:, 1].max() <= 239
        assert boxes[:, 2:].min() >= 1
        if frame < 8:  # while the image does not bound it
            assert np.trace(step.posterior.covariance[:2, :2]) > spread
        spread, now = np.trace(step.posterior.covariance[:2, :2]), step.posterior
        windows.append(np.ptp(boxes[:, 0]))
    # Anywhere in the image: uniform over 320 x 240, about a mean inside it.
    assert np.sqrt(now.covariance[0, 0]) <= 320 / np.sqrt(3)
    assert windows[0] < windows[2] < windows[5]
    assert min(windows[20:]) > 250
    assert np.linalg.eigvalsh(now.covariance).min() > 0


def test_hypotheses_span_the_predicted_window(motion_of, stream_of):
    """The search window of the tracking chapter, 3.9: all but a share of the prediction lies inside it."""
    motion = motion_of("constant_velocity")
    belief = GaussianFilter(spec.Gaussian(samples=200))
    start = GaussianPosterior(
        np.r_[BOX, 12.0, -7.0], np.diag([9.0, 9.0, 1.0, 1.0, 4.0, 4.0]), motion.fields, 200
    )
    step = belief.step(start, motion, 2.0, likelihood(lambda h: np.zeros(len(h))), stream_of(0, 1))
    mean, covariance = predict(start.mean, start.covariance, motion, 2.0, belief.settings)
    for k in (0, 1):
        values, sd = step.support.states[:, k], np.sqrt(covariance[k, k])
        # The largest of 100 pairs lies beyond 2 sd with probability 1 - .954^100 = .99.
        assert values.min() < mean[k] - 2 * sd and values.max() > mean[k] + 2 * sd
    assert mean[0] == pytest.approx(BOX[0] + 24.0)


def test_kalman_refuses_what_is_not_linear(motion_of, stream_of):
    motion = motion_of("random_walk", sd_log={"scale": 0.1})
    with pytest.raises(ValueError, match="linear-Gaussian"):
        GaussianFilter(spec.Gaussian(filter="kalman")).start(BOX, Confined(motion, 320, 240), stream_of(0, 0))


def test_the_same_streams_give_the_same_step(motion_of, stream_of):
    motion, belief = motion_of("constant_velocity"), GaussianFilter(spec.Gaussian())
    start = belief.start(BOX, motion, stream_of(0, 0))
    one, two, other = (
        belief.step(start, motion, 1.0, likelihood(quadratic), stream_of(seed, 1)).posterior.mean
        for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, other)


# ------------------------------------------------------------------------------------ what it says


@pytest.fixture
def posterior():
    return GaussianPosterior(
        np.array([10.0, 20.0, 3.0, 5.0]), np.diag([4.0, 9.0, 4.0, 1e-4]), BOX_FIELDS, 200
    )


def test_its_region_is_that_of_the_normal_distribution(posterior):
    for share in (0.5, 0.9):
        z = stats.norm.ppf((1 + share) / 2)
        assert posterior.regions((share,))[0] == pytest.approx(
            (10 - 2 * z, 10 + 2 * z, 20 - 3 * z, 20 + 3 * z)
        )


def test_its_uncertainty_is_about_the_state_asked(posterior):
    assert posterior.uncertainty(posterior.mean, [0, 1]) == pytest.approx(13.0)
    assert posterior.uncertainty(np.array([13.0, 16.0, 0, 0]), [0, 1]) == pytest.approx(13 + 9 + 16)


def test_its_draws_are_its_own(posterior, rng):
    boxes = posterior.draw(20_000, rng)
    assert boxes[:, 2:].min() >= 1
    np.testing.assert_allclose(boxes[:, :2].mean(axis=0), [10, 20], atol=4 * 3 / np.sqrt(20_000))
    np.testing.assert_allclose(boxes[:, :2].std(axis=0), [2, 3], rtol=4 / np.sqrt(2 * 20_000))
