"""Work that a run short of time does without, over all live targets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bayesnet_track.adapt.shedding import Load, Running, balance
from bayesnet_track.belief.contract import BeliefFilter
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import Particles
from bayesnet_track.journal.events.load import LateFrame, SpareTime
from bayesnet_track.journal.net import Decision, Net

LEAST_SHARE, LEAST = 8, 100
"""A fixed number of hypotheses is cut to an eighth at most, and never below this."""


def balance_load(
    engine: Engine,
    net: Net,
    targets: Mapping[str, TargetState],
    timing: Iterable[LateFrame | SpareTime],
    load: Load,
    frame: int,
) -> tuple[tuple[Decision, ...], Load]:
    """Decisions to shed or take back in this frame, and the memory after it."""
    running = {target: _running(engine, net, target, state) for target, state in targets.items()}
    return balance(frame, timing, running, load)


def within(belief: BeliefFilter[Any], limit: int | None) -> BeliefFilter[Any]:
    """The belief with at most so many hypotheses."""
    if limit is None or not isinstance(belief, ParticleFilter):
        return belief
    settings = belief.settings
    if isinstance(settings.size, int):
        return ParticleFilter(settings.model_copy(update={"size": min(settings.size, limit)}))
    limits = {"min": min(settings.least, limit), "max": min(settings.most, limit)}
    return ParticleFilter(settings.model_copy(update=limits))


def _running(engine: Engine, net: Net, target: str, state: TargetState) -> Running:
    live = net.targets[target]
    compiled = engine.plates[live.template]
    parts = (compiled.plate, live, state.memory, compiled.costs_ms)
    if not isinstance(compiled.belief, ParticleFilter):
        return Running(*parts)
    low, high = _bounds(compiled.belief.settings)
    return Running(*parts, len(state.belief), low, high)


def _bounds(settings: Particles) -> tuple[int, int]:
    if isinstance(settings.size, int):
        return max(settings.size // LEAST_SHARE, min(LEAST, settings.size)), settings.size
    return settings.least, settings.most
