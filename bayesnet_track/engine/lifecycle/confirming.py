"""What is confirmed becomes a target: an old one when it is recognised, else a new one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesnet_track.adapt.association import alike
from bayesnet_track.adapt.lifecycle import AppearanceMemory, Candidate, TrackRecord, is_refusal_notable
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.motion.modes import moments_of
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.lifecycle.detecting import Found
from bayesnet_track.engine.lifecycle.recognise import Match, match
from bayesnet_track.engine.lifecycle.reidentifying import compare
from bayesnet_track.engine.lifecycle.track_table import LiveTable
from bayesnet_track.engine.starting import start
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.lifecycle import Birth, LifeRules
from bayesnet_track.journal.events.lives import BirthsRefused, CandidateConfirmed, Returned
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import changed
from bayesnet_track.observation.cue import OBSERVED
from bayesnet_track.observation.planes import Frame

TESTED = 32
"""Detections, the best, that are compared with remembered targets in a frame: bounds the time it takes."""


@dataclass(frozen=True, eq=False)
class Births:
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


def start_confirmed(now: Births, ready: Sequence[Candidate], found: Found) -> list[Candidate]:
    """Confirmed candidates become targets, the best first, while there is room; those that are done with."""
    tracks, most = now.tracks, now.birth.max_targets
    dead = [one for one in tracks.history.dead if one.template == now.plate]
    boxes = np.array([one.box for one in ready[:TESTED]]).reshape(-1, 4)
    nearest = {one.detection: one for one in match_known(now, dead, boxes, found.boxes)}
    done: list[Candidate] = []
    refused: list[Floats] = []
    for number, candidate in enumerate(ready):
        if _is_one_of(now, candidate, tracks.boxes(tracks.held(now.plate))):
            done.append(candidate)
        elif len(tracks.of_plate(now.plate)) >= most:
            if not _is_one_of(now, candidate, np.array(refused).reshape(-1, 4)):
                refused.append(candidate.box)
        else:
            _start(now, candidate, nearest.get(number))
            done.append(candidate)
    if refused:
        _refuse(now, len(refused))
    return done


def _is_one_of(now: Births, candidate: Candidate, boxes: Floats) -> bool:
    """Whether a candidate is the object in one of the boxes (K, 4)."""
    return bool(alike(candidate.box[None], boxes, now.birth.min_distance_box, now.birth.covered).any())


def _start(now: Births, candidate: Candidate, nearest: Match | None) -> None:
    """A net for a candidate: of an old target when it is recognised, else of a new one."""
    tracks, frame, box = now.tracks, now.frame, candidate.box
    if nearest is not None and nearest.is_sure:
        target = nearest.recognition.target
        old = next(one for one in tracks.history.dead if one.target == target)
        looks = now.work.engine.plates[now.plate].looks
        known = {agent: one for agent, one in old.references.items() if agent in looks}
        born = start(now.work, target, now.plate, box, candidate.birth, known)
        first = born.decisions[0]
        active = getattr(first, "active", ())
        back = Returned(frame.index, target, now.plate, box_of(box), active, nearest.recognition)
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
        born = start(now.work, target, now.plate, box, candidate.birth)
        tracks.decide(*born.decisions)
    tracks.history = changed(tracks.history, births={**tracks.history.births, target: candidate.birth})
    state = with_belief(born.state, candidate, now.work.engine.plates[now.plate].association_rules)
    tracks.add(target, state, start_record(state, frame.index, frame), born.metrics)


def with_belief(state: TargetState, candidate: Candidate, rules: Iterable[str]) -> TargetState:
    """The state of a target that was a prospect or a tentative track, with what was known of it."""
    belief = state.belief
    if candidate.mean is None or candidate.covariance is None:
        return state
    if isinstance(belief, GaussianPosterior):
        belief = replace(belief, mean=candidate.mean, covariance=candidate.covariance)
    elif isinstance(belief, ModalPosterior):
        mean, covariance = candidate.mean, candidate.covariance
        parts = tuple(replace(part, mean=mean, covariance=covariance) for part in belief.parts)
        belief = replace(belief, parts=parts)
    references, observed = dict(state.references), candidate.observed
    if observed is not None and len(observed):
        references |= {agent: {**references.get(agent, {}), OBSERVED: observed} for agent in rules}
    return replace(state, belief=belief, references=references, existence=candidate.existence)


def _refuse(now: Births, waiting: int) -> None:
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


def match_known(
    now: Births, known: Sequence[AppearanceMemory], boxes: Floats, detections: Floats
) -> tuple[Match, ...]:
    """Which of the boxes (M, 4) are which of the known targets."""
    reidentify = now.rule.reidentify
    if reidentify is None or not known or not len(boxes):
        return ()
    others = np.concatenate([now.tracks.boxes(now.tracks.held(now.plate)), detections[:TESTED]])
    asked = partial(compare, now.work, now.plate, reidentify, boxes, others)
    return match(list(map(asked, known)), len(boxes), reidentify)


def start_record(state: TargetState, since: int, frame: Frame) -> TrackRecord:
    """The record of a target that starts now, of a net born in frame `since`."""
    return TrackRecord(since, *moments_of(state.belief), frame.time)


def box_of(box: Floats) -> tuple[float, float, float, float]:
    """A box as numbers of an event."""
    x, y, w, h = (float(value) for value in box)
    return x, y, w, h
