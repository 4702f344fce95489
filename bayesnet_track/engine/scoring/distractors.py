"""Is there something beside the target that looks like it? Then nobody can say which of the two is held."""

from __future__ import annotations

import numpy as np

from bayesnet_track.adapt.rule_inputs import Measures
from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.engine.scoring.encounters import (
    BEFORE,
    NEAR_BOX,
    NEARER,
    SPAN,
    WAIT,
    Encounter,
    Place,
    distances_since,
    motion_before,
)
from bayesnet_track.engine.scoring.score import Scored
from bayesnet_track.graph.settings.scores import Distractors
from bayesnet_track.journal.events.statuses import DistractorSeen, DoubtEnded
from bayesnet_track.numerics.records import changed


def find_distractor(
    rule: Distractors, frame: int, target: str, step: Step[Posterior], measures: Measures
) -> DistractorSeen | None:
    """The best hypothesis that is not the target's own, where it is nearly as likely; else None.

    None, too, where nothing fits: nothing resembles it.
    """
    if measures.fit < rule.fit:
        return None
    boxes, log = step.support.boxes, step.evidence.log_likelihood
    own = int(np.argmax(step.support.weights.log))
    side = float(np.sqrt(max(measures.area_px2, 1.0)))
    away = np.hypot(boxes[:, 0] - boxes[own, 0], boxes[:, 1] - boxes[own, 1]) / side
    beside = np.flatnonzero(away >= rule.beyond_box)
    if not len(beside):
        return None
    other = int(beside[np.argmax(log[beside])])
    behind = float(log[own] - log[other])
    if behind >= rule.within_nats:
        return None
    x, y = boxes[other, :2].tolist()
    return DistractorSeen(
        frame, target, x, y, float(away[other]), behind, rule.within_nats, measures.fit, rule.hold
    )


def follow_distractor(
    scored: Scored, distractor: DistractorSeen | None, frames: int, target: str, place: Place, side_px: float
) -> tuple[Scored, DoubtEnded | None]:
    """With the distractor of this frame, or the end of the doubt, where motion shows which is followed.

    `place` is the estimate's, `side_px` the root of its area.
    """
    scored, ended = with_distractor(scored, distractor, frames), None
    if scored.doubt and scored.encounter is not None and _is_past(scored.meeting, place.frame):
        away = distances_since(scored.encounter, place, side_px)
        if away is not None and away[0] < min(NEARER * away[1], NEAR_BOX):
            ended = DoubtEnded(place.frame, target, *away, min(NEARER, NEAR_BOX / away[1]), scored.doubt)
            scored = changed(scored, doubt=0)
    return changed(scored, places=(*scored.places, place)[-BEFORE - SPAN :]), ended


def _is_past(meeting: Encounter | None, frame: int) -> bool:
    """Whether no look-alike has been seen for a while, be it in too few frames in a row to count."""
    return meeting is None or frame - meeting.last.frame >= WAIT


def with_distractor(scored: Scored, distractor: DistractorSeen | None, frames: int) -> Scored:
    """With the distractor of this frame, if there is one; `frames` in a row put the target in doubt."""
    if distractor is None:
        return changed(scored, distractors=0)
    count, seen = scored.distractors + 1, Place(distractor.frame, distractor.x, distractor.y)
    meeting = Encounter(motion_before(scored.places), seen, seen, distractor.behind_nats)
    if scored.distractors and scored.meeting is not None:
        most = max(scored.meeting.behind_nats, distractor.behind_nats)
        meeting = changed(scored.meeting, last=seen, behind_nats=most)
    scored = changed(scored, distractors=count, meeting=meeting)
    if count < frames:
        return scored
    # In doubt already: how the target moved is known from before.
    own = scored.encounter.own if scored.doubt and scored.encounter is not None else meeting.own
    return changed(scored, doubt=distractor.hold, encounter=changed(meeting, own=own))


def without_motion(scored: Scored) -> Scored:
    """The same of a target that may be anywhere now: how it and a look-alike moved before says nothing."""
    return changed(scored, distractors=0, places=(), meeting=None, encounter=None)
