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
from bayesnet_track.engine.lifecycle.initiating import velocities
from bayesnet_track.engine.rows.columns import Rows
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import TargetDied
from bayesnet_track.journal.events.refused import DetectionRefused, Refusal
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import AssociationRule

BESIDE_BOX = 3.0
"""A detection is beside a target within so many box sides of where the target is expected."""
NEARER = 0.5
"""A later detection takes the place of an earlier one within this share of its distance."""


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
    refused: dict[str, Refusal] = {}
    is_beside = distances(unmatched.mean[:, :4], unmatched.boxes) <= BESIDE_BOX
    for row in np.flatnonzero(is_beside.any(axis=1)).tolist():
        target = unmatched.names[row]
        refusal = earlier.get(target)
        if target in earlier and refusal is None:
            continue
        columns = np.flatnonzero(is_beside[row]).tolist()
        candidates = [_refusal(rule, agent, frame, unmatched, row, column) for column in columns]
        nearest = min(candidates, key=lambda candidate: candidate.excess)
        if refusal is None or nearest.distance_px < NEARER * refusal.distance_px:
            refused[target] = nearest
    return refused


def _refusal(
    rule: AssociationRule, agent: str, frame: int, unmatched: Unmatched, row: int, column: int
) -> Refusal:
    box, mean, gap = unmatched.boxes[column], unmatched.mean[row], unmatched.gaps[row]
    spread = unmatched.covariance[row, :4, :4] + np.diag(rule.variances(box))
    offset = box - mean[:4]
    has_gate = rule.similarity == "density"
    d2 = float(offset @ np.linalg.solve(spread, offset)) if has_gate else None
    steps = (offset[:2], offset[:2] + unmatched.velocity[row] * gap)
    sides = math.sqrt(max(float(mean[2] * mean[3]), 1e-12))
    return Refusal(
        frame,
        agent,
        _box(box),
        _box(mean),
        gap,
        d2,
        float(offset[:2] @ np.linalg.solve(spread[:2, :2], offset[:2])),
        chi_square_quantile(rule.gate, 4),
        rule.gate,
        float(overlap(box[None], mean[:4])[0]),
        rule.min_overlap,
        min(float(np.hypot(*step)) for step in steps) / sides / gap,
        rule.continue_box,
        unmatched.is_shared,
    )


def _box(values: Floats) -> tuple[float, float, float, float]:
    x, y, w, h = (round(float(value), 2) for value in values[:4])
    return x, y, w, h


def _is_gone(nets: Mapping[str, TargetNet], target: str) -> bool:
    """True if a target has ended or is lost, after all decisions of a frame."""
    return target not in nets or nets[target].status == "lost"
