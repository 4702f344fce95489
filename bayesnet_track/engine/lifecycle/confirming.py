"""What is confirmed becomes a target: a live one that turned, a dead one that is recognised, or a new one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.adapt.association import alike
from bayesnet_track.adapt.lifecycle import AppearanceMemory, Candidate, TrackRecord, is_refusal_notable
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.motion.modes import mode_probabilities, moments_of
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.recognise import Match, compare_remembered, match
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.engine.lifecycle.track_table import LiveTable
from bayesnet_track.engine.lifecycle.unconfirmed import initiate, velocities
from bayesnet_track.engine.metrics import state_numbers
from bayesnet_track.engine.modes import with_kinds, with_label
from bayesnet_track.engine.starting import drawn, restart, start
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.lifecycle import Birth, LifeRules
from bayesnet_track.journal.events.lives import BirthsRefused, CandidateConfirmed, Continued, Returned
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import OBSERVED
from bayesnet_track.observation.planes import Frame

TESTED = 32
"""Detections, the best, that are compared with remembered targets in a frame: bounds the time it takes."""


MAX_RATIO = 1.25
"""The area of a target's box changes by this factor a frame at most."""

COVERED = 0.25
"""A target so much covered by another is missed because of it."""

MAX_GAP = 2.5
"""Frame intervals at most between the last detection of a target and the next one.

Where detections are shared by probability, the first one of a turn may be nobody's: too little of it is the
target's, and too little is left for a candidate.
"""


@dataclass(frozen=True, eq=False)
class Births:
    """Context of one plate's births in a frame."""

    work: FrameContext
    tracks: LiveTable
    plate: str
    rule: LifeRules
    birth: Birth

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self.work.frame


def start_confirmed(births: Births, ready: Sequence[Candidate], detections: Found) -> list[Candidate]:
    """Confirmed candidates become targets, the best first, while there is room; those that are done with."""
    if not ready:
        return []
    tracks, max_targets = births.tracks, births.birth.max_targets
    dead = [entry for entry in tracks.history.dead if entry.template == births.plate]
    boxes = np.array([entry.box for entry in ready[:TESTED]]).reshape(-1, 4)
    nearest = {entry.detection: entry for entry in match_known(births, dead, boxes, detections.boxes)}
    handled: list[Candidate] = []
    refused: list[Floats] = []
    compiled = births.work.engine.plates[births.plate]
    live, places, count = len(tracks.of_plate(births.plate)), *_with_room(births, len(ready))
    unseen = _unseen(births)
    for number, waiting in enumerate(ready):
        candidate = initiate(compiled, waiting)
        if candidate.is_far and candidate.mean is None:
            continue
        if _share_in_area(compiled, candidate) < _least_share(births):
            continue
        place = _place(compiled, candidate)
        if _is_one_of(births, place, places[:count]):
            handled.append(waiting)
        elif (target := _continue(births, candidate, unseen)) is not None:
            handled.append(waiting)
            unseen = None if unseen is None else unseen.without(target)
            places, count = _with_room(births, len(ready))
        elif live >= max_targets:
            if not _is_one_of(births, place, np.array(refused).reshape(-1, 4)):
                refused.append(place)
        else:
            metrics = _start(births, candidate, nearest.get(number))
            live += 1
            if metrics.status != "lost":
                places[count] = metrics.centre_box if compiled.has_one_image else place
                count += 1
            handled.append(waiting)
    if refused:
        _refuse(births, len(refused))
    return handled


def _place(compiled: CompiledPlate, candidate: Candidate) -> Floats:
    """(4,) a candidate's place: its box in the image; where there are several, its square of the ground."""
    if compiled.views is None or compiled.has_one_image or candidate.mean is None:
        return candidate.box
    return np.asarray(compiled.views.footprints(candidate.mean[None])[0])


def _share_in_area(compiled: CompiledPlate, candidate: Candidate) -> float:
    """Probability that a candidate stands where targets may start."""
    views = compiled.views
    if views is None or views.area is None:
        return 1.0
    if candidate.mean is not None and candidate.covariance is not None:
        return float(views.shares_in_area(candidate.mean[None], candidate.covariance[None])[0])
    placed = views.place(candidate.box)
    return 0.0 if placed is None else float(views.shares_in_area(placed.states, placed.covariances)[0])


def _least_share(births: Births) -> float:
    """The probability of standing in the area from which on a candidate is a target."""
    return 0.5 if births.rule.existence is None else births.rule.existence.confirm


def _is_one_of(births: Births, place: Floats, places: Floats) -> bool:
    """True if what is at a place is the object in one of the others (K, 4)."""
    return bool(alike(place[None], places, births.birth.min_distance_box, births.birth.covered).any())


def _with_room(births: Births, room: int) -> tuple[Floats, int]:
    """(K + room, 4) places that live targets take, with room for those that start, and K.

    In an image they are those of targets that are not lost; on the ground two never stand in one place.
    """
    tracks, compiled = births.tracks, births.work.engine.plates[births.plate]
    if compiled.views is None or compiled.has_one_image:
        places = tracks.boxes(tracks.held(births.plate))
    else:
        means = [tracks.mean(target) for target in tracks.of_plate(births.plate)]
        places = compiled.views.footprints(np.array(means).reshape(-1, len(compiled.motion.fields)))
    return np.concatenate([places, np.empty((room, 4))]), len(places)


def _unseen(births: Births) -> Unseen | None:
    """The targets that a candidate may turn out to be; None where none goes on with its detections."""
    rules = births.work.engine.plates[births.plate].association_rules
    if max((rule.continue_box for rule in rules.values()), default=0.0) <= 0.0:
        return None
    return Unseen.of(births.tracks, births.plate, births.work.engine.plates[births.plate].motion)


def _continue(births: Births, candidate: Candidate, unseen: Unseen | None) -> str | None:
    """The live target that goes on with a candidate's detections: it lost its own when these began."""
    compiled, tracks, frame = births.work.engine.plates[births.plate], births.tracks, births.frame
    rules = compiled.association_rules
    reach_box = max((rule.continue_box for rule in rules.values()), default=0.0)
    same = None if unseen is None else find_continuation(tracks, unseen, candidate, frame.time, reach_box)
    if same is None:
        return None
    target, box = same.target, candidate.box
    state = restart(births.work, target, births.plate, box, tracks.state(target))
    state = _as_known(compiled, with_belief(state, candidate, rules), candidate, None)
    numbers = (candidate.first_frame, same.distance_box, reach_box)
    tracks.decide(Continued(frame.index, target, box_of(box), *numbers))
    birth_frame = tracks.record(target).since
    tracks.put_back(target, state, start_record(state, birth_frame, frame))
    return target


def _start(births: Births, candidate: Candidate, nearest: Match | None) -> FrameMetrics:
    """A net for a candidate: of an old target when it is recognised, else of a new one; its first metrics."""
    tracks, frame, box = births.tracks, births.frame, candidate.box
    memory = None
    if nearest is not None and nearest.is_sure:
        target = nearest.recognition.target
        memory = next(entry for entry in tracks.history.dead if entry.target == target)
        looks = births.work.engine.plates[births.plate].looks
        references = {agent: entry for agent, entry in memory.references.items() if agent in looks}
        born = start(births.work, target, births.plate, box, candidate.birth, references)
        first = born.decisions[0]
        active = getattr(first, "active", ())
        back = Returned(frame.index, target, births.plate, box_of(box), active, nearest.recognition)
        tracks.decide(back, *born.decisions[1:])
        tracks.history = replace(
            tracks.history, dead=tuple(entry for entry in tracks.history.dead if entry is not memory)
        )
    else:
        tracks.history = replace(tracks.history, last_id=tracks.history.last_id + 1)
        target = str(tracks.history.last_id)
        tracks.events.append(
            CandidateConfirmed(
                frame=frame.index,
                target=target,
                template=births.plate,
                detector=births.birth.detector.detector,
                first_frame=candidate.first_frame,
                seen=candidate.seen,
                looks=len(candidate.looks),
                score=candidate.score,
                nearest=None if nearest is None else nearest.recognition,
                existence=candidate.existence,
                confirm=None if births.rule.existence is None else births.rule.existence.confirm,
            )
        )
        born = start(births.work, target, births.plate, box, candidate.birth)
        tracks.decide(*born.decisions)
    tracks.history = evolve(tracks.history, births={**tracks.history.births, target: candidate.birth})
    compiled, metrics = births.work.engine.plates[births.plate], born.metrics
    rng = (
        None
        if compiled.views is None
        else births.work.stream_of(candidate.birth, compiled.plate.root)("placed")
    )
    state = with_belief(born.state, candidate, compiled.association_rules, rng)
    state = _as_known(compiled, state, candidate, None if memory is None else memory.kinds)
    if compiled.modes is not None and compiled.modes.constants:
        probabilities = mode_probabilities(state.belief, len(compiled.modes))
        metrics = evolve(metrics, category=compiled.modes.values(probabilities))
    if compiled.views is not None:
        metrics = evolve(metrics, state=state_numbers(state.belief, on_ground=True))
    tracks.add(target, state, start_record(state, frame.index, frame), metrics)
    return metrics


def _as_known(
    compiled: CompiledPlate, state: TargetState, candidate: Candidate, kinds: Floats | None
) -> TargetState:
    """The state with what the labels of the first detections say, and what the target was before."""
    label = next((rule.label for rule in compiled.association_rules.values() if rule.label is not None), None)
    belief = with_kinds(state.belief, compiled.modes, kinds)
    if label is not None:
        belief = with_label(belief, compiled.modes, label.category, candidate.labels)
    return state if belief is state.belief else replace(state, belief=belief)


def with_belief(
    state: TargetState,
    candidate: Candidate,
    rules: Iterable[str],
    on_ground: np.random.Generator | None = None,
) -> TargetState:
    """The state of a target that was a prospect or a tentative track, with what was known of it.

    Particles keep the box that they start in; those `on_ground`, where a box says little, are drawn anew.
    """
    belief = state.belief
    if candidate.mean is None or candidate.covariance is None:
        return state
    if isinstance(belief, GaussianPosterior):
        belief = replace(belief, mean=candidate.mean, covariance=candidate.covariance)
    elif isinstance(belief, ModalPosterior):
        mean, covariance = candidate.mean, candidate.covariance
        parts = tuple(replace(part, mean=mean, covariance=covariance) for part in belief.parts)
        belief = replace(belief, parts=parts)
    elif isinstance(belief, ParticleSet) and on_ground is not None:
        belief = drawn(belief, candidate.mean, candidate.covariance, on_ground)
    references, observed = dict(state.references), candidate.observed
    if observed is not None and len(observed):
        references |= {agent: {**references.get(agent, {}), OBSERVED: observed} for agent in rules}
    return replace(state, belief=belief, references=references, existence=candidate.existence)


def _refuse(births: Births, waiting: int) -> None:
    tracks = births.tracks
    refused = tracks.history.refused.get(births.plate, 0)
    tracks.history = replace(
        tracks.history, refused={**tracks.history.refused, births.plate: refused + waiting}
    )
    if is_refusal_notable(refused, refused + waiting):
        live_ones = len(tracks.of_plate(births.plate))
        detector = births.birth.detector.detector
        tracks.events.append(
            BirthsRefused(
                births.frame.index,
                births.plate,
                detector,
                live_ones,
                births.birth.max_targets,
                refused + waiting,
                waiting,
            )
        )


def match_known(
    births: Births, memories: Sequence[AppearanceMemory], boxes: Floats, detections: Floats
) -> tuple[Match, ...]:
    """Matches of the boxes (M, 4) with the known targets."""
    reidentify = births.rule.reidentify
    if reidentify is None or not memories or not len(boxes):
        return ()
    occupied = np.concatenate([births.tracks.boxes(births.tracks.held(births.plate)), detections[:TESTED]])
    compared = compare_remembered(births.work, births.plate, reidentify, boxes, occupied, memories)
    return match(compared, reidentify)


def start_record(state: TargetState, birth_frame: int, frame: Frame) -> TrackRecord:
    """The record of a target that starts now, of a net born in frame `birth_frame`."""
    return TrackRecord(birth_frame, *moments_of(state.belief), frame.time)


def box_of(box: Floats) -> tuple[float, float, float, float]:
    """A box as numbers of an event."""
    x, y, w, h = (float(value) for value in box)
    return x, y, w, h


@dataclass(frozen=True)
class Continuation:
    """A live target that a candidate is.

    Attributes:
        target: target id.
        distance_box: from where the target was, or should have been, to that detection, in its sides
            sqrt(w h) a frame interval.
    """

    target: str
    distance_box: float


@dataclass(frozen=True, eq=False)
class Unseen:
    """U live targets of a plate without a detection of their own.

    Attributes:
        plate: the plate.
        ids: target ids.
        frames: (U,) for how many frames.
        boxes: (U, 4) means of their boxes.
        steps: (U, 2) means of their velocities, px a frame interval.
    """

    plate: str
    ids: Sequence[str]
    frames: Ints
    boxes: Floats
    steps: Floats

    @classmethod
    def of(cls, tracks: LiveTable, plate: str, motion: MotionModel) -> Unseen:
        """Find them in the table of the living; they move by `motion`."""
        ids, frames, means = tracks.unseen(plate, len(motion.fields))
        return cls(plate, ids, frames, means[:, :4], velocities(motion, means))

    def without(self, target: str) -> Unseen:
        """All but one."""
        rows = np.array([name != target for name in self.ids], dtype=np.bool_)
        ids = [name for name in self.ids if name != target]
        return Unseen(self.plate, ids, self.frames[rows], self.boxes[rows], self.steps[rows])


def find_continuation(
    tracks: LiveTable, unseen: Unseen, candidate: Candidate, frame_time: float, reach_box: float
) -> Continuation | None:
    """The nearest live target that lost its detections when the candidate's began.

    In the frame of its last detection the candidate had none, for else they are two objects; and no other
    target covers it, for that would be why it is missed. `frame_time` is in frame intervals; `reach_box`
    says how far off a target may be, in box sides.
    """
    if not len(unseen.ids) or not candidate.track:
        return None
    looks, frames = np.array([look is not None for look in candidate.looks[::-1]]), unseen.frames
    had_own = (frames < len(looks)) & looks[np.minimum(frames, len(looks) - 1)]
    times = np.array([time for time, _ in candidate.track])
    boxes, ends = np.array([box for _, box in candidate.track]), frame_time - frames
    first = np.searchsorted(times, ends + 0.5, side="right")
    later = np.minimum(first, len(times) - 1)
    gaps, places, sizes = times[later] - ends, boxes[later], unseen.boxes[:, 2] * unseen.boxes[:, 3]
    ratios, limits = boxes[later, 2] * boxes[later, 3] / np.maximum(sizes, 1e-12), MAX_RATIO**frames
    fits = ~had_own & (first < len(times)) & (gaps <= MAX_GAP) & (1.0 / limits <= ratios) & (ratios <= limits)
    steps = unseen.steps
    begins = unseen.boxes[:, :2] - steps * frames[:, None]
    ways = [places[:, :2] - begins, places[:, :2] - (begins + steps * gaps[:, None])]
    distances = np.minimum(*(np.hypot(*way.T) / np.sqrt(sizes) for way in ways)) / np.maximum(gaps, 1.0)
    rows = np.flatnonzero(fits & (distances <= reach_box))
    if not len(rows):
        return None
    neighbours = tracks.boxes(sorted({*tracks.held(unseen.plate)}.difference(unseen.ids)))
    for row in rows[np.argsort(distances[rows], kind="stable")].tolist():
        if not _is_covered(unseen.boxes[row], neighbours):
            return Continuation(unseen.ids[row], float(distances[row]))
    return None


def _is_covered(mean: Floats, boxes: Floats) -> bool:
    """True if one of the boxes (K, 4) covers at least `COVERED` of a target's own."""
    low = np.maximum(mean[:2] - mean[2:4] / 2, boxes[:, :2] - boxes[:, 2:4] / 2)
    high = np.minimum(mean[:2] + mean[2:4] / 2, boxes[:, :2] + boxes[:, 2:4] / 2)
    shared = np.maximum(high - low, 0.0).prod(axis=1)
    return bool((shared >= COVERED * mean[2] * mean[3]).any())
