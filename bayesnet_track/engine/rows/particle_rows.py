"""The first half of the frame of many targets held by particles, in a few calls on arrays.

Targets fit whose plate has one belief, a fixed number of hypotheses drawn from the motion model, and whose
active agents are at work here and score hypotheses. All others go one by one (`filtering.filter_target`), and
so does a target where an agent fails.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from functools import lru_cache

import numpy as np

from bayesnet_track.adapt.status import on_call_rule
from bayesnet_track.belief.contract import hypotheses_of
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.models import KinematicMotion, draws_twice, propagate_rows
from bayesnet_track.belief.particles.adaptive_size import start_size
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.belief.particles.particle_set import Clouds
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.rows.filtered_rows import FilteredRows, weigh
from bayesnet_track.engine.rows.particle_table import ParticleTable
from bayesnet_track.engine.rows.shared_planes import ask_together
from bayesnet_track.engine.shedding import within
from bayesnet_track.engine.state import TargetState, with_agents
from bayesnet_track.engine.targets import Targets
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.executor import is_elsewhere
from bayesnet_track.inference.measure_rows import is_flat
from bayesnet_track.inference.messages import join_plain
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.log_weights import LogWeights


def filter_rows(work: FrameContext, before: Mapping[str, TargetState]) -> list[FilteredRows]:
    """Those of the targets that fit, predicted and weighed by what their active agents see, by groups."""
    groups = []
    for table in _tables(work, before):
        group = _filter(work, table)
        if len(group):
            groups.append(group)
    return groups


def _tables(work: FrameContext, before: Mapping[str, TargetState]) -> list[ParticleTable]:
    """The targets that fit, those together that are alike: those that are columns already come first."""
    known = Targets.of(before).unchanged(work.net.targets)
    tables: dict[Hashable, ParticleTable] = {}
    others = dict(known.others)
    key: Hashable
    for table in known.particles:
        if not _asks_here(work, table.compiled, table.plan):
            continue
        most = work.net.targets[table.ids[0]].most_particles
        shape = table.clouds.states.shape[1:]
        key = (table.compiled.plate.name, table.plan.active, table.time, shape, most)
        if key in tables:  # they had another number of hypotheses so far
            others |= {target: table.state(row) for row, target in enumerate(table.ids)}
        else:
            tables[key] = table
    alike: dict[Hashable, dict[str, TargetState]] = {}
    for target, state in others.items():
        live, compiled = work.net.targets[target], work.plate_of(target)
        if not plate_fits(compiled):
            continue
        own = with_agents(compiled, state, live.looking(work.frame.ordinal))
        if own.plan.factors or any(one.agent not in own.references for one in own.plan.observations):
            continue
        if not _asks_here(work, compiled, own.plan):
            continue
        shape = particles(own.belief).states.shape
        key = (live.template, own.plan.active, own.time, shape, live.most_particles)
        alike.setdefault(key, {})[target] = own
    for key, group in alike.items():
        added = ParticleTable.of(work.plate_of(next(iter(group))), group)
        tables[key] = tables[key].extended(added) if key in tables else added
    return list(tables.values())


@lru_cache(maxsize=64)
def plate_fits(compiled: CompiledPlate) -> bool:
    """True if the targets of a plate may be filtered together."""
    belief = compiled.belief
    if not isinstance(belief, ParticleFilter) or not isinstance(compiled.motion, KinematicMotion):
        return False
    settings = belief.settings
    return (
        isinstance(settings.size, int)
        and settings.resample == "systematic"
        and settings.when == "every_frame"
        and settings.proposal.bootstrap is not None
        and compiled.moving is None
        and compiled.modes is None
        and is_flat(compiled.plate)
        and on_call_rule(compiled.plate) is None
    )


def _asks_here(work: FrameContext, compiled: CompiledPlate, plan: Plan) -> bool:
    """True if all agents of a plan, one at least, are at work here and score hypotheses."""
    return (
        not work.availability.known
        and len(plan.observations) > 0
        and not any(one.measures or is_elsewhere(compiled.cues[one.agent]) for one in plan.observations)
    )


def _filter(work: FrameContext, table: ParticleTable) -> FilteredRows:
    """The targets of a table, without those whose weights say nothing, or where an agent fails."""
    started, compiled, plan = work.engine.clock(), table.compiled, table.plan
    moved, parents = _move(work, table)
    count, size, fields = moved.shape
    hypotheses = hypotheses_of(moved.reshape(-1, fields), compiled.motion.fields)
    answers, failed = ask_together(
        work, (compiled, plan, table.references), hypotheses, np.arange(0, count * size + 1, size)
    )
    messages = {agent: answer.reshape(count, size) for agent, answer in answers.items()}
    total = join_plain(plan, messages, moved.shape[:2])[plan.root]
    log, log_evidence = weigh(LogWeights.uniform(size).log, total)
    clouds = Clouds(moved, compiled.motion.fields, log, np.exp(log))
    motion = confined(compiled.motion, work.frame.width, work.frame.height, work.inputs)
    found = FilteredRows(work, table, clouds, messages, total, total, log_evidence, motion, parents=parents)
    work.charge("belief", started)
    is_usable = np.isfinite(log_evidence)
    is_usable[list(failed)] = False
    for row, faults in failed.items():
        for agent, fault in faults.items():
            work.note_fault(table.ids[row], "observing", agent, fault)
    return found if is_usable.all() else found.take(np.flatnonzero(is_usable).tolist())


def _move(work: FrameContext, table: ParticleTable) -> tuple[Floats, Ints]:
    """(T, N, D) hypotheses of the frame, and (T, N) those of the frame before that they come from."""
    from bayesnet_track.numerics.resampling import look_up_even_of_each

    compiled, frame, root = table.compiled, work.frame, table.compiled.plate.root
    belief = within(compiled.belief, work.net.targets[table.ids[0]].most_particles)
    motion, streams = compiled.motion, work.engine.streams
    assert isinstance(belief, ParticleFilter) and isinstance(motion, KinematicMotion)
    births, moment = work.births_of(table.ids), work.moment
    shifts = streams.uniforms(births, root, moment, "resample")
    parents = look_up_even_of_each(table.clouds.weights, shifts, start_size(belief.settings))
    own: Iterable[np.random.Generator] = streams.of_each(births, root, moment, "propagate")
    if draws_twice(motion):
        own = [streams.of(birth, root, moment, "propagate") for birth in births]
    moved = propagate_rows(motion, table.clouds.states, frame.time - table.time, own, parents)
    confined(motion, frame.width, frame.height).confine(moved.reshape(-1, moved.shape[2]))
    return moved, parents
