"""The bootstrap filter against the exact Kalman filter, and its behaviour where evidence fails."""

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.motion.models import linear_gaussian
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.graph import spec
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.resampling import SCHEMES

BOX = np.array([160.0, 120.0, 60.0, 50.0])
SD = np.array([4.0, 6.0, 2.0])  # of the measured x, y, w
TIMES = [1.0, 1.0, 2.0, 0.5, 1.0, 1.0, 1.5, 1.0]


def measurements(motion, seed, times):
    """(T, 3) measured x, y, w of one target that moves as the model says."""
    rng = np.random.default_rng(seed)
    state, measured = motion.start(BOX, 1, rng), []
    for dt in times:
        state = motion.propagate(state, dt, rng)
        measured.append(state[0, :3] + rng.normal(size=3) * SD)
    return np.array(measured)


def kalman(motion, measured, times):
    """Exact mean, covariance and summed log-evidence of the same model."""
    size = len(motion.fields)
    mean = np.r_[BOX, np.zeros(size - 4)]
    cov = np.diag(np.r_[np.zeros(4), np.repeat(np.square(motion.start_sd), 2)])
    observe, noise, log_evidence = np.eye(3, size), np.diag(SD**2), 0.0
    for z, dt in zip(measured, times, strict=True):
        moves, spread = linear_gaussian(motion, dt)
        mean, cov = moves @ mean, moves @ cov @ moves.T + spread
        innovation, s = z - observe @ mean, observe @ cov @ observe.T + noise
        log_evidence -= 0.5 * (innovation @ np.linalg.solve(s, innovation))
        log_evidence -= 0.5 * np.linalg.slogdet(2 * np.pi * s)[1]
        gain = cov @ observe.T @ np.linalg.inv(s)
        mean, cov = mean + gain @ innovation, cov - gain @ observe @ cov
    return mean, cov, log_evidence


def gaussian_evidence(z):
    def evaluate(hypotheses, log_prior):
        away = (hypotheses.boxes[:, :3] - z) / SD
        return Evidence(-0.5 * np.sum(away**2, axis=1) - np.sum(np.log(SD * np.sqrt(2 * np.pi))))

    return evaluate


def run(settings, motion, measured, times, seed, stream_of):
    """Posterior, summed log-evidence and every step."""
    belief = ParticleFilter(settings)
    now = belief.start(BOX, motion, stream_of(seed, 0))
    total, steps = 0.0, []
    for frame, (z, dt) in enumerate(zip(measured, times, strict=True), start=1):
        step = belief.step(now, motion, dt, gaussian_evidence(z), stream_of(seed, frame))
        now, total = step.posterior, total + step.log_evidence
        steps.append(step)
        assert step.degenerate is None
    return now, total, steps


def check_against_kalman(settings, motion, stream_of):
    """Errors of several seeds, on measurements drawn from the model.

    A frame's weighted mean has the variance P / ESS and its log-evidence 1 / ESS. If each frame's error were
    kept to the end without growing, the variances there would be the sum of these over the frames; that root
    is the unit here. Errors are mostly forgotten, but may first grow, the predicted mean being off by many
    sds of a frame's evidence: hence 1.5 units for mean and covariance and 3 for the evidence, which collects
    them all. An error of the model itself (a wrong Q, a missing constant) is many times larger.
    """
    measured = measurements(motion, 99, TIMES)
    exact_mean, exact_cov, exact_log = kalman(motion, measured, TIMES)
    sd = np.sqrt(exact_cov.diagonal())
    errors, spreads, logs, variances = [], [], [], []
    for seed in range(6):
        belief, total, steps = run(settings, motion, measured, TIMES, seed, stream_of)
        errors.append((belief.weights.weights @ belief.states - exact_mean) / sd)
        spreads.append((belief.covariance - exact_cov) / np.outer(sd, sd))
        logs.append(total - exact_log)
        variances.append(sum(1 / step.posterior.weights.ess for step in steps))
        resampled = sum(np.ptp(step.prior.log) == 0 for step in steps)
        assert resampled > 0
        assert (resampled < len(TIMES)) == isinstance(settings.when, spec.EssBelow)
    root = np.sqrt(np.mean(variances))
    assert root < 0.25
    assert np.sqrt(np.mean(np.square(errors))) < 1.5 * root
    assert np.sqrt(np.mean(np.square(spreads))) < 1.5 * root
    assert np.sqrt(np.mean(np.square(logs))) < 3 * root
    # Errors of different seeds are independent, so their mean shrinks by sqrt(6): a bias would stay.
    assert np.abs(np.mean(errors, axis=0)).max() < 3 * 1.5 * root / np.sqrt(6)


def test_every_motion_model_agrees_with_kalman(linear, stream_of):
    check_against_kalman(spec.Particles(size=2000), linear, stream_of)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_scheme_agrees_with_kalman_when_triggered_by_ess(scheme, motion_of, stream_of):
    settings = spec.Particles(size=2000, resample=scheme, when=spec.EssBelow(ess_below=0.3))
    check_against_kalman(settings, motion_of("constant_velocity"), stream_of)


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        spec.Particles(size=60),
        spec.Particles(size=60, resample="multinomial", when=spec.EssBelow(ess_below=0.5)),
        spec.Particles(size=60, resample="multinomial"),
    ],
)
def test_evidence_is_unbiased_in_the_natural_scale(settings, motion_of, stream_of):
    motion, times = motion_of("damped_velocity"), [1.0, 2.0, 1.0]
    measured = measurements(motion, 5, times)
    exact = kalman(motion, measured, times)[2]
    ratios = np.exp([run(settings, motion, measured, times, s, stream_of)[1] - exact for s in range(700)])
    assert abs(ratios.mean() - 1) < 4 * ratios.std() / np.sqrt(ratios.size)
    assert ratios.std() / np.sqrt(ratios.size) < 0.03


def test_without_evidence_the_belief_is_the_prior(linear, stream_of):
    """When no agent is active every hypothesis keeps its prior weight, resampled or not."""
    for when in ("every_frame", spec.EssBelow(ess_below=0.2)):
        belief = ParticleFilter(spec.Particles(size=50, when=when))
        start = belief.start(BOX, linear, stream_of(1, 0))
        weighted = LogWeights.normalise(np.linspace(-1, 0, 50))[0]
        start = type(start)(start.states, start.fields, weighted)
        step = belief.step(start, linear, 1.0, lambda h, b: Evidence(np.zeros(len(h))), stream_of(1, 1))
        np.testing.assert_allclose(step.posterior.weights.log, step.prior.log, atol=1e-12)
        expected = LogWeights.uniform(50) if when == "every_frame" else weighted
        np.testing.assert_array_equal(step.prior.log, expected.log)
        assert step.log_evidence == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("fault", [-np.inf, np.nan, np.inf])
def test_degenerate_evidence_keeps_the_prior_and_says_why(fault, linear, stream_of):
    belief = ParticleFilter(spec.Particles(size=40, when=spec.EssBelow(ess_below=0.1)))
    start = belief.start(BOX, linear, stream_of(2, 0))
    half_dead = np.r_[np.full(20, -np.inf), np.zeros(20)]
    start = type(start)(start.states, start.fields, LogWeights.normalise(half_dead)[0])
    bad = np.full(40, -np.inf) if fault == -np.inf else np.r_[fault, np.zeros(39)]
    step = belief.step(start, linear, 1.0, lambda h, b: Evidence(bad), stream_of(2, 1))
    assert step.degenerate is not None and "log-weights" in step.degenerate
    assert step.log_evidence == -np.inf
    np.testing.assert_array_equal(step.posterior.weights.log, step.prior.log)
    assert np.all(np.isfinite(step.map_state))


def test_evidence_only_where_the_prior_is_zero_is_degenerate(motion_of, stream_of):
    motion = motion_of("random_walk")
    belief = ParticleFilter(spec.Particles(size=4, when=spec.EssBelow(ess_below=0.1)))
    start = belief.start(BOX, motion, stream_of(3, 0))
    start = type(start)(start.states, start.fields, LogWeights.normalise(np.array([0, 0, 0, -np.inf]))[0])
    only_last = np.array([-np.inf, -np.inf, -np.inf, 0.0])
    step = belief.step(start, motion, 1.0, lambda h, b: Evidence(only_last), stream_of(3, 1))
    assert step.degenerate is not None


def test_a_step_is_a_function_of_its_stream(linear, stream_of):
    belief = ParticleFilter(spec.Particles(size=30))
    start = belief.start(BOX, linear, stream_of(4, 0))
    steps = [belief.step(start, linear, 1.0, gaussian_evidence(BOX[:3]), stream_of(4, 1)) for _ in range(2)]
    np.testing.assert_array_equal(steps[0].posterior.states, steps[1].posterior.states)
    assert steps[0].log_evidence == steps[1].log_evidence


def test_hypotheses_carry_the_further_fields(motion_of, stream_of):
    motion = motion_of("constant_velocity")
    start = ParticleFilter(spec.Particles(size=30)).start(BOX, motion, stream_of(4, 0))
    assert len(start) == 30
    np.testing.assert_array_equal(start.hypotheses.boxes, np.tile(BOX, (30, 1)))
    assert set(start.hypotheses.fields) == {"vx", "vy"}
    np.testing.assert_array_equal(start.hypotheses.fields["vy"], start.states[:, 5])


def test_a_changed_size_is_reached_by_resampling(motion_of, stream_of):
    motion = motion_of("random_walk")
    start = ParticleFilter(spec.Particles(size=30)).start(BOX, motion, stream_of(4, 0))
    step = ParticleFilter(spec.Particles(size=70)).step(
        start, motion, 1.0, gaussian_evidence(BOX[:3]), stream_of(4, 1)
    )
    assert len(step.posterior) == 70
