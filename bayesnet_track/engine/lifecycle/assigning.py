"""Assign detections to the targets of a plate that are an object each, and to its tentative tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesnet_track.adapt.association import (
    NOBODY,
    Owners,
    assign,
    first_observed,
    gated_gains,
    remembered,
    share_by_overlap,
    share_in_passes,
)
from bayesnet_track.adapt.lifecycle import Candidate, TrackHistory
from bayesnet_track.belief.gaussian.belief import GaussianPosterior, predict
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.lifecycle.detecting import Found
from bayesnet_track.engine.lifecycle.sharing import Predict, Tracks, follow, own_detections, update_tentative
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import Gaussian
from bayesnet_track.inference.compile import compile_plan
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import OBSERVED, OWN_DETECTION, AssociationRule, Hypotheses

TENTATIVE = ""
"""Stands for any tentative track where it is said whose a detection is."""

LEAST_LOG = -50.0
"""Log-likelihoods of looks are cut here, so that they are numbers: lower ones are beyond every gate."""


NO_TRACKS = Tracks(np.empty((0, 4)), np.empty((0, 4, 4)), np.empty((0, 0)))


@dataclass(frozen=True, eq=False)
class Sharing:
    """What is needed to share out the detections of one plate among targets that are an object each."""

    work: FrameWork
    plate: str
    history: TrackHistory
    found: Found | None
    expected: Mapping[str, tuple[Floats, Floats]]

    def share(
        self, targets: Mapping[str, TargetState]
    ) -> tuple[tuple[str | None, ...], dict[str, TargetState], tuple[Candidate, ...] | None]:
        """Whose each detection is, the targets with what they were given, and the tentative tracks left."""
        compiled, names = self.work.engine.plates[self.plate], tuple(targets)
        rule = next(iter(compiled.association_rules.values()))
        seen = Found.none() if self.found is None else self.found
        waiting = tentative_tracks(compiled, self.history)
        if not (waiting or rule.remembers):
            owner = self._owners(rule, targets, NO_TRACKS, seen)
            return (
                name_owners(owner, names, len(seen.boxes)),
                self._give(targets, own_detections(owner, seen.boxes, seen.scores), owner),
                None,
            )
        agent, predict = next(iter(compiled.association_rules)), Predict(self._elapsed, self._predict)
        size = len(compiled.motion.fields)
        beliefs = [one.belief for one in targets.values()]
        before = Tracks(
            np.array([one.mean for one in beliefs]).reshape(-1, size),
            np.array([one.covariance for one in beliefs]).reshape(-1, size, size),
            np.array(
                [remembered(rule, one.references.get(agent, {}), one.belief.mean) for one in targets.values()]
            ).reshape(len(names), first_observed(rule, np.empty((0, 4)), size).shape[1]),
        ).and_tentative(waiting)
        expected = Tracks(*predict(before.mean, before.covariance), before.observed)
        owner = self._owners(rule, targets, expected, seen)
        own = own_detections(owner, seen.boxes, seen.scores)
        after, changed = follow(rule, before, expected, owner, own, predict)
        given = self._give(targets, own, owner)
        for row, target in enumerate(names):
            given[target] = _remember(given[target], agent, after.observed[row], changed.get(row))
        left = advance_tentative(compiled, waiting, after, own, self.found is not None)
        return name_owners(owner, names, len(seen.boxes)), given, left if waiting else None

    def _owners(
        self,
        rule: AssociationRule,
        targets: Mapping[str, TargetState],
        expected: Tracks,
        seen: Found,
    ) -> Owners:
        """(T + C,) the detection of each target, then of each tentative track."""
        moments = [self.expected[target] for target in targets]
        for row in range(len(targets), len(expected.mean)):
            moments.append((expected.mean[row, :4], expected.covariance[row, :4, :4]))
        if not len(seen.boxes):
            return np.full(len(moments), NOBODY, dtype=np.intp)
        if rule.similarity == "iou":
            boxes = np.array([mean for mean, _ in moments]).reshape(-1, 4)
            return share_by_overlap(rule, boxes, expected.observed, seen.boxes, seen.scores)
        gain = np.full((len(moments), len(seen.boxes)), -np.inf)
        for row, (target, state) in enumerate(targets.items()):
            looks = partial(score_looks, self.work, target, state)
            gain[row] = gated_gains(*moments[row], seen.boxes, rule, looks)
        for row in range(len(targets), len(moments)):
            gain[row] = gated_gains(*moments[row], seen.boxes, rule, lambda boxes: np.zeros(len(boxes)))
        return share_in_passes(
            rule, seen.scores, len(gain), lambda _, rows, columns: assign(gain[np.ix_(rows, columns)])
        )

    def _give(self, targets: Mapping[str, TargetState], own: Floats, owner: Owners) -> dict[str, TargetState]:
        rules = self.work.engine.plates[self.plate].association_rules
        return {
            target: give_detection(state, rules, own[row : row + (owner[row] != NOBODY)])
            for row, (target, state) in enumerate(targets.items())
        }

    @property
    def _elapsed(self) -> float:
        frame, previous = self.work.frame, self.work.cache.frames.previous
        return 1.0 if previous is None else frame.time - previous.time

    def _predict(self, means: Floats, covariances: Floats, dt: float) -> tuple[Floats, Floats]:
        work = self.work
        motion = confined(work.engine.plates[self.plate].motion, work.frame.width, work.frame.height)
        moved = [
            predict(mean, covariance, motion, dt, Gaussian())
            for mean, covariance in zip(means, covariances, strict=True)
        ]
        return (
            np.array([mean for mean, _ in moved]).reshape(means.shape),
            np.array([covariance for _, covariance in moved]).reshape(covariances.shape),
        )


def tentative_tracks(compiled: CompiledPlate, history: TrackHistory) -> tuple[Candidate, ...]:
    """The tentative tracks of a plate."""
    birth = None if compiled.lifecycle is None else compiled.lifecycle.birth
    if birth is None or not birth.tentative:
        return ()
    return history.candidates.get(compiled.plate.name, ())


def advance_tentative(
    compiled: CompiledPlate, waiting: Sequence[Candidate], after: Tracks, own: Floats, looked: bool
) -> tuple[Candidate, ...]:
    """Tentative tracks, the last rows of `after` and `own`, after they were given their detections."""
    if not waiting:
        return ()
    rows = slice(len(own) - len(waiting), len(own))
    agent, rule = next(iter(compiled.association_rules.items()))
    variances = rule.variances(own[rows, :4]) * compiled.plate.agent(agent).temperature
    assert compiled.lifecycle is not None and compiled.lifecycle.birth is not None
    confirm = compiled.lifecycle.birth.confirm if looked else None
    return update_tentative(waiting, after.only(rows), own[rows], variances, confirm)


def name_owners(owner: Owners, names: Sequence[str], found: int) -> tuple[str | None, ...]:
    """Whose each of the detections is: a target's, `TENTATIVE`, or nobody's."""
    whose: list[str | None] = [None] * found
    for row, column in enumerate(owner.tolist()):
        if column != NOBODY:
            whose[column] = names[row] if row < len(names) else TENTATIVE
    return tuple(whose)


def _remember(
    state: TargetState, agent: str, observed: Floats, changed: tuple[Floats, Floats] | None
) -> TargetState:
    if changed is not None and isinstance(state.belief, GaussianPosterior):
        state = replace(state, belief=replace(state.belief, mean=changed[0], covariance=changed[1]))
    if not len(observed) or agent not in state.references:
        return state
    reference = {**state.references[agent], OBSERVED: observed}
    return replace(state, references={**state.references, agent: reference})


def score_looks(work: FrameWork, target: str, state: TargetState, boxes: Floats) -> Floats:
    """(N,) log-likelihood of boxes (N, 4) by all agents that know the target's looks, switched on or not."""
    compiled = work.plate_of(target)
    agents = [a for a in compiled.plate.agents if a in compiled.looks and a in state.references]
    if not work.frame.has_color:
        agents = [agent for agent in agents if agent not in compiled.color_agents]
    if not agents:
        return np.zeros(len(boxes))
    stream = work.stream(target, compiled.plate.root)
    observer = Observer(
        work.cache,
        compiled.cues,
        state.references,
        lambda what: stream(f"claim {what}"),
        availability=work.availability_of(target, "claiming"),
    )
    prior = np.full(len(boxes), -np.log(len(boxes)))
    plan = replace(compile_plan(compiled.plate, agents, compiled.cues), factors=())
    return np.clip(evaluate(plan, observer, Hypotheses(boxes), prior).log_likelihood, LEAST_LOG, 0.0)


def give_detection(state: TargetState, agents: Mapping[str, AssociationRule], own: Floats) -> TargetState:
    """The target with what its agents are given of the detections."""
    given = {
        agent: {**state.references[agent], OWN_DETECTION: own}
        for agent in agents
        if agent in state.references
    }
    return replace(state, references={**state.references, **given})
