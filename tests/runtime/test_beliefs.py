"""Beliefs that are kept come back as they were, and a damaged file says where."""

from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.grid.belief import GridFilter
from bayesnet_track.belief.motion.composed import Influences
from bayesnet_track.belief.motion.delayed import CameraShift
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.engine.predicting import MotionContext
from bayesnet_track.engine.step import TargetState
from bayesnet_track.graph import spec
from bayesnet_track.journal.encoder import JournalError
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.runtime.recording.beliefs import BeliefWriter, check_kept, read_beliefs

RNG = np.random.default_rng(0)
SIZE = np.array([20.0, 10.0])


def particles():
    log = RNG.normal(size=50)
    log[3] = -np.inf
    return ParticleSet(RNG.normal(100, 5, (50, 4)), BOX_FIELDS, LogWeights.normalise(log)[0])


def gaussian():
    root = RNG.normal(size=(6, 6))
    return GaussianPosterior(RNG.normal(100, 5, 6), root @ root.T, (*BOX_FIELDS, "vx", "vy"), 13)


def grid():
    motion = make_motion(spec.Motion.model_validate({"constant_velocity": {"sd_velocity_px": 1.0}}))
    return GridFilter(spec.Grid()).start(np.array([50.0, 40.0, 20.0, 10.0]), motion, None)


def state(belief, influences=None):
    context = None if influences is None else MotionContext(SIZE, 1.0, 200.0, influences=influences)
    return TargetState(belief, {}, None, None, 3.0, motion_context=context)


def written(path, *states):
    with BeliefWriter(path) as file:
        for frame, one in enumerate(states):
            file.write(frame, "1", one)
    return list(read_beliefs(path))


@pytest.mark.parametrize("make", [particles, gaussian, grid])
def test_a_belief_comes_back(make, tmp_path):
    belief = make()
    (kept,) = written(tmp_path / "beliefs.jsonl", state(belief))
    assert (kept.frame, kept.target, kept.time, kept.influences) == (0, "1", 3.0, None)
    assert kept.posterior.fields == belief.fields
    np.testing.assert_allclose(kept.posterior.mean, belief.mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(kept.posterior.covariance, belief.covariance, rtol=1e-4, atol=1e-4)


def test_a_gaussian_comes_back_to_the_bit(tmp_path):
    belief = gaussian()
    (kept,) = written(tmp_path / "beliefs.jsonl", state(belief))
    assert (kept.posterior.mean == belief.mean).all()
    assert (kept.posterior.covariance == belief.covariance).all()


def test_what_the_motion_depended_on_comes_back(tmp_path):
    camera = CameraShift(RNG.normal(size=(2, 2)), RNG.normal(size=2))
    full = Influences(2.0, SIZE, 1.5, camera, 0.02)
    plain = Influences(1.0, SIZE)
    kept = written(tmp_path / "beliefs.jsonl", state(particles(), full), state(particles(), plain))
    first, second = (one.influences for one in kept)
    assert (first.camera.linear == camera.linear).all() and (first.camera.offset == camera.offset).all()
    for one, other in ((first, full), (second, plain)):
        assert (one.first_size == other.first_size).all()
        assert (one.dt, one.inflation, one.jump_share) == (other.dt, other.inflation, other.jump_share)
    assert second.camera is None


def test_a_torn_last_line_is_left_out(tmp_path):
    path = tmp_path / "beliefs.jsonl"
    written(path, state(particles()), state(particles()))
    path.write_bytes(path.read_bytes()[:-20])
    assert [one.frame for one in read_beliefs(path)] == [0]


@pytest.mark.parametrize(
    "line",
    [
        b"no json",
        b"[]",
        b'{"frame": 1}',
        b'{"frame":1,"target":"1","time":1,"particles":["x"],"states":"%%","log_weights":""}',
        b'{"frame":1,"target":"1","time":1,"particles":["x"],"states":"AACAPw==","log_weights":""}',
        b'{"frame":1,"target":"1","time":1,"particles":["x"],"states":"AADAfw==","log_weights":"AACAPw=="}',
        b'{"frame":1,"target":"1","time":1,"gaussian":["x"],"mean":"AA","covariance":"AA","size":3}',
    ],
)
def test_a_damaged_line_is_named(line, tmp_path):
    path = tmp_path / "beliefs.jsonl"
    written(path, state(particles()))
    path.write_bytes(path.read_bytes() + line + b"\n")
    with pytest.raises(JournalError, match=r"beliefs\.jsonl:2: not a belief"):
        list(read_beliefs(path))


def test_only_the_heaviest_cells_of_a_grid_are_kept(tmp_path, monkeypatch):
    from bayesnet_track.runtime.recording import beliefs as module

    monkeypatch.setattr(module, "MOST_CELLS", 7)
    belief = grid()
    mass = RNG.random(belief.mass.shape)
    (kept,) = written(tmp_path / "beliefs.jsonl", state(replace(belief, mass=mass / mass.sum())))
    assert len(kept.posterior) == 7
    heaviest = np.sort(mass.ravel())[-7:]
    np.testing.assert_allclose(np.sort(kept.posterior.weights.weights), heaviest / heaviest.sum(), rtol=1e-6)


def test_a_gaussian_for_each_mode_is_kept_with_their_probabilities(tmp_path):
    parts = (gaussian(), gaussian(), gaussian())
    belief = ModalPosterior(parts, np.array([0.5, 0.3, 0.2]))
    (kept,) = written(tmp_path / "beliefs.jsonl", state(belief))
    assert np.array_equal(kept.posterior.mode_probabilities, belief.mode_probabilities)
    for part, kept_part in zip(parts, kept.posterior.parts, strict=True):
        assert np.array_equal(kept_part.mean, part.mean) and kept_part.fields == part.fields
        assert np.array_equal(kept_part.covariance, part.covariance)


def test_what_can_be_kept():
    check_kept(load_graph("hidden_ball").spec)
    check_kept(load_graph("bouncing_square").spec)
    check_kept(load_graph("kalman_ball").spec)
