"""Is there something beside the target that looks like it? Then nobody can say which of the two is held."""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from bayesnet_track.adapt.measures import Measures
from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.graph.settings.scores import Distractors
from bayesnet_track.journal.events.distractors import DistractorSeen


def find_distractor(
    rule: Distractors,
    frame: int,
    target: str,
    able: Set[str],
    step: Step[Posterior],
    measures: Measures,
) -> DistractorSeen | None:
    """The best hypothesis that is not the target's own, where it is nearly as likely; else None.

    Asked only in frames at which all agents look that are `able` to, since it takes all of them to tell
    things apart, and where something fits: what nothing fits, nothing resembles.
    """
    if not able <= measures.kl.keys() or measures.fit < rule.fit:
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
