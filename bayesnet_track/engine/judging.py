"""Second half of a frame, first part: beliefs of a group are measured and scored, and the rules decide."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_columns import STATUSES, RuleColumns
from bayesnet_track.adapt.rule_inputs import GroupMeasures, RuleInputs
from bayesnet_track.adapt.rules import decide
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.groups import FilteredGroup, LiveGroup
from bayesnet_track.engine.scoring.outcome import ScoreOutcome, score_target
from bayesnet_track.engine.state import inside_frame, inside_frame_all
from bayesnet_track.inference.measure import measure
from bayesnet_track.inference.measure_rows import measure_rows
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.numerics.arrays import Bools, Floats


@dataclass(frozen=True, eq=False)
class JudgedGroup:
    """Measures of a group, and what the rules make of them.

    Attributes:
        filtered: the first half of the frame of T targets.
        nets: their live nets, as in `LiveGroup`.
        states: (T, D) estimates.
        boxes: (T, 4) their centre boxes, inside the frame.
        measures: UD, KL, contributions, ...
        scores: of each; empty where the graph does not say how a score comes about.
        chosen: row -> decisions, in order; without rows of which nothing was decided.
        memory: what the rules remember.
        baselines_px2: of each the baseline of the root's UD; None while unknown.
        see: row -> all that the rules of one target see.
    """

    filtered: FilteredGroup
    nets: Sequence[TargetNet]
    states: Floats
    boxes: Floats
    measures: GroupMeasures
    scores: Sequence[ScoreOutcome]
    chosen: Mapping[int, tuple[Decision, ...]]
    memory: RuleMemory
    baselines_px2: Sequence[float | None]
    see: Callable[[int], RuleInputs]

    def score(self, row: int) -> ScoreOutcome:
        """Score of one target."""
        return self.scores[row] if self.scores else ScoreOutcome(self.filtered.state(row).scored)

    def held(self, row: int) -> Floats | None:
        """(4,) the box of one target, while it more probably holds the target than not."""
        score = self.score(row).score
        is_held = self.nets[row].status == "tracking" and (score is None or score >= 0.5)
        return self.boxes[row] if is_held else None


def judge_group(work: FrameWork, group: LiveGroup) -> JudgedGroup:
    """Measure and score the targets of a group, and apply the rules."""
    filtered, nets = group.filtered, group.nets
    plate = filtered.compiled.plate
    root = plate.inference(plate.root)
    states = filtered.estimates(root.estimate)
    boxes = _inside_frame(states, work)
    measures = measure_group(filtered, boxes[:, 2] * boxes[:, 3])
    scores: list[ScoreOutcome] = []
    if root.score is not None:
        scores = [
            score_target(work, filtered.of(row), boxes[row], measures.of(row)) for row in range(len(nets))
        ]
    see = partial(_see, work, group, measures, scores)
    inputs = rule_columns(group, measures, scores, see)
    chosen, memory = decide(inputs, filtered.memory)
    levels = memory.levels_px2(plate.root, plate.below[plate.root] & inputs.active).tolist()
    baselines = [None if level != level else level for level in levels]
    return JudgedGroup(filtered, nets, states, boxes, measures, scores, chosen, memory, baselines, see)


def _inside_frame(states: Floats, work: FrameWork) -> Floats:
    """(T, 4) centre boxes of states (T, D), inside the frame."""
    if len(states) == 1:  # plain numbers: a tenth of the time of arrays
        return inside_frame(states[0, :4], work.frame)[None]
    return inside_frame_all(states[:, :4], work.frame)


def measure_group(filtered: FilteredGroup, areas_px2: Floats) -> GroupMeasures:
    """UD, KL, ... of the beliefs of a group, whose estimates have these areas (T,)."""
    plate, steps = filtered.compiled.plate, filtered.arrays
    if steps is not None:
        return measure_rows(plate, filtered.plan, steps, areas_px2)
    targets = [filtered.of(row) for row in range(len(areas_px2))]
    pairs = zip(targets, areas_px2.tolist(), strict=True)
    return GroupMeasures.of_each([measure(plate, one.plan, one.step, area) for one, area in pairs])


# ------------------------------------------------------------------------------------ rules


def rule_columns(
    group: LiveGroup,
    measures: GroupMeasures,
    scores: Sequence[ScoreOutcome],
    see: Callable[[int], RuleInputs],
) -> RuleColumns:
    """The inputs of the rules as columns."""
    filtered, nets = group.filtered, group.nets
    compiled, rows = filtered.compiled, range(len(nets))
    beside = [filtered.beside(row) for row in rows]
    hidden = filtered.hidden
    existences = [filtered.state(row).existence for row in rows]
    return RuleColumns(
        plate=compiled.plate,
        active=nets[0].active,
        statuses=np.array([STATUSES.index(net.status) for net in nets]),
        measures=measures,
        see=see,
        adaptable=compiled.adaptable,
        hidden=np.array(hidden) if any(hidden) else None,
        score=np.array([one.score for one in scores]) if scores else None,
        existence=None if existences[0] is None else np.array(existences),
        is_hidden=_probably_hidden(beside),
        pending=_asks(nets, beside),
    )


def _probably_hidden(beside: Sequence[Filtered | None]) -> Bools | None:
    """(T,) whether targets probably cannot be seen, by their modes; None where these do not say."""
    causes = [None if one is None or one.modes is None else one.modes.hiding for one in beside]
    if causes[0] is None:
        return None
    return np.array([cause is not None and cause.hidden > cause.level for cause in causes])


def _asks(nets: Sequence[TargetNet], beside: Sequence[Filtered | None]) -> Bools | None:
    """(T,) whether something else than a streak asks for a decision; None where nothing does."""
    asks = [
        bool(net.quarantined or (one is not None and (one.missed or (one.call is not None and one.call.ran))))
        for net, one in zip(nets, beside, strict=True)
    ]
    return np.array(asks) if any(asks) else None


def _see(
    work: FrameWork, group: LiveGroup, measures: GroupMeasures, scores: Sequence[ScoreOutcome], row: int
) -> RuleInputs:
    """All that the rules of one target see."""
    filtered, compiled = group.filtered, group.filtered.compiled
    one = filtered.beside(row)
    return RuleInputs(
        work.frame.index,
        filtered.ids[row],
        compiled.plate,
        group.nets[row],
        measures.of(row),
        compiled.costs_ms,
        compiled.adaptable,
        filtered.hidden[row],
        scores[row].score if scores else None,
        {} if one is None else one.missed,
        filtered.state(row).existence,
        None if one is None or one.modes is None else one.modes.hiding,
        None if one is None else one.call,
        work.frame.stride,
    )
