"""What becomes of detections that are no target's: lost targets are found, candidates wait, targets start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayesnet_track.adapt.association import UNASSIGNED, alike, associate
from bayesnet_track.adapt.existence import UnconfirmedTracks
from bayesnet_track.adapt.lifecycle import (
    ALONE_BOX,
    Candidate,
    FreeDetections,
    feed,
    is_confirmed,
    keep_candidates,
)
from bayesnet_track.adapt.presence import Known
from bayesnet_track.engine.lifecycle.confirming import (
    TESTED,
    Births,
    box_of,
    match_known,
    start_confirmed,
    start_record,
)
from bayesnet_track.engine.lifecycle.ends import memory_of
from bayesnet_track.engine.lifecycle.initiating import has_way
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.engine.lifecycle.sharing import start_tentative
from bayesnet_track.engine.lifecycle.unconfirmed import CrowdRule, confirmed, first_population
from bayesnet_track.engine.starting import restart
from bayesnet_track.engine.state import TargetState
from bayesnet_track.journal.events.lives import Reacquired
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.numerics.streams import birth_key


def give_birth(births: Births, detections: Found, owners: tuple[str | None, ...] | None) -> None:
    """Start targets from a plate's detections; `owners` says whose each is where they were given before."""
    tracks, distance_box, covered = births.tracks, births.birth.min_distance_box, births.birth.covered
    if owners is None:
        live = tracks.held(births.plate)
        sd = np.array([_sd_px(tracks.state(target)) for target in live])
        owner, free = associate(detections.boxes, tracks.boxes(live), sd, distance_box, covered)
        claimed = [live[k] for k in owner if k != UNASSIGNED]
    else:
        claimed = [target for target in owners if target]
        free = np.array([name is None for name in owners], dtype=bool)
        if free.any():
            boxes = tracks.boxes(list(dict.fromkeys([*tracks.held(births.plate), *claimed])))
            free[free] = ~alike(detections.boxes[free], boxes, distance_box, covered).any(axis=1)
    tracks.mark_seen(claimed)
    if not free.any() and tracks.history.candidates.get(births.plate) == ():
        return
    detections = detections.only(free)
    restarts = _find_lost(births, detections, claimed)
    if len(restarts):
        detections = detections.only(
            np.logical_not(np.any(alike(detections.boxes, restarts, distance_box, covered), axis=1))
        )
    detections = detections.only(detections.scores >= births.birth.min_score)
    waiting = _wait(births, detections)
    ready = sorted(
        (k for k, candidate in enumerate(waiting) if is_confirmed(candidate, births.birth.confirm)),
        key=lambda k: (-waiting[k].score, k),
    )
    born = start_confirmed(births, [waiting[k] for k in ready], detections)
    gone = {*map(id, born)}
    remaining = tuple(candidate for candidate in waiting if id(candidate) not in gone)
    tracks.history = evolve(tracks.history, candidates={**tracks.history.candidates, births.plate: remaining})


def give_birth_by_existence(births: Births, detections: Found, owners: tuple[str | None, ...] | None) -> None:
    """Make targets of a plate's unconfirmed tracks."""
    tracks, plate = births.tracks, births.plate
    rule = CrowdRule.of(births.work.engine.plates[plate])
    if rule is None:
        return
    if owners is None:  # of a first frame nothing was given before
        boxes = tracks.boxes(tracks.held(plate))
        is_near = alike(detections.boxes, boxes, births.birth.min_distance_box, births.birth.covered)
        free = detections.only(np.logical_not(np.any(is_near, axis=1)))
        detection_model = first_population(rule, free, births.frame)
    else:
        tracks.mark_seen([target for target in owners if target is not None])
        detection_model = tracks.history.detection_models[plate]
    ready = confirmed(rule, detection_model.unconfirmed, plate, births.frame.time)
    if ready:
        born = start_confirmed(births, list(ready.values()), detections)
        unconfirmed = detection_model.unconfirmed
        rows = [row for row, candidate in ready.items() if any(candidate is entry for entry in born)]
        is_waiting = np.ones(len(unconfirmed), dtype=bool)
        is_waiting[rows] = False
        presences = _with_born(detection_model.known, tracks.history.births, ready, unconfirmed)
        detection_model = evolve(detection_model, unconfirmed=unconfirmed.take(is_waiting), known=presences)
    tracks.history = evolve(
        tracks.history, detection_models={**tracks.history.detection_models, plate: detection_model}
    )


def _with_born(
    presences: Known,
    births: Mapping[str, str],
    ready: Mapping[int, Candidate],
    unconfirmed: UnconfirmedTracks,
) -> Known:
    """The presence of targets, with that of those which unconfirmed tracks have become."""
    rows = {candidate.birth: row for row, candidate in ready.items()}
    born = {target: rows[birth] for target, birth in births.items() if birth in rows}
    names = [name for name in presences.names if name not in born]
    presence = presences.of(names).extend(unconfirmed.presence.take(np.array([*born.values()], np.int64)))
    return Known((*names, *born), presence)


def _wait(births: Births, detections: Found) -> tuple[Candidate, ...]:
    """The candidates of a plate after the look, in which nobody was given these detections."""
    previous, frame = births.tracks.history.candidates.get(births.plate, ()), births.frame.index
    keys = [birth_key(births.frame.time, births.plate, number) for number in detections.numbers.tolist()]
    compiled = births.work.engine.plates[births.plate]
    label_rule = next(
        (settings.label for settings in compiled.association_rules.values() if settings.label is not None),
        None,
    )
    labels = None if label_rule is None else label_rule.log(detections.labels)
    if not births.birth.tentative:
        alone_box = ALONE_BOX if has_way(compiled) else 0.0
        free = FreeDetections(
            detections.boxes, detections.scores, keys, frame, births.frame.time, alone_box, labels
        )
        return feed(previous, free, births.birth)
    rule = next(iter(compiled.association_rules.values()))
    candidates = [
        start_tentative(rule, box, float(score), (frame, birth), compiled.moments.start_moments(box))
        for box, score, birth in zip(detections.boxes, detections.scores, keys, strict=True)
    ]
    if labels is not None:
        candidates = [candidate.told(log) for candidate, log in zip(candidates, labels, strict=True)]
    return keep_candidates([*previous, *candidates], births.birth)


def _find_lost(births: Births, detections: Found, claimed: Sequence[str]) -> Floats:
    """Lost targets whose looks a free detection has start again there: (K, 4) where; not those `claimed`."""
    tracks, reidentify = births.tracks, births.rule.reidentify
    places = np.empty((0, 4))
    if reidentify is None or not reidentify.lost:
        return places
    located = {*tracks.held(births.plate), *claimed}
    lost = [target for target in tracks.of_plate(births.plate) if target not in located]
    if not lost:
        return places
    boxes = detections.boxes[:TESTED]
    memories = [memory_of(tracks, target, births.plate) for target in lost]
    for entry in match_known(births, memories, boxes, detections.boxes):
        target, box = entry.recognition.target, boxes[entry.detection]
        if not entry.is_sure:
            continue
        state = restart(births.work, target, births.plate, box, tracks.state(target))
        tracks.decide(Reacquired(births.frame.index, target, box_of(box), entry.recognition))
        start = tracks.record(target).since
        tracks.put_back(target, state, start_record(state, start, births.frame))
        places = np.vstack([places, box])
    return places


def _sd_px(state: TargetState) -> float:
    return math.sqrt(max(float(np.mean(np.diag(state.belief.covariance)[:2])), 0.0))
