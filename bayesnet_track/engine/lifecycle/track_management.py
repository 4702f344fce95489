"""The life of targets in one frame: detections become targets, lost ones are found, nets end.

`manage_tracks` comes after every live target is finished. Detectors look; live targets are given what they
hold; what is left is compared with the lost, gathers looks, and becomes a target, an old one when it is
recognised. Then the younger of two nets that hold one object ends, and those that were lost for too long or
hardly exist. All of it is a function of the engine, what is remembered and the frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayesnet_track.adapt.association import UNASSIGNED, alike, associate
from bayesnet_track.adapt.existence import UnconfirmedTracks
from bayesnet_track.adapt.lifecycle import (
    ALONE_BOX,
    AppearanceMemory,
    Candidate,
    FreeDetections,
    feed,
    is_confirmed,
    keep_candidates,
    overlapping,
)
from bayesnet_track.adapt.presence import Known
from bayesnet_track.belief.motion.modes import moments_of
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.association import Associated, associate_new
from bayesnet_track.engine.lifecycle.confirming import (
    TESTED,
    Births,
    box_of,
    match_known,
    start_confirmed,
    start_record,
)
from bayesnet_track.engine.lifecycle.detecting import look
from bayesnet_track.engine.lifecycle.refusing import report_refusals
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.engine.lifecycle.sharing import start_tentative
from bayesnet_track.engine.lifecycle.track_table import LiveTable
from bayesnet_track.engine.lifecycle.unconfirmed import CrowdRule, confirmed, first_population, has_way
from bayesnet_track.engine.outcome import Outcome
from bayesnet_track.engine.starting import restart
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.lifecycle import LifeRules
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import DuplicateEnded, Reacquired, TargetDied
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.numerics.streams import birth_key
from bayesnet_track.observation.planes import Frame


def manage_tracks(work: FrameContext, outcome: Outcome, associated: Associated | None = None) -> Outcome:
    """The outcome after the frame's births, returns and deaths; as it is where no plate has any.

    `associated` holds what the detectors found, and whose it is, where they looked before targets were
    weighed.
    """
    frame, plates, start = work.frame, work.engine.plates, work.engine.clock()
    rules = {
        plate: compiled.lifecycle for plate, compiled in plates.items() if compiled.lifecycle is not None
    }
    if not rules:
        return outcome
    tracks = LiveTable.of(work.engine, outcome)
    if associated is None:
        detections, tracks.history, looked_by = look(work, tracks.history, tracks.boxes, tracks.held)
        events: tuple[Event, ...] = looked_by
    else:
        detections, events = associated.found, associated.events
        looked = associated.history
        tracks.history = evolve(
            tracks.history,
            detectors=looked.detectors,
            failed=looked.failed,
            detection_models=looked.detection_models,
            candidates=looked.candidates,
            refusals=looked.refusals,
            watches=looked.watches,
        )
    looks = {plate: _is_looked(rule, plates[plate], plate in detections) for plate, rule in rules.items()}
    tracks.count(looks, frame)
    tracks.events += events
    for plate, rule in rules.items():
        if rule.birth is None:
            continue
        births = Births(work, tracks, plate, rule, rule.birth)
        owners = None if associated is None else associated.owners.get(plate)
        if plates[plate].plate.inverses or not plates[plate].has_one_image:
            # Detections are no boxes in one image, which could be compared with others.
            if associated is None:
                tracks.history, owners = associate_new(work, plate, tracks.history, detections), ()
            _give_birth_by_existence(births, Found.none(), owners)
        elif plate in detections:
            give = _give_birth if rule.existence is None else _give_birth_by_existence
            (answer,) = detections[plate].values()
            give(births, answer, owners)
    for plate, rule in rules.items():
        _end_duplicates(tracks, plate, rule, frame)
        _end_lost(tracks, plate, rule, frame)
    happened = (*outcome.events, *tracks.events)
    tracks.history, refused = report_refusals(tracks.history, frame.index, happened, tracks.net.targets)
    tracks.events += refused
    work.charge("life", start)
    return evolve(tracks.outcome(outcome, frame), seconds=work.seconds)


def _is_looked(rule: LifeRules, compiled: CompiledPlate, has_looked: bool) -> bool:
    """True where targets of a plate that claim no detection in the frame are unseen: somebody looked."""
    return has_looked or rule.birth is None or bool(compiled.plate.inverses)


REMEMBERED = 4
"""Dead targets that are remembered, in multiples of `birth.max_targets`."""


def _end_duplicates(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """The younger of two nets whose beliefs hold one object ends; joined ones are known to be two."""
    if rule.merge_duplicates is None:
        return
    live, previous = tracks.held(plate), tracks.history.overlaps
    of_plate = set(tracks.of_plate(plate)) if previous else set()
    elsewhere = {pair: streak for pair, streak in previous.items() if not of_plate.intersection(pair)}
    streaks = overlapping(live, *tracks.beliefs(live), previous, rule.merge_duplicates)
    if not streaks and not previous:
        return
    joined = {frozenset(pair) for pair in tracks.net.joins}
    streaks = {pair: streak for pair, streak in streaks.items() if frozenset(pair) not in joined}
    ended: set[str] = set()
    for (younger, older), streak in list(streaks.items()):
        if not ended.intersection((younger, older)) and len(streak) >= rule.merge_duplicates.frames:
            tracks.end(
                DuplicateEnded(
                    frame.index,
                    younger,
                    older,
                    min(streak),
                    rule.merge_duplicates.overlap,
                    rule.merge_duplicates.frames,
                )
            )
            ended.add(younger)
    remaining = {pair: streak for pair, streak in streaks.items() if not ended.intersection(pair)}
    tracks.history = evolve(tracks.history, overlaps={**elsewhere, **remaining})


def _end_lost(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Nets of targets that were lost for too long, or hardly exist, end; what they knew is kept a while."""
    limit = None if rule.existence is None else rule.existence.end
    vanishing = (
        {} if limit is None else {**dict(tracks.vanishing(plate, limit)), **_outside(tracks, plate, limit)}
    )
    causes = {} if rule.death is None else dict(tracks.ending(plate, rule.death))
    for target in (*causes, *(name for name in vanishing if name not in causes)):
        unseen = tracks.record(target).unseen_frames
        why = causes.get(target, ("existence", unseen, 0))
        enough = None if rule.death is None else rule.death.unseen_frames
        is_too_long = why[0] == "lost" and enough is not None and unseen >= enough
        existence = vanishing.get(target)
        _end(
            tracks,
            plate,
            TargetDied(
                frame.index,
                target,
                *why,
                remembered=rule.reidentify is not None,
                existence=existence,
                end=None if existence is None else limit,
                unseen_frames=unseen if is_too_long else 0,
            ),
        )
    _forget(tracks, plate, rule, frame)


def _outside(tracks: LiveTable, plate: str, limit: float) -> dict[str, float]:
    """Targets that exist in the area of a plate with less probability than `limit`, and which."""
    views = tracks.engine.plates[plate].views
    if views is None or views.area is None:
        return {}
    states = {target: tracks.state(target) for target in tracks.of_plate(plate)}
    if not states:
        return {}
    means, covariances = zip(*(moments_of(state.belief) for state in states.values()), strict=True)
    shares = views.shares_in_area(np.array(means), np.array(covariances)).tolist()
    return {
        target: existence
        for (target, state), share in zip(states.items(), shares, strict=True)
        if (existence := share * (state.existence or 1.0)) < limit
    }


def _end(tracks: LiveTable, plate: str, died: TargetDied) -> None:
    """A net ends, and is remembered where the graph says so."""
    if died.remembered:
        remembered = memory_of(tracks, died.target, plate)
        tracks.history = evolve(tracks.history, dead=(*tracks.history.dead, remembered))
    tracks.end(died)


def _forget(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Targets that ended long ago or are too many are forgotten, and overlaps of all that ended."""
    if rule.reidentify is not None and rule.birth is not None:
        dead = [entry for entry in tracks.history.dead if entry.template == plate]
        recent = [entry for entry in dead if frame.time - entry.time <= rule.reidentify.frames]
        gone = {entry.target for entry in dead} - {
            entry.target for entry in recent[-REMEMBERED * rule.birth.max_targets :]
        }
        if gone:
            remaining = tuple(entry for entry in tracks.history.dead if entry.target not in gone)
            tracks.history = evolve(tracks.history, dead=remaining)
    # A target that returns starts its overlaps anew.
    previous, live = tracks.history.overlaps, tracks.net.targets.keys()
    overlaps = {pair: streak for pair, streak in previous.items() if live >= {*pair}}
    if len(overlaps) < len(previous):
        tracks.history = evolve(tracks.history, overlaps=overlaps)
    births = tracks.history.births
    if len(births) > len(live):
        kept_births = {target: birth for target, birth in births.items() if target in live}
        tracks.history = evolve(tracks.history, births=kept_births)


def memory_of(tracks: LiveTable, target: str, plate: str) -> AppearanceMemory:
    """Memory by which a live target would be recognised."""
    record, birth = tracks.record(target), tracks.history.births[target]
    memory = record.mean, record.covariance, record.time, tracks.references(target)
    return AppearanceMemory(target, plate, *memory, birth, tracks.kinds(target, plate))


def _give_birth(births: Births, detections: Found, owners: tuple[str | None, ...] | None) -> None:
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


def _give_birth_by_existence(
    births: Births, detections: Found, owners: tuple[str | None, ...] | None
) -> None:
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
