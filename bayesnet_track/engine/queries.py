"""The stage that answers the queries of a graph from the beliefs after a frame, and forecasts.

A forecast is the belief of a target some frames ahead, with no evidence.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np

from bayesnet_track.belief.asked import BeliefGroup, GaussianGroup, WeightedGroup, groups_of
from bayesnet_track.belief.contract import MotionModel, Posterior
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.composed import compose_motion
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.outcome import Outcome, State
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.engine.scoring.score import blur_regions
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.targets import Targets
from bayesnet_track.graph.expressions.terms import FRAME_S
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.inference.crossings import (
    Sample,
    Trail,
    advance_trail,
    convolved,
    sample_gaussian,
    sample_weighted,
)
from bayesnet_track.inference.queries import (
    CompiledQuery,
    PairGroup,
    QueryMemory,
    count_of,
    probabilities,
    query_numbers,
    sum_of_events,
)
from bayesnet_track.journal.events.beliefs import QueryPassed
from bayesnet_track.journal.events.lives import DuplicateEnded
from bayesnet_track.journal.metrics import Answers, FrameMetrics, HasBox, Subject, numbers_of
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.numerics.streams import moment_of
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.observation.timed_columns import values_at

Trails = Mapping[tuple[str, str], Trail]
"""(query, target) -> its hypotheses with the automaton of a line."""


@dataclass(frozen=True, eq=False)
class AskedTargets:
    """The live targets of some kinds as what queries are asked of.

    Attributes:
        groups: kind -> its targets, in groups.
        existence: target -> probability that it exists, where that is not 1.
    """

    groups: Mapping[str, Sequence[BeliefGroup]]
    existence: Mapping[str, float]

    def singles(self, kind: str) -> list[tuple[str, BeliefGroup]]:
        """Each target of a kind with its belief, in the order of their ids."""
        singles = [
            (target, group.take(row)) for group in self.groups[kind] for row, target in enumerate(group.ids)
        ]
        return sorted(singles, key=lambda single: _by_number(single[0]))


def _by_number(target: str) -> tuple[int, str]:
    return len(target), target


def answer_queries(work: FrameContext, outcome: Outcome, filtered: FilteredTargets | None = None) -> Outcome:
    """The outcome with the answers of its frame, and the events of those that passed their level.

    `filtered` is the first half of the frame, from which hypotheses have their ancestors.
    """
    start, state = work.engine.clock(), outcome.state
    kinds = {kind for compiled in work.engine.queries for kind in compiled.query.kinds}
    targets = asked_targets(work.engine, state, kinds)
    frame = frame_names(work.cache.frames)
    trails, ended = follow_crossings(work, outcome, targets, filtered)
    answers = tuple(
        answer(compiled, targets, frame)
        if compiled.query.crosses is None
        else answer_crossings(compiled, targets, trails, ended)
        for compiled in work.engine.queries
    )
    events, high = _passed(work, answers, state.queries.high)
    state = evolve(state, queries=QueryMemory(high, trails, ended))
    work.charge("queries", start)
    return evolve(
        outcome,
        state=state,
        metrics=outcome.metrics.with_answers(answers),
        events=(*outcome.events, *events),
        answers=answers,
        seconds=work.seconds,
    )


def frame_names(frames: FramePair) -> dict[str, float]:
    """Values of the names that are the same for all hypotheses of a frame; NaN where unknown."""
    frame, previous = frames.current, frames.previous
    passed = math.nan if previous is None else frame.time - previous.time
    seconds = math.nan if previous is None else frame.time_s - previous.time_s
    return {**frames.names, FRAME_S: seconds / passed}


def forecast_numbers(
    engine: Engine,
    kind: str,
    single: tuple[str, Posterior],
    size: tuple[int, int],
    inputs: Mapping[str, float],
) -> dict[str, float]:
    """Numbers that a belief one frame after another answers, by name; `single`: a target and its belief.

    Conditions and numbers of one target; what reads `frame_s`, pairs and crossings are left out. `inputs` has
    the time and the inputs of the frame.
    """
    target, belief = single
    targets = AskedTargets({kind: groups_of([(target, belief)], engine.plates[kind].modes)}, {})
    frame = {"frame_width": float(size[0]), "frame_height": float(size[1]), "dt": 1.0, FRAME_S: math.nan}
    frame |= inputs
    queries = [
        compiled
        for compiled in engine.queries
        if compiled.query.kinds == (kind,)
        and compiled.query.kind in ("probability", "value")
        and FRAME_S not in compiled.fixed
    ]
    return numbers_of([answer(compiled, targets, frame) for compiled in queries], target)


def asked_targets(engine: Engine, state: State, kinds: set[str]) -> AskedTargets:
    """The live targets of some kinds; those of tables stay columns."""
    targets = Targets.of(state.targets)
    groups: dict[str, list[BeliefGroup]] = {kind: [] for kind in sorted(kinds)}
    existence: dict[str, float] = {}
    for rows in targets.gaussians:
        kind, columns = rows.rule.plate, rows.columns
        if kind in groups and rows.ids:
            fields = rows.rule.motion.fields
            groups[kind].append(GaussianGroup(rows.ids, fields, columns.mean, columns.covariance))
            if rows.rule.crowd is not None:
                existence.update(zip(rows.ids, columns.existence.tolist(), strict=True))
    for table in targets.particles:
        kind, clouds = table.compiled.plate.name, table.clouds
        if kind in groups and table.ids:
            groups[kind].append(WeightedGroup(table.ids, clouds.fields, clouds.states, clouds.weights))
    for kind in groups:
        states = {
            target: target_state
            for target, target_state in targets.others.items()
            if target_state.plan.target == kind
        }
        beliefs = ((target, states[target].belief) for target in states)
        groups[kind] += groups_of(beliefs, engine.plates[kind].modes)
        known_existence = {target: states[target].existence for target in states}
        existence.update((target, share) for target, share in known_existence.items() if share is not None)
    return AskedTargets(groups, existence)


def answer(compiled: CompiledQuery, targets: AskedTargets, frame: Mapping[str, float]) -> Answers:
    """The answers to one query."""
    query = compiled.query
    find = query_numbers if query.kind == "value" else probabilities
    subjects: list[Subject] = []
    columns: list[Floats] = []
    if query.is_pair:
        for (first, first_belief), (second, second_belief) in _pairs(targets, query.kinds):
            subjects.append((first, second))
            columns.append(_rows(find(compiled, PairGroup.from_groups(first_belief, second_belief), frame)))
    else:
        for group in targets.groups[query.kinds[0]]:
            subjects += ((target,) for target in group.ids)
            columns.append(_rows(find(compiled, group, frame)))
    height = 4 if query.kind == "value" else 1
    table = np.concatenate(columns, axis=1) if columns else np.empty((height, 0))
    total = None
    if query.kind == "count":
        exists = np.array([targets.existence.get(target, 1.0) for (target,) in subjects])
        table = table * exists
        total = count_of(compiled, sum_of_events(table[0]))
    return Answers(compiled.name, query.kind, tuple(subjects), table, total, query.unit or "")


def answer_crossings(
    compiled: CompiledQuery, targets: AskedTargets, trails: Trails, ended: Mapping[str, Floats]
) -> Answers:
    """Of each live target the probability that it has crossed; the number of crossings of all so far."""
    (kind,) = compiled.query.kinds
    ids = sorted((target for group in targets.groups[kind] for target in group.ids), key=_by_number)
    shares = [1.0 - float(trails[compiled.name, target].distribution[0]) for target in ids]
    total = ended.get(compiled.name, np.ones(1))
    for name, target in sorted(trails, key=lambda key: _by_number(key[1])):
        if name == compiled.name:
            total = convolved(total, trails[name, target].distribution)
    subjects = tuple((target,) for target in ids)
    table = np.array(shares).reshape(1, -1)
    return Answers(compiled.name, "crosses", subjects, table, count_of(compiled, total))


def follow_crossings(
    work: FrameContext, outcome: Outcome, targets: AskedTargets, filtered: FilteredTargets | None
) -> tuple[Trails, Mapping[str, Floats]]:
    """Trails of all lines with one frame more, and what is left of targets that are gone.

    The crossings of a target that may return stay its own, so that it is counted once. Those of a duplicate
    are those of another target.
    """
    state, memory = outcome.state, outcome.state.queries
    returning = {remembered.target for remembered in state.history.dead}
    doubles = {event.target for event in outcome.events if isinstance(event, DuplicateEnded)}
    trails: dict[tuple[str, str], Trail] = {}
    ended = dict(memory.ended)
    for compiled in work.engine.queries:
        line = compiled.query.crosses
        if line is None:
            continue
        (kind,) = compiled.query.kinds
        for target, group in targets.singles(kind):
            key = compiled.name, target
            trail = memory.trails.get(key)
            sample = _sample(work, outcome, compiled, (group, trail), filtered)
            trails[key] = advance_trail(line, trail, sample, targets.existence.get(target, 1.0))
        for (name, target), trail in memory.trails.items():
            if name != compiled.name or (name, target) in trails or target in doubles:
                continue
            if target in returning:
                trails[name, target] = trail
            else:
                ended[name] = convolved(ended.get(name, np.ones(1)), trail.distribution)
    return trails, ended


def _sample(
    work: FrameContext,
    outcome: Outcome,
    compiled: CompiledQuery,
    single: tuple[BeliefGroup, Trail | None],
    filtered: FilteredTargets | None,
) -> Sample:
    line, (group, trail) = compiled.query.crosses, single
    assert line is not None
    (target,) = group.ids
    if not isinstance(group, GaussianGroup):
        ancestors = None if filtered is None else filtered.ancestors(target)
        return sample_weighted(group, line, ancestors)
    previous = work.cache.frames.previous
    passed = 1.0 if previous is None else work.frame.time - previous.time
    motion = work.engine.plates[compiled.query.kinds[0]].motion
    birth = outcome.state.history.births.get(target, target)
    stream = work.stream_of(birth, f"query {compiled.name}")
    return sample_gaussian(group, line, trail, (motion, passed), stream)


def _rows(values: Floats) -> Floats:
    return values.reshape(-1, values.shape[-1])


def _pairs(
    targets: AskedTargets, kinds: tuple[str, ...]
) -> Iterator[tuple[tuple[str, BeliefGroup], tuple[str, BeliefGroup]]]:
    """Every pair of a first and a second kind; of one kind each pair of two targets once."""
    first, second = kinds
    if first == second:
        yield from combinations(targets.singles(first), 2)
    else:
        yield from product(targets.singles(first), targets.singles(second))


def _passed(
    work: FrameContext, answers: Sequence[Answers], earlier: frozenset[Subject]
) -> tuple[list[QueryPassed], frozenset[Subject]]:
    """Events of answers that passed their level, and those that are above it now: query, then targets."""
    events: list[QueryPassed] = []
    high: set[Subject] = set()
    for compiled, answered in zip(work.engine.queries, answers, strict=True):
        level = compiled.query.event_above
        if level is None:
            continue
        for subject, probability in zip(answered.subjects, answered.columns[0].tolist(), strict=True):
            key = (answered.query, *subject)
            is_above = probability >= level
            if is_above:
                high.add(key)
            if is_above != (key in earlier):
                second = subject[1] if len(subject) > 1 else ""
                frame = work.frame.index
                events.append(
                    QueryPassed(frame, subject[0], answered.query, probability, level, is_above, second)
                )
    return events, frozenset(high)


@dataclass(frozen=True)
class Forecast(HasBox):
    """Expected state of a target some frames ahead.

    Attributes:
        target: target id.
        ahead: frames after the last one.
        centre_box: mean centre x, y, width, height, px.
        sd: of x, y, w, h, px.
        region50: bounds of the central 50 % of the centre: x_low, x_high, y_low, y_high, px.
        region90: the same of the central 90 %.
        queries: what the belief answers to the queries of the graph, by name: conditions and numbers of one
            target that do not read `frame_s`.
    """

    target: str
    ahead: int
    centre_box: tuple[float, ...]
    sd: tuple[float, ...]
    region50: tuple[float, ...]
    region90: tuple[float, ...]
    queries: Mapping[str, float] = field(default_factory=dict)


def check_forecasts(graph: GraphSpec) -> None:
    """Refuse forecasts of targets on the ground; raises ValueError."""
    name = next((name for name, target in graph.targets.items() if target.is_ground), None)
    if name is not None:
        raise ValueError(
            f"forecasts are of boxes in the image, and the state of {name} is on the ground, in m"
        )


def forecast(
    engine: Engine,
    state: TargetState,
    birth: str,
    measured: FrameMetrics,
    frames: int,
    size: tuple[int, int],
) -> list[Forecast]:
    """The belief of one target 1 to `frames` frames ahead.

    Args:
        engine: of the run.
        state: what is known of the target after the last frame.
        birth: what its draws are keyed by.
        measured: what was measured of it there.
        frames: how far to look.
        size: width and height of the image.

    The motion is the graph's, its noise as wide as in the last frame; that the camera goes on moving or that
    the target jumps is not expected. Inputs by frame are those of the frames to come; others
    stay as they are.
    """
    compiled = engine.plates[state.plan.target]
    free = _motion_of(compiled, state)
    belief, forecasts = state.belief, []
    for horizon in range(1, frames + 1):
        coming = measured.frame + horizon
        numbers = values_at(engine.inputs, (coming, coming - 1), (measured.time_s, measured.time_s))
        inputs = {"t": state.time + horizon, **numbers}
        motion = confined(free, *size, inputs)
        stream = engine.streams.of(birth, compiled.plate.root, moment_of(state.time + horizon), "forecast")
        belief = compiled.belief.predict(belief, motion, 1.0, stream)
        expected = _described(compiled, belief, measured, horizon)
        if engine.queries:
            answers = forecast_numbers(engine, compiled.plate.name, (measured.target, belief), size, inputs)
            expected = replace(expected, queries=answers)
        forecasts.append(expected)
    return forecasts


def _motion_of(compiled: CompiledPlate, state: TargetState) -> MotionModel:
    context = state.motion_context
    if compiled.moving is None or context is None or context.influences is None:
        return compiled.motion
    return compose_motion(compiled.motion, compiled.moving, replace(context.influences, dt=1.0, camera=None))


def _described(compiled: CompiledPlate, belief: Posterior, measured: FrameMetrics, horizon: int) -> Forecast:
    mean, variances = belief.mean[:4], np.clip(np.diagonal(belief.covariance)[:4], 0.0, None).copy()
    region50, region90 = belief.regions((0.5, 0.9))
    error = compiled.plate.inference(compiled.plate.root).localization_error
    if error is not None:
        wide = blur_regions(belief, error, measured.score, float(np.sqrt(max(mean[2] * mean[3], 1.0))))
        region50, region90 = wide.region50, wide.region90
        variances[:2] += wide.variance
    return Forecast(
        measured.target,
        horizon,
        tuple(mean.tolist()),
        tuple(np.sqrt(variances).tolist()),
        tuple(float(value) for value in region50),
        tuple(float(value) for value in region90),
    )
