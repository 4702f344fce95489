"""Keep a run within its time: shed what says least per millisecond, take it back when there is time.

A pure function of what came from outside (which frames were late), of declared costs and of what agents
contributed. Agents go first, down to those that their rules keep; then hypotheses, down to the least number.
What was shed last comes back first, after a number of frames in time that doubles when it had to go again
soon after, so that nothing flaps.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import count_left_out
from bayesnet_track.adapt.status import on_call_rule
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.journal.events.load import LateFrame, ParticlesLimited, Shed, SpareTime, TakenBack
from bayesnet_track.journal.net import Decision
from bayesnet_track.journal.target_net import TargetNet

LATE, WITHIN = 3, 10
"""So many late frames among so many: time to shed."""

CALM = 50
"""Frames in time before something is taken back, the first time."""

MOST_CALM = 1600
"""Frames in time beyond which the wait does not double any more."""

SOON = 100
"""What has to go again within so many frames after something came back went too soon."""

ROOM = 0.9
"""Share of the budget that the expected time may take when something comes back."""

LEAST_FACTOR = 0.5
"""Fewer hypotheses at a time: at least this share of them stays."""


@dataclass(frozen=True)
class Load:
    """Memory of late frames.

    Attributes:
        late: the last late frames: how many tracked frames came before, and what it took, ms.
        calm: frames in time in a row, as far as they were told.
        wait: frames in time before something comes back.
        back: how many tracked frames came before something came back last; None before.
        frames: tracked frames until now, since the first one that was late.
    """

    late: tuple[tuple[int, float], ...] = ()
    calm: int = 0
    wait: int = CALM
    back: int | None = None
    frames: int = 0


@dataclass(frozen=True, eq=False)
class Running:
    """A live target, as shedding sees it.

    Attributes:
        plate: its checked plate.
        net: its live net after the frame's other decisions.
        memory: what its agents contributed.
        costs_ms: agent -> declared cost.
        particles: how many hypotheses it has; None where their number says nothing.
        least: least number of them.
        most: largest number that its graph asks for.
    """

    plate: CheckedTarget
    net: TargetNet
    memory: RuleMemory
    costs_ms: Mapping[str, float]
    particles: int | None = None
    least: int = 0
    most: int = 0


def balance(
    frame: int, timing: Iterable[LateFrame | SpareTime], running: Mapping[str, Running], load: Load
) -> tuple[tuple[Decision, ...], Load]:
    """Decisions to shed or take back in this frame, and the memory after it.

    Asked in every frame as long as `load` counts them: the numbers of frames jump where some are dropped.
    """
    decisions: list[Decision] = []
    load = replace(load, frames=load.frames + 1)
    for notice in timing:
        if isinstance(notice, LateFrame):
            load = _late(notice, running, load, frame, decisions)
        else:
            load = _in_time(notice, running, load, frame, decisions)
    return tuple(decisions), load


def _late(
    notice: LateFrame, running: Mapping[str, Running], load: Load, frame: int, decisions: list[Decision]
) -> Load:
    frames = load.frames
    late = (*(entry for entry in load.late if entry[0] > frames - WITHIN), (frames, notice.spent_ms))
    load = replace(load, late=late, calm=0)
    if len(late) < LATE:
        return load
    spent = median(ms for _, ms in late)
    shed = _shed_agents(notice, running, late, spent, frame) or _fewer(notice, running, spent, frame)
    decisions += shed
    if not shed:
        return load
    too_soon = load.back is not None and frames - load.back <= SOON
    return Load(wait=min(load.wait * 2, MOST_CALM) if too_soon else CALM, back=load.back, frames=frames)


def _shed_agents(
    notice: LateFrame,
    running: Mapping[str, Running],
    late: Sequence[tuple[int, float]],
    spent: float,
    frame: int,
) -> list[Decision]:
    """Agents that say least per ms, until by declared costs enough is saved; at least one if possible."""
    total = sum(run.costs_ms[agent] for run in running.values() for agent in run.net.active)
    to_save, saved = total * (1.0 - notice.budget_ms / spent), 0.0
    turning = sorted(ms for _, ms in late)[-LATE]
    index = {
        (target, agent): (run.memory.helpfulness(agent) or 0.0) / run.costs_ms[agent]
        for target, run in running.items()
        for agent in sorted(run.net.active - run.net.by_hand.keys())
    }
    gone: dict[str, set[str]] = {target: set() for target in running}
    shed: list[Decision] = []
    for target, agent in sorted(index, key=lambda pair: index[pair]):
        run = running[target]
        if (shed and saved >= to_save) or not _can_go(run, agent, gone[target]):
            continue
        indices = {
            name: index[target, name] for name in run.net.active - gone[target] if (target, name) in index
        }
        gone[target].add(agent)
        saved += run.costs_ms[agent]
        numbers = (spent, notice.budget_ms, len(late), WITHIN, turning)
        shed.append(Shed(frame, target, agent, *numbers, indices))
    return shed


def _can_go(run: Running, agent: str, gone: set[str]) -> bool:
    """True where the node that governs it keeps enough others.

    The last that is not on call stays with those on call, which would run in every frame without it.
    """
    governor = run.plate.governor[agent]
    rules = None if governor is None else run.plate.inference(governor).adapt
    working = run.net.active - gone
    if on_call_rule(run.plate) is not None:
        first = {name for name in working if run.plate.governor[name] != run.plate.root}
        if first == {agent}:
            return False
    remaining = sum(run.plate.governor[name] == governor for name in working)
    if governor is not None:
        remaining += count_left_out(run.plate, working, governor)
    return remaining > (0 if rules is None else rules.keep) and len(working) > 1


def _fewer(notice: LateFrame, running: Mapping[str, Running], spent: float, frame: int) -> list[Decision]:
    factor = max(notice.budget_ms / spent, LEAST_FACTOR)
    limited: list[Decision] = []
    for target, run in running.items():
        if run.particles is None:
            continue
        previous = run.particles if run.net.most_particles is None else run.net.most_particles
        limit = max(int(previous * factor), run.least)
        if limit < previous:
            limited.append(ParticlesLimited(frame, target, limit, previous, spent, notice.budget_ms))
    return limited


def _in_time(
    notice: SpareTime, running: Mapping[str, Running], load: Load, frame: int, decisions: list[Decision]
) -> Load:
    load = replace(load, calm=load.calm + notice.frames)
    if load.calm < load.wait:
        return load
    back = _more_hypotheses(notice, running, frame) or _take_back(notice, running, load, frame)
    decisions += back
    return replace(load, late=(), calm=0, back=load.frames) if back else load


def _more_hypotheses(notice: SpareTime, running: Mapping[str, Running], frame: int) -> list[Decision]:
    """Twice as many hypotheses where they are limited, if that fits."""
    if 2.0 * notice.spent_ms > ROOM * notice.budget_ms:
        return []
    limited: list[Decision] = []
    for target, run in running.items():
        previous = run.net.most_particles
        if previous is not None:
            limit = 2 * previous if 2 * previous < run.most else None
            limited.append(
                ParticlesLimited(frame, target, limit, previous, notice.spent_ms, notice.budget_ms)
            )
    return limited


def _take_back(notice: SpareTime, running: Mapping[str, Running], load: Load, frame: int) -> list[Decision]:
    """The agent of one target that was shed last, if it fits by declared costs."""
    if any(run.net.most_particles is not None for run in running.values()):
        return []
    total = sum(run.costs_ms[agent] for run in running.values() for agent in run.net.active)
    for target, run in running.items():
        for agent in reversed(run.net.shed):
            if agent in run.net.quarantined:
                continue
            expected = notice.spent_ms * (1.0 + run.costs_ms[agent] / max(total, 1e-9))
            if expected <= ROOM * notice.budget_ms:
                numbers = (notice.spent_ms, expected, notice.budget_ms, load.calm)
                return [TakenBack(frame, target, agent, *numbers)]
    return []
