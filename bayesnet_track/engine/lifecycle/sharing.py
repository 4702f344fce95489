"""Share the detections of a frame out among the targets of a plate and its tentative tracks, as arrays.

Targets that are advanced one by one and those that are rows of a table go through here alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from bayesnet_track.adapt.association import (
    GAP,
    LAST,
    UNASSIGNED,
    Owners,
    PartColumns,
    first_observed,
    observe_hypotheses,
)
from bayesnet_track.adapt.lifecycle import Candidate, look_again
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.belief import predict
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.rows.fitting import RowRule, row_rule
from bayesnet_track.graph.settings.lifecycle import Confirm
from bayesnet_track.graph.spec import Gaussian
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import AssociationRule

MOST_STEPS = 1000
"""Virtual detections in a gap: one an interval, as many as a video has in a minute, and no more."""


@dataclass(frozen=True, eq=False)
class Predict:
    """Prediction of beliefs.

    Attributes:
        elapsed: frame intervals from the last frame to this one.
        over: means (T, D), covariances (T, D, D), frame intervals -> those so much later.
    """

    elapsed: float
    over: Callable[[Floats, Floats, float], tuple[Floats, Floats]]

    def __call__(self, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
        """Means (T, D) and covariances (T, D, D) of the last frame in this one."""
        return self.over(means, covariances, self.elapsed)


def predictor(work: FrameContext, compiled: CompiledPlate) -> Predict:
    """The prediction of the targets of a plate from the last frame to this one.

    Exact of Gaussian beliefs under linear motion, else by moments and the motion's derivative.
    """
    frame, previous = work.frame, work.cache.frames.previous
    elapsed = 1.0 if previous is None else frame.time - previous.time
    rule = row_rule(work.engine, compiled.plate.name)
    if rule is None:
        motion = work.confined(compiled.moments)
        return Predict(elapsed, partial(_predict_each, motion))
    return Predict(elapsed, partial(_predict_rows, rule, image_of(rule, frame.width, frame.height)))


def _predict_rows(
    rule: RowRule, image: Floats, means: Floats, covariances: Floats, dt: float
) -> tuple[Floats, Floats]:
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.row_kernels import predict_rows

    return predict_rows(means, covariances, *_moves(rule, dt), image)


# Rules are told apart by identity: to hash a motion takes as long as to predict a crowd.
@lru_cache(maxsize=64)
def image_of(rule: RowRule, width: int, height: int) -> Floats:
    """(2,) width and height that targets are confined to."""
    return Confined(rule.motion, width, height).extent


@lru_cache(maxsize=64)
def _moves(rule: RowRule, dt: float) -> tuple[Floats, Floats]:
    return rule.motion.linearise(np.ones(len(rule.motion.fields)), dt)


def _predict_each(
    motion: MotionModel, means: Floats, covariances: Floats, dt: float
) -> tuple[Floats, Floats]:
    moments = [
        predict(mean, covariance, motion, dt, Gaussian())
        for mean, covariance in zip(means, covariances, strict=True)
    ]
    return (
        np.array([mean for mean, _ in moments]).reshape(means.shape),
        np.array([covariance for _, covariance in moments]).reshape(covariances.shape),
    )


@dataclass(frozen=True, eq=False)
class TrackArrays:
    """Tracks as arrays.

    Attributes:
        mean: (T, D) of their beliefs.
        covariance: (T, D, D).
        observed: (T, H) what is remembered of their detections.
    """

    mean: Floats
    covariance: Floats
    observed: Floats

    def and_tentative(self, candidates: Sequence[Candidate]) -> TrackArrays:
        """These, then tentative tracks."""
        if not candidates:
            return self
        return TrackArrays(
            np.concatenate([self.mean, np.array([candidate.mean for candidate in candidates])]),
            np.concatenate([self.covariance, np.array([candidate.covariance for candidate in candidates])]),
            np.concatenate([self.observed, np.array([candidate.observed for candidate in candidates])]),
        )

    def only(self, rows: slice) -> TrackArrays:
        """Some of them."""
        return TrackArrays(self.mean[rows], self.covariance[rows], self.observed[rows])


def own_detections(owner: Owners, boxes: Floats, scores: Floats) -> Floats:
    """(T, 5) the detection that each was given, centre box and score; 0 where none was."""
    assigned, is_given = np.zeros((len(owner), 5)), owner != UNASSIGNED
    assigned[is_given, :4], assigned[is_given, 4] = boxes[owner[is_given]], scores[owner[is_given]]
    return assigned


def follow_owners(
    rule: AssociationRule,
    previous: TrackArrays,
    expected: TrackArrays,
    owner: Owners,
    assigned: Floats,
    predict: Predict,
) -> tuple[TrackArrays, dict[int, tuple[Floats, Floats]]]:
    """Expectations after detections were given, and the beliefs of the frame before that changed, by row.

    A track that has a detection after a gap is filtered anew over the gap, where the rule says so; what is
    remembered of detections is brought up to this frame.
    """
    is_given = owner != UNASSIGNED
    refiltered: dict[int, tuple[Floats, Floats]] = {}
    mean, covariance = expected.mean, expected.covariance
    if rule.re_update:
        for row in np.flatnonzero(is_given & (previous.observed[:, GAP] > 0)).tolist():
            refiltered[row] = re_update(
                rule, previous.observed[row], assigned[row, :4], previous.mean.shape[1], predict
            )
            predicted = predict(refiltered[row][0][None], refiltered[row][1][None])
            mean[row], covariance[row] = predicted[0][0], predicted[1][0]
    moments = previous.mean, previous.covariance
    observed = observe_hypotheses(
        rule, previous.observed, moments, assigned[:, :4], is_given, predict.elapsed
    )
    return TrackArrays(mean, covariance, observed), refiltered


def re_update(
    rule: AssociationRule, observed: Floats, box: Floats, size: int, predict: Predict
) -> tuple[Floats, Floats]:
    """Belief of the frame before, filtered anew from the last detection on (Cao et al. 2023, section 4.1).

    For every frame interval of the gap, which ends with the frame before, a box on the line from the last
    detection to the new one is taken for what was detected. The new one itself is left to the update of this
    frame.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.row_kernels import correct_row

    layout, gap, last_box = PartColumns.of(rule, size), float(observed[GAP]), observed[LAST]
    steps = int(min(max(round(gap), 1), MOST_STEPS))
    mean, covariance = observed[layout.mean], observed[layout.covariance].reshape(size, size)
    for step in range(1, steps + 1):
        means, covariances = predict.over(mean[None], covariance[None], gap / steps)
        mean, covariance = means[0], covariances[0]
        virtual = last_box + (box - last_box) * (step * (gap / steps) / (gap + predict.elapsed))
        correct_row(mean, covariance, virtual - mean[:4], rule.variances(virtual), np.empty((3, size, size)))
        np.maximum(mean[2:4], 1.0, out=mean[2:4])
    return mean, covariance


def start_tentative(
    rule: AssociationRule, box: Floats, score: float, first: tuple[int, str], moments: tuple[Floats, Floats]
) -> Candidate:
    """A tentative track that starts with a detection: its frame and birth, its first moments."""
    mean, covariance = moments
    observed = first_observed(rule, box[None], len(mean))[0]
    return Candidate(box.copy(), np.zeros(2), (score,), *first, mean, covariance, observed=observed)


def update_tentative(
    candidates: Sequence[Candidate],
    updated: TrackArrays,
    assigned: Floats,
    variances: Floats,
    confirm: Confirm | None,
) -> tuple[Candidate, ...]:
    """Tentative tracks after a frame: those given a detection in `assigned` (C, 5) are updated by it.

    Without `confirm` nobody looked. Others go on as predicted; those given up are left out.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.row_kernels import correct_row

    survivors = []
    for row, candidate in enumerate(candidates):
        mean, covariance, size = (
            updated.mean[row].copy(),
            updated.covariance[row].copy(),
            updated.mean.shape[1],
        )
        is_given = bool(assigned[row, 2] > 0)
        if is_given:
            work = np.empty((3, size, size))
            correct_row(mean, covariance, assigned[row, :4] - mean[:4], variances[row], work)
            np.maximum(mean[2:4], 1.0, out=mean[2:4])
        survivor: Candidate | None = candidate
        if confirm is not None:
            box, score = (assigned[row, :4], float(assigned[row, 4])) if is_given else (None, None)
            survivor = look_again(candidate, box, score, confirm)
        if survivor is not None:
            survivors.append(
                replace(survivor, mean=mean, covariance=covariance, observed=updated.observed[row].copy())
            )
    return tuple(survivors)
