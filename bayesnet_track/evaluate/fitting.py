"""Estimate what makes a graph's score and regions calibrated from runs over videos with truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.evaluate.calibration import (
    OFF_TARGET,
    ON_TARGET,
    Bin,
    Levels,
    auroc,
    below_on_target,
    blurred_below,
    brier,
    fit_levels,
    fit_localization_error,
    fit_logistic,
    reliability,
)
from bayesnet_track.evaluate.calibration_data import TEMPERATURES, CalibrationData, by_video
from bayesnet_track.numerics.arrays import Floats

SIGNS: Mapping[str, int] = {
    "log_ud_box": -1,
    "evidence": 1,
    "log_fit": 1,
    "agreement": 1,
    "log_size": -1,
    "border": -1,
}
"""What a larger value of each feature can only speak for: 1 on target, -1 off it; of a verifier it is 1."""

USUAL_FEATURES = ("log_ud_box", "evidence")
"""Few features carry over to other videos better than many."""


@dataclass(frozen=True)
class Fitted:
    """What was estimated.

    Attributes:
        logistic: bias and coefficients of the score.
        localization_error: sd_box and lost_sd_box, beside `HEAVY_TAIL`.
        levels: of the statuses.
        ud_box: levels of UD, relative to the box: activate, deactivate, learn.
        temperatures: agent -> factor on its temperature.
        videos: how many.
        frames: of how many.
    """

    logistic: Mapping[str, float]
    localization_error: tuple[float, float]
    levels: Levels
    ud_box: Mapping[str, float]
    videos: int
    frames: int
    temperatures: Mapping[str, float] = field(default_factory=dict)


def fit(
    data: Sequence[CalibrationData], features: Sequence[str] = USUAL_FEATURES, keep_score: bool = False
) -> Fitted:
    """Estimate from runs over videos.

    For the score each video counts the same, however long it is. For the localization error and for
    temperatures each run does, and for the levels of the score and of UD each frame.

    Frames in which the truth has no box are off target, and say nothing of where the centre is.

    Regions and statuses are fitted to the score that is, or with `keep_score` to the graph's own.

    Raises:
        ValueError: no frame is on target, or every frame is.
    """
    videos = by_video(data)
    hits = np.concatenate([one.iou > ON_TARGET for one in data])
    if not hits.any():
        raise ValueError("no frame is on target (IoU above 0.5); fitting needs some that are")
    if hits.all():
        raise ValueError("every frame is on target (IoU above 0.5); fitting also needs some that are not")
    weights = _weights(data, videos)
    table = {name: np.concatenate([one.features[name] for one in data]) for name in features}
    logistic = fit_logistic(table, hits, weights, {name: SIGNS.get(name, 1) for name in features})
    scores = [one.scores if keep_score else score_of(logistic, one) for one in data]
    localization_error = fit_localization_error(
        [one.offsets[one.seen] for one in data],
        [said[one.seen] for one, said in zip(data, scores, strict=True)],
    )
    iou = np.concatenate([one.iou for one in data])
    ud = np.concatenate([one.ud_box for one in data])
    levels = fit_levels(np.concatenate(scores), iou)
    return Fitted(
        logistic,
        localization_error,
        levels,
        _ud_levels(ud, iou),
        len(videos),
        len(iou),
        _temperatures(data),
    )


def score_of(logistic: Mapping[str, float], one: CalibrationData) -> Floats:
    """(n,) scores by other coefficients than the graph's."""
    odds = np.full(one.frames, logistic["bias"])
    for name, slope in logistic.items():
        if name != "bias":
            odds = odds + slope * one.features[name]
    scores = np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds, -500.0, 500.0))))
    return scores if one.most is None else np.minimum(scores, one.most)


@dataclass(frozen=True)
class Checked:
    """How calibrated frames are that were not fitted on.

    Attributes:
        name: video, or what it sums up.
        frames: frames.
        on: share of them on target (IoU above 0.5).
        said: mean score.
        coverage50: share of true centres in the 50 % region, mean of x and y.
        coverage90: the same of the 90 % region.
        auroc: of the score, for IoU above 0.5 against below 0.1; None where one kind is missing.
        brier: mean squared error of the score.
        bins: reliability.
    """

    name: str
    frames: int
    on: float
    said: float
    coverage50: float
    coverage90: float
    auroc: float | None
    brier: float
    bins: tuple[Bin, ...]


def leave_one_out(
    data: Sequence[CalibrationData], features: Sequence[str] = USUAL_FEATURES
) -> tuple[tuple[Checked, ...], Checked]:
    """Each video judged by what is fitted to the others, and all of them together.

    Raises:
        ValueError: fewer than two videos, or the others of one cannot be fitted.
    """
    videos = by_video(data)
    if len(videos) < 2:
        raise ValueError("leaving one out needs two videos or more")
    rows, scores, below = [], [], []
    for video, own in videos.items():
        try:
            fitted = fit([one for one in data if one.video != video], features)
        except ValueError as error:
            raise ValueError(f"without {video}: {error}") from None
        said = np.concatenate([score_of(fitted.logistic, one) for one in own])
        under = np.concatenate([mass_below(fitted, one)[one.seen] for one in own])
        rows.append(_check(video, own, said, under))
        scores.append(said)
        below.append(under)
    everyone = [one for own in videos.values() for one in own]
    return tuple(rows), _check("all", everyone, np.concatenate(scores), np.concatenate(below))


def mass_below(fitted: Fitted, one: CalibrationData) -> Floats:
    """(n, 2) mass of the widened belief below the true centre, in x and y."""
    p = score_of(fitted.logistic, one)[:, None]
    sd, lost_sd = (np.array([value]) for value in fitted.localization_error)
    near, far = below_on_target(one.offsets, sd)[0], blurred_below(one.offsets, lost_sd)[0]
    return np.asarray(p * near + (1.0 - p) * far)


def _check(name: str, own: Sequence[CalibrationData], said: Floats, below: Floats) -> Checked:
    iou = np.concatenate([one.iou for one in own])
    hits, sure = iou > ON_TARGET, (iou > ON_TARGET) | (iou < OFF_TARGET)
    off = np.abs(below - 0.5)
    return Checked(
        name,
        len(iou),
        float(hits.mean()),
        float(said.mean()),
        float((off <= 0.25).mean()),
        float((off <= 0.45).mean()),
        auroc(said[sure], hits[sure]),
        brier(said, hits),
        reliability(said, hits),
    )


def _weights(data: Sequence[CalibrationData], videos: Mapping[str, Sequence[CalibrationData]]) -> Floats:
    """(frames,) weights: one for all frames of a video together, in all runs."""
    totals = {video: sum(one.frames for one in own) for video, own in videos.items()}
    return np.concatenate([np.full(one.frames, 1.0 / totals[one.video]) for one in data])


def _ud_levels(ud_box: Floats, iou: Floats) -> dict[str, float]:
    """Help is called above nine tenths of the frames on target; below half of them an agent may go.

    References learn below two thirds of them, and where at least half of the frames off target are not.
    """
    on, off = ud_box[iou > ON_TARGET], ud_box[iou < OFF_TARGET]
    activate, deactivate, learn = (float(q) for q in np.quantile(on, [0.9, 0.5, 2.0 / 3.0]))
    if len(off):
        learn = min(learn, max(float(np.quantile(off, 0.5)), 1e-4))
    return {"activate": activate, "deactivate": deactivate, "learn": learn}


def _temperatures(data: Sequence[CalibrationData]) -> dict[str, float]:
    """Agent -> the factor that surprises it least, averaged over the runs in which it was heard."""
    agents = dict.fromkeys(agent for one in data for agent in one.surprise)
    return {
        agent: float(
            TEMPERATURES[
                int(
                    np.argmin(np.mean([one.surprise[agent] for one in data if agent in one.surprise], axis=0))
                )
            ]
        )
        for agent in agents
    }
