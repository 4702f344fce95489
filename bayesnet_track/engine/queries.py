"""The stage that answers the queries of a graph from the beliefs after a frame."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from bayesnet_track.belief.asked import BeliefGroup, GaussianGroup, WeightedGroup, groups_of
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.outcome import Outcome, State
from bayesnet_track.engine.targets import Targets
from bayesnet_track.inference.queries import (
    CompiledQuery,
    QueryMemory,
    count_of,
    numbers,
    pair_up,
    probabilities,
)
from bayesnet_track.journal.events.beliefs import QueryPassed
from bayesnet_track.journal.metrics import Answers, Subject
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import changed
from bayesnet_track.observation.planes import Frame


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


def answer_queries(work: FrameWork, outcome: Outcome) -> Outcome:
    """The outcome with the answers of its frame, and the events of those that passed their level."""
    started, state = work.engine.clock(), outcome.state
    kinds = {kind for compiled in work.engine.queries for kind in compiled.query.kinds}
    targets = asked_targets(state, kinds)
    frame = frame_names(work.frame, work.cache.frames.previous)
    answers = tuple(answer(compiled, targets, frame) for compiled in work.engine.queries)
    events, high = _passed(work, answers, state.queries.high)
    state = changed(state, queries=QueryMemory(high))
    work.charge("queries", started)
    return changed(
        outcome,
        state=state,
        metrics=outcome.metrics.with_answers(answers),
        events=(*outcome.events, *events),
        answers=answers,
        seconds=work.seconds,
    )


def frame_names(frame: Frame, previous: Frame | None) -> dict[str, float]:
    """Values of the names that are the same for all hypotheses of a frame; NaN where unknown."""
    passed = math.nan if previous is None else frame.time - previous.time
    seconds = math.nan if previous is None else frame.time_s - previous.time_s
    return {
        "frame_width": float(frame.width),
        "frame_height": float(frame.height),
        "dt": 1.0 if previous is None else passed,
        "frame_s": seconds / passed,
    }


def asked_targets(state: State, kinds: set[str]) -> AskedTargets:
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
        groups[kind] += groups_of((target, states[target].belief) for target in states)
        known_existence = {target: states[target].existence for target in states}
        existence.update((target, share) for target, share in known_existence.items() if share is not None)
    return AskedTargets(groups, existence)


def answer(compiled: CompiledQuery, targets: AskedTargets, frame: Mapping[str, float]) -> Answers:
    """The answers to one query."""
    query = compiled.query
    find = numbers if query.kind == "value" else probabilities
    subjects: list[Subject] = []
    columns: list[Floats] = []
    if query.is_pair:
        for (first, first_belief), (second, second_belief) in _pairs(targets, query.kinds):
            subjects.append((first, second))
            columns.append(_rows(find(compiled, pair_up(first_belief, second_belief), frame)))
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
        total = count_of(compiled, table[0])
    return Answers(compiled.name, query.kind, tuple(subjects), table, total, query.unit or "")


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
    work: FrameWork, answers: Sequence[Answers], earlier: frozenset[Subject]
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
