"""The life of targets in one frame: detections become targets, lost ones are found, nets end.

`manage_tracks` comes after every live target is finished. Detectors look; live targets claim what they hold;
what is left is compared with the lost, gathers looks, and becomes a target, an old one when it is recognised.
Then the younger of two nets that hold one object ends, and those that were lost for too long. All of it is a
function of the engine, what is remembered and the frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.claims import NOBODY, alike, claim
from bayesnet_track.adapt.lifecycle import (
    Candidate,
    Identity,
    Lifeline,
    feed,
    is_confirmed,
    overlapping,
    refusals_to_tell,
    time_to_die,
)
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.lifecycle.claiming import Looked
from bayesnet_track.engine.lifecycle.detecting import Found, look
from bayesnet_track.engine.lifecycle.people import Population
from bayesnet_track.engine.lifecycle.recalling import compare
from bayesnet_track.engine.lifecycle.recognise import Match, match
from bayesnet_track.engine.outcome import Outcome
from bayesnet_track.engine.starting import restart, start
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.lifecycle import Birth, LifeRules
from bayesnet_track.journal.events.life_events import BirthsRefused, CandidateConfirmed
from bayesnet_track.journal.net.life_decisions import DuplicateEnded, Reacquired, Returned, TargetDied
from bayesnet_track.observation.planes import Frame

Floats = NDArray[np.float64]

TESTED = 32
"""Detections, the best, that are compared with remembered targets in a frame: bounds the time it takes."""

REMEMBERED = 4
"""Dead targets that are remembered, in multiples of `birth.max_targets`."""


def manage_tracks(work: FrameWork, outcome: Outcome, looked: Looked | None = None) -> Outcome:
    """The outcome after the frame's births, returns and deaths; as it is where no plate has any.

    `looked` holds what the detectors found, and whose it is, where they looked before targets were weighed.
    """
    frame, plates, started = work.frame, work.engine.plates, work.engine.clock()
    rules = {
        plate: compiled.lifecycle for plate, compiled in plates.items() if compiled.lifecycle is not None
    }
    if not rules:
        return outcome
    state = outcome.state
    people = Population(state.net, dict(state.targets), list(outcome.metrics), state.life)
    _count(people, rules, frame)
    if looked is None:
        found, people.life, told = look(work, people.life, people.boxes, people.held)
    else:
        found, told = looked.found, looked.told
    people.events += told
    for plate, rule in rules.items():
        if plate in found and rule.birth is not None:
            now = _Nursery(work, people, plate, rule, rule.birth)
            _give_birth(now, found[plate], None if looked is None else looked.owners.get(plate))
    for plate, rule in rules.items():
        _end_duplicates(people, plate, rule, frame)
        _end_lost(people, plate, rule, frame)
    work.charge("life", started)
    return Outcome(
        replace(state, net=people.net, targets=people.targets, previous=frame, life=people.life),
        tuple(people.metrics),
        (*outcome.events, *people.events),
        outcome.covariances,
        work.seconds,
    )


def _count(people: Population, rules: Mapping[str, LifeRules], frame: Frame) -> None:
    """One more frame for every live target."""
    lines = {}
    for target, state in people.targets.items():
        if people.net.targets[target].template not in rules:
            continue
        lost = people.net.targets[target].status == "lost"
        line = people.life.lifelines.get(target)
        if line is None or not (lost or state.memory.lost.count):
            since = frame.index if line is None else line.since
            unseen = 0 if line is None else line.unseen_frames
            line = Lifeline(since, state.belief.mean, state.belief.covariance, frame.time, 0, unseen)
        lines[target] = replace(
            line, lost_frames=line.lost_frames + 1 if lost else 0, unseen_frames=line.unseen_frames + 1
        )
    numbers = [int(target) for target in people.targets if target.isdecimal()]
    people.life = replace(people.life, lifelines=lines, last_id=max([people.life.last_id, *numbers]))


# ------------------------------------------------------------------------------------ births


@dataclass(frozen=True, eq=False)
class _Nursery:
    """What one plate's births need of the frame."""

    work: FrameWork
    people: Population
    plate: str
    rule: LifeRules
    birth: Birth

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self.work.frame


def _give_birth(now: _Nursery, found: Found, owners: tuple[str | None, ...] | None) -> None:
    """What becomes of a plate's detections; `owners` says whose each is where they were given before."""
    people, apart, covered = now.people, now.birth.min_distance_box, now.birth.max_overlap
    held = people.held(now.plate)
    if owners is None:
        sd = np.array([_sd_px(people.targets[target]) for target in held])
        owner, free = claim(found.boxes, people.boxes(held), sd, apart, covered)
        seen = [held[k] for k in owner if k != NOBODY]
    else:
        seen = [target for target in owners if target is not None]
        near = people.boxes(list(dict.fromkeys([*held, *seen])))
        free = np.array([one is None for one in owners], dtype=bool)
        free &= ~alike(found.boxes, near, apart, covered).any(axis=1)
    people.life = replace(people.life, lifelines=_seen(people.life.lifelines, seen))
    found = found.only(free)
    at = _find_lost(now, found, seen)
    found = found.only(np.logical_not(np.any(alike(found.boxes, at, apart, covered), axis=1)))
    waiting = feed(
        people.life.candidates.get(now.plate, ()), found.boxes, found.scores, now.frame.index, now.birth
    )
    ready = sorted(
        (k for k, one in enumerate(waiting) if is_confirmed(one, now.birth.confirm)),
        key=lambda k: (-waiting[k].score, k),
    )
    taken = _bear(now, [waiting[k] for k in ready], found)
    left = tuple(one for one in waiting if not any(one is other for other in taken))
    people.life = replace(people.life, candidates={**people.life.candidates, now.plate: left})


def _find_lost(now: _Nursery, found: Found, seen: Sequence[str]) -> Floats:
    """Lost targets whose looks a free detection has start again there: (K, 4) where; not those `seen`."""
    people, reidentify = now.people, now.rule.reidentify
    held = {*people.held(now.plate), *seen}
    lost = [target for target in people.of_plate(now.plate) if target not in held]
    places = np.empty((0, 4))
    if reidentify is None or not reidentify.lost or not lost:
        return places
    boxes = found.boxes[:TESTED]
    known = [_identity(people, target, now.plate) for target in lost]
    for one in _matches(now, known, boxes, found.boxes):
        target, box = one.recognition.target, boxes[one.detection]
        if not one.is_sure:
            continue
        state = restart(now.work, target, now.plate, box, people.targets[target])
        people.decide(Reacquired(now.frame.index, target, _box(box), one.recognition))
        people.targets[target] = state
        people.life = replace(
            people.life, lifelines={**people.life.lifelines, target: _anew(people, target, now.frame)}
        )
        places = np.vstack([places, box])
    return places


def _bear(now: _Nursery, ready: Sequence[Candidate], found: Found) -> list[Candidate]:
    """Confirmed candidates become targets, the best first, while there is room; those that are done with."""
    people, most = now.people, now.birth.max_targets
    dead = [one for one in people.life.dead if one.template == now.plate]
    boxes = np.array([one.box for one in ready[:TESTED]]).reshape(-1, 4)
    nearest = {one.detection: one for one in _matches(now, dead, boxes, found.boxes)}
    taken: list[Candidate] = []
    refused = 0
    for number, candidate in enumerate(ready):
        others = people.boxes(people.held(now.plate))
        if alike(candidate.box[None], others, now.birth.min_distance_box, now.birth.max_overlap).any():
            taken.append(candidate)
        elif len(people.of_plate(now.plate)) >= most:
            refused += 1
        else:
            _start(now, candidate, nearest.get(number))
            taken.append(candidate)
    if refused:
        _refuse(now, refused)
    return taken


def _start(now: _Nursery, candidate: Candidate, nearest: Match | None) -> None:
    """A net for a candidate: of an old target when it is recognised, else of a new one."""
    people, frame, box = now.people, now.frame, candidate.box
    if nearest is not None and nearest.is_sure:
        target = nearest.recognition.target
        old = next(one for one in people.life.dead if one.target == target)
        looks = now.work.engine.plates[now.plate].looks
        known = {agent: one for agent, one in old.references.items() if agent in looks}
        born = start(now.work, target, now.plate, box, known)
        first = born.decisions[0]
        active = getattr(first, "active", ())
        back = Returned(frame.index, target, now.plate, _box(box), active, nearest.recognition)
        people.decide(back, *born.decisions[1:])
        people.life = replace(people.life, dead=tuple(one for one in people.life.dead if one is not old))
    else:
        people.life = replace(people.life, last_id=people.life.last_id + 1)
        target = str(people.life.last_id)
        people.events.append(
            CandidateConfirmed(
                frame=frame.index,
                target=target,
                template=now.plate,
                detector=now.birth.detector.detector,
                first_frame=candidate.first_frame,
                seen=candidate.seen,
                looks=len(candidate.looks),
                score=candidate.score,
                nearest=None if nearest is None else nearest.recognition,
            )
        )
        born = start(now.work, target, now.plate, box)
        people.decide(*born.decisions)
    people.targets[target] = born.state
    people.metrics.append(born.metrics)
    people.life = replace(
        people.life, lifelines={**people.life.lifelines, target: _anew(people, target, frame)}
    )


def _refuse(now: _Nursery, waiting: int) -> None:
    people = now.people
    before = people.life.refused.get(now.plate, 0)
    people.life = replace(people.life, refused={**people.life.refused, now.plate: before + waiting})
    if refusals_to_tell(before, before + waiting):
        live_ones = len(people.of_plate(now.plate))
        detector = now.birth.detector.detector
        people.events.append(
            BirthsRefused(
                now.frame.index,
                now.plate,
                detector,
                live_ones,
                now.birth.max_targets,
                before + waiting,
                waiting,
            )
        )


def _matches(
    now: _Nursery, known: Sequence[Identity], boxes: Floats, detections: Floats
) -> tuple[Match, ...]:
    """Which of the boxes (M, 4) are which of the known targets."""
    reidentify = now.rule.reidentify
    if reidentify is None or not known or not len(boxes):
        return ()
    others = np.concatenate([now.people.boxes(now.people.held(now.plate)), detections[:TESTED]])
    asked = partial(compare, now.work, now.plate, reidentify, boxes, others)
    return match(list(map(asked, known)), len(boxes), reidentify)


# ------------------------------------------------------------------------------------ ends


def _end_duplicates(people: Population, plate: str, rule: LifeRules, frame: Frame) -> None:
    """The younger of two nets whose beliefs hold one object ends; joined ones are known to be two."""
    if rule.merge_duplicates is None:
        return
    held = people.held(plate)
    beliefs = {t: (people.targets[t].belief.mean, people.targets[t].belief.covariance) for t in held}
    since = {t: people.life.lifelines[t].since for t in held}
    others = {
        pair: s for pair, s in people.life.overlaps.items() if not set(pair) & set(people.of_plate(plate))
    }
    streaks = overlapping(beliefs, since, people.life.overlaps, rule.merge_duplicates)
    joined = {frozenset(pair) for pair in people.net.joins}
    streaks = {pair: streak for pair, streak in streaks.items() if frozenset(pair) not in joined}
    for (younger, older), streak in list(streaks.items()):
        both = younger in people.targets and older in people.targets
        if both and len(streak) >= rule.merge_duplicates.frames:
            ended = DuplicateEnded(
                frame.index,
                younger,
                older,
                min(streak),
                rule.merge_duplicates.overlap,
                rule.merge_duplicates.frames,
            )
            _end(people, ended)
    left = {pair: streak for pair, streak in streaks.items() if set(pair) <= set(people.targets)}
    people.life = replace(people.life, overlaps={**others, **left})


def _end_lost(people: Population, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Nets of targets that were lost for too long end; what they knew is kept for a while."""
    for target in people.of_plate(plate) if rule.death is not None else []:
        why = time_to_die(people.life.lifelines[target], rule.death) if rule.death is not None else None
        if why is not None:
            if rule.reidentify is not None:
                people.life = replace(people.life, dead=(*people.life.dead, _identity(people, target, plate)))
            _end(people, TargetDied(frame.index, target, *why, remembered=rule.reidentify is not None))
    if rule.reidentify is not None and rule.birth is not None:
        own = [one for one in people.life.dead if one.template == plate]
        kept = [one for one in own if frame.time - one.time <= rule.reidentify.frames]
        gone = {one.target for one in own} - {
            one.target for one in kept[-REMEMBERED * rule.birth.max_targets :]
        }
        people.life = replace(
            people.life, dead=tuple(one for one in people.life.dead if one.target not in gone)
        )


def _end(people: Population, decision: TargetDied | DuplicateEnded) -> None:
    people.decide(decision)
    del people.targets[decision.target]
    lines = {target: line for target, line in people.life.lifelines.items() if target in people.targets}
    people.life = replace(people.life, lifelines=lines)


# ------------------------------------------------------------------------------------ parts


def _identity(people: Population, target: str, plate: str) -> Identity:
    line = people.life.lifelines[target]
    references = people.targets[target].references
    return Identity(target, plate, line.mean, line.covariance, line.time, references)


def _anew(people: Population, target: str, frame: Frame) -> Lifeline:
    belief, before = people.targets[target].belief, people.life.lifelines.get(target)
    since = frame.index if before is None else before.since
    return Lifeline(since, belief.mean, belief.covariance, frame.time)


def _seen(lines: Mapping[str, Lifeline], targets: Sequence[str]) -> dict[str, Lifeline]:
    return {**lines, **{target: replace(lines[target], unseen_frames=0) for target in targets}}


def _sd_px(state: TargetState) -> float:
    return math.sqrt(max(float(np.mean(np.diag(state.belief.covariance)[:2])), 0.0))


def _box(box: Floats) -> tuple[float, float, float, float]:
    x, y, w, h = (float(value) for value in box)
    return x, y, w, h
