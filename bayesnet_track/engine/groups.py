"""Groups of targets after the filter: T >= 1 of a plate that the same agents looked at.

The second half of a frame (`judging`, `learning`, `finishing`) knows groups only. Targets that were filtered
as arrays are a group as they are; the others are grouped by what has to be equal for columns of them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import GroupMeasures
from bayesnet_track.belief.contract import Step, estimate
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import Estimate
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure import StepArrays, fits_rows, measure, measure_rows
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.observation.cue import OWN_DETECTION, Measurement, Reference


@dataclass(frozen=True, eq=False)
class AgentMessages:
    """Answers of the agents of one target.

    Attributes:
        log_likelihoods: active agent -> (N,) its log-likelihood of each particle of the belief; none for
            other beliefs.
        measured: agent that found the target -> what it measured, in fields of the state.
    """

    log_likelihoods: Mapping[str, Floats] = field(default_factory=dict)
    measured: Mapping[str, Measurement] = field(default_factory=dict)

    @classmethod
    def of(cls, step: Step[Any], agents: frozenset[str]) -> AgentMessages:
        """Answers of the active `agents` in a step, for the hypotheses that are still the belief's."""
        evidence = step.evidence
        is_aligned = isinstance(step.posterior, ParticleSet) and step.support is step.posterior
        messages = {
            name: message for name, message in evidence.messages.items() if is_aligned and name in agents
        }
        measured = {
            name: message
            for name, message in evidence.gaussians.items()
            if name in agents and message.seen is None and not message.choices
        }
        return cls(messages, measured)


Table = TypeVar("Table", covariant=True)


class FilteredGroup(Protocol[Table]):
    """The first half of the frame of T targets of a plate.

    Attributes:
        keeps_status: True where columns hold the status, so that a target stays a row when it changes.
        holds_frame: True where it holds the frame and its planes.
    """

    keeps_status: bool
    holds_frame: bool

    @property
    def ids(self) -> Sequence[str]:
        """The targets."""

    @property
    def compiled(self) -> CompiledPlate:
        """Their plate."""

    @property
    def plan(self) -> Plan:
        """The compiled net of the frame."""

    @property
    def fields(self) -> tuple[str, ...]:
        """The D fields of a state."""

    @property
    def references(self) -> Mapping[str, Sequence[Reference]]:
        """Agent -> its reference of each target."""

    @property
    def memory(self) -> RuleMemory:
        """Rule memory of all targets."""

    @property
    def hidden(self) -> Sequence[float]:
        """Of each target the expected share that cannot be seen."""

    @property
    def existence(self) -> Floats | None:
        """(T,) probabilities that they exist; None where the plate has no `existence`."""

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """Means (T, D) and covariances (T, D, D) of the beliefs."""

    @property
    def is_hidden(self) -> Bools | None:
        """(T,) whether targets probably cannot be seen, by their modes; None where these do not say."""

    @property
    def is_unasked(self) -> Bools | None:
        """(T,) whether all active agents wait for detections and nobody looked; None where somebody did."""

    @property
    def statuses(self) -> Ints | None:
        """(T,) places in `adapt.rule_columns.STATUSES`; None where the live nets say."""

    @property
    def beside(self) -> Sequence[Filtered] | None:
        """The first half of the frame of each, where it says more than the columns."""

    def asks(self, nets: Sequence[TargetNet]) -> Bools | None:
        """(T,) whether something else than a streak asks for a decision; None where nothing does."""

    def measures(self, areas_px2: Floats) -> GroupMeasures:
        """UD, KL, ... of the beliefs, whose estimates have these areas (T,)."""

    def of(self, row: int) -> Filtered:
        """The first half of the frame of one target.

        Raises:
            LookupError: columns say all of these targets.
        """

    def heard(self, row: int) -> AgentMessages:
        """Answers of the agents of one target."""

    def state(self, row: int) -> TargetState:
        """The state of one target before the frame; its belief, references and memory may be elsewhere."""

    def estimates(self, rule: Estimate | None) -> Floats:
        """(T, D) states that stand for the beliefs."""

    def apart(self, decided: Collection[int]) -> Mapping[int, str]:
        """Row -> target, of those that are an object each after the frame, where some were `decided` on."""

    def then(
        self,
        time: float,
        references: Mapping[str, Sequence[Reference]],
        memory: RuleMemory,
        decided: Collection[int],
        nets: Mapping[str, TargetNet],
    ) -> Table | None:
        """The table of the other targets after the frame; None without any."""

    def reports(self, frame: int) -> Mapping[int, tuple[Event, ...]]:
        """Row -> events of its update, of targets that are in a table after the frame."""

    def line_columns(
        self,
        work: FrameContext,
        boxes: Floats,
        is_lost: Bools,
        levels_px2: Floats,
        rates: Sequence[float],
    ) -> Mapping[str, NDArray[Any]] | None:
        """The columns of `journal.frame_columns` without hypotheses; None where lines have to be made.

        Of the estimates (T, 4) px, whether each was lost, the baselines of UD, NaN while unknown, and the
        shares of the largest learning rate.
        """


@dataclass(frozen=True, eq=False)
class FilteredEach:
    """Targets that were filtered one by one.

    Attributes:
        compiled: their plate.
        targets: the first half of the frame of each.
    """

    compiled: CompiledPlate
    targets: Sequence[Filtered]
    keeps_status = False
    holds_frame = True
    statuses = None
    """The live nets say."""

    @property
    def ids(self) -> Sequence[str]:
        """The targets."""
        return [target.target for target in self.targets]

    @property
    def plan(self) -> Plan:
        """The compiled net of the frame."""
        return self.targets[0].plan

    @property
    def fields(self) -> tuple[str, ...]:
        """The D fields of a state."""
        return self.targets[0].step.posterior.fields

    @cached_property
    def references(self) -> Mapping[str, Sequence[Reference]]:
        """Agent -> its reference of each target."""
        references_each = [target.before.references for target in self.targets]
        return {agent: [references[agent] for references in references_each] for agent in references_each[0]}

    @property
    def memory(self) -> RuleMemory:
        """Rule memory of all targets."""
        return RuleMemory.join([target.before.memory for target in self.targets])

    @property
    def hidden(self) -> Sequence[float]:
        """Of each target the expected share that cannot be seen."""
        return [target.hidden for target in self.targets]

    @property
    def existence(self) -> Floats | None:
        """(T,) probabilities that they exist; None where the plate has no `existence`."""
        probabilities = [target.before.existence for target in self.targets]
        return None if probabilities[0] is None else np.array(probabilities)

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """Means (T, D) and covariances (T, D, D) of the beliefs."""
        beliefs = [target.step.posterior for target in self.targets]
        return np.array([belief.mean for belief in beliefs]), np.array(
            [belief.covariance for belief in beliefs]
        )

    @property
    def is_hidden(self) -> Bools | None:
        """(T,) whether targets probably cannot be seen, by their modes; None where these do not say."""
        causes = [None if target.modes is None else target.modes.hiding for target in self.targets]
        if causes[0] is None:
            return None
        return np.array([cause is not None and cause.hidden > cause.level for cause in causes])

    @property
    def is_unasked(self) -> Bools | None:
        """(T,) whether all active agents wait for detections and nobody looked; None where somebody did."""
        active, references = self.plan.active, self.references
        if not active or not active <= self.compiled.association_rules.keys():
            return None
        by_target = zip(*(references[agent] for agent in active), strict=True)
        unasked = np.array(
            [
                all(OWN_DETECTION not in reference for reference in references_of)
                for references_of in by_target
            ]
        )
        return unasked if unasked.any() else None

    def asks(self, nets: Sequence[TargetNet]) -> Bools | None:
        """(T,) whether something else than a streak asks for a decision; None where nothing does."""
        asks = [
            bool(net.quarantined or target.missed or (target.call is not None and target.call.ran))
            for net, target in zip(nets, self.targets, strict=True)
        ]
        return np.array(asks) if any(asks) else None

    def measures(self, areas_px2: Floats) -> GroupMeasures:
        """UD, KL, ... of the beliefs, whose estimates have these areas (T,)."""
        plate, steps = self.compiled.plate, [target.step for target in self.targets]
        if fits_rows(plate) and steps[0].evidence.latent.keys() <= plate.views.keys():
            return measure_rows(plate, self.plan, StepArrays.of(plate, self.plan, steps), areas_px2)
        pairs = zip(self.targets, areas_px2.tolist(), strict=True)
        return GroupMeasures.of_each(
            [measure(plate, target.plan, target.step, area) for target, area in pairs]
        )

    def of(self, row: int) -> Filtered:
        """The first half of the frame of one target."""
        return self.targets[row]

    def heard(self, row: int) -> AgentMessages:
        """Answers of the agents of one target."""
        target = self.targets[row]
        return AgentMessages.of(target.step, target.plan.active)

    @property
    def beside(self) -> Sequence[Filtered]:
        """The same: it may say more than the columns."""
        return self.targets

    def state(self, row: int) -> TargetState:
        """The state of one target before the frame."""
        return self.targets[row].before

    def estimates(self, rule: Estimate | None) -> Floats:
        """(T, D) states that stand for the beliefs."""
        return np.array([estimate(rule, target.step) for target in self.targets])

    def apart(self, decided: Collection[int]) -> Mapping[int, str]:
        """Row -> target, of all."""
        return dict(enumerate(self.ids))

    def then(
        self,
        time: float,
        references: Mapping[str, Sequence[Reference]],
        memory: RuleMemory,
        decided: Collection[int],
        nets: Mapping[str, TargetNet],
    ) -> None:
        """No target is in a table after the frame."""

    def reports(self, frame: int) -> Mapping[int, tuple[Event, ...]]:
        """No target is in a table after the frame."""
        return {}

    def line_columns(self, *_: Any) -> None:
        """Lines have to be made."""


@dataclass(frozen=True, eq=False)
class LiveGroup:
    """A group with the live nets of its targets.

    Attributes:
        filtered: the first half of their frame.
        nets: as a person switched them, without agents that failed or gave no answer: the same are active.
    """

    filtered: FilteredGroup[Any]
    nets: Sequence[TargetNet]
