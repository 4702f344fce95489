"""The first belief of a target from all detections of its candidate."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bayesnet_track.adapt.lifecycle import FOLLOW_BOX, Candidate
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import plain
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import AssociationRule
from bayesnet_track.observation.planes import for_reading

VELOCITY = ("vx", "vy")

MIN_DETECTIONS = 3
"""Of two detections each velocity is the way of one object."""

ROUTE = 0.999
"""Detections are one object's way if none is farther from its prediction than this share of right ones."""


def initiate(compiled: CompiledPlate, candidate: Candidate) -> Candidate:
    """A candidate with the moments of its state if it moves faster than the graph's start velocities say.

    The filter runs from the first detection on, with the start velocity of the graph. If a detection is
    outside its gate, it runs again with a velocity that is known only by how far a candidate is followed
    (`FOLLOW_BOX` sides a frame). If all further detections are inside then, they tell the velocity; else they
    are no way of one object, and the target starts in the last detection, as one does that fits at once.
    """
    if candidate.mean is not None or len(candidate.track) < MIN_DETECTIONS or not has_way(compiled):
        return candidate
    rule = next(iter(compiled.association_rules.values()))
    mean, covariance = compiled.moments.start_moments(candidate.track[0][1])
    limit = chi_square_quantile(ROUTE, 4)
    if _follow(compiled.moments, rule, candidate, (mean, covariance))[2] <= limit:
        return candidate
    fast = fast_covariance(compiled.moments, covariance, mean)
    mean, covariance, d2 = _follow(compiled.moments, rule, candidate, (mean, fast))
    return candidate if d2 > limit else evolve(candidate, mean=mean, covariance=covariance)


def has_way(compiled: CompiledPlate) -> bool:
    """True if the detections of a plate tell the velocity of a target: by their density, where it has one."""
    is_dense = any(rule.similarity == "density" for rule in compiled.association_rules.values())
    return is_dense and is_moving(compiled.moments)


def is_moving(motion: MotionModel) -> bool:
    """True if a target has a velocity."""
    return all(name in motion.fields for name in VELOCITY)


def velocities(motion: MotionModel, means: Floats) -> Floats:
    """(T, 2) velocities of states (T, D), px a frame interval; 0 of a motion without one."""
    if not is_moving(motion):
        return np.zeros((len(means), 2))
    return means[:, [motion.fields.index(name) for name in VELOCITY]]


def fast_covariance(motion: MotionModel, covariance: Floats, mean: Floats) -> Floats:
    """(..., D, D) covariances of starts at (..., D) with a velocity of sd `FOLLOW_BOX` sides a frame."""
    fast, sides2 = covariance.copy(), mean[..., 2] * mean[..., 3]
    for index in (motion.fields.index(name) for name in VELOCITY):
        fast[..., index, index] = np.maximum(fast[..., index, index], FOLLOW_BOX**2 * sides2)
    return fast


def _follow(
    motion: MotionModel, rule: AssociationRule, candidate: Candidate, moments: tuple[Floats, Floats]
) -> tuple[Floats, Floats, float]:
    """Mean (D,) and covariance (D, D) after a candidate's detections, and the largest d^2 of one.

    d is its distance from its prediction, in sds. `moments` are those of a start in the first detection as if
    that had no errors.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.row_kernels import follow_row

    mean, covariance, largest = *(np.array(part) for part in moments), 0.0
    boxes = np.array([box for _, box in candidate.track])
    variances, shift = np.ascontiguousarray(rule.variances(boxes)), np.zeros(len(mean))
    covariance[range(4), range(4)] += variances[0]
    for row, ((start, _), (end, _)) in enumerate(pairwise(candidate.track), 1):
        transition, noise = motion.linearise(mean, end - start)
        if not isinstance(motion, KinematicMotion):
            shift = motion.drift(mean[None], end - start)[0] - transition @ mean
        move = for_reading(transition), plain(noise), shift
        largest = max(largest, follow_row(mean, covariance, move, boxes[row], variances[row]))
    return mean, covariance, largest
