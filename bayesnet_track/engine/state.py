"""What is known of one live target between frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.belief.contract import Posterior
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.predicting import MotionContext
from bayesnet_track.engine.scoring.score import ScoreState
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.learn import SlowReferences
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Reference


@dataclass(frozen=True, eq=False)
class TargetState:
    """All that is known of one live target.

    Attributes:
        belief: the posterior of the last frame.
        references: agent -> what it remembers.
        memory: what the rules remember, of this one target.
        plan: the compiled net.
        time: time of the last frame, frame intervals.
        watched: the slow references that guard the others against drift.
        motion_context: what its motion depends on besides its states; None when on nothing.
        scored: what its score remembers.
        flawed: expressions that had no value for some hypotheses in the last frame.
        existence: probability that it exists; None where the plate has no `existence`.
        started: number of the frame in which it started.
    """

    belief: Posterior
    references: Mapping[str, Reference]
    memory: RuleMemory
    plan: Plan
    time: float
    watched: SlowReferences = field(default_factory=SlowReferences)
    motion_context: MotionContext | None = None
    scored: ScoreState = field(default_factory=ScoreState)
    flawed: frozenset[str] = frozenset()
    existence: float | None = None
    started: int = 0


def with_agents(compiled: CompiledPlate, state: TargetState, agents: frozenset[str]) -> TargetState:
    """The state with a plan for exactly these agents."""
    plan = state.plan if agents == state.plan.active else plan_for(compiled, agents)
    return state if plan is state.plan else evolve(state, plan=plan)


@lru_cache(maxsize=256)
def plan_for(compiled: CompiledPlate, agents: frozenset[str]) -> Plan:
    """The plan of a plate with these agents: the same few take turns where agents are sampled."""
    return compile_plan(compiled.plate, agents, compiled.cues)
