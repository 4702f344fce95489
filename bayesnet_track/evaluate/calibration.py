"""Calibration of probabilities: reliability, ranking, and fits of scores and regions to ground truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.evaluate.calibration_data import TEMPERATURES, CalibrationData, by_video
from bayesnet_track.numerics.arrays import Floats

ON_TARGET, OFF_TARGET = 0.5, 0.1
"""IoU above which a frame is on target, and below which it is off."""

NEWTON_STEPS = 50
SLACKS = np.geomspace(0.002, 0.5, 34)
LOST_SLACKS = np.geomspace(0.05, 20.0, 37)
"""Sds in box sides among which the localization error is chosen: 18 % apart."""
HEAVY_TAIL: Mapping[str, float] = {"weight": 0.2, "factor": 5.0}
"""Of the localization error: errors of different videos, each of an sd of its own, have such a tail."""


def auroc(scores: ArrayLike, positive: ArrayLike) -> float | None:
    """Probability that a positive has a larger score than a negative, ties counted half; None without both.

    >>> auroc([0.1, 0.4, 0.4, 0.9], [False, False, True, True])
    0.875
    """
    values, flags = np.asarray(scores, dtype=np.float64), np.asarray(positive, dtype=bool)
    positives, negatives = np.sort(values[flags]), values[~flags]
    if not len(positives) or not len(negatives):
        return None
    higher_count = len(positives) - np.searchsorted(positives, negatives, side="right")
    equal = np.searchsorted(positives, negatives, side="right") - np.searchsorted(
        positives, negatives, side="left"
    )
    return float((higher_count + 0.5 * equal).mean() / len(positives))


def brier(scores: ArrayLike, hits: ArrayLike) -> float:
    """Mean squared difference of probability and outcome; 0.25 for one that always says one half."""
    return float(np.mean((np.asarray(scores, dtype=np.float64) - np.asarray(hits, dtype=np.float64)) ** 2))


@dataclass(frozen=True)
class Bin:
    """Frames with scores in [low, high), the last bin's high included: their mean score, and the truth."""

    low: float
    high: float
    frames: int
    said: float
    was: float


def reliability(scores: ArrayLike, hits: ArrayLike, bins: int = 5) -> tuple[Bin, ...]:
    """Mean score and share on target, in `bins` equal bins of the score; empty ones are left out."""
    values, flags = np.asarray(scores, dtype=np.float64), np.asarray(hits, dtype=bool)
    edges = np.linspace(0.0, 1.0, bins + 1)
    indices = np.clip(np.digitize(values, edges) - 1, 0, bins - 1)
    return tuple(
        Bin(
            float(edges[k]),
            float(edges[k + 1]),
            int(in_bin.sum()),
            float(values[in_bin].mean()),
            float(flags[in_bin].mean()),
        )
        for k in range(bins)
        if (in_bin := indices == k).any()
    )


def longest_run(flags: ArrayLike) -> int:
    """Length of the longest stretch of True.

    >>> longest_run([True, False, True, True])
    2
    """
    steps = np.diff(np.concatenate([[0], np.asarray(flags, dtype=int), [0]]))
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    return int((ends - starts).max(initial=0))


def fit_logistic(
    features: Mapping[str, ArrayLike],
    hits: ArrayLike,
    weights: ArrayLike,
    signs: Mapping[str, int],
    ridge: float = 0.1,
) -> dict[str, float]:
    """Coefficients and `bias` of a logistic regression with known signs.

    Maximises sum w log p(outcome) - ridge / 2 |coefficients of standardised features|^2 by Newton's method. A
    feature whose coefficient comes out with the wrong sign is left out (coefficient 0), the worst first:
    more evidence cannot mean that the target is lost.

    Args:
        features: name -> (n,) values.
        hits: (n,) outcomes; both kinds occur.
        weights: (n,) of the frames.
        signs: name -> 1 or -1, what a larger value speaks for.
        ridge: precision of the coefficients' Gaussian prior, in the unit of the weights.
    """
    w, y = np.asarray(weights, dtype=np.float64), np.asarray(hits, dtype=np.float64)
    remaining = list(features)
    while True:
        table = (
            np.array([np.asarray(features[name], dtype=np.float64) for name in remaining])
            .reshape(-1, len(y))
            .T
        )
        means = w @ table / w.sum()
        sds = np.sqrt(w @ (table - means) ** 2 / w.sum()) + 1e-9
        solved = _newton(np.column_stack([np.ones(len(y)), (table - means) / sds]), y, w, ridge)
        wrong = {name: signs[name] * solved[1 + k] for k, name in enumerate(remaining)}
        if not wrong or min(wrong.values()) >= 0:
            slopes = solved[1:] / sds
            coefficients = {name: float(slope) for name, slope in zip(remaining, slopes, strict=True)}
            bias = float(solved[0] - slopes @ means)
            return {"bias": bias, **{name: coefficients.get(name, 0.0) for name in features}}
        remaining.remove(min(wrong, key=lambda name: wrong[name]))


def _newton(table: Floats, y: Floats, w: Floats, ridge: float) -> Floats:
    penalty = np.full(table.shape[1], ridge)
    penalty[0] = 1e-9
    solved = np.zeros(table.shape[1])
    for _ in range(NEWTON_STEPS):
        p = 1.0 / (1.0 + np.exp(-np.clip(table @ solved, -30.0, 30.0)))
        gradient = table.T @ (w * (y - p)) - penalty * solved
        curvature = (table * (w * p * (1.0 - p))[:, None]).T @ table + np.diag(penalty)
        step = np.linalg.solve(curvature, gradient)
        solved = solved + step / max(1.0, float(np.abs(step).max()) / 5.0)
        if np.abs(step).max() < 1e-9:
            break
    return solved


def fit_localization_error(
    offsets: Sequence[ArrayLike], scores: Sequence[ArrayLike], shares: tuple[float, float] = (0.5, 0.9)
) -> tuple[float, float]:
    """The localization error (sd_box, lost_sd_box) with which regions hold as many true centres as they say.

    On target it has the heavy tail `HEAVY_TAIL`, so that both regions can be right where videos differ.
    The pair, on a logarithmic grid, whose coverage of the central 50 % and 90 % regions, averaged over
    videos, is nearest to 50 % and 90 % (sum of squared differences).

    Args:
        offsets: of each video (n, M, 2) true centre less M equally probable centres, in sqrt(w h).
        scores: of each video (n,) probabilities of being on target.
        shares: of the two regions.
    """
    near_mass = [below_on_target(np.asarray(video, dtype=np.float64), SLACKS) for video in offsets]
    far_mass = [blurred_below(np.asarray(video, dtype=np.float64), LOST_SLACKS) for video in offsets]
    probabilities = [np.asarray(p, dtype=np.float64)[:, None] for p in scores]
    lowest, slacks = np.inf, (float(SLACKS[0]), float(LOST_SLACKS[-1]))
    for a, sd in enumerate(SLACKS):
        for b, lost_sd in enumerate(LOST_SLACKS):
            if lost_sd <= sd:
                continue
            inside_shares = np.array(
                [
                    [np.mean(np.abs(p * n[a] + (1.0 - p) * f[b] - 0.5) <= share / 2.0) for share in shares]
                    for n, f, p in zip(near_mass, far_mass, probabilities, strict=True)
                ]
            )
            miss = float(((inside_shares.mean(axis=0) - shares) ** 2).sum())
            if miss < lowest:
                lowest, slacks = miss, (float(sd), float(lost_sd))
    return slacks


def below_on_target(offsets: Floats, sds: Floats) -> Floats:
    """(S, n, 2) mass below the true centre, of the (n, M, 2) points blurred by each sd and its heavy tail."""
    weight, factor = HEAVY_TAIL["weight"], HEAVY_TAIL["factor"]
    return (1.0 - weight) * blurred_below(offsets, sds) + weight * blurred_below(offsets, factor * sds)


def blurred_below(offsets: Floats, sds: Floats) -> Floats:
    """(S, n, 2) mass below the true centre, of the (n, M, 2) points blurred by each sd."""
    from scipy.special import ndtr  # here, because it takes long to import

    return np.array([ndtr(offsets / sd).mean(axis=1) for sd in sds])


@dataclass(frozen=True)
class StatusLevels:
    """Levels of the score, for the statuses."""

    score_below: float
    uncertain_below: float


def fit_levels(scores: ArrayLike, iou: ArrayLike, spared: float = 0.02) -> StatusLevels:
    """Levels that tell on target from off it.

    `uncertain_below` is where the share of frames off target below it exceeds that of frames on target most
    (Youden's index; 0.5 when there is none of one kind); `score_below` leaves only the share `spared` of
    frames on target below it, and lies below the other.
    """
    values, overlaps = np.asarray(scores, dtype=np.float64), np.asarray(iou, dtype=np.float64)
    on_scores, off_scores = np.sort(values[overlaps > ON_TARGET]), np.sort(values[overlaps < OFF_TARGET])
    if not len(on_scores) or not len(off_scores):
        return StatusLevels(0.2, 0.5)
    grid = np.linspace(0.05, 0.95, 91)
    gain = np.searchsorted(off_scores, grid) / len(off_scores) - np.searchsorted(on_scores, grid) / len(
        on_scores
    )
    high = float(grid[int(np.argmax(gain))])
    low = min(float(np.quantile(on_scores, spared)), 0.8 * high)
    return StatusLevels(max(low, 0.01), high)


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
class FittedCalibration:
    """Estimated calibration of a score.

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
    levels: StatusLevels
    ud_box: Mapping[str, float]
    videos: int
    frames: int
    temperatures: Mapping[str, float] = field(default_factory=dict)


def fit_calibration(
    data: Sequence[CalibrationData], features: Sequence[str] = USUAL_FEATURES, keep_score: bool = False
) -> FittedCalibration:
    """Estimate from runs over videos.

    For the score each video counts the same, however long it is. For the localization error and for
    temperatures each run does, and for the levels of the score and of UD each frame.

    Frames in which the truth has no box are off target, and say nothing of where the centre is.

    Regions and statuses are fitted to the score that is, or with `keep_score` to the graph's own.

    Raises:
        ValueError: no frame is on target, or every frame is.
    """
    videos = by_video(data)
    hits = np.concatenate([datum.iou > ON_TARGET for datum in data])
    if not hits.any():
        raise ValueError("no frame is on target (IoU above 0.5); fitting needs some that are")
    if hits.all():
        raise ValueError("every frame is on target (IoU above 0.5); fitting also needs some that are not")
    weights = _weights(data, videos)
    table = {name: np.concatenate([datum.features[name] for datum in data]) for name in features}
    logistic = fit_logistic(table, hits, weights, {name: SIGNS.get(name, 1) for name in features})
    scores = [datum.scores if keep_score else score_of(logistic, datum) for datum in data]
    localization_error = fit_localization_error(
        [datum.offsets[datum.seen] for datum in data],
        [probabilities[datum.seen] for datum, probabilities in zip(data, scores, strict=True)],
    )
    iou = np.concatenate([datum.iou for datum in data])
    ud = np.concatenate([datum.ud_box for datum in data])
    levels = fit_levels(np.concatenate(scores), iou)
    return FittedCalibration(
        logistic,
        localization_error,
        levels,
        _ud_levels(ud, iou),
        len(videos),
        len(iou),
        _temperatures(data),
    )


def score_of(logistic: Mapping[str, float], data: CalibrationData) -> Floats:
    """(n,) scores by other coefficients than the graph's."""
    odds = np.full(data.frames, logistic["bias"])
    for name, slope in logistic.items():
        if name != "bias":
            odds = odds + slope * data.features[name]
    scores = np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds, -500.0, 500.0))))
    return scores if data.most is None else np.minimum(scores, data.most)


@dataclass(frozen=True)
class Checked:
    """Calibration of frames that were not fitted on.

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
    rows, scores, masses = [], [], []
    for video, video_data in videos.items():
        try:
            fitted = fit_calibration([datum for datum in data if datum.video != video], features)
        except ValueError as error:
            raise ValueError(f"without {video}: {error}") from None
        probabilities = np.concatenate([score_of(fitted.logistic, datum) for datum in video_data])
        under = np.concatenate([mass_below(fitted, datum)[datum.seen] for datum in video_data])
        rows.append(_check(video, video_data, probabilities, under))
        scores.append(probabilities)
        masses.append(under)
    everyone = [datum for video_data in videos.values() for datum in video_data]
    return tuple(rows), _check("all", everyone, np.concatenate(scores), np.concatenate(masses))


def mass_below(fitted: FittedCalibration, data: CalibrationData) -> Floats:
    """(n, 2) mass of the widened belief below the true centre, in x and y."""
    p = score_of(fitted.logistic, data)[:, None]
    sd, lost_sd = (np.array([value]) for value in fitted.localization_error)
    near_mass, far_mass = below_on_target(data.offsets, sd)[0], blurred_below(data.offsets, lost_sd)[0]
    return np.asarray(p * near_mass + (1.0 - p) * far_mass)


def _check(
    name: str, video_data: Sequence[CalibrationData], probabilities: Floats, masses: Floats
) -> Checked:
    iou = np.concatenate([datum.iou for datum in video_data])
    hits, sure = iou > ON_TARGET, (iou > ON_TARGET) | (iou < OFF_TARGET)
    deviations = np.abs(masses - 0.5)
    return Checked(
        name,
        len(iou),
        float(hits.mean()),
        float(probabilities.mean()),
        float((deviations <= 0.25).mean()),
        float((deviations <= 0.45).mean()),
        auroc(probabilities[sure], hits[sure]),
        brier(probabilities, hits),
        reliability(probabilities, hits),
    )


def _weights(data: Sequence[CalibrationData], videos: Mapping[str, Sequence[CalibrationData]]) -> Floats:
    """(frames,) weights: one for all frames of a video together, in all runs."""
    totals = {video: sum(datum.frames for datum in video_data) for video, video_data in videos.items()}
    return np.concatenate([np.full(datum.frames, 1.0 / totals[datum.video]) for datum in data])


def _ud_levels(ud_box: Floats, iou: Floats) -> dict[str, float]:
    """Help is called above nine tenths of the frames on target; below half of them an agent may go.

    References learn below two thirds of them, and where at least half of the frames off target are not.
    """
    on_ud, off_ud = ud_box[iou > ON_TARGET], ud_box[iou < OFF_TARGET]
    activate, deactivate, learn = (float(q) for q in np.quantile(on_ud, [0.9, 0.5, 2.0 / 3.0]))
    if len(off_ud):
        learn = min(learn, max(float(np.quantile(off_ud, 0.5)), 1e-4))
    return {"activate": activate, "deactivate": deactivate, "learn": learn}


def _temperatures(data: Sequence[CalibrationData]) -> dict[str, float]:
    """Agent -> the factor that surprises it least, averaged over the runs in which it was heard."""
    agents = dict.fromkeys(agent for datum in data for agent in datum.surprise)
    return {
        agent: float(
            TEMPERATURES[
                int(
                    np.argmin(
                        np.mean([datum.surprise[agent] for datum in data if agent in datum.surprise], axis=0)
                    )
                )
            ]
        )
        for agent in agents
    }
