"""Give targets their detections before they are weighed, for plates whose agents measure by them.

The detectors look, every target's belief is predicted, and the targets of a plate share its detections out:
as many as can be, the best for all together by where each target is expected and, where the agent's
`appearance` asks for it, by what the target looks like. What nobody gets is left to the life of targets
(`track_management`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.adapt.association import NOBODY
from bayesnet_track.adapt.existence import Population
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.belief.gaussian.belief import predict
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.lifecycle.assigning import Sharing, give_detection, score_looks
from bayesnet_track.engine.lifecycle.detecting import Found, look
from bayesnet_track.engine.lifecycle.existing import Crowd, divide
from bayesnet_track.engine.lifecycle.prospects import CrowdRule
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import Gaussian
from bayesnet_track.journal.events.lives import DetectionsCut, DetectorFailed
from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Associated:
    """What a look before the targets were weighed gave.

    Attributes:
        found: plate that looked -> its detections, the best first.
        owners: plate whose agents measure by detections -> (N,) for each of its detections the target that it
            was given to, or `TENTATIVE`.
        targets: every live target, the references of such agents with what they were given.
        history: as it was, with the detectors' states after the look, and tentative tracks after the frame.
        events: detectors that failed.
    """

    found: dict[str, Found]
    owners: Mapping[str, tuple[str | None, ...]]
    targets: Mapping[str, TargetState]
    history: TrackHistory
    events: tuple[DetectorFailed | DetectionsCut, ...]


def associate_first(work: FrameWork, targets: Mapping[str, TargetState], history: TrackHistory) -> Associated:
    """Association of detections and targets, for plates with agents that measure by them."""
    net, plates = work.net, work.engine.plates
    started = work.engine.clock()
    expected = {target: _predict_box(work, target, before) for target, before in targets.items()}

    def held(plate: str) -> list[str]:
        of_plate = (target for target in targets if net.targets[target].template == plate)
        return [target for target in of_plate if net.targets[target].status != "lost"]

    found, history, events = look(
        work, history, lambda names: np.array([expected[name][0] for name in names]).reshape(-1, 4), held
    )
    given = dict(targets)
    owners: dict[str, tuple[str | None, ...]] = {}
    for plate, compiled in plates.items():
        if not compiled.association_rules:
            continue
        own = {target: one for target, one in targets.items() if net.targets[target].template == plate}
        boxes = {target: expected[target] for target in own}
        rule, whose = CrowdRule.of(compiled), tuple[str | None, ...]()
        if rule is None:
            whose, own, left = Sharing(work, plate, history, found.get(plate), boxes).share(own)
            if left is not None:
                history = replace(history, candidates={**history.candidates, plate: left})
        else:
            before = history.populations.get(plate)
            own, whose, population = _divide(work, rule, (own, boxes), before, found.get(plate))
            history = replace(history, populations={**history.populations, plate: population})
        given |= own
        if plate in found:
            owners[plate] = whose
    work.charge("life", started)
    return Associated(found, owners, given, history, events)


def _divide(
    work: FrameWork,
    rule: CrowdRule,
    crowd: tuple[Mapping[str, TargetState], Mapping[str, tuple[Floats, Floats]]],
    population: Population | None,
    found: Found | None,
) -> tuple[dict[str, TargetState], tuple[str | None, ...], Population]:
    """The targets of a plate as they exist after the look, with what each is given of the detections.

    Also whose each detection is more probably than not, and what was learnt. `crowd` holds the targets and
    the boxes that are expected.
    """
    targets, expected = crowd
    names = list(targets)

    def log_looks(row: int, boxes: Floats) -> Floats:
        return (
            score_looks(work, names[row], targets[names[row]], boxes)
            if row < len(names)
            else np.zeros(len(boxes))
        )

    mean = np.array([expected[target][0] for target in names]).reshape(-1, 4)
    covariance = np.array([expected[target][1] for target in names]).reshape(-1, 4, 4)
    existence = [one.existence for one in targets.values()]
    before = np.array([1.0 if one is None else one for one in existence])
    all_of = Crowd(mean, covariance, before, names, log_looks)
    done = divide(rule, work.cache.frames, all_of, population, found)
    seen = Found.none() if found is None else found
    whose: list[str | None] = [None] * len(seen.boxes)
    given = {}
    for row, target in enumerate(names):
        which = slice(done.starts[row], done.starts[row + 1])
        columns = done.columns[which]
        own = np.column_stack([seen.boxes[columns], seen.scores[columns]])
        if rule.is_marginal:
            own = np.column_stack([own, done.weights[which]])
        state = give_detection(targets[target], work.plate_of(target).association_rules, own)
        given[target] = replace(state, existence=float(done.existence[row]))
        if done.owner[row] != NOBODY:
            whose[done.owner[row]] = target
    return given, tuple(whose), done.population


def _predict_box(work: FrameWork, target: str, before: TargetState) -> tuple[Floats, Floats]:
    """(4,) mean and (4, 4) covariance of the box that the target is expected to have in this frame.

    Exact of a Gaussian belief under linear motion, else by moments and the motion's derivative.
    """
    frame = work.frame
    motion = confined(work.plate_of(target).motion, frame.width, frame.height)
    belief, elapsed = before.belief, frame.time - before.time
    mean, covariance = predict(belief.mean, belief.covariance, motion, elapsed, Gaussian())
    return mean[:4], covariance[:4, :4]
