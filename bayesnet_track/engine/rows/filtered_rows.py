"""The first half of the frame of many targets as arrays; `Filtered` of one when somebody asks for it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import GroupMeasures
from bayesnet_track.belief.contract import Evidence, MotionModel, Step, estimate
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.belief.particles.belief import Before, FindMap, find_places
from bayesnet_track.belief.particles.particle_set import Clouds, Inputs, some
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.groups import AgentMessages
from bayesnet_track.engine.predicting import PredictedMotion
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.targets import ParticleTable
from bayesnet_track.graph.spec import Estimate
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure import (
    StepArrays,
    is_flat,
    measure,
    measure_rows,
    state_index,
)
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.metrics import JoinMetrics
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.log_weights import LogWeights, effective, uncertainties
from bayesnet_track.observation.cue import Hypotheses, Reference


@dataclass(frozen=True, eq=False)
class FilteredRows(Mapping[str, Filtered]):
    """Targets of a plate after they were predicted and weighed by the same agents.

    Attributes:
        work: the frame.
        before: what was known of them.
        clouds: their beliefs.
        prior: the weights of each target's hypotheses before the evidence.
        messages: agent -> (T, N) log-likelihoods.
        own: (T, N) log-likelihoods of the net.
        said: (T, N) those that the weights come from: `own`, or those of a joint belief.
        log_evidence: (T,).
        motion: how all of them moved.
        dt: the time since the last frame, frame intervals.
        joins: target -> what a joint belief says of it.
        parents: (T, N) hypotheses of the belief before that these come from.
        moves: target -> its motion in this frame, where that depends on more than its states.
    """

    work: FrameContext
    before: ParticleTable
    clouds: Clouds
    prior: LogWeights
    messages: Mapping[str, Floats]
    own: Floats
    said: Floats
    log_evidence: Floats
    motion: MotionModel
    dt: float
    joins: Mapping[str, JoinMetrics] = field(default_factory=dict)
    parents: Ints | None = None
    moves: Mapping[str, PredictedMotion] = field(default_factory=dict)
    keeps_status = False
    holds_frame = True
    is_hidden = None
    """No modes say whether a target can be seen."""
    is_unasked = None
    """Agents look at the image."""
    statuses = None
    """The live nets say."""
    beside = None
    """Nothing beside the columns is known of a target."""
    _made: dict[str, Filtered] = field(default_factory=dict)

    @property
    def ids(self) -> tuple[str, ...]:
        """The targets."""
        return self.before.ids

    @property
    def compiled(self) -> CompiledPlate:
        """The plate of the targets."""
        return self.before.compiled

    @property
    def plan(self) -> Plan:
        """The compiled net of the frame."""
        return self.before.plan

    @property
    def fields(self) -> tuple[str, ...]:
        """The D fields of a state."""
        return self.clouds.fields

    @property
    def references(self) -> Mapping[str, Sequence[Reference]]:
        """Agent -> its reference of each target."""
        return self.before.references

    @property
    def memory(self) -> RuleMemory:
        """Rule memory of all targets."""
        return self.before.columns()

    def of(self, row: int) -> Filtered:
        """The first half of the frame of one target."""
        return self[self.ids[row]]

    def state(self, row: int) -> TargetState:
        """The state of one target before the frame; its belief, references and memory may be elsewhere."""
        return self.before.base[row]

    def estimates(self, rule: Estimate | None) -> Floats:
        """(T, D) states that stand for the beliefs."""
        if rule is None or rule.kind == "map":
            return self.best
        return np.array([estimate(rule, self[target].step) for target in self.ids])

    @cached_property
    def boxes(self) -> Floats:
        """(T, N, 4) hypotheses of centre boxes, px, in C order."""
        return np.ascontiguousarray(self.clouds.states[:, :, :4])

    @cached_property
    def extremes(self) -> list[tuple[float, float]]:
        """Of each target the largest and the smallest log-likelihood."""
        return list(zip(self.own.max(axis=1).tolist(), self.own.min(axis=1).tolist(), strict=True))

    @cached_property
    def places(self) -> Ints:
        """(T,) the MAP hypotheses; -1 where a step looks further by itself."""
        if not isinstance(self.motion, Confined) or not isinstance(self.motion.motion, KinematicMotion):
            return np.full(len(self.ids), -1)
        earlier = Before(self.before.clouds.states, self.before.clouds.log)
        return find_places(self.motion.motion, self.dt, earlier, self.said, self.clouds.states)

    @cached_property
    def best(self) -> Floats:
        """(T, D) MAP states."""
        states = self.clouds.states[np.arange(len(self.ids)), self.places]
        for row in np.flatnonzero(self.places < 0).tolist():
            states[row] = self[self.ids[row]].step.map_state
        return states

    def find_maps(self) -> None:
        """Find the MAP states, before anybody asks for a target's own."""
        if "best" not in self.__dict__:
            self._made.clear()
            self.__dict__["best"] = self.best

    @property
    def hidden(self) -> list[float]:
        """Of each target the expected share that others hide."""
        joins = self.joins
        if not joins:
            return [0.0] * len(self)
        return [joins[target].hidden if target in joins else 0.0 for target in self.ids]

    def measures(self, areas_px2: Floats) -> GroupMeasures:
        """UD, KL, ... of the beliefs, whose estimates have these areas (T,)."""
        plate = self.compiled.plate
        if is_flat(plate):
            return measure_rows(plate, self.plan, self.arrays, areas_px2)
        pairs = zip(self.ids, areas_px2.tolist(), strict=True)
        return GroupMeasures.of_each(
            [measure(plate, self.plan, self[target].step, area) for target, area in pairs]
        )

    @property
    def arrays(self) -> StepArrays:
        """Inputs of measures."""
        plan, clouds = self.plan, self.clouds
        agents = [observation.agent for observation in plan.observations]
        picks, prior = state_index(self.before.compiled.plate, plan.root), self.prior.log
        priors, boxes = np.tile(prior, (len(clouds.log), 1)), self.boxes
        uds = uncertainties(clouds.states[:, :, picks], clouds.weights, self.best[:, picks])
        return StepArrays(agents, (), self.messages, priors, clouds.log, boxes, {plan.root: uds})

    @property
    def existence(self) -> Floats | None:
        """(T,) probabilities that they exist; None where the plate has no `existence`."""
        if self.before.base[0].existence is None:
            return None
        return np.array([state.existence for state in self.before.base])

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """Means (T, D) and covariances (T, D, D) of the beliefs."""
        beliefs = [self.of(row).step.posterior for row in range(len(self.ids))]
        return np.array([belief.mean for belief in beliefs]), np.array(
            [belief.covariance for belief in beliefs]
        )

    def asks(self, nets: Sequence[TargetNet]) -> Bools | None:
        """(T,) whether something else than a streak asks for a decision; None where nothing does."""
        asks = [bool(net.quarantined) for net in nets]
        return np.array(asks) if any(asks) else None

    def heard(self, row: int) -> AgentMessages:
        """Answers of the agents of one target."""
        return AgentMessages({agent: answers[row] for agent, answers in self.messages.items()})

    def apart(self, decided: Collection[int]) -> Mapping[int, str]:
        """Row -> target, of those that are an object each after the frame, where some were `decided` on."""
        rows = decided if columns_say_all(self.compiled) else range(len(self))
        return {row: self.ids[row] for row in rows}

    def then(
        self,
        time: float,
        references: Mapping[str, Sequence[Reference]],
        memory: RuleMemory,
        decided: Collection[int],
        nets: Mapping[str, TargetNet],
    ) -> ParticleTable | None:
        """The table of the targets about which nothing was decided; None without any."""
        singles = self.apart(decided)
        if len(singles) == len(self):
            return None
        table = self.before.then(time, self.clouds, references, memory, nets)
        return table.take([row for row in range(len(self)) if row not in singles]) if singles else table

    def reports(self, frame: int) -> Mapping[int, tuple[Event, ...]]:
        """Nothing is left out of an update."""
        return {}

    def line_columns(self, *_: Any) -> None:
        """Lines have to be made."""

    @cached_property
    def ess(self) -> list[float]:
        """Of each target the effective number of hypotheses."""
        numbers: list[float] = effective(self.clouds.log).tolist()
        return numbers

    def reweighted(self, messages: Mapping[str, Floats], joins: Mapping[str, JoinMetrics]) -> FilteredRows:
        """With what a joint belief says of some targets: (N,) log-likelihoods, and in numbers.

        A target of which it leaves no hypothesis keeps its weights.
        """
        joined = {target: metrics for target, metrics in joins.items() if target in self.before.index}
        names = [target for target in messages if target in self.before.index]
        if not names:
            return replace(self, joins=joined, _made={})
        rows = np.array([self.before.index[target] for target in names])
        likelihoods = np.array([messages[target] for target in names])
        log, total = weigh(self.prior.log, likelihoods)
        usable = np.isfinite(total)
        rows, log, total, likelihoods = rows[usable], log[usable], total[usable], likelihoods[usable]
        all_said, all_log, weights = self.said.copy(), self.clouds.log.copy(), self.clouds.weights.copy()
        all_said[rows], all_log[rows], weights[rows] = likelihoods, log, np.exp(log)
        evidence = self.log_evidence.copy()
        evidence[rows] = evidence[rows] + total - self.log_evidence[rows]
        clouds = replace(self.clouds, log=all_log, weights=weights)
        return replace(self, clouds=clouds, said=all_said, log_evidence=evidence, joins=joined, _made={})

    def take(self, rows: Sequence[int]) -> FilteredRows:
        """Some of the targets."""
        picks = some(rows)
        group = replace(
            self,
            before=self.before.take(rows),
            clouds=self.clouds.take(rows),
            messages={agent: answers[picks] for agent, answers in self.messages.items()},
            own=self.own[picks],
            said=self.said[picks],
            log_evidence=self.log_evidence[picks],
            parents=None if self.parents is None else self.parents[picks],
            _made=dict(self._made),
        )
        if "places" in self.__dict__:
            group.__dict__["places"] = self.places[picks]
        return group

    def __getitem__(self, target: str) -> Filtered:
        if target not in self._made:
            self._made[target] = self._make(target, self.before.index[target])
        return self._made[target]

    def _make(self, target: str, row: int) -> Filtered:
        work, state, posterior = self.work, self.before.state(row), self.clouds.belief(row)
        stream = work.stream(target, self.before.compiled.plate.root)
        inputs = Inputs(particles(state.belief), self.motion, self.dt, _ask_nobody, stream)
        step = Step(
            posterior,
            float(self.log_evidence[row]),
            posterior,
            self.prior,
            Evidence(self.own[row], {agent: answers[row] for agent, answers in self.messages.items()}),
            FindMap(self.said[row], posterior.states, inputs),
        )
        if "places" in self.__dict__ and self.places[row] >= 0:
            step.__dict__["map_state"] = posterior.states[self.places[row]]
        predicted = self.moves.get(target) or PredictedMotion(self.before.compiled.motion)
        return Filtered(target, state, step, (), predicted, self.plan, join=self.joins.get(target))

    def __contains__(self, target: object) -> bool:
        return target in self.before.index

    def __iter__(self) -> Iterator[str]:
        return iter(self.ids)

    def __len__(self) -> int:
        return len(self.ids)


@lru_cache(maxsize=64)
def columns_say_all(compiled: CompiledPlate) -> bool:
    """True where belief, references and rule memory are a target's state while nothing is decided."""
    root = compiled.plate.inference(compiled.plate.root)
    return (
        root.score is None
        and compiled.guard is None
        and compiled.moving is None
        and compiled.modes is None
        and not compiled.elsewhere
    )


def _ask_nobody(hypotheses: Hypotheses, prior_log: Floats) -> Evidence:
    raise AssertionError("the frame's hypotheses were weighed already")


def weigh(prior_log: Floats, message: Floats) -> tuple[Floats, Floats]:
    """(T, N) normalised log-weights after likelihoods, and (T,) log-evidence; not finite where none are left.

    `prior_log` (N,) or (T, N), `message` (T, N); the bits of `LogWeights.normalise` of each row.
    """
    log = prior_log + message
    top = log.max(axis=1)
    with np.errstate(invalid="ignore"):
        shares = np.exp(log - top[:, None])
        total = top + np.log(shares.sum(axis=1))
        log -= total[:, None]
    return log, total


class FilteredTargets(Mapping[str, Filtered]):
    """The first half of the frame of all targets: those in groups, and those that went by themselves.

    Args:
        groups: of targets that were filtered together.
        others: target -> its own.
        order: all targets, and maybe more.
    """

    def __init__(
        self, groups: Iterable[FilteredRows], others: Mapping[str, Filtered], order: Sequence[str]
    ) -> None:
        self.groups, self.others, self.order = tuple(groups), others, order
        self._group: dict[str, FilteredRows] = {}
        for group in self.groups:
            self._group |= dict.fromkeys(group.ids, group)

    def __getitem__(self, target: str) -> Filtered:
        return self.others[target] if target in self.others else self._group[target][target]

    def row(self, target: str) -> tuple[FilteredRows, int] | None:
        """The group that a target is in, and its row; None for one by itself."""
        group = self._group.get(target)
        return None if group is None else (group, group.before.index[target])

    def __contains__(self, target: object) -> bool:
        return target in self.others or target in self._group

    def __iter__(self) -> Iterator[str]:
        is_full = len(self) == len(self.order)
        return iter(self.order) if is_full else (target for target in self.order if target in self)

    def __len__(self) -> int:
        return len(self.others) + len(self._group)

    def ancestors(self, target: str) -> Ints | None:
        """(N,) hypotheses of the belief before that a target's come from; None where unknown."""
        if target in self.others:
            return self.others[target].step.ancestors
        group = self._group.get(target)
        if group is None or group.parents is None:
            return None
        parents: Ints = group.parents[group.before.index[target]]
        return parents

    def missing(self) -> list[str]:
        """Targets in neither."""
        if len(self) == len(self.order):
            return []
        return [target for target in self.order if target not in self]
