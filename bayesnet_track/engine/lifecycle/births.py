"""What becomes of detections that are no target's: lost targets are found, candidates wait, targets start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayesnet_track.adapt.association import UNASSIGNED, alike, associate
from bayesnet_track.adapt.existence import UnconfirmedTracks
from bayesnet_track.adapt.lifecycle import ALONE_BOX, Candidate, FreeDetections, feed, is_confirmed, keep_best
from bayesnet_track.adapt.presence import Known
from bayesnet_track.engine.lifecycle.confirming import (
    TESTED,
    Births,
    box_of,
    match_known,
    start_confirmed,
    start_record,
)
from bayesnet_track.engine.lifecycle.ends import remember
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


def give_birth(now: Births, found: Found, owners: tuple[str | None, ...] | None) -> None:
    """What becomes of a plate's detections; `owners` says whose each is where they were given before."""
    tracks, apart, covered = now.tracks, now.birth.min_distance_box, now.birth.covered
    if owners is None:
        held = tracks.held(now.plate)
        sd = np.array([_sd_px(tracks.state(target)) for target in held])
        owner, free = associate(found.boxes, tracks.boxes(held), sd, apart, covered)
        seen = [held[k] for k in owner if k != UNASSIGNED]
    else:
        seen = [target for target in owners if target]
        free = np.array([one is None for one in owners], dtype=bool)
        if free.any():
            near = tracks.boxes(list(dict.fromkeys([*tracks.held(now.plate), *seen])))
            free[free] = ~alike(found.boxes[free], near, apart, covered).any(axis=1)
    tracks.mark_seen(seen)
    if not free.any() and tracks.history.candidates.get(now.plate) == ():
        return
    found = found.only(free)
    at = _find_lost(now, found, seen)
    if len(at):
        found = found.only(np.logical_not(np.any(alike(found.boxes, at, apart, covered), axis=1)))
    found = found.only(found.scores >= now.birth.min_score)
    waiting = _wait(now, found)
    ready = sorted(
        (k for k, one in enumerate(waiting) if is_confirmed(one, now.birth.confirm)),
        key=lambda k: (-waiting[k].score, k),
    )
    done = start_confirmed(now, [waiting[k] for k in ready], found)
    gone = {*map(id, done)}
    left = tuple(one for one in waiting if id(one) not in gone)
    tracks.history = evolve(tracks.history, candidates={**tracks.history.candidates, now.plate: left})


def give_birth_by_existence(now: Births, found: Found, owners: tuple[str | None, ...] | None) -> None:
    """What of a plate's unconfirmed tracks becomes targets."""
    tracks, plate = now.tracks, now.plate
    rule = CrowdRule.of(now.work.engine.plates[plate])
    if rule is None:
        return
    if owners is None:  # of a first frame nothing was given before
        held = tracks.boxes(tracks.held(plate))
        near = alike(found.boxes, held, now.birth.min_distance_box, now.birth.covered)
        free = found.only(np.logical_not(np.any(near, axis=1)))
        detection_model = first_population(rule, free, now.frame)
    else:
        tracks.mark_seen([target for target in owners if target is not None])
        detection_model = tracks.history.detection_models[plate]
    ready = confirmed(rule, detection_model.unconfirmed, plate, now.frame.time)
    if ready:
        done = start_confirmed(now, list(ready.values()), found)
        unconfirmed = detection_model.unconfirmed
        rows = [row for row, one in ready.items() if any(one is other for other in done)]
        left = np.ones(len(unconfirmed), dtype=bool)
        left[rows] = False
        known = _with_born(detection_model.known, tracks.history.births, ready, unconfirmed)
        detection_model = evolve(detection_model, unconfirmed=unconfirmed.take(left), known=known)
    tracks.history = evolve(
        tracks.history, detection_models={**tracks.history.detection_models, plate: detection_model}
    )


def _with_born(
    known: Known, births: Mapping[str, str], ready: Mapping[int, Candidate], unconfirmed: UnconfirmedTracks
) -> Known:
    """The presence of targets, with that of those which unconfirmed tracks have become."""
    rows = {one.birth: row for row, one in ready.items()}
    born = {target: rows[birth] for target, birth in births.items() if birth in rows}
    names = [name for name in known.names if name not in born]
    both = known.of(names).extend(unconfirmed.presence.take(np.array([*born.values()], np.int64)))
    return Known((*names, *born), both)


def _wait(now: Births, found: Found) -> tuple[Candidate, ...]:
    """The candidates of a plate after the look, in which nobody was given these detections."""
    before, frame = now.tracks.history.candidates.get(now.plate, ()), now.frame.index
    births = [birth_key(now.frame.time, now.plate, number) for number in found.numbers.tolist()]
    compiled = now.work.engine.plates[now.plate]
    by = next((one.label for one in compiled.association_rules.values() if one.label is not None), None)
    labels = None if by is None else by.log(found.labels)
    if not now.birth.tentative:
        alone_box = ALONE_BOX if has_way(compiled) else 0.0
        free = FreeDetections(found.boxes, found.scores, births, frame, now.frame.time, alone_box, labels)
        return feed(before, free, now.birth)
    rule = next(iter(compiled.association_rules.values()))
    new = [
        start_tentative(rule, box, float(score), (frame, birth), compiled.moments.start_moments(box))
        for box, score, birth in zip(found.boxes, found.scores, births, strict=True)
    ]
    if labels is not None:
        new = [one.told(said) for one, said in zip(new, labels, strict=True)]
    return keep_best([*before, *new], now.birth)


def _find_lost(now: Births, found: Found, seen: Sequence[str]) -> Floats:
    """Lost targets whose looks a free detection has start again there: (K, 4) where; not those `seen`."""
    tracks, reidentify = now.tracks, now.rule.reidentify
    places = np.empty((0, 4))
    if reidentify is None or not reidentify.lost:
        return places
    held = {*tracks.held(now.plate), *seen}
    lost = [target for target in tracks.of_plate(now.plate) if target not in held]
    if not lost:
        return places
    boxes = found.boxes[:TESTED]
    known = [remember(tracks, target, now.plate) for target in lost]
    for one in match_known(now, known, boxes, found.boxes):
        target, box = one.recognition.target, boxes[one.detection]
        if not one.is_sure:
            continue
        state = restart(now.work, target, now.plate, box, tracks.state(target))
        tracks.decide(Reacquired(now.frame.index, target, box_of(box), one.recognition))
        since = tracks.record(target).since
        tracks.put_back(target, state, start_record(state, since, now.frame))
        places = np.vstack([places, box])
    return places


def _sd_px(state: TargetState) -> float:
    return math.sqrt(max(float(np.mean(np.diag(state.belief.covariance)[:2])), 0.0))
