"""Guarantees for new videos: a level by conformal risk control, and the e-value of an alarm.

Both count whole calibration videos, so that nothing is assumed of the frames of one video. They hold when the
new video and the calibration videos are exchangeable, and the score was fitted to others.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from bayesnet_track.engine.scoring.outcome import level_afterwards, means_of, next_cusum
from bayesnet_track.evaluate.calibration import OFF_TARGET, ON_TARGET
from bayesnet_track.evaluate.calibration_data import CalibrationData
from bayesnet_track.numerics.arrays import Floats

SLACK = 1e-12
"""Rounding that is forgiven where a bound is met exactly."""

PARTS = 20
"""Levels of a run that is over."""


@dataclass(frozen=True, eq=False)
class CalibrationRun:
    """One run over a calibration video, each frame after the first.

    Attributes:
        means: (m,) mean of the last scores, as `guarantee` compares it.
        iou: (m,) overlap, 0 where the target is absent.
    """

    means: Floats
    iou: Floats


@dataclass(frozen=True)
class Controlled:
    """A level that controls the risk.

    Attributes:
        above: the level.
        risk: mean over calibration videos of the share of frames called tracking while off target.
        allowed: what that may be at most.
        called: share of the frames on target that are called tracking, mean over videos that have some.
        videos: calibration videos.
    """

    above: float
    risk: float
    allowed: float
    called: float
    videos: int


def fewest_videos(share: float, alarm: bool = False) -> int:
    """The fewest calibration videos n: share (n + 1) is at least 1, and above 1 for an alarm.

    >>> fewest_videos(0.05), fewest_videos(0.05, alarm=True), fewest_videos(0.3)
    (19, 20, 3)
    """
    return math.floor(1.0 / share + 1e-9) if alarm else math.ceil(1.0 / share - 1.0 - 1e-9)


def allowed_risk(videos: int, share: float, worst: float = 1.0) -> float:
    """The calibrated risk at which the expected one is at most `share`: (share (n + 1) - worst) / n.

    A new video may be wrong in a share `worst` of its frames, in all where nothing else is known. That counts
    like one more calibration video that is.

    >>> round(allowed_risk(25, 0.05), 6), round(allowed_risk(25, 0.05, worst=0.8), 6)
    (0.012, 0.02)
    """
    return (share * (videos + 1) - worst) / videos


def control_risk(
    videos: Sequence[Sequence[CalibrationRun]], share: float, overlap: float = ON_TARGET
) -> Controlled:
    """The lowest level at which the expected share of a new video is at most `share`.

    The loss of a video is the share of its frames with a mean score above the level and an IoU of at most
    `overlap`, averaged over its runs. It falls as the level rises, as conformal risk control needs
    (Angelopoulos et al., Conformal Risk Control, 2024).

    Raises:
        ValueError: there are too few videos for `share`.
    """
    _check_count(len(videos), fewest_videos(share), f"a guarantee of {share:g}")
    risk_limit = allowed_risk(len(videos), share)
    level = lowest_level(videos, risk_limit, overlap)
    risk, called = share_wrong(videos, level, overlap), share_called(videos, level)
    return Controlled(level, risk, risk_limit, called, len(videos))


def control_afterwards(
    videos: Sequence[Sequence[CalibrationRun]], share: float, overlap: float = ON_TARGET
) -> tuple[float, ...]:
    """Levels of a run that is over, the k-th for one with at most a share k / 20 of its frames above.

    Off target it can be in no larger share. That bound takes the place of the 1 for a new video of which
    nothing is known, and the argument of `control_risk` holds as before. It needs single runs: each pass over
    the videos controls the risk by itself, and the highest level of them counts.

    Raises:
        ValueError: there are too few videos for `share`.
    """
    _check_count(len(videos), fewest_videos(share), f"a guarantee of {share:g}")
    passes = [[[run] for run in level_pair] for level_pair in zip(*videos, strict=False)]
    risk_limits = [allowed_risk(len(videos), share, (k + 1) / PARTS) for k in range(PARTS)]
    return tuple(
        max(lowest_level(wrong_shares, risk_limit, overlap) for wrong_shares in passes)
        for risk_limit in risk_limits
    )


def lowest_level(
    videos: Sequence[Sequence[CalibrationRun]], risk_limit: float, overlap: float = ON_TARGET
) -> float:
    """The lowest level at which the mean loss is at most `risk_limit`; alone, it promises nothing."""
    levels, weights = [np.zeros(1)], [np.zeros(1)]
    for runs in videos:
        for run in runs:
            wrong = run.means[run.iou <= overlap]
            levels.append(wrong)
            weights.append(np.full(len(wrong), 1.0 / (len(run.means) * len(runs) * len(videos))))
    level, weight = np.concatenate(levels), np.concatenate(weights)
    order = np.argsort(level, kind="stable")
    level, weight = level[order], weight[order]
    ends = np.searchsorted(level, level, side="right")
    risks = np.append(np.cumsum(weight[::-1])[::-1], 0.0)[ends]  # weight of the frames above each level
    first = int(np.argmax(risks <= risk_limit + SLACK))
    return _rounded_up(float(level[first]))


def share_wrong(
    videos: Sequence[Sequence[CalibrationRun]], level: float, overlap: float = ON_TARGET
) -> float:
    """Mean over videos of the share of frames that are called tracking while IoU is at most `overlap`."""
    return fmean(
        fmean(float(((run.means > level) & (run.iou <= overlap)).mean()) for run in runs) for runs in videos
    )


def share_called(videos: Sequence[Sequence[CalibrationRun]], level: float) -> float:
    """Mean over videos of the share of the frames on target that are called tracking; NaN without any."""
    shares = []
    for runs in videos:
        good = np.concatenate([run.means[run.iou > ON_TARGET] for run in runs])
        if len(good):
            shares.append(float((good > level).mean()))
    return fmean(shares) if shares else math.nan


def share_called_afterwards(videos: Sequence[Sequence[CalibrationRun]], levels: Sequence[float]) -> float:
    """`share_called` with each run at the level that is its own when it is over."""
    return share_called([[_judged(run, levels) for run in runs] for runs in videos], 0.5)


def _judged(run: CalibrationRun, levels: Sequence[float]) -> CalibrationRun:
    """The run with 1 where it is called tracking, and 0 elsewhere."""
    return CalibrationRun((run.means > level_afterwards(levels, run.means)).astype(float), run.iou)


def largest_evidence(scores: Iterable[float], iou: Iterable[float]) -> float:
    """The largest X of the alarm while the target is held: before the first frame with an IoU below 0.1."""
    cusum = largest = 0.0
    for score, overlap in zip(scores, iou, strict=True):
        if overlap < OFF_TARGET:
            break
        cusum = next_cusum(cusum, score)
        largest = max(largest, cusum)
    return math.exp(largest)


def total_evidence(videos: Sequence[Sequence[CalibrationData]], share: float) -> float:
    """Sum over videos of the largest evidence, mean over the runs of each.

    Raises:
        ValueError: there are too few videos for `share`.
    """
    _check_count(len(videos), fewest_videos(share, alarm=True), f"an alarm of {share:g}")
    return sum(fmean(largest_evidence(run.all_scores, run.all_iou) for run in runs) for runs in videos)


def runs_of(data: Iterable[CalibrationData], frames: int) -> dict[str, list[CalibrationRun]]:
    """Video -> its runs, with means over `frames` scores as the engine takes them."""
    runs: dict[str, list[CalibrationRun]] = {}
    for datum in data:
        means = means_of(datum.all_scores.tolist(), frames)
        runs.setdefault(datum.video, []).append(CalibrationRun(means, datum.all_iou))
    return runs


def _check_count(videos: int, minimum: int, purpose: str) -> None:
    if videos < minimum:
        count_text = "there is 1" if videos == 1 else f"there are {videos}"
        raise ValueError(
            f"{purpose} needs {minimum} calibration videos or more, and {count_text}: the new video counts "
            "as one more in which everything is wrong"
        )


def _rounded_up(level: float) -> float:
    """Four digits after the point, never lower: a higher level is on the safe side."""
    return min(math.ceil(level * 1e4 - 1e-9) / 1e4, 1.0) if level < 1.0 else 1.0
