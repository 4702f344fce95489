"""What is known of one live target between frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.belief.contract import Posterior
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.moving.predicting import MotionContext
from bayesnet_track.engine.scoring.score import ScoreState
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.learn import SlowReferences
from bayesnet_track.journal.net import Net
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.planes import Frame


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


def recompile(engine: Engine, net: Net, target: str, state: TargetState) -> TargetState:
    """The state with its plan compiled again when its active agents changed."""
    live = net.targets[target]
    return with_agents(engine.plates[live.template], state, live.active)


def with_agents(compiled: CompiledPlate, state: TargetState, agents: frozenset[str]) -> TargetState:
    """The state with a plan for exactly these agents."""
    plan = state.plan if agents == state.plan.active else plan_for(compiled, agents)
    return state if plan is state.plan else evolve(state, plan=plan)


@lru_cache(maxsize=256)
def plan_for(compiled: CompiledPlate, agents: frozenset[str]) -> Plan:
    """The plan of a plate with these agents: the same few take turns where agents are sampled."""
    return compile_plan(compiled.plate, agents, compiled.cues)


def inside_frame(box: Floats, frame: Frame) -> Floats:
    """The box with its centre on the image, so that tracks and references stay meaningful."""
    x, y, w, h = box.tolist()  # plain numbers: a tenth of the time of arrays
    width, height = float(frame.width), float(frame.height)
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    return np.array([x, y, min(max(w, 1.0), 2.0 * width), min(max(h, 1.0), 2.0 * height)])


def inside_frame_all(boxes: Floats, frame: Frame) -> Floats:
    """(T, 4) the same of several boxes."""
    return np.asarray(np.minimum(np.maximum(boxes, _SMALLEST), _largest(frame.width, frame.height)))


_SMALLEST = np.array([0.0, 0.0, 1.0, 1.0])


@lru_cache(maxsize=64)
def _largest(width: int, height: int) -> Floats:
    return np.array([width - 1.0, height - 1.0, 2.0 * width, 2.0 * height])
