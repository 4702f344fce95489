"""What is promised of new videos: hand-worked levels, monotone losses, and rates over simulated videos."""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import fmean

import numpy as np
import pytest

from bayesnet_track.engine.scoring.outcome import e_value, level_afterwards, next_cusum
from bayesnet_track.evaluate.calibration_data import CalibrationData
from bayesnet_track.evaluate.guarantees import (
    CalibrationRun,
    allowed_risk,
    control_afterwards,
    control_risk,
    fewest_videos,
    largest_evidence,
    runs_of,
    share_called,
    share_called_afterwards,
    share_wrong,
    total_evidence,
)
from bayesnet_track.graph.spec import Alarm


def run(means, iou):
    return CalibrationRun(np.array(means, dtype=float), np.array(iou, dtype=float))


def test_the_counting_argument():
    assert allowed_risk(25, 0.05) == pytest.approx(0.012)
    assert allowed_risk(19, 0.05) == pytest.approx(0.0)
    assert [fewest_videos(share) for share in (0.05, 0.1, 0.01, 0.3)] == [19, 9, 99, 3]
    assert fewest_videos(0.05, alarm=True) == 20  # of 19 the e-value stays below 20
    with pytest.raises(ValueError, match=r"needs 19 calibration videos or more, and there are 18"):
        control_risk([[run([0.5], [0.9])]] * 18, 0.05)
    with pytest.raises(ValueError, match="there is 1:"):
        control_risk([[run([0.5], [0.9])]], 0.05)


def test_levels_worked_out_by_hand():
    """Three videos of ten frames at 0.5: a risk of (0.5 * 4 - 1) / 3 = 1/3, ten wrong frames of thirty."""
    one = run(np.arange(1, 11) / 20, np.zeros(10))  # wrong at 0.05, 0.1, ..., 0.5
    two = run(np.arange(1, 11) / 20 + 0.4, np.zeros(10))  # wrong at 0.45, ..., 0.9
    good = run(np.full(10, 0.7), np.ones(10))
    found = control_risk([[one], [two], [good]], 0.5)
    # Above 0.5 are 8 of the second video; above 0.45 one of the first and 9 of the second.
    assert found.above == 0.45 and found.risk == pytest.approx(1 / 3) == pytest.approx(found.allowed)
    assert found.called == 1.0 and found.videos == 3
    # Two runs of a video count as their mean.
    again = control_risk([[one, good], [two], [good]], 0.5)
    # Frames of the first now count half: 2 / 60 + 10 / 30 above 0.4 is too much, 1 / 60 + 9 / 30 is not.
    assert again.above == 0.45 and again.risk == pytest.approx(19 / 60)


def test_frames_off_target_are_those_up_to_the_overlap():
    """As the levels above, among frames at 0.3, which are wrong at an overlap of 0.5 and right at 0.1."""
    one = run([*np.arange(1, 11) / 20, *np.full(10, 0.99)], [*np.zeros(10), *np.full(10, 0.3)])
    two = run([*np.arange(1, 11) / 20 + 0.4, *np.full(10, 0.99)], [*np.zeros(10), *np.full(10, 0.3)])
    videos = [[one], [two], [run(np.full(20, 0.7), np.ones(20))]]
    strict, mild = control_risk(videos, 0.5), control_risk(videos, 0.5, overlap=0.1)
    # Of sixty frames 20 may be wrong: the 20 at 0.99, or all of those that are elsewhere.
    assert (strict.above, mild.above) == (0.9, 0.0) and mild.risk == pytest.approx(1 / 3)
    assert share_wrong(videos, 0.45, overlap=0.1) == pytest.approx(10 / 60)
    assert control_afterwards(videos, 0.5, overlap=0.1)[19] == mild.above


def test_without_a_wrong_frame_everything_is_called_and_with_19_videos_nothing_wrong_is():
    good = [[run([0.2, 0.9], [0.8, 0.8])]] * 19
    assert control_risk(good, 0.05).above == 0.0
    found = control_risk([*good[1:], [run([0.91, 0.97], [0.8, 0.3])]], 0.05)
    assert found.above == 0.97 and found.risk == 0.0 == found.called


def test_a_level_is_rounded_to_the_safe_side():
    found = control_risk([[run([0.912345], [0.2])]] * 19, 0.05)
    assert found.above == 0.9124 and share_wrong([[run([0.912345], [0.2])]], found.above) == 0.0


def test_what_a_run_may_be_wrong_in_takes_the_place_of_all_its_frames():
    """As above, with (0.5 * 4 - k / 20) / 3 instead of 1 / 3: 20 - k / 2 wrong frames of thirty."""
    one = run(np.arange(1, 11) / 20, np.zeros(10))
    two = run(np.arange(1, 11) / 20 + 0.4, np.zeros(10))
    levels = control_afterwards([[one], [two], [run(np.full(10, 0.7), np.ones(10))]], 0.5)
    # 14 of the frames are above 0.3, of the first 4 and all of the second; 0.05, where 19 are, is the lowest.
    assert (levels[19], levels[11], levels[1]) == (0.45, 0.3, 0.05) and len(levels) == 20
    assert all(low <= high for low, high in pairwise(levels))
    assert allowed_risk(3, 0.5, 0.6) == pytest.approx(14 / 30)
    with pytest.raises(ValueError, match="needs 19 calibration videos or more"):
        control_afterwards([[one]] * 18, 0.05)


def test_of_several_passes_over_the_videos_the_highest_level_counts():
    low, high = ([run(np.full(10, mean), np.zeros(10))] for mean in (0.3, 0.8))
    both = [low + high, high + low, low + low]
    # In each pass one video is wrong up to 0.8, and 10 of 30 frames are allowed only for k = 20.
    assert control_afterwards(both, 0.5)[0] == max(
        control_afterwards([one[k : k + 1] for one in both], 0.5)[0] for k in range(2)
    )
    worse = [low + high, low + high, low + high]
    assert control_afterwards(worse, 0.5) == control_afterwards([high] * 3, 0.5)


def test_loss_and_called_share_fall_as_the_level_rises():
    videos = simulated(np.random.default_rng(0), 30)
    levels = np.linspace(0.0, 1.0, 101)
    for shares in ([share_wrong(videos, a) for a in levels], [share_called(videos, a) for a in levels]):
        assert all(a >= b for a, b in pairwise(shares))
    assert math.isnan(share_called([[run([0.5], [0.1])]], 0.0))


def simulated(rng, count):
    """Videos of their own difficulty; scores depend on the frame before, and are high when wrong in some."""
    found = []
    for _ in range(count):
        easy, frames = rng.normal(2.0, 1.5), 40
        walk = np.cumsum(rng.normal(0, 0.4, frames))
        iou = 1.0 / (1.0 + np.exp(-(easy + walk)))
        score = 1.0 / (1.0 + np.exp(-(easy + walk + rng.normal(0, 1.0) + rng.normal(0, 0.5, frames))))
        found.append([CalibrationRun(score, iou)])
    return found


@pytest.mark.slow
def test_the_mean_share_of_new_videos_is_bounded():
    """1500 draws of 25 videos and a new one: the mean is at most 0.05, up to three standard errors."""
    rng = np.random.default_rng(1)
    losses = []
    for _ in range(1500):
        *videos, new = simulated(rng, 26)
        losses.append(share_wrong([new], control_risk(videos, 0.05).above))
    error = np.std(losses) / math.sqrt(len(losses))
    assert np.mean(losses) <= 0.05 + 3 * error
    assert np.mean(losses) > 0.005  # it is not kept by calling nothing


def wrong_afterwards(one, levels):
    """The share of a run's frames that are called tracking at its own level while off target."""
    return float(((one.means > level_afterwards(levels, one.means)) & (one.iou <= 0.5)).mean())


@pytest.mark.slow
def test_judged_afterwards_the_mean_share_is_bounded_and_more_is_called():
    """The same 1500 draws, each new video at the level of its own share."""
    rng = np.random.default_rng(1)
    losses, called = [], []
    for _ in range(1500):
        *videos, new = simulated(rng, 26)
        levels = control_afterwards(videos, 0.05)
        losses.append(fmean(wrong_afterwards(one, levels) for one in new))
        live = share_called([new], control_risk(videos, 0.05).above)
        called.append((share_called_afterwards([new], levels), live))
    error = np.std(losses) / math.sqrt(len(losses))
    assert np.mean(losses) <= 0.05 + 3 * error
    afterwards, live = np.nanmean(called, axis=0)
    assert afterwards > live + 0.05


def test_frames_without_a_true_box_count_as_wrong_and_means_are_those_of_the_engine():
    one = data([0.5, 1.0, 0.0], [0.9, 0.0, 0.7])
    (found,) = runs_of([one], 2)["v"]
    assert found.means.tolist() == [0.5, 0.75, 0.5]
    assert share_wrong([[found]], 0.6) == pytest.approx(1 / 3)


def data(scores, iou):
    empty = np.empty(0)
    return CalibrationData(
        "v", empty, {}, empty, empty, empty, (), all_scores=np.array(scores), all_iou=np.array(iou)
    )


def test_evidence_counts_until_the_target_is_lost():
    low, held = [0.01, 0.01, 0.9, 0.01], [0.8, 0.4, 0.8, 0.05]
    assert largest_evidence(low, held) == pytest.approx(math.exp(2.0))
    assert largest_evidence(low, [0.05, 0.8, 0.8, 0.8]) == 1.0
    assert total_evidence([[data(low, held), data([0.9], [0.9])]] * 20, 0.05) == pytest.approx(
        20 * (math.exp(2.0) + 1.0) / 2
    )
    with pytest.raises(ValueError, match="needs 20 calibration videos"):
        total_evidence([[data(low, held)]] * 19, 0.05)


@pytest.mark.slow
def test_false_alarms_are_seldom_although_frames_depend_on_each_other():
    """2000 new videos in which the target is held, each beside 25 others like it: at most 5 % alarms.

    Scores walk, and some videos have low ones throughout; the tolerance is three standard errors.
    """
    rng = np.random.default_rng(2)
    alarms, sums = 0, []
    for _ in range(2000):
        *others, new = [_largest(rng) for _ in range(26)]
        largest = e_value(math.log(new), Alarm(total=sum(others), videos=25))
        sums.append(largest)
        alarms += largest >= 20.0
    assert alarms / 2000 <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 2000)
    assert alarms > 0  # the bound is not kept by never alarming
    assert np.mean(sums) == pytest.approx(1.0, abs=4 * np.std(sums) / math.sqrt(2000))


def _largest(rng):
    walk = np.cumsum(rng.normal(0.0, 0.4, 30)) + rng.normal(3.0, 2.0)
    cusum = most = 0.0
    for odds in walk:
        cusum = next_cusum(cusum, 1.0 / (1.0 + math.exp(-odds)))
        most = max(most, cusum)
    return math.exp(most)
