"""Groups of targets after the filter: T >= 1 of a plate that the same agents looked at.

The second half of a frame (`judging`, `learning`, `finishing`) knows groups only. Targets that were filtered
as arrays are a group as they are; the others are grouped by what has to be equal for columns of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.belief.contract import estimate
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import Estimate
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure_rows import StepArrays, is_flat
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Reference


class FilteredGroup(Protocol):
    """The first half of the frame of T targets of a plate."""

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
    def arrays(self) -> StepArrays | None:
        """Inputs of measures of a flat net; None where each target is measured by itself."""

    def of(self, row: int) -> Filtered:
        """The first half of the frame of one target."""

    def beside(self, row: int) -> Filtered | None:
        """The same where it says more than the columns."""

    def state(self, row: int) -> TargetState:
        """The state of one target before the frame; its belief, references and memory may be elsewhere."""

    def estimates(self, rule: Estimate | None) -> Floats:
        """(T, D) states that stand for the beliefs."""


@dataclass(frozen=True, eq=False)
class FilteredEach:
    """Targets that were filtered one by one.

    Attributes:
        compiled: their plate.
        targets: the first half of the frame of each.
    """

    compiled: CompiledPlate
    targets: Sequence[Filtered]

    @property
    def ids(self) -> Sequence[str]:
        """The targets."""
        return [one.target for one in self.targets]

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
        known = [one.before.references for one in self.targets]
        return {agent: [references[agent] for references in known] for agent in known[0]}

    @property
    def memory(self) -> RuleMemory:
        """Rule memory of all targets."""
        return RuleMemory.join([one.before.memory for one in self.targets])

    @property
    def hidden(self) -> Sequence[float]:
        """Of each target the expected share that cannot be seen."""
        return [one.hidden for one in self.targets]

    @property
    def arrays(self) -> StepArrays | None:
        """Inputs of measures of a flat net; None where each target is measured by itself."""
        plate, steps = self.compiled.plate, [one.step for one in self.targets]
        if not is_flat(plate) or steps[0].evidence.latent:
            return None
        return StepArrays.of(plate, self.plan, steps)

    def of(self, row: int) -> Filtered:
        """The first half of the frame of one target."""
        return self.targets[row]

    def beside(self, row: int) -> Filtered | None:
        """The same: it may say more than the columns."""
        return self.targets[row]

    def state(self, row: int) -> TargetState:
        """The state of one target before the frame."""
        return self.targets[row].before

    def estimates(self, rule: Estimate | None) -> Floats:
        """(T, D) states that stand for the beliefs."""
        return np.array([estimate(rule, one.step) for one in self.targets])


@dataclass(frozen=True, eq=False)
class LiveGroup:
    """A group with the live nets of its targets.

    Attributes:
        filtered: the first half of their frame.
        nets: as a person switched them, without agents that failed or gave no answer: the same are active.
    """

    filtered: FilteredGroup
    nets: Sequence[TargetNet]
