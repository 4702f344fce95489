"""What a graph needs to run, made once: its cues, beliefs, motion models, prices and random streams."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from bayesnet_track.belief.contract import Belief, Motion
from bayesnet_track.belief.gaussian import GaussianFilter
from bayesnet_track.belief.grid import GridFilter
from bayesnet_track.belief.motion import make_motion
from bayesnet_track.belief.particles import ParticleFilter
from bayesnet_track.cue import AnyCue, CueDeclaration, LocallyAdaptable, installed_cues
from bayesnet_track.graph import spec
from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.spec import Guard, Learn
from bayesnet_track.inference.parts import part_of_agents
from bayesnet_track.numerics.streams import Streams


@dataclass(frozen=True, eq=False)
class Machinery:
    """What one plate needs to run, made once: cues, belief, motion model and prices.

    Attributes:
        plate: the checked plate.
        cues: agent -> implementation.
        belief: the root's belief.
        motion: the root's motion model.
        costs_ms: agent -> declared cost.
        rate_max: agent -> largest learning rate.
        adaptable: agents that can act locally.
        color_agents: agents that are blind on a gray source.
        guard: what keeps references from drifting, or None.
        part_of: agent that looks at a part of the target -> the part.
        appearance: agents that know the target by its looks.
    """

    plate: CheckedTarget
    cues: Mapping[str, AnyCue]
    belief: Belief[Any]
    motion: Motion
    costs_ms: Mapping[str, float]
    rate_max: Mapping[str, float]
    adaptable: frozenset[str]
    color_agents: frozenset[str] = frozenset()
    guard: Guard | None = None
    part_of: Mapping[str, str] = field(default_factory=dict)
    appearance: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Engine:
    """A graph ready to run.

    Attributes:
        machinery: plate name -> what it needs.
        streams: all randomness.
        clock: seconds, for timings only.
    """

    machinery: Mapping[str, Machinery]
    streams: Streams
    clock: Callable[[], float] = time.perf_counter


def make_engine(
    graph: CheckedGraph,
    seed: int = 0,
    cues: Mapping[str, CueDeclaration] | None = None,
    motion: Mapping[str, Motion] | None = None,
) -> Engine:
    """Load the cues of `graph` and make it ready to run.

    `motion` maps plates to motion models of one's own, such as `belief.functions.FunctionMotion`, in place of
    the graph's: what the language cannot say. The log does not hold them.

    Raises:
        ValueError: `motion` names a plate that the graph does not have.
    """
    declarations = installed_cues() if cues is None else cues
    own = {} if motion is None else motion
    unknown = [name for name in own if name not in graph.targets]
    if unknown:
        raise ValueError(f"motion for {unknown[0]!r}; the graph has {', '.join(graph.targets)}")
    machinery = {
        name: _make_machinery(plate, declarations, own.get(name)) for name, plate in graph.targets.items()
    }
    return Engine(machinery, Streams(seed))


def _make_machinery(
    plate: CheckedTarget, declarations: Mapping[str, CueDeclaration], own: Motion | None
) -> Machinery:
    root = plate.inference(plate.root)
    of = {agent: declarations[plate.agent(agent).agent.cue] for agent in plate.agents}
    made = {agent: of[agent].make(plate.parameters[agent]) for agent in plate.agents}
    assert root.motion is not None
    return Machinery(
        plate=plate,
        cues=made,
        belief=make_belief(root.belief),
        motion=make_motion(root.motion) if own is None else own,
        costs_ms={agent: of[agent].cost_ms for agent in plate.agents},
        rate_max={agent: _rate_max(plate, agent, of[agent], root.learn) for agent in plate.agents},
        adaptable=frozenset(agent for agent, cue in made.items() if isinstance(cue, LocallyAdaptable)),
        color_agents=frozenset(agent for agent in plate.agents if of[agent].needs_color),
        guard=None if root.learn is None else root.learn.guard,
        part_of=part_of_agents(plate),
        appearance=frozenset(agent for agent in plate.agents if of[agent].is_appearance),
    )


def make_belief(chosen: spec.Belief | None) -> Belief[Any]:
    """The belief that a graph asks for; particles when it does not say."""
    settings = spec.Particles() if chosen is None else chosen.settings
    match settings:
        case spec.Particles():
            return ParticleFilter(settings)
        case spec.Gaussian():
            return GaussianFilter(settings)
        case spec.Grid():
            return GridFilter(settings)
    raise TypeError(f"no belief for {type(settings).__name__}")


def _rate_max(plate: CheckedTarget, agent: str, declaration: CueDeclaration, learn: Learn | None) -> float:
    """The agent's own rate, else its cue's, else the graph's."""
    own = plate.agent(agent).learn_rate_max
    for rate in (own, declaration.rate_max):
        if rate is not None:
            return rate
    return learn.rate_max if learn is not None else 0.0
