"""Refusals of detections beside targets without one: recorded, and reported when these are lost or end.

Of each such target, the first detection beside it since its last one is kept, or a far nearer one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.adapt.association import UNASSIGNED, distances
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.lifecycle.unconfirmed import velocities
from bayesnet_track.engine.rows.columns import Rows
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joins import DetectionRefused, Refusal
from bayesnet_track.journal.events.lives import TargetDied
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import AssociationRule

BESIDE_BOX = 3.0
"""A detection is beside a target within so many box sides of where the target is expected."""
NEARER = 0.5
"""A later detection takes the place of an earlier one within this share of its distance."""
ROUNDING_PX = 0.05
"""By so much less than their distance two boxes may be apart in a refusal, which rounds them."""


@dataclass(frozen=True, eq=False)
class Unmatched:
    """M targets without a detection, and the K detections of a frame that no target has.

    Attributes:
        names: the targets.
        mean: (M, D) as they are expected.
        covariance: (M, D, D).
        velocity: (M, 2) px a frame interval, by their velocities.
        gaps: (M,) frame intervals since their last detections.
        boxes: (K, 4) the detections.
        is_shared: whether targets share detections by probability.
    """

    names: Sequence[str]
    mean: Floats
    covariance: Floats
    velocity: Floats
    gaps: Sequence[int]
    boxes: Floats
    is_shared: bool


def record_refusals(
    compiled: CompiledPlate,
    frame: int,
    history: TrackHistory,
    tracks: tuple[Sequence[str], Rows | None],
    expected: tuple[Floats, Floats],
    assigned: tuple[Bools, Ints, Floats],
) -> TrackHistory:
    """The history with the refusals of a frame.

    Args:
        compiled: the plate.
        frame: index of the frame.
        history: as it was.
        tracks: names of its targets (T,), and the table of those that are rows, which come first.
        expected: means (T or more, D) and covariances of the targets, and of tentative tracks after them.
        assigned: (T,) whether each target is given a detection, (T,) or more owned columns, and (N, 4) the
            detections.
    """
    (names, rows), (has_own, owner, boxes), earlier = tracks, assigned, history.refusals
    missed = np.flatnonzero(~has_own[: len(names)])
    unmatched = [names[row] for row in missed.tolist()]
    matched = {*names}.difference(unmatched) if earlier else ()
    refusals = {target: refusal for target, refusal in earlier.items() if target not in matched}
    is_free = np.ones(len(boxes), dtype=np.bool_)
    columns = owner[: len(names)]
    is_free[columns[columns != UNASSIGNED]] = False
    if len(missed) and is_free.any():
        agent, rule = next(iter(compiled.association_rules.items()))
        mean, covariance = (of_all[missed] for of_all in expected)
        gaps = _gaps(names, rows, history, missed)
        is_shared = compiled.plate.spec.associate == "marginal"
        velocity = velocities(compiled.moments, mean)
        unmatched_targets = Unmatched(unmatched, mean, covariance, velocity, gaps, boxes[is_free], is_shared)
        refusals |= _refuse(rule, agent, frame, unmatched_targets, earlier)
    return history if refusals == earlier else evolve(history, refusals=refusals)


def _gaps(names: Sequence[str], rows: Rows | None, history: TrackHistory, missed: Ints) -> list[int]:
    """Frames since the last detection of each."""
    count = 0 if rows is None else len(rows.ids)
    gaps = []
    for row in missed.tolist():
        if rows is not None and row < count:
            unseen = int(rows.columns.unseen_frames[row])
        else:
            record = history.records.get(names[row])
            unseen = 0 if record is None else record.unseen_frames
        gaps.append(unseen + 1)
    return gaps


def report_refusals(
    history: TrackHistory, frame: int, events: Sequence[Event], nets: Mapping[str, TargetNet]
) -> tuple[TrackHistory, Sequence[DetectionRefused]]:
    """Reports of targets that are lost or end by the events of a frame, one until they are seen again."""
    refusals = history.refusals
    if not refusals:
        return history, ()
    finished = [
        event.target
        for event in events
        if isinstance(event, TargetDied) or (isinstance(event, StatusChanged) and event.status == "lost")
    ]
    reported = {
        target: refusal
        for target in finished
        if _is_gone(nets, target) and (refusal := refusals.get(target)) is not None
    }
    remaining = {
        target: None if target in reported else refusal
        for target, refusal in refusals.items()
        if target in nets
    }
    if remaining != refusals:
        history = evolve(history, refusals=remaining)
    return history, [DetectionRefused(frame, *of_target) for of_target in reported.items()]


def _refuse(
    rule: AssociationRule, agent: str, frame: int, unmatched: Unmatched, earlier: Mapping[str, Refusal | None]
) -> dict[str, Refusal]:
    """Target -> the detection beside it that was nearest to being its own, where none was as near `earlier`.

    Only what is new; of a target with None in `earlier`, nothing.
    """
    is_beside = distances(unmatched.mean[:, :4], unmatched.boxes) <= BESIDE_BOX
    offsets = np.hypot(*(unmatched.mean[:, None, k] - unmatched.boxes[:, k] for k in (0, 1)))
    nearest_px = np.where(is_beside, offsets, np.inf).min(axis=1) - ROUNDING_PX
    for row in np.flatnonzero(is_beside.any(axis=1)).tolist():
        target = unmatched.names[row]
        refusal = earlier.get(target)
        if target in earlier and (refusal is None or nearest_px[row] >= NEARER * refusal.distance_px):
            is_beside[row] = False
    rows, columns = np.nonzero(is_beside)
    if not len(rows):
        return {}
    nearest, d2s, shared = _nearest(rule, unmatched, (rows, columns))
    rows, columns, closer = rows[nearest], columns[nearest], []
    for k, (row, column) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
        refusal = earlier.get(unmatched.names[row])
        if refusal is not None:
            offset_px = math.dist(_box(unmatched.boxes[column])[:2], _box(unmatched.mean[row])[:2])
            if offset_px >= NEARER * refusal.distance_px:
                continue
        closer.append(k)
    pairs = rows[closer], columns[closer]
    refusals = _refusals(
        rule, agent, frame, unmatched, pairs, (d2s[nearest][closer], shared[nearest][closer])
    )
    return {unmatched.names[row]: refusal for row, refusal in zip(pairs[0].tolist(), refusals, strict=True)}


def _nearest(
    rule: AssociationRule, unmatched: Unmatched, pairs: tuple[Ints, Ints]
) -> tuple[Ints, Floats, Floats]:
    """Pair of each target that was the least beyond the bounds; (P,) squared distances and overlaps of all.

    Pairs of a target and a detection, rows and columns (P,), are in the order of the rows.
    """
    rows, columns = pairs
    boxes, means = unmatched.boxes[columns], unmatched.mean[rows]
    shared, d2s = overlap(boxes, means[:, :4]), np.zeros(len(rows))
    beyond = np.ones(len(rows))
    if rule.similarity == "density":
        d2s = _squared_distances(boxes - means[:, :4], _spreads(rule, unmatched, pairs))
        beyond = np.maximum(d2s / chi_square_quantile(rule.gate, 4), 1.0)
    excess = beyond + np.maximum(rule.min_overlap - shared, 0.0)
    order = np.lexsort((np.arange(len(rows)), excess, rows))
    firsts = np.flatnonzero(np.diff(rows[order], prepend=-1))
    return order[firsts], d2s, shared


def _spreads(rule: AssociationRule, unmatched: Unmatched, pairs: tuple[Ints, Ints]) -> Floats:
    """(P, 4, 4) covariances of detections about where targets are expected."""
    rows, columns = pairs
    variances = rule.variances(unmatched.boxes[columns])
    return np.asarray(unmatched.covariance[rows, :4, :4] + variances[:, :, None] * np.eye(4))


def _refusals(
    rule: AssociationRule,
    agent: str,
    frame: int,
    unmatched: Unmatched,
    pairs: tuple[Ints, Ints],
    nearness: tuple[Floats, Floats],
) -> list[Refusal]:
    """The refusals of pairs of a target and a detection, of these squared distances and overlaps (P,)."""
    (rows, columns), (d2s, shared) = pairs, nearness
    if not len(rows):
        return []
    boxes, means, gaps = unmatched.boxes[columns], unmatched.mean[rows], np.array(unmatched.gaps)[rows]
    spreads = _spreads(rule, unmatched, pairs)
    offsets, sides = boxes - means[:, :4], np.sqrt(np.maximum(means[:, 2] * means[:, 3], 1e-12))
    ways = (offsets[:, :2], offsets[:, :2] + unmatched.velocity[rows] * gaps[:, None])
    reach = np.minimum(*(np.hypot(*way.T) for way in ways)) / sides / gaps
    numbers = zip(
        boxes,
        means,
        gaps.tolist(),
        d2s.tolist() if rule.similarity == "density" else [None] * len(rows),
        _squared_distances(offsets[:, :2], spreads[:, :2, :2]).tolist(),
        shared.tolist(),
        reach.tolist(),
        strict=True,
    )
    limit = chi_square_quantile(rule.gate, 4)
    return [
        Refusal(
            frame,
            agent,
            _box(box),
            _box(mean),
            gap,
            d2,
            place_d2,
            limit,
            rule.gate,
            area,
            rule.min_overlap,
            distance,
            rule.continue_box,
            unmatched.is_shared,
        )
        for box, mean, gap, d2, place_d2, area, distance in numbers
    ]


def _squared_distances(offsets: Floats, spreads: Floats) -> Floats:
    """(P,) Mahalanobis distances squared of offsets (P, K) with covariances (P, K, K)."""
    return np.asarray(np.einsum("pk,pk->p", offsets, np.linalg.solve(spreads, offsets[..., None])[..., 0]))


def _box(values: Floats) -> tuple[float, float, float, float]:
    x, y, w, h = values[:4].tolist()
    return round(x, 2), round(y, 2), round(w, 2), round(h, 2)


def _is_gone(nets: Mapping[str, TargetNet], target: str) -> bool:
    """True if a target has ended or is lost, after all decisions of a frame."""
    return target not in nets or nets[target].status == "lost"
