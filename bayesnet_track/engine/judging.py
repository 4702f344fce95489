"""Second half of a frame, first part: beliefs of a group are measured and scored, and the rules decide."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.presence import SHIFT
from bayesnet_track.adapt.rule_columns import STATUSES, RuleColumns
from bayesnet_track.adapt.rule_inputs import GroupMeasures, RuleInputs
from bayesnet_track.adapt.rules import decide
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext, inside_frame, inside_frame_all
from bayesnet_track.engine.groups import FilteredGroup, LiveGroup
from bayesnet_track.engine.scoring.outcome import ScoreOutcome, score_target
from bayesnet_track.journal.net import Decision
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.cameras import UNSEEN
from bayesnet_track.observation.planes import Frame


@dataclass(frozen=True, eq=False)
class JudgedGroup:
    """Measures of a group, and what the rules make of them.

    Attributes:
        filtered: the first half of the frame of T targets.
        nets: their live nets, as in `LiveGroup`.
        statuses: (T,) places in `adapt.rule_columns.STATUSES`.
        states: (T, D) estimates.
        boxes: (T, 4) their centre boxes, inside the frame.
        measures: UD, KL, contributions, ...
        scores: of each; empty where the graph does not say how a score comes about.
        chosen: row -> decisions, in order; without rows of which nothing was decided.
        memory: what the rules remember.
        levels_px2: (T,) baselines of the root's UD; NaN while unknown.
        see: row -> all that the rules of one target see.
    """

    filtered: FilteredGroup[Any]
    nets: Sequence[TargetNet]
    statuses: Ints
    states: Floats
    boxes: Floats
    measures: GroupMeasures
    scores: Sequence[ScoreOutcome]
    chosen: Mapping[int, tuple[Decision, ...]]
    memory: RuleMemory
    levels_px2: Floats
    see: Callable[[int], RuleInputs]

    @cached_property
    def baselines_px2(self) -> Sequence[float | None]:
        """Of each the baseline of the root's UD; None while unknown."""
        return [None if level != level else level for level in self.levels_px2.tolist()]

    def score(self, row: int) -> ScoreOutcome:
        """Score of one target."""
        return self.scores[row] if self.scores else ScoreOutcome(self.filtered.state(row).scored)

    def held(self, row: int) -> Floats | None:
        """(4,) the box of one target, while it more probably holds the target than not."""
        score = self.score(row).score
        is_held = self.nets[row].status == "tracking" and (score is None or score >= 0.5)
        return self.boxes[row] if is_held else None


def judge_group(work: FrameContext, group: LiveGroup) -> JudgedGroup:
    """Measure and score the targets of a group, and apply the rules."""
    filtered, nets = group.filtered, group.nets
    plate = filtered.compiled.plate
    root = plate.inference(plate.root)
    states = filtered.estimates(root.estimate)
    boxes = _boxes_of(filtered.compiled, states, work.frame)
    sides = boxes if filtered.compiled.views is None else states
    measures = filtered.measures(sides[:, 2] * sides[:, 3])
    scores: list[ScoreOutcome] = []
    if root.score is not None:
        scores = [
            score_target(work, filtered.of(row), boxes[row], measures.of(row)) for row in range(len(nets))
        ]
    see = partial(_see, (work.frame.index, work.frame.stride), group, measures, scores)
    inputs = rule_columns(group, measures, scores, see)
    decisions, memory = decide(inputs, filtered.memory)
    levels = memory.levels_px2(plate.root, plate.below[plate.root] & inputs.active)
    return JudgedGroup(
        filtered, nets, inputs.statuses, states, boxes, measures, scores, decisions, memory, levels, see
    )


def _boxes_of(compiled: CompiledPlate, states: Floats, frame: Frame) -> Floats:
    """(T, 4) centre boxes of states (T, D), inside the frame; of points as they are."""
    boxes = compiled.boxes(states, frame)
    if compiled.plate.spec.state == "point":
        return boxes.copy()
    if len(boxes) == 1:  # plain numbers: a tenth of the time of arrays
        return inside_frame(boxes[0], frame)[None] if boxes[0, 0] != UNSEEN[0] else boxes
    return np.where(boxes[:, :1] == UNSEEN[0], boxes, inside_frame_all(boxes, frame))


# ------------------------------------------------------------------------------------ rules


def rule_columns(
    group: LiveGroup,
    measures: GroupMeasures,
    scores: Sequence[ScoreOutcome],
    see: Callable[[int], RuleInputs],
) -> RuleColumns:
    """The inputs of the rules as columns."""
    filtered, nets = group.filtered, group.nets
    compiled, statuses, existence = filtered.compiled, filtered.statuses, _existence(filtered)
    if statuses is None:
        statuses = np.array([STATUSES.index(net.status) for net in nets])
    hidden = filtered.hidden
    return RuleColumns(
        plate=compiled.plate,
        active=nets[0].active if nets else filtered.plan.active,
        statuses=statuses,
        measures=measures,
        see=see,
        adaptable=compiled.adaptable,
        hidden=np.array(hidden) if any(hidden) else None,
        score=np.array([outcome.score for outcome in scores]) if scores else None,
        existence=existence,
        is_hidden=filtered.is_hidden,
        is_unasked=filtered.is_unasked,
        pending=filtered.asks(nets),
    )


def _existence(filtered: FilteredGroup[Any]) -> Floats | None:
    """(T,) the probabilities of existence that say which targets are lost."""
    existence = filtered.existence
    if existence is None or filtered.compiled.plate.lost.existence_in_box_below is None:
        return existence
    return existence * _probability_in_box(*filtered.moments)


def _see(
    frame: tuple[int, int],
    group: LiveGroup,
    measures: GroupMeasures,
    scores: Sequence[ScoreOutcome],
    row: int,
) -> RuleInputs:
    """All that the rules of one target see; `frame` is its number and stride: it is not to be held."""
    filtered, compiled, (index, stride) = group.filtered, group.filtered.compiled, frame
    target = None if filtered.beside is None else filtered.beside[row]
    existence = _existence(filtered)
    return RuleInputs(
        index,
        filtered.ids[row],
        compiled.plate,
        group.nets[row],
        measures.of(row),
        compiled.costs_ms,
        compiled.adaptable,
        filtered.hidden[row],
        scores[row].score if scores else None,
        {} if target is None else target.missed,
        None if existence is None else float(existence[row]),
        None if target is None or target.modes is None else target.modes.hiding,
        None if target is None else target.call,
        stride,
    )


def _probability_in_box(mean: Floats, covariance: Floats) -> Floats:
    """(T,) probabilities that targets are shifted from their box by at most a third of a side in x and in y.

    Means (T, D) of x, y, w, h, ... and covariances (T, D, D).

    >>> mean, covariance = np.array([[50.0, 40, 30, 60]]), np.diag([10.0, 1e-6, 1, 1])[None] ** 2
    >>> float(_probability_in_box(mean, covariance)[0].round(4))  # within one sd
    0.6827
    """
    sd = np.sqrt(np.maximum(covariance[:, (0, 1), (0, 1)], 1e-12))
    reach = (SHIFT * mean[:, 2:4] / sd / math.sqrt(2.0)).ravel().tolist()
    return np.asarray(np.array([math.erf(value) for value in reach]).reshape(-1, 2).prod(axis=1))
