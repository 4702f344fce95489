"""Figures of calibration against brute force, and fits against the truth that data were drawn from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.evaluate.calibration import (
    HEAVY_TAIL,
    SIGNS,
    auroc,
    below_on_target,
    brier,
    fit_calibration,
    fit_levels,
    fit_localization_error,
    fit_logistic,
    leave_one_out,
    longest_run,
    reliability,
)
from bayesnet_track.evaluate.calibration_data import CalibrationData
from bayesnet_track.graph.settings.scores import FEATURES


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 6), st.booleans()), min_size=1, max_size=25))
def test_auroc_is_the_share_of_pairs_in_order(pairs):
    on = [s for s, hit in pairs if hit]
    off = [s for s, hit in pairs if not hit]
    found = auroc([s for s, _ in pairs], [hit for _, hit in pairs])
    if not on or not off:
        assert found is None
    else:
        assert found == pytest.approx(np.mean([(a > b) + 0.5 * (a == b) for a in on for b in off]))


def test_reliability_bins_the_frames():
    first, last = reliability([0.1, 0.3, 1.0, 0.9], [False, True, True, True], bins=2)
    assert (first.frames, first.said, first.was) == (2, pytest.approx(0.2), 0.5)
    assert (last.low, last.high, last.frames, last.was) == (0.5, 1.0, 2, 1.0)
    assert brier([1.0, 0.5], [True, True]) == 0.125


def test_logistic_regression_finds_what_the_data_were_drawn_from():
    rng = np.random.default_rng(1)
    n = 40_000
    x, y = rng.normal(size=n), 3.0 + 2.0 * rng.normal(size=n)
    hit = rng.random(n) < 1 / (1 + np.exp(-(0.5 + 1.0 * x - 0.8 * y)))
    found = fit_logistic({"x": x, "y": y}, hit, np.ones(n), {"x": 1, "y": -1}, ridge=0.0)
    # Sds of the estimates are below 0.02 (inverse of the information); five of them.
    assert [found["bias"], found["x"], found["y"]] == pytest.approx([0.5, 1.0, -0.8], abs=0.1)


def test_a_coefficient_of_the_wrong_sign_is_left_out():
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, 2000))
    hit = rng.random(2000) < 1 / (1 + np.exp(-(x + y)))
    found = fit_logistic({"x": x, "y": y}, hit, np.ones(2000), {"x": 1, "y": -1})
    alone = fit_logistic({"x": x}, hit, np.ones(2000), {"x": 1})
    assert found["y"] == 0.0
    assert found["x"] == pytest.approx(alone["x"]) and found["x"] > 0.5


def test_separable_data_give_finite_coefficients():
    found = fit_logistic({"x": np.arange(10.0)}, np.arange(10) > 4, np.full(10, 0.1), {"x": 1})
    assert np.isfinite(list(found.values())).all() and found["x"] > 0


def drawn(n, sd, lost_sd, rng, draws=24, spread=0.02):
    """Offsets of (n,) frames whose truth is drawn from a mixture with scores p and a heavy tail."""
    p = rng.uniform(0.2, 1.0, n)
    points = spread * rng.normal(size=(n, draws, 2))
    chosen = points[np.arange(n), rng.integers(draws, size=n)]
    sds = np.where(rng.random(n) < HEAVY_TAIL["weight"], HEAVY_TAIL["factor"] * sd, sd)
    noise = np.where(rng.random(n) < p, sds, lost_sd)[:, None] * rng.normal(size=(n, 2))
    return (chosen + noise)[:, None, :] - points, p


def test_slack_is_found_from_data_drawn_with_it():
    offsets, p = drawn(1500, 0.05, 2.0, np.random.default_rng(3))
    sd, lost_sd = fit_localization_error([offsets], [p])
    # Coverage of 3,000 axes has an sd below 0.01, which the grid's 18 % exceeds; two of its steps.
    assert 0.05 / 1.4 < sd < 0.05 * 1.4
    assert 2.0 / 1.4 < lost_sd < 2.0 * 1.4


@pytest.mark.slow
def test_both_regions_are_right_where_each_video_is_off_by_an_sd_of_its_own():
    """Eight videos on target, some held closely and some loosely: one Gaussian is too wide and too narrow."""
    rng = np.random.default_rng(5)
    sds = (0.01, 0.02, 0.02, 0.03, 0.03, 0.05, 0.1, 0.15)
    points = 0.01 * rng.normal(size=(len(sds), 400, 16, 2))
    videos = [sd * rng.normal(size=(400, 1, 2)) - own for sd, own in zip(sds, points, strict=True)]
    scores = [np.ones(400)] * len(sds)
    sd, _ = fit_localization_error(videos, scores)
    # One tail for eight sds misses by a few percent; one Gaussian gives .795 instead of .9.
    off = np.array([np.abs(below_on_target(one, np.array([sd]))[0] - 0.5) for one in videos])
    assert np.mean(off <= 0.25) == pytest.approx(0.5, abs=0.06)
    assert np.mean(off <= 0.45) == pytest.approx(0.9, abs=0.045)


def calibration_data(video, seed, n=400):
    rng = np.random.default_rng(seed)
    ud = rng.normal(-3, 2, n)
    on = rng.random(n) < 1 / (1 + np.exp(-(-2.0 - 1.0 * ud)))
    iou = np.where(on, 0.8, 0.05)
    offsets = np.where(on[:, None, None], 0.04, 3.0) * rng.normal(size=(n, 1, 2)) + 0.01 * rng.normal(
        size=(n, 16, 2)
    )
    features = {name: np.zeros(n) for name in FEATURES} | {"log_ud_box": ud}
    return CalibrationData(video, iou, features, np.exp(ud), offsets, np.zeros(n), ("tracking",) * n)


def test_regions_are_fitted_to_the_score_that_stays():
    data = [replace(calibration_data(name, k), scores=np.ones(400)) for k, name in enumerate("ab")]
    (sd, _), kept = (
        fit_calibration(data).localization_error,
        fit_calibration(data, keep_score=True).localization_error,
    )
    # A score that is always 1 leaves the frames off target to the first sd.
    assert kept[0] > 1.5 * sd


@pytest.mark.parametrize("name", sorted(SIGNS))
def test_a_feature_only_speaks_for_what_it_can(name):
    """Log UD, size and border against being on target, the others for it."""
    one = calibration_data("a", 0)
    against = {"log_ud_box", "log_size", "border"}
    for slope in (1.0, -1.0):
        features = {**one.features, name: slope * one.features["log_ud_box"]}  # which is low on target
        coefficient = fit_calibration([replace(one, features=features)], (name,)).logistic[name]
        assert (coefficient == 0.0) == ((name in against) == (slope < 0.0))


def test_frames_without_a_box_are_off_target_and_say_nothing_of_the_centre():
    one = replace(calibration_data("a", 0), scores=np.full(400, 0.5))
    away = np.arange(400) < 100
    gone = replace(
        one, iou=np.where(away, 0.0, one.iou), offsets=np.where(away[:, None, None], np.nan, one.offsets)
    )
    present = ("iou", "ud_box", "offsets", "scores")
    rest = replace(
        one,
        features={name: of[~away] for name, of in one.features.items()},
        status=one.status[100:],
        **{name: getattr(one, name)[~away] for name in present},
    )
    assert gone.seen.sum() == 300 and rest.seen.all()
    found, without = fit_calibration([gone], keep_score=True), fit_calibration([rest], keep_score=True)
    assert found.localization_error == without.localization_error
    # A quarter of the frames is off target, whatever their features: the score is less sure at every UD.
    for ud in (-5.0, -3.0):
        odds = [one.logistic["bias"] + one.logistic["log_ud_box"] * ud for one in (found, without)]
        assert odds[0] < odds[1]
    rows, everyone = leave_one_out([gone, replace(gone, video="b")])
    assert everyone.frames == 800 and all(np.isfinite(row.coverage50) for row in rows)


@pytest.mark.slow
def test_left_out_videos_are_calibrated_where_videos_are_alike():
    videos = [calibration_data(name, k) for k, name in enumerate("abcd")]
    rows, everyone = leave_one_out(videos)
    assert [row.name for row in rows] == list("abcd") and everyone.frames == 1600
    # Shares of 1600 frames have an sd below 0.0125; the sds of the fit are of the same size: four of both.
    assert everyone.said == pytest.approx(everyone.on, abs=0.07)
    assert everyone.coverage50 == pytest.approx(0.5, abs=0.07)
    assert everyone.coverage90 == pytest.approx(0.9, abs=0.07)
    assert everyone.auroc is not None and everyone.auroc > 0.85


def test_what_cannot_be_fitted_is_said():
    one = calibration_data("a", 0)
    on = CalibrationData(
        "a", np.full(400, 0.9), one.features, one.ud_box, one.offsets, one.scores, one.status
    )
    with pytest.raises(ValueError, match="every frame is on target"):
        fit_calibration([on])
    off = CalibrationData("a", np.zeros(400), one.features, one.ud_box, one.offsets, one.scores, one.status)
    with pytest.raises(ValueError, match="no frame is on target"):
        fit_calibration([off])
    with pytest.raises(ValueError, match="two videos"):
        leave_one_out([one])
    with pytest.raises(ValueError, match="without b: no frame"):
        leave_one_out([off, CalibrationData("b", one.iou, *[getattr(one, k) for k in (
            "features", "ud_box", "offsets", "scores", "status")])])  # fmt: skip


def test_levels_tell_on_target_from_off():
    scores = np.concatenate([np.linspace(0.7, 1.0, 100), np.linspace(0.0, 0.4, 100)])
    levels = fit_levels(scores, np.repeat([0.9, 0.0], 100))
    assert 0.4 <= levels.uncertain_below <= 0.71
    assert levels.score_below == pytest.approx(0.8 * levels.uncertain_below)
    assert fit_levels([0.9], [0.9]).score_below == 0.2


def test_longest_run():
    assert longest_run([]) == 0 and longest_run([True] * 3 + [False] + [True] * 2) == 3
