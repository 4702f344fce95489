"""Standard deviations of cues: found as they were drawn, whatever a few gross errors say."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.cues import color_blobs, motion
from bayesnet_track.evaluate.cue_parameters import central_shares, cue_residuals, fit_sd, fit_sds
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.observation.cue import Residual
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.scenes import random_geometry, two_squares


@pytest.mark.parametrize("gross", [0.0, 0.02])
def test_the_sd_that_residuals_were_drawn_with(gross):
    rng = np.random.default_rng(3)
    videos = [rng.normal(0, 1.7, 2000) for _ in range(3)]
    for one in videos:
        one[: int(gross * len(one))] = 300.0
    # 6000 residuals: the sd of the estimate is 1.2 %; 4 of them, 1 % of the grid, and 3 % for the gross ones.
    assert fit_sd(videos).value == pytest.approx(1.7, rel=0.058 + 1.5 * gross)
    assert central_shares(videos, 1.7) == pytest.approx((0.5, 0.9), abs=0.045)


def test_every_video_counts_the_same_however_long_it_is():
    rng = np.random.default_rng(4)
    narrow, wide = rng.normal(0, 1, 4000), rng.normal(0, 3, 400)
    alone = fit_sd([narrow, wide]).value
    assert fit_sd([np.tile(narrow, 5), wide]).value == pytest.approx(alone)
    assert 1.2 < alone < 2.8


def test_too_few_residuals_or_none_that_vary_make_no_estimate():
    rng = np.random.default_rng(5)
    assert fit_sd([rng.normal(size=19)]) is None
    assert fit_sd([np.zeros(50), rng.normal(size=5)]) is None


def test_both_cues_of_the_thesis_say_what_they_differ_by():
    for declaration in (motion.CUE, color_blobs.CUE):
        assert isinstance(declaration.make(declaration.parameters()), Residual)


def graph(agent):
    root = {"belief": {"particles": {"size": 50}}, "motion": {"random_walk": {"sd_px": {"x": 4, "y": 4}}}}
    return check_graph(
        {"name": "g", "targets": {"t": {"nodes": {"t": root, "a": {"parent": "t", "agent": agent}}}}}
    )


def painted(draw, frames):
    """Gray frames, as `draw` paints each."""
    for k in range(frames):
        image = np.full((90, 120, 3), 100, np.uint8)
        draw(image, k)
        yield Frame(k, float(k), image)


def test_hue_of_blobs_is_found_as_it_was_painted():
    """Red whose hue is drawn with an sd of 6 degrees; one degree of hue is 255 / 60 gray levels of green."""
    rng = np.random.default_rng(6)
    videos = []
    for _ in range(2):
        # Green above or blue above: hue on either side of 0 degrees. The first frame is the reference.
        hue = np.concatenate([[0.0], rng.normal(0, 6, 99)])
        level = np.rint(np.abs(hue) * 255 / 60).astype(np.uint8)

        def draw(image, k, hue=hue, level=level):
            image[18:42, 18:42] = (0, level[k], 255) if hue[k] >= 0 else (level[k], 0, 255)

        truth = np.tile([18.0, 18, 24, 24], (100, 1))
        videos.append(cue_residuals(graph("color_blobs"), painted(draw, 100), truth))
    value = fit_sd([np.concatenate(one["a", "sd_hue_deg"]) for one in videos]).value
    assert value == pytest.approx(6.0, rel=0.35)  # 198 residuals: 7 %, four of them, and rounding


def test_flow_at_true_boxes_is_found_as_the_target_was_moved():
    """A patterned square that jitters: the reference is the flow before, so residuals are changes of flow."""
    rng = np.random.default_rng(7)
    pattern = np.kron(rng.integers(0, 255, (8, 8, 3)), np.ones((4, 4, 1))).astype(np.uint8)
    videos = []
    for _ in range(2):
        steps = np.rint(rng.normal(0, 2.5, (100, 2))).clip(-6, 6).astype(int)
        place = np.clip(np.cumsum(steps, axis=0) + (45, 28), 5, (80, 50))

        def draw(image, k, place=place):
            x, y = place[k]
            image[y : y + 32, x : x + 32] = pattern

        truth = np.column_stack([place, np.full((100, 2), 32)]).astype(float)
        found = cue_residuals(graph("motion"), painted(draw, 100), truth)
        flow = np.diff(place, axis=0).astype(float)
        change = np.diff(flow, axis=0)
        assert len(found["a", "sd_x_px"]) > 80
        assert np.median(np.abs(np.concatenate(found["a", "sd_x_px"]))) == pytest.approx(
            np.median(np.abs(change[:, 0])), abs=0.8
        )
        videos.append(found)
    fitted = fit_sds(videos)
    assert set(fitted) == {("a", "sd_x_px"), ("a", "sd_y_px")}


def test_an_sd_that_follows_is_right_where_targets_differ():
    """Twelve targets whose sds differ by a factor of 100 in all: no one sd is right for all."""
    rng = np.random.default_rng(9)
    videos = [{("a", "sd"): list(rng.normal(0, sd, (200, 1)))} for sd in np.geomspace(0.3, 30.0, 12)]
    fitted = fit_sds(videos)
    (one,) = fitted.values()
    # Of 12 videos each share is known to .01 where the sd follows; it lags by a few frames, and has an error.
    assert one.followed == pytest.approx((0.5, 0.88), abs=0.04)
    assert abs(one.left_out[1] - 0.9) > 0.08


def test_one_sd_is_right_where_targets_are_alike():
    rng = np.random.default_rng(10)
    (one,) = fit_sds([{("a", "sd"): list(rng.normal(0, 2.0, (300, 1)))} for _ in range(8)]).values()
    # 2400 residuals: .01 and .006, four of them.
    assert one.left_out == pytest.approx((0.5, 0.9), abs=0.04)


@pytest.mark.slow
def test_fitted_sds_hold_on_other_scenes():
    """Fitted on seeds 340 to 343, on 350 to 353 they held .55 and .88 (mean of x and y); the default, all.

    Four scenes differ by .07 (50 %) and .04 (90 %): two of these on either side.
    """
    checked = load_graph("two_squares")

    def residuals(seeds):
        for seed in seeds:
            geometry = random_geometry(np.random.Generator(np.random.Philox(seed)))
            scene = two_squares(seed, geometry)
            frames = (Frame(k, float(k), image) for k, image in enumerate(islice(scene.frames, 80)))
            yield cue_residuals(checked, frames, scene.truth)

    fitted, unseen = fit_sds(list(residuals(range(340, 344)))), list(residuals(range(350, 354)))
    assert set(fitted) == {("motion", "sd_x_px"), ("motion", "sd_y_px")}

    def held_by(key, value):
        return central_shares([np.concatenate(one[key]) for one in unseen], value)

    held = [held_by(key, sd.value) for key, sd in fitted.items()]
    fifty, ninety = np.mean(held, axis=0)
    assert 0.41 < fifty < 0.69 and 0.80 < ninety < 0.96
    assert held_by(("motion", "sd_x_px"), 1.5)[0] > 0.9


def test_what_cannot_be_estimated_is_said():
    rng = np.random.default_rng(8)
    one = {("a", "sd_x_px"): [rng.normal(size=100)]}
    with pytest.raises(ValueError, match="one video; two or more"):
        fit_sds([one])
    with pytest.raises(ValueError, match="no agent of the target has any"):
        fit_sds([{}, {}])
    with pytest.raises(ValueError, match="sd_y_px of a cannot be estimated from 3 residuals: 20 are needed"):
        fit_sds([{**one, ("a", "sd_y_px"): [np.zeros(3)]}, one])
