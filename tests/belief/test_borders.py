"""A box that bounces off the borders: its path, its density by mirror images, and its derivatives."""

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.gaussian.belief import predict, require_linear
from bayesnet_track.belief.motion.borders import Confined, Reflecting, confined, framed
from bayesnet_track.belief.motion.delayed import Attached
from bayesnet_track.belief.motion.formulas import derivative
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.graph import spec
from bayesnet_track.graph.spec import Motion
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.sources.scenes.shapes import bouncing

FRAME = (320, 240)


def motion_of(**settings):
    kind, inside = next(iter(settings.items()))
    return Reflecting(make_motion(Motion.model_validate({kind: inside})), FRAME)


def walk(sd):
    return motion_of(random_walk={"sd_px": {"x": sd, "y": sd}})


FAST = motion_of(constant_velocity={"sd_velocity_px": 1.0, "sd_px": {"x": 2, "y": 2, "w": 1, "h": 1}})


def test_without_noise_it_is_the_path_of_the_bouncing_square():
    path = bouncing((270.0, 190.0), (-7.0, -4.74), 40.0, 200, *FRAME)
    state = np.array([[270.0, 190.0, 40.0, 40.0, -7.0, -4.74]])
    for place in path[1:]:
        state = FAST.drift(state, 1.0)
        np.testing.assert_allclose(state[0, :4], place, atol=1e-9)
    assert abs(state[0, 4]) == 7.0


def test_however_far_it_went_it_is_inside_and_a_large_box_is_centred():
    rng = np.random.default_rng(0)
    moved = FAST.propagate(FAST.start(np.array([5.0, 5.0, 300.0, 230.0]), 2000, rng), 400.0, rng)
    half = moved[:, 2:4] / 2
    fits = moved[:, 2:4] < FRAME
    assert fits.any(axis=0).all() and not fits.all()
    low, high = half - 0.5, np.array(FRAME) - 0.5 - half
    inside = (moved[:, :2] >= low - 1e-9) & (moved[:, :2] <= high + 1e-9)
    assert inside[fits].all()
    np.testing.assert_allclose(
        moved[:, :2][~fits], np.broadcast_to((np.array(FRAME) - 1) / 2, fits.shape)[~fits]
    )


def test_a_hypothesis_is_drawn_from_its_mirrored_density():
    motion, old = walk(12.0), np.array([[30.0, 120.0, 40.0, 40.0]])
    drawn = motion.propagate(np.repeat(old, 40_000, axis=0), 1.0, np.random.default_rng(3))[:, 0]
    edges = np.linspace(19.5, 79.5, 16)
    seen = np.histogram(drawn, edges)[0] / len(drawn)
    fine = np.linspace(19.5, 79.5, 6001)
    states = np.repeat(old, len(fine), axis=0)
    states[:, 0] = fine
    line = np.exp(motion.log_density(states, old, 1.0)[:, 0] + 0.5 * np.log(2 * np.pi * 144))  # y left out
    mass = np.diff(np.concatenate([[0.0], np.cumsum((line[1:] + line[:-1]) / 2 * np.diff(fine))])[::400])
    assert mass.sum() == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(seen, mass, atol=5 * np.sqrt(0.1 / len(drawn)))


@pytest.mark.parametrize(
    ("place", "speed"),
    [((160, 120), (3, 2)), ((22, 120), (-9, 2)), ((298, 219), (9, 8)), ((160, 120), (-660, 450))],
)
def test_its_derivative_is_that_of_what_it_does(place, speed):
    state = np.array([*place, 40.0, 30.0, *speed], dtype=float)
    numerical = derivative(lambda states: FAST.drift(states, 1.0), state)
    found, noise = FAST.linearise(state, 1.0)
    np.testing.assert_allclose(found, numerical, atol=1e-6)
    assert (np.linalg.eigvalsh(noise) > -1e-9).all()
    free = FAST.motion.linearise(state, 1.0)[1]
    assert np.isclose(noise[4, 4], free[4, 4]) and noise[0, 0] > 0


@pytest.mark.parametrize("filter_kind", ["extended", "unscented"])
def test_a_gaussian_turns_round(filter_kind):
    mean, covariance = np.array([25.0, 120, 40, 40, -10, 0]), np.diag([1.0, 1, 0, 0, 0.25, 0.25])
    mean, covariance = predict(mean, covariance, FAST, 1.0, spec.Gaussian(filter=filter_kind))
    assert mean[0] == pytest.approx(19.5 + (10 - 5.5), abs=0.2) and mean[4] == pytest.approx(10, abs=0.1)
    with pytest.raises(ValueError, match="linear motion"):
        require_linear(Confined(FAST, *FRAME))


def test_particles_are_weighed_as_enumeration_says():
    """A walk seen beside the border: the posterior mean by a sum over the mirrored prior."""
    motion, start, see = walk(12.0), np.array([26.0, 120, 40, 40]), (24.0, 6.0)

    def evaluate(hypotheses, log_prior):
        log = -0.5 * ((hypotheses.boxes[:, 0] - see[0]) / see[1]) ** 2
        return Evidence(log, {"a": log})

    belief = ParticleFilter(spec.Particles(size=20_000))

    def stream(purpose):
        return Streams(4).of("1", "root", 1, purpose)

    known = belief.start(start, motion, stream)
    step = belief.step(known, confined(motion, *FRAME), 1.0, evaluate, stream)
    fine = np.linspace(19.5, 120, 20001)
    states = np.repeat(start[None], len(fine), axis=0)
    states[:, 0] = fine
    weight = np.exp(
        motion.log_density(states, start[None], 1.0)[:, 0] - 0.5 * ((fine - see[0]) / see[1]) ** 2
    )
    assert step.posterior.mean[0] == pytest.approx(weight @ fine / weight.sum(), abs=0.15)


def test_the_frame_reaches_what_depends_on_it_wherever_it_stands():
    inner = Reflecting(make_motion(Motion.model_validate({"random_walk": {"sd_px": {"x": 1}}})))
    free = inner.drift(np.array([[-50.0, 0, 10, 10]]), 1.0)
    assert free[0, 0] == -50.0  # no frame is known yet
    found = confined(Attached(inner, np.zeros(2), 0.1, 0.9, 1.0), *FRAME).motion
    assert isinstance(found, Attached) and found.motion.frame == FRAME
    plain = inner.motion
    assert framed(plain, FRAME) is plain
