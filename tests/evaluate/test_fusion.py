"""The correlation of a learned pool: found as it was drawn, from residuals and from a video."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from bayesnet_track import CueDeclaration, CueParameters, GrayPlane
from bayesnet_track.cues.intensity import CUE as INTENSITY
from bayesnet_track.evaluate.cue_parameters import (
    fit_correlation,
    lattice,
    learned_pools,
    own_estimate,
    pool_errors,
)
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame


def drawn(rng, frames, correlation, children=2):
    """(frames, 2, children) errors of sd 3 with one correlation."""
    shared = rng.normal(size=(frames, 2, 1))
    own = rng.normal(size=(frames, 2, children))
    return 3.0 * (np.sqrt(correlation) * shared + np.sqrt(1.0 - correlation) * own)


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("children", [2, 4])
def test_the_correlation_that_residuals_were_drawn_with(correlation, children):
    """Two coordinates of 3 x 400 frames: its sd is (1 - r^2) / sqrt(2400) for a pair, less for more pairs."""
    rng = np.random.default_rng(11)
    fitted = fit_correlation([drawn(rng, 400, correlation, children) for _ in range(3)])
    assert fitted.value == pytest.approx(correlation, abs=4.5 * (1.0 - correlation**2) / np.sqrt(2400))
    assert fitted.without[0] <= fitted.value <= fitted.without[1] and fitted.frames == 1200


def test_every_video_counts_the_same_however_long_it_is():
    rng = np.random.default_rng(2)
    one, other = drawn(rng, 200, 0.8), drawn(rng, 200, 0.0)
    longer = fit_correlation([np.tile(one, (5, 1, 1)), other])
    assert longer.value == pytest.approx(fit_correlation([one, other]).value)


def test_frames_in_which_a_child_says_nothing_are_left_out_and_opposite_errors_count_as_none():
    rng = np.random.default_rng(3)
    errors = drawn(rng, 100, 0.5)
    silent = np.vstack([errors, np.full((40, 2, 2), np.nan)])
    assert fit_correlation([silent]) == fit_correlation([errors])
    assert fit_correlation([np.stack([errors[..., 0], -errors[..., 0]], axis=2)]).value == 0.0
    with pytest.raises(ValueError, match="at most 19 frames of a video in which the children say something"):
        fit_correlation([errors[:19]])


@pytest.mark.parametrize("sd", [0.1, 0.3])
def test_the_estimate_of_a_gaussian_message_is_its_mean(sd):
    """Cut off symmetrically at half of its maximum; the lattice is 0.05 box sides apart."""
    offsets, at = lattice(), np.array([0.13, -0.21])
    message = -0.5 * ((offsets - at) ** 2).sum(axis=1) / sd**2
    np.testing.assert_allclose(own_estimate(message, offsets), at, atol=0.01)
    assert np.isnan(own_estimate(np.zeros(len(offsets)), offsets)).all()
    assert np.isnan(own_estimate(None, offsets)).all()


SIDE = 20.0


class Erring:
    """Sees the target with an error drawn for each frame, part of it for all children alike."""

    needs = (GrayPlane(),)

    def __init__(self, own: int, correlation: float) -> None:
        self.own, self.correlation = own, correlation

    def learn(self, planes, box) -> Mapping[str, np.ndarray]:
        return {"size": box[2:].astype(float)}

    def blend(self, old, new, rate):
        return old

    def log_likelihood(self, planes, hypotheses: Hypotheses, reference):
        frame = int(planes[self.needs[0]].max())  # painted with its number
        shared, own = (np.random.default_rng([frame, k]).normal(size=2) for k in (0, self.own))
        error = np.sqrt(self.correlation) * shared + np.sqrt(1.0 - self.correlation) * own
        away = hypotheses.boxes[:, :2] - [60.0, 45.0] - error
        return -0.5 * (away**2).sum(axis=1) / 2.0**2


def erring(name, own, correlation):
    return CueDeclaration(name, make=lambda parameters: Erring(own, correlation), parameters=CueParameters)


def net(correlation, latent=False):
    root = {
        "belief": {"particles": {"size": 100}},
        "motion": {"random_walk": {"sd_px": {"x": 2, "y": 2}}},
        "fuse": "product",
    }
    pool = {"parent": "t", "fuse": {"pool": "learned"}}
    if latent:
        root["fuse"] = {"latent": {"given": {"sd_px": {"x": 2, "y": 2}}}}
    nodes = {"t": root, "p": pool, "a": {"parent": "p", "agent": "one"}, "b": {"parent": "p", "agent": "two"}}
    cues = {"one": erring("one", 1, correlation), "two": erring("two", 2, correlation)}
    return check_graph({"name": "g", "targets": {"t": {"nodes": nodes}}}, {**cues, "intensity": INTENSITY})


def frames(count):
    for k in range(count):
        image = np.full((90, 120, 3), k, np.uint8)
        yield Frame(k, float(k), image)


@pytest.mark.slow
def test_the_correlation_of_agents_in_a_video():
    """Errors of sd 1 px in 119 frames, x and y: 4.5 sds of the estimate, (1 - r^2) / sqrt(238)."""
    count, correlation = 120, 0.6
    truth = np.tile([60.0 - SIDE / 2 + 0.5, 45.0 - SIDE / 2 + 0.5, SIDE, SIDE], (count, 1))
    found = pool_errors(net(correlation), frames(count), truth)
    fitted = fit_correlation([found["p"]])
    assert fitted.frames > 110
    assert fitted.value == pytest.approx(correlation, abs=4.5 * (1.0 - correlation**2) / np.sqrt(238))


def test_a_pool_about_a_state_that_no_video_shows_is_refused():
    with pytest.raises(ValueError, match="p is about the state of t, whose true value no video gives"):
        learned_pools(net(0.5, latent=True).targets["t"])
