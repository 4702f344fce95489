"""What every belief of the language keeps to, whoever wrote it. A line in beliefs.yaml adds one."""

import numpy as np
import pytest

from bayesnet_track.belief.contract import BOX_FIELDS, Evidence
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.engine.step import make_engine
from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import Measurement

BOX = np.array([160.0, 120.0, 40.0, 30.0])
SD = 3.0
"""Of a measured x or y, px."""

MOTIONS = {
    "walk": {"random_walk": {"sd_px": {"x": 3, "y": 2.5}}},
    "velocity": {
        "constant_velocity": {
            "sd_px": {"x": 1.5, "y": 1.5},
            "sd_velocity_px": 1.0,
            "start_velocity_sd_px": 1.5,
        }
    },
}
TIMES = (1.0, 1.0, 2.0, 0.5, 1.0)
TRACKS = (11, 12, 17)
"""Seeds whose measurements lie where the prediction expects them: d^2 < 4.5, a half is farther than 1.4.

Of a surprise few hypotheses know, and their own effective number does not tell how few.
"""


@pytest.fixture(params=sorted(MOTIONS))
def kind(request):
    return request.param


@pytest.fixture
def make(fakes):
    """(asked, kind of motion) -> belief and motion, by a graph."""

    def made(asked, kind):
        declared = {"agent": fakes.declare(fakes.Oracle(fakes.flat()))}
        nodes = {"root": {"belief": asked.says, "motion": MOTIONS[kind]}, "agent": "root"}
        compiled = make_engine(fakes.graph(nodes, declared), 0, declared).plates["plate"]
        return compiled.belief, compiled.motion

    return made


def seen_at(place, sd=SD):
    """A likelihood of the centre, 1 at its best."""
    return lambda boxes: -0.5 * np.sum(((boxes[:, :2] - place) / sd) ** 2, axis=1)


def nothing(boxes):
    return np.zeros(len(boxes))


class Asking:
    """The net's side of the contract: answers by `see`, and checks what it is asked."""

    def __init__(self, see, fields, gaussians=None):
        self.see, self.fields, self.gaussians, self.asked = see, fields, gaussians, 0

    def __call__(self, hypotheses, log_prior):
        size = len(hypotheses)
        assert hypotheses.boxes.shape == (size, 4) and hypotheses.boxes.dtype == np.float64
        assert np.isfinite(hypotheses.boxes).all() and hypotheses.boxes[:, 2:].min() >= 1 - 1e-9
        assert tuple(hypotheses.fields) == self.fields[4:]
        assert all(values.shape == (size,) for values in hypotheses.fields.values())
        assert log_prior.shape == (size,) and np.exp(log_prior).sum() == pytest.approx(1.0)
        self.asked += size
        log = self.see(hypotheses.boxes)
        if self.gaussians is None:
            return Evidence(log, {"agent": log})
        return Evidence(log, {"agent": log}, gaussians=self.gaussians, sampled=np.zeros(size))


def streams_of(seed, frame, target="1"):
    """A stream that refuses to be asked twice for the same purpose: both would get the same numbers."""
    given = set()

    def stream(purpose):
        assert purpose not in given, purpose
        given.add(purpose)
        return Streams(seed).of(target, "root", frame, purpose)

    stream.given = given
    return stream


def step(belief, known, motion, see, seed=0, frame=1, dt=1.0, gaussians=None, target="1"):
    asking = Asking(see, motion.fields, gaussians)
    return belief.step(known, motion, dt, asking, streams_of(seed, frame, target))


def start(belief, motion, box=BOX, seed=0):
    return belief.start(box, motion, streams_of(seed, 0))


def followed(belief, motion, places, seed=0, times=TIMES, box=BOX, measured=False):
    """The steps over measured places (T, 2)."""
    known, steps = start(belief, motion, box, seed), []
    for frame, (place, dt) in enumerate(zip(places, times, strict=True), start=1):
        gaussians = {"agent": Measurement(("x", "y"), place, SD**2 * np.eye(2))} if measured else None
        steps.append(step(belief, known, motion, seen_at(place), seed, frame, dt, gaussians))
        known = steps[-1].posterior
    return steps


def places_of(motion, seed):
    """(T, 2) measured centres of a target that moves as the model says."""
    rng = np.random.default_rng(seed)
    state, places = motion.start(BOX, 1, rng), []
    for dt in TIMES:
        state = motion.propagate(state, dt, rng)
        places.append(state[0, :2] + SD * rng.standard_normal(2))
    return np.array(places)


def kalman(motion, places, times=TIMES, box=BOX):
    """Mean, covariance and summed log-evidence in closed form; a place of None is no measurement."""
    mean, cov = motion.start_moments(box)
    total, look = 0.0, np.eye(2, len(mean))
    for place, dt in zip(places, times, strict=True):
        moves, noise = motion.linearise(mean, dt)
        mean, cov = moves @ mean, moves @ cov @ moves.T + noise
        if place is None:
            continue
        expected, off = look @ cov @ look.T + SD**2 * np.eye(2), place - look @ mean
        total -= 0.5 * (off @ np.linalg.solve(expected, off) + np.linalg.slogdet(expected / SD**2)[1])
        gain = cov @ look.T @ np.linalg.inv(expected)
        mean, cov = mean + gain @ off, cov - gain @ look @ cov
    return mean, cov, total


def moved_columns(motion):
    """The columns of a state that have noise in these motions: all but the size."""
    return [k for k in range(len(motion.fields)) if k not in (2, 3)]


def in_sds(motion, posterior, mean, cov):
    """Errors of mean and covariance in units of the exact sds."""
    chosen = moved_columns(motion)
    sd = np.sqrt(cov.diagonal())[chosen]
    away = (posterior.mean - mean)[chosen] / sd
    return away, (posterior.covariance - cov)[np.ix_(chosen, chosen)] / np.outer(sd, sd)


# ------------------------------------------------------------------------------------ what a step is


def check_posterior(known, fields):
    width = len(fields)
    assert known.fields == fields and fields[:4] == BOX_FIELDS
    assert isinstance(len(known), int) and len(known) >= 1
    assert known.mean.shape == (width,) and known.mean.dtype == np.float64
    assert known.covariance.shape == (width, width)
    assert np.isfinite(known.mean).all() and np.isfinite(known.covariance).all()
    np.testing.assert_allclose(known.covariance, known.covariance.T, atol=1e-9)
    scale = 1.0 + np.trace(known.covariance)
    assert np.linalg.eigvalsh(known.covariance).min() > -1e-9 * scale
    assert known.mean[2:4].min() >= 1 - 1e-9


def check_step(one, fields):
    """Shapes, types and weights of a step."""
    check_posterior(one.posterior, fields)
    size = len(one.support.states)
    assert one.support.states.shape == (size, len(fields))
    np.testing.assert_array_equal(one.support.boxes, one.support.states[:, :4])
    for weights in (one.prior, one.support.weights):
        assert isinstance(weights, LogWeights) and weights.log.shape == (size,)
        assert weights.weights.sum() == pytest.approx(1.0)
    assert one.evidence.log_likelihood.shape == (size,)
    assert all(values.shape == (size,) for values in one.evidence.messages.values())
    assert one.map_state.shape == (len(fields),) and np.isfinite(one.map_state).all()
    assert isinstance(float(one.log_evidence), float) and not np.isnan(one.log_evidence)
    if one.degenerate is None:
        assert np.isfinite(one.log_evidence)
        posterior, _ = one.prior.times(one.evidence.log_likelihood)
        np.testing.assert_allclose(one.support.weights.weights, posterior.weights, atol=1e-9)
    else:
        assert one.log_evidence == -np.inf and one.degenerate
        np.testing.assert_allclose(one.support.weights.weights, one.prior.weights, atol=1e-12)
    for report in one.reports:
        event = report(3, "7")
        assert isinstance(event, Event) and (event.frame, event.target) == (3, "7")
        assert to_json(from_json(to_json(event))) == to_json(event)
        assert explain(event)


def test_every_step_keeps_to_the_contract(asked_each, kind, make):
    belief, motion = make(asked_each, kind)
    check_posterior(start(belief, motion), motion.fields)
    np.testing.assert_allclose(start(belief, motion).mean[:4], BOX)
    for one in followed(belief, motion, places_of(motion, 1)):
        assert one.degenerate is None
        check_step(one, motion.fields)


def test_what_a_posterior_says_fits_together(asked, make, rng):
    """UD, regions and draws against mean and covariance."""
    belief, motion = make(asked, "walk")
    known = followed(belief, motion, places_of(motion, 2))[-1].posterior
    for about in (known.mean, known.mean + 2.0):
        for columns in ([0, 1], [1], [0, 1, 2, 3]):
            away = (known.mean - about)[columns]
            ud = np.trace(known.covariance[np.ix_(columns, columns)]) + away @ away
            assert known.uncertainty(about, columns) == pytest.approx(ud, rel=1e-6, abs=1e-9)

    boxes = known.draw(4000, rng)
    assert boxes.shape == (4000, 4) and np.isfinite(boxes).all() and boxes[:, 2:].min() >= 1
    cell = asked.says.get("grid", {}).get("cell_px", 0.0)  # draws fill the inside of a cell
    sd = np.sqrt(known.covariance.diagonal()[:2] + cell**2 / 12)
    # Four sds of a mean and an sd of 4000 draws.
    assert (np.abs(boxes[:, :2].mean(axis=0) - known.mean[:2]) < 4 * sd / np.sqrt(4000)).all()
    np.testing.assert_allclose(boxes[:, :2].std(axis=0), sd, rtol=4 / np.sqrt(4000))

    half, most = known.regions((0.5, 0.9))
    for k, (low, high) in enumerate((half[:2], half[2:])):
        outer = most[2 * k : 2 * k + 2]
        assert outer[0] <= low <= high <= outer[1]
        # Steps of the distribution are those of its heaviest hypotheses; 4 sds of a share.
        step_size = 0.25 if len(known) < 100 else 0.05
        for share, (left, right) in ((0.5, (low, high)), (0.9, outer)):
            inside = np.mean((boxes[:, k] >= left) & (boxes[:, k] <= right))
            assert abs(inside - share) < step_size + 4 * 0.5 / np.sqrt(4000)


# ------------------------------------------------------------------------------------ exact answers


def check_kalman(asked, belief, motion, measured):
    """Mean, covariance and log-evidence after five steps with gaps, three seeds.

    For sampled beliefs the unit is the root of sum 1 / ESS over the frames, as for a bootstrap filter (whose
    tests say why 1.5 of it for the moments, 3 for the evidence); those of three seeds scatter by another 1.5.
    """
    for track in TRACKS[: 3 if asked.tolerance is None else 2]:
        places = places_of(motion, track)
        mean, cov, total = kalman(motion, places)
        steps = followed(belief, motion, places, seed=track, measured=measured)
        away, spread = in_sds(motion, steps[-1].posterior, mean, cov)
        log = sum(one.log_evidence for one in steps) - total
        yield away, spread, log, sum(1 / one.support.weights.ess for one in steps)


def test_moments_and_evidence_are_those_of_kalman(asked_exactly, kind, make):
    belief, motion = make(asked_exactly, kind)
    errors = list(check_kalman(asked_exactly, belief, motion, measured=False))
    away, spread, log = (np.sqrt(np.mean(np.square([e[k] for e in errors]))) for k in range(3))
    if asked_exactly.tolerance is not None:
        assert max(away, spread) < asked_exactly.tolerance
        assert log < 3 * asked_exactly.tolerance
        return
    unit = np.sqrt(np.mean([e[3] for e in errors]))
    assert unit < 0.3
    assert max(away, spread) < 1.5 * 1.5 * unit
    assert log < 1.5 * 3 * unit


def test_gaussian_messages_say_what_their_likelihood_says(asked_exactly, kind, make):
    """Exact for the Kalman family, whatever it asks samples for; as the sampled likelihood for others."""
    belief, motion = make(asked_exactly, kind)
    if "gaussian" in asked_exactly.says:
        for away, spread, log, _ in check_kalman(asked_exactly, belief, motion, measured=True):
            assert max(np.abs(away).max(), np.abs(spread).max(), abs(log)) < 1e-9
        return
    places = places_of(motion, TRACKS[0])
    sampled, exact = (followed(belief, motion, places, 3, measured=exact)[-1] for exact in (False, True))
    np.testing.assert_allclose(exact.posterior.mean, sampled.posterior.mean, atol=1e-9)
    np.testing.assert_allclose(exact.posterior.covariance, sampled.posterior.covariance, atol=1e-9)
    assert exact.log_evidence == pytest.approx(sampled.log_evidence, abs=1e-9)


# ------------------------------------------------------------------------------------ without evidence


def test_without_an_active_agent_it_only_predicts(asked, kind, make):
    belief, motion = make(asked, kind)
    known, uncertainty = start(belief, motion), -1.0
    for frame in range(1, 6):
        one = step(belief, known, motion, nothing, 0, frame)
        check_step(one, motion.fields)
        known = one.posterior
        np.testing.assert_allclose(one.support.weights.weights, one.prior.weights, atol=1e-12)
        size = len(one.prior)
        # Zero, but for beliefs that weigh hypotheses from elsewhere: weights below 2, whose mean is 1.
        assert abs(one.log_evidence) < 4 / np.sqrt(size) and one.degenerate is None
        ud = known.uncertainty(known.mean, [0, 1])
        assert ud > uncertainty
        uncertainty = ud
    if not asked.is_kalman:
        return
    mean, cov, _ = kalman(motion, [None] * 5, [1.0] * 5)
    away, spread = in_sds(motion, known, mean, cov)
    # Five resamplings of equal weights at most, each of 1 / sqrt(N); prior editing and kernels thin out.
    bound = 4 * np.sqrt(5 / known.weights.ess) if hasattr(known, "weights") else 1e-2
    assert np.abs(away).max() < bound and np.abs(spread).max() < 1.5 * bound


@pytest.mark.parametrize("value", [-np.inf, np.nan, np.inf])
def test_evidence_that_cannot_be_used_leaves_the_prediction(asked, value, make):
    belief, motion = make(asked, "walk")
    places = places_of(motion, 4)
    known = followed(belief, motion, places[:2], times=TIMES[:2])[-1].posterior

    def broken(boxes):
        log = np.full(len(boxes), -np.inf if value == -np.inf else 0.0)
        log[len(log) // 2] = value
        return log

    bad = step(belief, known, motion, broken, 0, 3)
    check_step(bad, motion.fields)
    assert bad.degenerate and bad.log_evidence == -np.inf
    plain = step(belief, known, motion, nothing, 0, 3).posterior
    sd = np.sqrt(plain.covariance.diagonal()[:2])
    tolerance = 6 / np.sqrt(min(len(bad.support.states), len(plain)))  # drawn otherwise by some
    assert (np.abs(bad.posterior.mean - plain.mean)[:2] < tolerance * sd).all()
    assert (np.abs(np.sqrt(bad.posterior.covariance.diagonal()[:2]) / sd - 1) < tolerance).all()
    # The next frame is as any other.
    after = step(belief, bad.posterior, motion, seen_at(places[1]), 0, 4)
    check_step(after, motion.fields)
    assert after.degenerate is None
    assert np.abs(after.posterior.mean[:2] - places[1]).max() < 3 * SD


def test_long_gaps(asked, kind, make):
    """Many frames without a picture: spread over the image, and found again where it is seen."""
    belief, motion = make(asked, kind)
    inside = Confined(motion, 320, 240)
    known = start(belief, inside)
    for frame, dt in enumerate((0.04, 2.5, 600.0), start=1):
        one = step(belief, known, inside, nothing, 0, frame, dt)
        check_step(one, motion.fields)
        known = one.posterior
        boxes = one.support.boxes
        assert boxes[:, :2].min() >= -1e-9 and (boxes[:, :2].max(axis=0) <= [319 + 1e-9, 239 + 1e-9]).all()
    sharp = step(belief, known, inside, seen_at(BOX[:2] + 20.0, 10.0), 0, 9)
    check_step(sharp, motion.fields)
    assert sharp.degenerate is None
    assert np.trace(sharp.posterior.covariance[:2, :2]) < np.trace(known.covariance[:2, :2])


# ------------------------------------------------------------------------------------ invariances


def test_shifting_everything_shifts_everything(asked, make):
    """By whole cells and bins: 40 px and -20 px."""
    belief, motion = make(asked, "walk")
    places, shift = places_of(motion, 5), np.array([40.0, -20.0])
    here = followed(belief, motion, places)
    there = followed(belief, motion, places + shift, box=BOX + np.append(shift, [0.0, 0.0]))
    for one, other in zip(here, there, strict=True):
        assert len(one.support.states) == len(other.support.states)
        np.testing.assert_allclose(other.posterior.mean[:2], one.posterior.mean[:2] + shift, atol=1e-6)
        np.testing.assert_allclose(other.posterior.mean[2:], one.posterior.mean[2:], atol=1e-6)
        np.testing.assert_allclose(other.posterior.covariance, one.posterior.covariance, atol=1e-6)
        assert other.log_evidence == pytest.approx(one.log_evidence, abs=1e-6)
        np.testing.assert_allclose(other.map_state[:2], one.map_state[:2] + shift, atol=1e-6)


def test_the_same_streams_give_the_same_bits_and_others_do_not(asked, make):
    belief, motion = make(asked, "velocity")
    places = places_of(motion, 6)
    known = followed(belief, motion, places[:1], times=TIMES[:1])[-1].posterior

    def again(**at):
        stream = streams_of(at.get("seed", 0), at.get("frame", 2), at.get("target", "1"))
        one = belief.step(known, motion, 1.0, Asking(seen_at(places[1]), motion.fields), stream)
        return one, stream.given

    (first, given), (second, _) = again(), again()
    np.testing.assert_array_equal(first.support.states, second.support.states)
    np.testing.assert_array_equal(first.posterior.covariance, second.posterior.covariance)
    np.testing.assert_array_equal(first.map_state, second.map_state)
    assert first.log_evidence == second.log_evidence
    for other in ({"seed": 1}, {"frame": 3}, {"target": "2"}):
        same = np.array_equal(first.posterior.mean, again(**other)[0].posterior.mean)
        assert same == (not _is_random(asked)), other
    assert bool(given) or not _is_random(asked)


def _is_random(asked):
    """Cells and sigma points are where they are."""
    return "grid" not in asked.says and asked.says.get("gaussian", {}).get("likelihood") != "sigma_points"


# ------------------------------------------------------------------------------------ borders and sizes


@pytest.mark.parametrize("corner", [(0.0, 0.0), (319.0, 239.0), (-12.0, 130.0)])
def test_a_target_at_the_border(asked, corner, make):
    belief, motion = make(asked, "walk")
    inside, place = Confined(motion, 320, 240), np.clip(corner, 0.0, [319.0, 239.0])
    known = start(belief, inside, np.array([*corner, 40.0, 30.0]))
    for frame in range(1, 7):
        one = step(belief, known, inside, seen_at(place, 4.0), 0, frame)
        check_step(one, motion.fields)
        assert one.degenerate is None
        known = one.posterior
    assert np.abs(known.mean[:2] - place).max() < 4.0


@pytest.mark.parametrize("size", [(3.0, 3.0), (1.0, 1.0), (900.0, 700.0)])
def test_tiny_and_huge_targets(asked, size, make):
    belief, motion = make(asked, "walk")
    inside = Confined(motion, 320, 240)
    known = start(belief, inside, np.array([*BOX[:2], *size]))
    for frame in range(1, 4):
        one = step(belief, known, inside, seen_at(BOX[:2] + 1.0), 0, frame)
        check_step(one, motion.fields)
        known = one.posterior
        assert (known.mean[2:4] <= np.array(size) + 1e-9).all()
        assert (known.mean[2:4] >= np.minimum(size, [640, 480]) - 1e-9).all()
    assert np.abs(known.mean[:2] - BOX[:2] - 1.0).max() < SD
