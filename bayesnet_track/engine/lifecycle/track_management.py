"""The life of targets in one frame: detections become targets, lost ones are found, nets end.

`manage_tracks` comes after every live target is finished. Detectors look; live targets are given what they
hold; what is left is compared with the lost, gathers looks, and becomes a target, an old one when it is
recognised. Then the younger of two nets that hold one object ends, and those that were lost for too long. All
of it is a function of the engine, what is remembered and the frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.association import NOBODY, alike, associate
from bayesnet_track.adapt.lifecycle import (
    AppearanceMemory,
    Candidate,
    TrackRecord,
    feed,
    is_confirmed,
    is_refusal_notable,
    keep_best,
    overlapping,
)
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.lifecycle.association import Associated
from bayesnet_track.engine.lifecycle.detecting import Found, look
from bayesnet_track.engine.lifecycle.existing import CrowdRule, confirmed, first_population
from bayesnet_track.engine.lifecycle.recognise import Match, match
from bayesnet_track.engine.lifecycle.reidentifying import compare
from bayesnet_track.engine.lifecycle.sharing import start_tentative
from bayesnet_track.engine.lifecycle.track_table import LiveTable, table_of
from bayesnet_track.engine.outcome import Outcome
from bayesnet_track.engine.rows.columns import RowStates
from bayesnet_track.engine.rows.row_metrics import RowMetrics
from bayesnet_track.engine.rows.row_table import RowTable
from bayesnet_track.engine.starting import restart, start
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.lifecycle import Birth, LifeRules
from bayesnet_track.journal.events.births import BirthsRefused, CandidateConfirmed
from bayesnet_track.journal.events.endings import DuplicateEnded, TargetDied
from bayesnet_track.journal.events.reidentification import Reacquired, Returned
from bayesnet_track.observation.cue import OBSERVED
from bayesnet_track.observation.planes import Frame

Floats = NDArray[np.float64]

TESTED = 32
"""Detections, the best, that are compared with remembered targets in a frame: bounds the time it takes."""

REMEMBERED = 4
"""Dead targets that are remembered, in multiples of `birth.max_targets`."""


def manage_tracks(work: FrameWork, outcome: Outcome, associated: Associated | None = None) -> Outcome:
    """The outcome after the frame's births, returns and deaths; as it is where no plate has any.

    `associated` holds what the detectors found, and whose it is, where they looked before targets were
    weighed.
    """
    frame, plates, started = work.frame, work.engine.plates, work.engine.clock()
    rules = {
        plate: compiled.lifecycle for plate, compiled in plates.items() if compiled.lifecycle is not None
    }
    if not rules:
        return outcome
    tracks = live_table(work, outcome)
    tracks.count(rules.keys(), frame)
    if associated is None:
        found, tracks.history, events = look(work, tracks.history, tracks.boxes, tracks.held)
    else:
        found, events = associated.found, associated.events
        looked = associated.history
        tracks.history = replace(
            tracks.history,
            detectors=looked.detectors,
            failed=looked.failed,
            populations=looked.populations,
            candidates=looked.candidates,
        )
    tracks.events += events
    for plate, rule in rules.items():
        if plate in found and rule.birth is not None:
            now = _Births(work, tracks, plate, rule, rule.birth)
            give = _give_birth if rule.existence is None else _give_birth_by_existence
            give(now, found[plate], None if associated is None else associated.owners.get(plate))
    for plate, rule in rules.items():
        _end_duplicates(tracks, plate, rule, frame)
        _end_lost(tracks, plate, rule, frame)
    work.charge("life", started)
    return replace(tracks.outcome(outcome, frame), seconds=work.seconds)


def live_table(work: FrameWork, outcome: Outcome) -> LiveTable:
    """The targets as rows where they were advanced so, else an object each."""
    if isinstance(outcome.state.targets, RowStates) and isinstance(outcome.metrics, RowMetrics):
        return RowTable.of(work.engine, outcome)
    return table_of(outcome)


# ------------------------------------------------------------------------------------ births


@dataclass(frozen=True, eq=False)
class _Births:
    """What one plate's births need of the frame."""

    work: FrameWork
    tracks: LiveTable
    plate: str
    rule: LifeRules
    birth: Birth

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self.work.frame


def _give_birth(now: _Births, found: Found, owners: tuple[str | None, ...] | None) -> None:
    """What becomes of a plate's detections; `owners` says whose each is where they were given before."""
    tracks, apart, covered = now.tracks, now.birth.min_distance_box, now.birth.covered
    if owners is None:
        held = tracks.held(now.plate)
        sd = np.array([_sd_px(tracks.state(target)) for target in held])
        owner, free = associate(found.boxes, tracks.boxes(held), sd, apart, covered)
        seen = [held[k] for k in owner if k != NOBODY]
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
    found = found.only(np.logical_not(np.any(alike(found.boxes, at, apart, covered), axis=1)))
    found = found.only(found.scores >= now.birth.min_score)
    waiting = _wait(now, found)
    ready = sorted(
        (k for k, one in enumerate(waiting) if is_confirmed(one, now.birth.confirm)),
        key=lambda k: (-waiting[k].score, k),
    )
    done = _start_confirmed(now, [waiting[k] for k in ready], found)
    left = tuple(one for one in waiting if not any(one is other for other in done))
    tracks.history = replace(tracks.history, candidates={**tracks.history.candidates, now.plate: left})


def _give_birth_by_existence(now: _Births, found: Found, owners: tuple[str | None, ...] | None) -> None:
    """What of a plate's prospects becomes targets."""
    tracks, plate = now.tracks, now.plate
    rule = CrowdRule.of(now.work.engine.plates[plate])
    if rule is None:
        return
    if owners is None:  # of a first frame nothing was given before
        held = tracks.boxes(tracks.held(plate))
        near = alike(found.boxes, held, now.birth.min_distance_box, now.birth.covered)
        free = found.only(np.logical_not(np.any(near, axis=1)))
        population = first_population(rule, free, now.frame.index)
    else:
        tracks.mark_seen([target for target in owners if target is not None])
        population = tracks.history.populations[plate]
    ready = confirmed(rule, population.prospects)
    if ready:
        done = _start_confirmed(now, list(ready.values()), found)
        left = np.ones(len(population.prospects), dtype=bool)
        left[[row for row, one in ready.items() if any(one is other for other in done)]] = False
        population = replace(population, prospects=population.prospects.take(left))
    tracks.history = replace(tracks.history, populations={**tracks.history.populations, plate: population})


def _wait(now: _Births, found: Found) -> tuple[Candidate, ...]:
    """The candidates of a plate after the look, in which nobody was given these detections."""
    before, frame = now.tracks.history.candidates.get(now.plate, ()), now.frame.index
    if not now.birth.tentative:
        return feed(before, found.boxes, found.scores, frame, now.birth)
    compiled = now.work.engine.plates[now.plate]
    rule = next(iter(compiled.association_rules.values()))
    new = [
        start_tentative(rule, box, float(score), frame, compiled.motion.start_moments(box))
        for box, score in zip(found.boxes, found.scores, strict=True)
    ]
    return keep_best([*before, *new], now.birth)


def _find_lost(now: _Births, found: Found, seen: Sequence[str]) -> Floats:
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
    known = [_remember(tracks, target, now.plate) for target in lost]
    for one in _match_known(now, known, boxes, found.boxes):
        target, box = one.recognition.target, boxes[one.detection]
        if not one.is_sure:
            continue
        state = restart(now.work, target, now.plate, box, tracks.state(target))
        tracks.decide(Reacquired(now.frame.index, target, _box(box), one.recognition))
        since = tracks.record(target).since
        tracks.put_back(target, state, _start_record(state, since, now.frame))
        places = np.vstack([places, box])
    return places


def _start_confirmed(now: _Births, ready: Sequence[Candidate], found: Found) -> list[Candidate]:
    """Confirmed candidates become targets, the best first, while there is room; those that are done with."""
    tracks, most = now.tracks, now.birth.max_targets
    dead = [one for one in tracks.history.dead if one.template == now.plate]
    boxes = np.array([one.box for one in ready[:TESTED]]).reshape(-1, 4)
    nearest = {one.detection: one for one in _match_known(now, dead, boxes, found.boxes)}
    done: list[Candidate] = []
    refused = 0
    for number, candidate in enumerate(ready):
        others = tracks.boxes(tracks.held(now.plate))
        if alike(candidate.box[None], others, now.birth.min_distance_box, now.birth.covered).any():
            done.append(candidate)
        elif len(tracks.of_plate(now.plate)) >= most:
            refused += 1
        else:
            _start(now, candidate, nearest.get(number))
            done.append(candidate)
    if refused:
        _refuse(now, refused)
    return done


def _start(now: _Births, candidate: Candidate, nearest: Match | None) -> None:
    """A net for a candidate: of an old target when it is recognised, else of a new one."""
    tracks, frame, box = now.tracks, now.frame, candidate.box
    if nearest is not None and nearest.is_sure:
        target = nearest.recognition.target
        old = next(one for one in tracks.history.dead if one.target == target)
        looks = now.work.engine.plates[now.plate].looks
        known = {agent: one for agent, one in old.references.items() if agent in looks}
        born = start(now.work, target, now.plate, box, known)
        first = born.decisions[0]
        active = getattr(first, "active", ())
        back = Returned(frame.index, target, now.plate, _box(box), active, nearest.recognition)
        tracks.decide(back, *born.decisions[1:])
        tracks.history = replace(
            tracks.history, dead=tuple(one for one in tracks.history.dead if one is not old)
        )
    else:
        tracks.history = replace(tracks.history, last_id=tracks.history.last_id + 1)
        target = str(tracks.history.last_id)
        tracks.events.append(
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
                existence=candidate.existence,
                confirm=None if now.rule.existence is None else now.rule.existence.confirm,
            )
        )
        born = start(now.work, target, now.plate, box)
        tracks.decide(*born.decisions)
    state = _with_belief(born.state, candidate, now.work.engine.plates[now.plate].association_rules)
    tracks.add(target, state, _start_record(state, frame.index, frame), born.metrics)


def _with_belief(state: TargetState, candidate: Candidate, rules: Iterable[str]) -> TargetState:
    """The state of a target that was a prospect or a tentative track, with what was known of it."""
    belief = state.belief
    if candidate.mean is None or candidate.covariance is None:
        return state
    if isinstance(belief, GaussianPosterior):
        belief = replace(belief, mean=candidate.mean, covariance=candidate.covariance)
    references, observed = dict(state.references), candidate.observed
    if observed is not None and len(observed):
        references |= {agent: {**references.get(agent, {}), OBSERVED: observed} for agent in rules}
    return replace(state, belief=belief, references=references, existence=candidate.existence)


def _refuse(now: _Births, waiting: int) -> None:
    tracks = now.tracks
    before = tracks.history.refused.get(now.plate, 0)
    tracks.history = replace(tracks.history, refused={**tracks.history.refused, now.plate: before + waiting})
    if is_refusal_notable(before, before + waiting):
        live_ones = len(tracks.of_plate(now.plate))
        detector = now.birth.detector.detector
        tracks.events.append(
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


def _match_known(
    now: _Births, known: Sequence[AppearanceMemory], boxes: Floats, detections: Floats
) -> tuple[Match, ...]:
    """Which of the boxes (M, 4) are which of the known targets."""
    reidentify = now.rule.reidentify
    if reidentify is None or not known or not len(boxes):
        return ()
    others = np.concatenate([now.tracks.boxes(now.tracks.held(now.plate)), detections[:TESTED]])
    asked = partial(compare, now.work, now.plate, reidentify, boxes, others)
    return match(list(map(asked, known)), len(boxes), reidentify)


# ------------------------------------------------------------------------------------ ends


def _end_duplicates(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """The younger of two nets whose beliefs hold one object ends; joined ones are known to be two."""
    if rule.merge_duplicates is None:
        return
    held, before = tracks.held(plate), tracks.history.overlaps
    own = set(tracks.of_plate(plate)) if before else set()
    others = {pair: streak for pair, streak in before.items() if not own.intersection(pair)}
    streaks = overlapping(held, *tracks.beliefs(held), before, rule.merge_duplicates)
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
    left = {pair: streak for pair, streak in streaks.items() if not ended.intersection(pair)}
    tracks.history = replace(tracks.history, overlaps={**others, **left})


def _end_lost(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Nets of targets that were lost for too long end; what they knew is kept for a while."""
    for target, why in [] if rule.death is None else tracks.ending(plate, rule.death):
        if rule.reidentify is not None:
            tracks.history = replace(
                tracks.history, dead=(*tracks.history.dead, _remember(tracks, target, plate))
            )
        tracks.end(TargetDied(frame.index, target, *why, remembered=rule.reidentify is not None))
    _end_vanishing(tracks, plate, rule, frame)
    if rule.reidentify is not None and rule.birth is not None:
        own = [one for one in tracks.history.dead if one.template == plate]
        kept = [one for one in own if frame.time - one.time <= rule.reidentify.frames]
        gone = {one.target for one in own} - {
            one.target for one in kept[-REMEMBERED * rule.birth.max_targets :]
        }
        tracks.history = replace(
            tracks.history, dead=tuple(one for one in tracks.history.dead if one.target not in gone)
        )


def _end_vanishing(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Nets of targets that hardly exist end."""
    if rule.existence is None:
        return
    for target, value in tracks.vanishing(plate, rule.existence.end):
        if rule.reidentify is not None:
            remembered = _remember(tracks, target, plate)
            tracks.history = replace(tracks.history, dead=(*tracks.history.dead, remembered))
        unseen = tracks.record(target).unseen_frames
        tracks.end(
            TargetDied(
                frame.index,
                target,
                "existence",
                unseen,
                0,
                rule.reidentify is not None,
                value,
                rule.existence.end,
            )
        )


# ------------------------------------------------------------------------------------ parts


def _remember(tracks: LiveTable, target: str, plate: str) -> AppearanceMemory:
    record = tracks.record(target)
    references = tracks.state(target).references
    return AppearanceMemory(target, plate, record.mean, record.covariance, record.time, references)


def _start_record(state: TargetState, since: int, frame: Frame) -> TrackRecord:
    return TrackRecord(since, state.belief.mean, state.belief.covariance, frame.time)


def _sd_px(state: TargetState) -> float:
    return math.sqrt(max(float(np.mean(np.diag(state.belief.covariance)[:2])), 0.0))


def _box(box: Floats) -> tuple[float, float, float, float]:
    x, y, w, h = (float(value) for value in box)
    return x, y, w, h
