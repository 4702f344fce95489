"""Look-alikes beside a target, and verifiers of its estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesnet_track.adapt.rule_inputs import Measures
from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.engine.scoring.score import (
    BEFORE,
    NEAR_BOX,
    NEARER,
    SPAN,
    WAIT,
    Encounter,
    Place,
    ScoreState,
    distances_since,
    motion_before,
)
from bayesnet_track.graph.checks.cues import cue_parameters
from bayesnet_track.graph.settings.scores import Distractors
from bayesnet_track.graph.spec import Verifier
from bayesnet_track.inference.asking import Fault, check_reference, follow, score
from bayesnet_track.journal.events.faults import VerifierFailed
from bayesnet_track.journal.events.statuses import DistractorSeen, DoubtEnded
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import (
    FAULTS,
    Cue,
    CueDeclaration,
    Hypotheses,
    Reference,
    context_of,
    make_cue,
    over_frames,
    said,
)
from bayesnet_track.observation.planes import PlaneCache, Planes, region_of_boxes


def find_distractor(
    rule: Distractors, frame: int, target: str, step: Step[Posterior], measures: Measures
) -> DistractorSeen | None:
    """The best hypothesis that is not the target's own, where it is nearly as likely; else None.

    None, too, where nothing fits: nothing resembles it.
    """
    if measures.fit < rule.fit:
        return None
    boxes, log = step.support.boxes, step.evidence.log_likelihood
    own_index = int(np.argmax(step.support.weights.log))
    side = float(np.sqrt(max(measures.area_px2, 1.0)))
    distances = np.hypot(boxes[:, 0] - boxes[own_index, 0], boxes[:, 1] - boxes[own_index, 1]) / side
    beside = np.flatnonzero(distances >= rule.beyond_box)
    if not len(beside):
        return None
    rival = int(beside[np.argmax(log[beside])])
    behind = float(log[own_index] - log[rival])
    if behind >= rule.within_nats:
        return None
    x, y = boxes[rival, :2].tolist()
    return DistractorSeen(
        frame, target, x, y, float(distances[rival]), behind, rule.within_nats, measures.fit, rule.hold
    )


def follow_distractor(
    scored: ScoreState,
    distractor: DistractorSeen | None,
    frames: int,
    target: str,
    place: Place,
    side_px: float,
) -> tuple[ScoreState, DoubtEnded | None]:
    """With the distractor of this frame, or the end of the doubt, where motion shows which is followed.

    `place` is the estimate's, `side_px` the root of its area.
    """
    scored, ended = with_distractor(scored, distractor, frames), None
    if scored.doubt and scored.encounter is not None and _is_past(scored.meeting, place.frame):
        separations = distances_since(scored.encounter, place, side_px)
        if separations is not None and separations[0] < min(NEARER * separations[1], NEAR_BOX):
            ended = DoubtEnded(
                place.frame, target, *separations, min(NEARER, NEAR_BOX / separations[1]), scored.doubt
            )
            scored = evolve(scored, doubt=0)
    return evolve(scored, places=(*scored.places, place)[-BEFORE - SPAN :]), ended


def _is_past(meeting: Encounter | None, frame: int) -> bool:
    """True where no look-alike has been seen for a while, be it in too few frames in a row to count."""
    return meeting is None or frame - meeting.last.frame >= WAIT


def with_distractor(scored: ScoreState, distractor: DistractorSeen | None, frames: int) -> ScoreState:
    """With the distractor of this frame, if there is one; `frames` in a row put the target in doubt."""
    if distractor is None:
        return evolve(scored, distractors=0)
    count, place = scored.distractors + 1, Place(distractor.frame, distractor.x, distractor.y)
    meeting = Encounter(motion_before(scored.places), place, place, distractor.behind_nats)
    if scored.distractors and scored.meeting is not None:
        behind = max(scored.meeting.behind_nats, distractor.behind_nats)
        meeting = evolve(scored.meeting, last=place, behind_nats=behind)
    scored = evolve(scored, distractors=count, meeting=meeting)
    if count < frames:
        return scored
    # In doubt already: how the target moved is known from before.
    motion = scored.encounter.own if scored.doubt and scored.encounter is not None else meeting.own
    return evolve(scored, doubt=distractor.hold, encounter=evolve(meeting, own=motion))


def without_motion(scored: ScoreState) -> ScoreState:
    """The same of a target that may be anywhere now: how it and a look-alike moved before says nothing."""
    return evolve(scored, distractors=0, places=(), meeting=None, encounter=None)


HELD = 0.1
"""Verifiers learn from frames with at least this score."""


@dataclass(frozen=True, eq=False)
class VerifierAtWork:
    """A verifier of a graph, its cue loaded.

    Attributes:
        cue: what is asked.
        learn_rate: how far its reference moves when it is asked.
        every: frames from one question to the next.
        needs_color: whether it is blind on a gray source.
    """

    cue: Cue
    learn_rate: float
    every: int
    needs_color: bool

    def planes(self, cache: PlaneCache, box: Floats) -> Planes:
        """Planes that the cue sees of a centre box (4,) and around it."""
        return cache.planes(self.cue.needs, region_of_boxes(box[None], grow=context_of(self.cue)))

    def first_reference(self, cache: PlaneCache, box: Floats) -> Reference | str:
        """The reference learnt in a centre box (4,), or the reason why there is none."""
        if self.needs_color and not cache.frames.current.has_color:
            return "needs colour, and the source is gray"
        try:
            return check_reference(self.cue.learn(self.planes(cache, box), box.copy()))
        except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
            return f"raised {said(error)}"

    def log_likelihood(self, cache: PlaneCache, box: Floats, reference: Reference) -> float | str:
        """Of the centre box (4,), or what was wrong."""
        try:
            planes = self.planes(cache, box)
        except FAULTS as error:  # as in evaluation: a cue's fault must not end the run
            return f"raised {said(error)}"
        hypothesis, starts = Hypotheses(box[None]), np.array([0, 1])
        (value,), faults = score(self.cue, [planes], hypothesis, starts, [reference])
        return _text_of(faults[0]) if faults else float(value)

    def follow(self, cache: PlaneCache, box: Floats, reference: Reference) -> Reference | str:
        """The reference moved toward what the centre box (4,) holds, or what was wrong."""
        if self.learn_rate == 0.0:
            return reference
        try:
            planes = self.planes(cache, box)
        except FAULTS as error:
            return f"raised {said(error)}"
        rates = np.array([self.learn_rate])
        (reference_after,), faults = follow(self.cue, [planes], box[None], [reference], rates)
        return _text_of(faults[0]) if faults else reference_after


def _text_of(fault: Fault) -> str:
    return fault if isinstance(fault, str) else fault.reason


def make_verifiers(
    settings: Mapping[str, Verifier], declarations: Mapping[str, CueDeclaration]
) -> dict[str, VerifierAtWork]:
    """The verifiers of a score, ready to be asked; raises CueError as `make_cue`."""
    verifiers = {}
    for name, verifier in settings.items():
        declaration = declarations[verifier.agent.cue]
        cue = make_cue(declaration, cue_parameters(verifier.agent, declaration))
        assert isinstance(cue, Cue)
        rate = over_frames(verifier.learn_rate, verifier.every)
        verifiers[name] = VerifierAtWork(cue, rate, verifier.every, declaration.needs_color)
    return verifiers


def first_references(
    verifiers: Mapping[str, VerifierAtWork], cache: PlaneCache, box: Floats
) -> dict[str, Reference]:
    """References that verifiers learn in the centre box (4,); one that cannot is asked again later."""
    learnt = {name: verifier.first_reference(cache, box) for name, verifier in verifiers.items()}
    return {name: reference for name, reference in learnt.items() if not isinstance(reference, str)}


@dataclass(frozen=True, eq=False)
class VerifierAnswers:
    """Answers of the verifiers of one target in a frame.

    Attributes:
        values: verifier -> its log-likelihood of the estimate, of those that are asked in this frame.
        references: verifier -> what it remembers; empty of one that failed.
        failed: those that failed in this frame.
    """

    values: Mapping[str, float]
    references: Mapping[str, Reference]
    failed: tuple[VerifierFailed, ...] = ()


@dataclass(frozen=True, eq=False)
class Verification:
    """One frame of one target: its verifiers are asked, and one that fails is out for the rest of the run.

    Attributes:
        verifiers: those of its plate.
        cache: the planes of the frame.
        target: target id.
        box: (4,) the estimate, centre box.
    """

    verifiers: Mapping[str, VerifierAtWork]
    cache: PlaneCache
    target: str
    box: Floats

    def verify(self, references: Mapping[str, Reference], everyone: bool = False) -> VerifierAnswers:
        """Ask those whose turn it is, or `everyone`.

        Those that are asked in every third frame, say, are asked in different ones. One that has no reference
        yet learns its first one here.
        """
        values, updated, faults = dict[str, float](), dict(references), dict[str, str]()
        ordinal = self.cache.frames.current.ordinal
        for place, (name, verifier) in enumerate(self.verifiers.items()):
            if (ordinal + place) % verifier.every and not everyone:
                continue
            reference = updated[name] if name in updated else verifier.first_reference(self.cache, self.box)
            if not reference:  # it failed before
                continue
            value = (
                reference
                if isinstance(reference, str)
                else verifier.log_likelihood(self.cache, self.box, reference)
            )
            if isinstance(reference, str) or isinstance(value, str):
                updated[name], faults[name] = {}, str(value)
            else:
                updated[name], values[name] = reference, value
        return VerifierAnswers(values, updated, self._failed(faults))

    def follow(self, verified: VerifierAnswers) -> VerifierAnswers:
        """The same after those that were asked have learnt from the estimate."""
        references, faults = dict(verified.references), dict[str, str]()
        for name in verified.values:
            answer = self.verifiers[name].follow(self.cache, self.box, references[name])
            references[name] = {} if isinstance(answer, str) else answer
            if isinstance(answer, str):
                faults[name] = answer
        return VerifierAnswers(verified.values, references, (*verified.failed, *self._failed(faults)))

    def _failed(self, faults: Mapping[str, str]) -> tuple[VerifierFailed, ...]:
        frame = self.cache.frames.current.index
        return tuple(VerifierFailed(frame, self.target, name, why) for name, why in faults.items())
