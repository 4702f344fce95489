"""Assign detections to the targets of a plate and to its tentative tracks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayesnet_track.adapt.association import (
    UNASSIGNED,
    Owners,
    Pass,
    assign_pairs,
    share_by_overlap,
    share_in_passes,
)
from bayesnet_track.adapt.existence import Pairs
from bayesnet_track.adapt.lifecycle import Candidate, TrackHistory
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext, ask_together
from bayesnet_track.engine.lifecycle.sensing import Found, gate_boxes, with_looks
from bayesnet_track.engine.lifecycle.sharing import TrackArrays, update_tentative
from bayesnet_track.engine.state import TargetState, plan_for
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure import is_flat
from bayesnet_track.inference.messages import Observer, evaluate, join_plain
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import (
    OBSERVED,
    OWN_DETECTION,
    OWN_LABEL,
    AssociationRule,
    Hypotheses,
    Reference,
)

TENTATIVE = ""
"""Stands for any tentative track where it is said whose a detection is."""

LEAST_LOG = -50.0
"""Log-likelihoods of looks are cut here, so that they are numbers: lower ones are beyond every gate."""


def assign_detections(
    rule: AssociationRule,
    expected: TrackArrays,
    detections: Found,
    log_looks: Callable[[Ints, Floats], Floats],
    by_labels: Mapping[int, Floats],
) -> Owners:
    """(T,) the detection of each track, or `UNASSIGNED`; see `adapt.association` and `adapt.association`.

    `log_looks` takes rows (M,) in order and boxes (M, 4), and gives (M,) log-likelihoods by what the targets
    look like. `by_labels` has, of rows that labels are evidence on, (N,) the log of how much likelier each
    label is theirs than nobody's.
    """
    log_labels = np.zeros((len(expected.mean), len(detections.boxes)) if by_labels else (0, 0))
    for row, log in by_labels.items():
        log_labels[row] = log
    mean, covariance, boxes = expected.mean, expected.covariance, np.ascontiguousarray(detections.boxes)
    if rule.similarity == "iou":
        if not len(boxes):
            return np.full(len(mean), UNASSIGNED, dtype=np.intp)
        return share_by_overlap(rule, mean[:, :4], expected.observed, boxes, detections.scores)
    if rule.first_score <= 0.0:
        return _assign_by_density(rule, (mean, covariance), boxes, log_looks, log_labels)

    def ask(stage: Pass, rows: Owners, columns: Owners) -> Owners:
        def log_own(some: Ints, places: Floats) -> Floats:
            return log_looks(rows[some], places)

        labels = log_labels[np.ix_(rows, columns)] if by_labels else log_labels
        return _assign_by_density(rule, (mean[rows], covariance[rows]), boxes[columns], log_own, labels)

    return share_in_passes(rule, detections.scores, len(mean), ask)


def _assign_by_density(
    rule: AssociationRule,
    moments: tuple[Floats, Floats],
    boxes: Floats,
    log_looks: Callable[[Ints, Floats], Floats],
    log_labels: Floats,
) -> Owners:
    mean, covariance = moments
    pairs = gate_boxes(rule, mean, covariance, boxes)
    if rule.appearance > 0.0 and len(pairs.rows):
        pairs = _gate_looks(rule, pairs, mean, covariance, (boxes, log_looks))
    if log_labels.size:
        pairs = evolve(pairs, values=pairs.values + log_labels[pairs.rows, pairs.columns])
    return assign_pairs(pairs.rows, pairs.columns, pairs.values, len(mean), len(boxes))


def _gate_looks(
    rule: AssociationRule,
    pairs: Pairs,
    mean: Floats,
    covariance: Floats,
    looks: tuple[Floats, Callable[[Ints, Floats], Floats]],
) -> Pairs:
    """The pairs that are left when looks count: d^2 - 2 appearance log L is within the gate as well."""
    boxes, log_looks = looks
    values = with_looks(rule, pairs, log_looks, boxes).values
    spread = covariance[pairs.rows, :4, :4] + rule.variances(boxes)[pairs.columns][:, :, None] * np.eye(4)
    limit = -0.5 * (chi_square_quantile(rule.gate, 4) + np.linalg.slogdet(spread)[1])
    is_near = values >= limit
    return Pairs(pairs.rows[is_near], pairs.columns[is_near], values[is_near])


def tentative_tracks(compiled: CompiledPlate, history: TrackHistory) -> tuple[Candidate, ...]:
    """The tentative tracks of a plate."""
    birth = None if compiled.lifecycle is None else compiled.lifecycle.birth
    if birth is None or not birth.tentative:
        return ()
    return history.candidates.get(compiled.plate.name, ())


def advance_tentative(
    compiled: CompiledPlate,
    waiting: Sequence[Candidate],
    updated: TrackArrays,
    assigned: Floats,
    looked: bool,
) -> tuple[Candidate, ...]:
    """Tentative tracks, the last rows of `updated` and `assigned`, after they were given their detections."""
    if not waiting:
        return ()
    rows = slice(len(assigned) - len(waiting), len(assigned))
    agent, rule = next(iter(compiled.association_rules.items()))
    variances = rule.variances(assigned[rows, :4]) * compiled.plate.agent(agent).temperature
    assert compiled.lifecycle is not None and compiled.lifecycle.birth is not None
    confirm = compiled.lifecycle.birth.confirm if looked else None
    return update_tentative(waiting, updated.only(rows), assigned[rows], variances, confirm)


def label_tentative(
    candidates: Sequence[Candidate], updated: Sequence[Candidate], log: Floats
) -> tuple[Candidate, ...]:
    """Tentative tracks after a look, with what the labels of their detections say: `log` (C, V)."""
    logs = {candidate.birth: row for candidate, row in zip(candidates, log, strict=True)}
    return tuple(candidate.told(logs[candidate.birth]) for candidate in updated)


def name_owners(owner: Owners, names: Sequence[str], detection_count: int) -> tuple[str | None, ...]:
    """Owner of each of the detections: a target, `TENTATIVE`, or nobody."""
    whose: list[str | None] = [None] * detection_count
    for row, column in enumerate(owner.tolist()):
        if column != UNASSIGNED:
            whose[column] = names[row] if row < len(names) else TENTATIVE
    return tuple(whose)


def remember_detections(
    state: TargetState, agent: str, observed: Floats, refiltered: tuple[Floats, Floats] | None
) -> TargetState:
    """The target with what is remembered of its detections, and a belief that was `refiltered`."""
    if refiltered is not None and isinstance(state.belief, GaussianPosterior):
        state = replace(state, belief=replace(state.belief, mean=refiltered[0], covariance=refiltered[1]))
    if not len(observed) or agent not in state.references:
        return state
    reference = {**state.references[agent], OBSERVED: observed}
    return replace(state, references={**state.references, agent: reference})


def score_looks(
    work: FrameContext,
    compiled: CompiledPlate,
    targets: Sequence[str],
    memories: Mapping[str, Sequence[Reference]],
    boxes: Floats,
    starts: Ints,
) -> Floats:
    """(N,) log-likelihoods of boxes (N, 4) by all agents that know the targets' looks, switched on or not.

    Those of target t are `starts[t]` to `starts[t + 1] - 1` of the boxes, one at least. `memories`: what each
    agent remembers of each target.
    """
    agents = [agent for agent in compiled.plate.agents if agent in compiled.looks and agent in memories]
    if not work.frame.has_color:
        agents = [agent for agent in agents if agent not in compiled.color_agents]
    if not (agents and len(targets)):
        return np.zeros(len(boxes))
    plan = replace(plan_for(compiled, frozenset(agents)), factors=()).in_image()
    rows: Iterable[int] = range(len(targets))
    log = np.zeros(len(boxes))
    if is_flat(compiled.plate) and not (work.availability.known or not compiled.elsewhere.isdisjoint(agents)):
        messages, rows = ask_together(work, (compiled, plan, memories), Hypotheses(boxes), starts)
        log = join_plain(plan, messages, (len(boxes),))[plan.root]
    for row in rows:
        references = {agent: memories[agent][row] for agent in agents}
        its = slice(*starts[row : row + 2].tolist())
        log[its] = _score_looks_of(work, plan, targets[row], references, boxes[its])
    return np.clip(log, LEAST_LOG, 0.0)


def _score_looks_of(
    work: FrameContext, plan: Plan, target: str, references: Mapping[str, Reference], boxes: Floats
) -> Floats:
    """(N,) the same of one target."""
    compiled = work.plate_of(target)
    stream = work.stream(target, compiled.plate.root)
    observer = Observer(
        work.cache,
        compiled.cues,
        references,
        lambda purpose: stream(f"claim {purpose}"),
        availability=work.availability_of(target, "claiming"),
    )
    prior = np.full(len(boxes), -np.log(len(boxes)))
    return evaluate(plan, observer, Hypotheses(boxes), prior).log_likelihood


def give_detections(
    state: TargetState, assigned: Mapping[str, Floats | None], labels: Mapping[str, Floats] | None = None
) -> TargetState:
    """The target with what each of its agents is given of the detections; None where nobody detected.

    `labels` has (M, V) log-probabilities of the labels of the M detections of agents that go by labels.
    """
    references = {
        agent: {k: v for k, v in state.references[agent].items() if k not in (OWN_DETECTION, OWN_LABEL)}
        | ({} if detection is None else {OWN_DETECTION: detection})
        | ({OWN_LABEL: labels[agent]} if labels and agent in labels else {})
        for agent, detection in assigned.items()
        if agent in state.references
    }
    return replace(state, references={**state.references, **references})
