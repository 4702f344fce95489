"""Modes: particles and Gaussians against enumeration of sequences of modes, and against filterpy's IMM."""

from __future__ import annotations

from functools import partial
from itertools import pairwise, product

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.gaussian.modal import ModalFilter
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.forgetting import Forgetting
from bayesnet_track.belief.motion.jumps import Jumping, modal_of
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.motion.modes import FIELD, Modal, make_modes, mode_probabilities
from bayesnet_track.belief.particles.adaptive_size import EVENLY
from bayesnet_track.belief.particles.belief import ParticleFilter, map_index
from bayesnet_track.belief.smoothing import Move, smooth_gaussians, smooth_particles
from bayesnet_track.graph import spec
from bayesnet_track.numerics.gaussian import symmetric
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Measurement
from bayesnet_track.runtime.smoothing import NO_SEARCH

BOX = np.array([60.0, 90.0, 20.0, 20.0])
SD = 4.0
BACKGROUND = 0.02
TWO_SPEEDS = {
    "straight": {"next": {"straight": 0.95, "turn": 0.05}},
    "turn": {"next": {"straight": 0.1, "turn": 0.9}, "motion": {"constant_velocity": {"sd_velocity_px": 3}}},
}
MANOEUVRE_AND_HIDING = {
    "straight": {"mean_frames": 8, "then": {"turn": 2, "behind": 1}},
    "turn": {"mean_frames": 3, "motion": {"constant_velocity": {"sd_velocity_px": 3}}},
    "behind": {"mean_frames": 2, "hidden": {"likelihood": BACKGROUND}},
}


def modal(settings, sd=0.2, start=6.0):
    usual = {"constant_velocity": {"sd_velocity_px": sd, "start_velocity_sd_px": start}}
    modes = {name: spec.Mode.model_validate(one) for name, one in settings.items()}
    walks = {
        name: make_motion(one.motion or spec.Motion.model_validate(usual)) for name, one in modes.items()
    }
    return Modal(make_modes(modes), tuple(walks.values()))


def seen_at(place, motion, measured):
    """A measured centre, whose likelihood has a peak of 1; what is hidden has the background's."""

    def evaluate(hypotheses, prior_log):
        hidden = np.array(motion.modes.hidden)[hypotheses.fields[FIELD].astype(int)]
        near = -0.5 * np.sum(((hypotheses.boxes[:, :2] - place) / SD) ** 2, axis=1)
        log = np.where(hidden, np.log(BACKGROUND), near)
        if not measured:
            return Evidence(log, {"agent": log})
        message = Measurement(("x", "y"), place, SD**2 * np.eye(2))
        rest = np.where(hidden, np.log(BACKGROUND), 0.0)
        return Evidence(log, {"agent": log}, gaussians={"agent": message}, sampled=rest)

    return evaluate


def run(belief, motion, places, stream_of, seed=0, measured=False):
    now = belief.start(BOX, motion, stream_of(seed, 0))
    for frame, place in enumerate(places, start=1):
        step = belief.step(now, motion, 1.0, seen_at(place, motion, measured), stream_of(seed, frame))
        now = step.posterior
        yield step, mode_probabilities(now, len(motion.modes))


def enumerate_sequences(motion, places):
    """Exact, a Kalman filter for each sequence: (mean, covariance, P(mode), log evidence) of each frame."""
    modes, chain = motion.modes, motion.modes.chain.over(1.0)
    mean, covariance = motion.start_moments(BOX)
    live = [(modes.start()[k], mean, covariance, k) for k in range(len(modes))]
    total_before = 0.0
    for place in places:
        after = []
        for (weight, mean, covariance, old), new in product(live, range(len(modes))):
            moves, noise = motion.motions[new].linearise(mean, 1.0)
            m, p = moves @ mean, moves @ covariance @ moves.T + noise
            if modes.hidden[new]:
                likelihood = BACKGROUND
            else:
                s = p[:2, :2] + SD**2 * np.eye(2)
                away = place - m[:2]
                gain = p[:, :2] @ np.linalg.inv(s)
                likelihood = (
                    SD**2 / np.sqrt(np.linalg.det(s)) * np.exp(-0.5 * away @ np.linalg.solve(s, away))
                )
                m, p = m + gain @ away, symmetric(p - gain @ s @ gain.T)
            after.append((weight * chain[old, new] * likelihood, m, p, new))
        live = [one for one in after if one[0] > 0]
        weights = np.array([one[0] for one in live])
        total = np.log(weights.sum())
        weights = weights / weights.sum()
        mean = weights @ np.array([one[1] for one in live])
        spread = sum(
            w * (p + np.outer(m - mean, m - mean)) for w, (_, m, p, _) in zip(weights, live, strict=True)
        )
        shares = np.bincount([one[3] for one in live], weights, minlength=len(modes))
        yield mean, spread, shares, total - total_before
        total_before = total


PLACES = np.array([[66.0, 92.0], [71.0, 95.0], [79.0, 84.0], [120.0, 20.0], [90.0, 70.0]])


@pytest.fixture(scope="module")
def exact():
    motion = modal(MANOEUVRE_AND_HIDING)
    return motion, list(enumerate_sequences(motion, PLACES))


def test_particles_agree_with_enumeration_within_their_error(exact, stream_of):
    """16 runs of 1000: the mean of each number lies within four of its standard errors."""
    motion, frames = exact
    belief = ParticleFilter(spec.Particles(size=1000))
    found = [list(run(belief, motion, PLACES, stream_of, seed)) for seed in range(16)]
    for number, (mean, _, shares, log_evidence) in enumerate(frames):
        steps = [one[number] for one in found]
        rows = np.array(
            [
                [*step.posterior.mean[:2], *probability, np.exp(step.log_evidence)]
                for step, probability in steps
            ]
        )
        error = rows.std(axis=0, ddof=1) / np.sqrt(len(rows))
        # Ratios of sums of N draws are off by a share of 1 / N besides.
        slack = np.array([0.1, 0.1, 0.005, 0.005, 0.005, 0.0])
        wanted = np.array([*mean[:2], *shares, np.exp(log_evidence)])
        assert (np.abs(rows.mean(axis=0) - wanted) < 4 * error + slack).all(), (
            number,
            rows.mean(axis=0),
            wanted,
        )


def test_the_target_is_probably_hidden_where_enumeration_says_so(exact):
    motion, frames = exact
    hidden = [motion.modes.probability_hidden(shares) for _, _, shares, _ in frames]
    assert hidden[3] > 0.9 and hidden[0] < 0.15


def test_gaussians_in_modes_are_exact_in_the_first_frame_and_near_it_later(exact, stream_of):
    """Before the second frame nothing has been mixed that differs; the mixing's error is bounded here."""
    motion, frames = exact
    belief = ModalFilter(spec.Gaussian(filter="kalman", gate=1.0, samples=40), motion.modes)
    for number, (step, shares) in enumerate(run(belief, motion, PLACES, stream_of, measured=True)):
        mean, spread, probabilities, log_evidence = frames[number]
        close = 1e-9 if number == 0 else 0.05
        assert shares == pytest.approx(probabilities, abs=close)
        assert step.log_evidence == pytest.approx(log_evidence, abs=close if number == 0 else 0.1)
        sds = np.sqrt(np.diagonal(spread))[[0, 1, 4, 5]]
        away = np.abs(step.posterior.mean - mean)[[0, 1, 4, 5]]
        assert (away <= (1e-9 if number == 0 else 0.15 * sds)).all()


# Made with filterpy 1.4.5 (IMMEstimator; R. Labbe), which is not a dependency: two KalmanFilters, Q of
# continuous white noise of spectral densities 0.2^2 and 3^2, R = 16 I, the chain of TWO_SPEEDS.
FILTERPY_PLACES = [
    [74.163676, 79.77734], [73.672395, 87.728922], [76.189403, 89.137611], [75.920055, 89.07227],
    [86.271167, 105.065119], [95.587179, 93.750453], [97.288543, 97.188752], [96.367237, 103.889968],
    [102.940044, 110.483928], [105.26772, 116.623903], [101.958147, 129.591365], [104.465954, 127.372137],
]  # fmt: skip
FILTERPY = {  # frame: x, y, vx, vy, var x, P(turn)
    1: [69.89113317, 82.86105605, 10.03008852, -7.23923524, 11.18636541, 0.35670179],
    2: [75.24594127, 84.6651128, 7.52545016, -2.41430429, 11.94214741, 0.32740524],
    5: [84.61726523, 99.52192245, 4.60262292, 6.17445279, 10.69201676, 0.80984195],
    11: [104.68455896, 126.07847885, 1.14792666, 8.16508821, 10.85918739, 0.68297655],
    12: [105.43684119, 129.45538701, 1.09662197, 5.72709301, 10.5359809, 0.46003104],
}


def test_gaussians_in_modes_are_the_imm_of_filterpy(stream_of):
    motion = modal(TWO_SPEEDS)
    belief = ModalFilter(spec.Gaussian(filter="kalman", gate=1.0, samples=20), motion.modes)
    steps = run(belief, motion, np.array(FILTERPY_PLACES), stream_of, measured=True)
    for frame, (step, shares) in enumerate(steps, start=1):
        if frame in FILTERPY:
            mean, covariance = step.posterior.mean, step.posterior.covariance
            found = [*mean[[0, 1, 4, 5]], covariance[0, 0], shares[1]]
            assert found == pytest.approx(FILTERPY[frame], abs=2e-6)  # measurements have six decimals


# ------------------------------------------------------------------------------------ the mixture


def test_the_mixture_has_the_moments_regions_and_masses_of_its_draws(stream_of, rng):
    motion = modal(TWO_SPEEDS, sd=0.2)
    belief = ModalFilter(spec.Gaussian(filter="kalman", gate=1.0, samples=20), motion.modes)
    posterior = list(run(belief, motion, np.array(FILTERPY_PLACES[:5]), stream_of, measured=True))[-1][
        0
    ].posterior
    boxes = posterior.draw(40_000, rng)
    mean, sds = posterior.mean[:2], np.sqrt(np.diagonal(posterior.covariance)[:2])
    assert (np.abs(boxes[:, :2].mean(axis=0) - mean) < 5 * sds / 200).all()
    assert boxes[:, :2].var(axis=0) == pytest.approx(sds**2, rel=0.05)
    low, high, _, _ = posterior.regions((0.9,))[0]
    inside = np.mean((boxes[:, 0] > low) & (boxes[:, 0] < high))
    assert inside == pytest.approx(0.9, abs=0.01)
    share, trials = posterior.mass_within(mean, 4.0)
    near = np.linalg.norm(boxes[:, :2] - mean, axis=1) < 4.0
    assert share == pytest.approx(near.mean(), abs=0.012) and trials == float("inf")
    assert posterior.uncertainty(posterior.mean, (0, 1)) == pytest.approx(float(sds @ sds))


def test_likelihoods_at_samples_agree_with_what_is_measured(stream_of):
    motion = modal(MANOEUVRE_AND_HIDING)
    settings = spec.Gaussian(filter="kalman", gate=1.0, samples=4000)
    belief = ModalFilter(settings, motion.modes)
    exactly, sampled = (
        [shares for _, shares in run(belief, motion, PLACES[:3], stream_of, measured=how)]
        for how in (True, False)
    )
    assert np.array(sampled) == pytest.approx(np.array(exactly), abs=0.02)


def test_a_measurement_outside_every_gate_counts_as_missed(stream_of):
    motion = modal({**TWO_SPEEDS})
    belief = ModalFilter(spec.Gaussian(filter="kalman", gate=0.99, samples=20), motion.modes)
    far = np.array([[66.0, 92.0], [400.0, 400.0]])
    (_, _), (step, shares) = run(belief, motion, far, stream_of, measured=True)
    assert len(step.reports) == 1
    assert np.abs(step.posterior.mean[:2] - 66.0).max() < 60.0
    assert shares.sum() == pytest.approx(1.0)


# ------------------------------------------------------------------------------------ motion


def test_modes_of_different_fields_share_a_state(rng):
    """A walk has no velocity: it forgets what there was, and sets off anew."""
    walk = make_motion(spec.Motion.model_validate({"random_walk": {"sd_px": {"x": 1, "y": 1}}}))
    flight = make_motion(spec.Motion.model_validate({"constant_velocity": {"start_velocity_sd_px": 7.0}}))
    modes = make_modes({name: spec.Mode(mean_frames=1e6) for name in ("go", "stop")})
    motion = Modal(modes, (flight, walk))
    assert motion.fields == ("x", "y", "w", "h", "vx", "vy", FIELD)
    states = np.tile(np.r_[BOX, 5.0, -3.0, 0.0], (4000, 1))
    states[2000:, -1] = 1.0
    moved = motion.propagate(states, 1.0, rng)
    assert moved[:2000, :2].mean(axis=0) == pytest.approx([65.0, 87.0], abs=0.15)
    assert moved[2000:, :2].mean(axis=0) == pytest.approx([60.0, 90.0], abs=0.15)
    assert moved[2000:, 4].std() == pytest.approx(7.0, rel=0.08)
    assert isinstance(motion.motions[1], Forgetting) and motion.motions[0] is flight
    mean, covariance = motion.motions[1].linearise(states[0, :-1], 1.0)
    assert (mean[4:] == 0.0).all() and covariance[4, 4] == pytest.approx(49.0)


def test_densities_are_those_of_the_chain_times_those_of_the_mode(rng):
    motion = modal(MANOEUVRE_AND_HIDING)
    old = np.tile(np.r_[BOX, 3.0, 1.0, 0.0], (3, 1))
    old[:, -1] = (0, 1, 2)
    new = motion.propagate(np.repeat(old, 4, axis=0), 1.0, rng)
    found = motion.log_density(new, old, 1.0)
    chain = motion.chain.over(1.0)
    for n, m in product(range(len(new)), range(3)):
        mode = int(new[n, -1])
        own = motion.motions[mode].log_density(new[n : n + 1, :-1], old[m : m + 1, :-1], 1.0)[0, 0]
        assert found[n, m] == pytest.approx(own + np.log(chain[m, mode]))


@pytest.mark.parametrize("jumps", [False, True])
def test_the_map_counts_the_density_of_the_mode(jumps, rng):
    motion = modal(MANOEUVRE_AND_HIDING)
    old = np.tile(np.r_[BOX, 3.0, 1.0, 0.0], (50, 1))
    old[:, -1] = rng.integers(0, 3, 50)
    old[:, :2] += rng.standard_normal((50, 2))
    whole = Confined(Jumping(motion, 0.1, 320, 240, NO_SEARCH) if jumps else motion, 320, 240)
    new = whole.propagate(old, 1.0, rng)
    weights = LogWeights.normalise(rng.standard_normal(50))[0]
    likelihood = rng.standard_normal(50)
    parted = modal_of(whole)
    density = np.logaddexp.reduce(parted.log_density(new, old, 1.0) + weights.log, axis=1)
    assert map_index(likelihood, new, old, weights, whole, 1.0) == int(np.argmax(likelihood + density))


def test_smoothing_weighs_the_modes_by_what_comes_later(stream_of):
    """Seen moving off in frame 3, the target was probably turning in frame 2 already."""
    motion = modal(TWO_SPEEDS, start=0.5)
    belief = ParticleFilter(spec.Particles(size=1500))
    places = np.array([[60.0, 90.0], [60.0, 93.0], [60.0, 104.0], [60.0, 118.0]])
    beliefs = [step.posterior for step, _ in run(belief, motion, places, stream_of)]
    moves = [Move(motion, 1.0)] * (len(beliefs) - 1)
    smoothed = smooth_particles(beliefs, moves, 80, np.random.default_rng(1))
    before, after = (mode_probabilities(one[1], 2)[1] for one in (beliefs, smoothed))
    assert after > before + 0.2


def smoothed_by_enumeration(motion, places):
    """Exact: mean, covariance and P(mode) of every frame, over the Kalman smoothers of all sequences."""
    modes, chain = motion.modes, motion.modes.chain.over(1.0)
    look, log, sequences = np.eye(2, 6), [], []
    for sequence in product(range(len(modes)), repeat=len(places) + 1):
        steps = pairwise(sequence)
        prior = modes.start()[sequence[0]] * np.prod([chain[old, new] for old, new in steps])
        if prior <= 0.0:
            continue
        mean, spread = motion.start_moments(BOX)
        total, forward = np.log(prior), []
        for place, new in zip(places, sequence[1:], strict=True):
            moves, noise = motion.motions[new].linearise(mean, 1.0)
            ahead, before = moves @ mean, moves @ spread @ moves.T + noise
            mean, spread = ahead, before
            if modes.hidden[new]:
                total += np.log(BACKGROUND)
            else:
                s = look @ before @ look.T + SD**2 * np.eye(2)
                away, gain = place - look @ ahead, before @ look.T @ np.linalg.inv(s)
                total += np.log(SD**2) - 0.5 * (np.linalg.slogdet(s)[1] + away @ np.linalg.solve(s, away))
                mean, spread = ahead + gain @ away, before - gain @ s @ gain.T
            forward.append((mean, spread, moves, ahead, before))
        back = [forward[-1][:2]]
        later = zip(reversed(forward[:-1]), reversed(forward[1:]), strict=True)
        for (mean, spread, *_), (_, _, moves, ahead, before) in later:
            gain = spread @ moves.T @ np.linalg.pinv(before, rcond=1e-12, hermitian=True)
            after, narrow = back[-1]
            back.append((mean + gain @ (after - ahead), spread + gain @ (narrow - before) @ gain.T))
        log.append(total)
        sequences.append((sequence[1:], back[::-1]))
    weights = np.exp(np.array(log) - np.logaddexp.reduce(log))
    for frame in range(len(places)):
        means = np.array([back[frame][0] for _, back in sequences])
        mean = weights @ means
        spread = sum(
            w * (back[frame][1] + np.outer(m - mean, m - mean))
            for w, m, (_, back) in zip(weights, means, sequences, strict=True)
        )
        frame_modes = [sequence[frame] for sequence, _ in sequences]
        yield mean, spread, np.bincount(frame_modes, weights, minlength=len(modes))


def smoothed_in_modes(motion, places, stream_of):
    settings = spec.Gaussian(filter="kalman", gate=1)
    belief = ModalFilter(settings, motion.modes)
    beliefs = [step.posterior for step, _ in run(belief, motion, places, stream_of, measured=True)]
    return beliefs, smooth_gaussians(beliefs, [Move(motion, 1.0)] * (len(beliefs) - 1), settings)


@pytest.mark.parametrize("settings", [TWO_SPEEDS, MANOEUVRE_AND_HIDING], ids=["speeds", "hiding"])
def test_a_gaussian_in_modes_is_smoothed_over_a_step_exactly(settings, stream_of):
    """In the first frame no modes were mixed yet, so that nothing is approximate."""
    motion = modal(settings, sd=1.0)
    _, smoothed = smoothed_in_modes(motion, PLACES[:2], stream_of)
    mean, spread, shares = next(smoothed_by_enumeration(motion, PLACES[:2]))
    assert smoothed[0].mean == pytest.approx(mean, abs=1e-8)
    assert smoothed[0].covariance == pytest.approx(spread, abs=1e-6)
    assert smoothed[0].mode_probabilities == pytest.approx(shares, abs=1e-9)


def test_modes_that_do_not_follow_each_other_are_smoothed_exactly(stream_of):
    """As those of a category: a Kalman smoother for each."""
    still = {
        name: {**mode, "next": {name: 1.0}}
        for name, mode in (("slow", {}), ("fast", {"motion": TWO_SPEEDS["turn"]["motion"]}))
    }
    motion = modal(still, sd=1.0)
    _, smoothed = smoothed_in_modes(motion, PLACES, stream_of)
    for belief, (mean, spread, shares) in zip(smoothed, smoothed_by_enumeration(motion, PLACES), strict=True):
        assert belief.mean == pytest.approx(mean, abs=1e-7)
        assert belief.covariance == pytest.approx(spread, abs=1e-6)
        assert belief.mode_probabilities == pytest.approx(shares, abs=1e-9)


def test_a_smoothed_gaussian_in_modes_is_nearer_to_enumeration_than_the_filter(stream_of):
    motion = modal(MANOEUVRE_AND_HIDING, sd=1.0)
    filtered, smoothed = smoothed_in_modes(motion, PLACES, stream_of)
    exact = list(smoothed_by_enumeration(motion, PLACES))
    for filtered_belief, belief, (mean, _, shares) in zip(filtered[:-1], smoothed, exact, strict=False):
        away, before = (np.abs(one.mean[:2] - mean[:2]).max() for one in (belief, filtered_belief))
        assert away < 0.2 * before
        assert belief.mode_probabilities == pytest.approx(shares, abs=0.1)
    assert smoothed[-1] is filtered[-1]


# ------------------------------------------------------------------------------------ chains


def test_a_rare_mode_has_hypotheses_and_costs_no_bias(stream_of):
    """Entered once in 200 frames, by a fortieth of the hypotheses at least, and weighted for it."""
    motion = modal({"seen": {"mean_frames": 200}, "behind": {"mean_frames": 10, "hidden": {}}})
    belief = ParticleFilter(spec.Particles(size=400))
    flat = partial(lambda hypotheses, prior_log: Evidence(np.zeros(len(hypotheses))))
    now = belief.start(BOX, motion, stream_of(3, 0))
    counts, shares = [], []
    for frame in range(1, 40):
        step = belief.step(now, motion, 1.0, flat, stream_of(3, frame))
        now = step.posterior
        counts.append(int((now.states[:, -1] == 1).sum()))
        shares.append(mode_probabilities(now, 2)[1])
    assert min(counts) >= EVENLY / 2 * 400 / 2
    chain = motion.chain.over(1.0)
    exact = [(np.array([1.0, 0.0]) @ np.linalg.matrix_power(chain, frame))[1] for frame in range(1, 40)]
    # The chain of resampled weights drifts: 400 draws of .05, correlated over 10 frames.
    assert np.mean(shares) == pytest.approx(np.mean(exact), abs=0.02)
