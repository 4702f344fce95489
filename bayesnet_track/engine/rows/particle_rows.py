"""The first half of the frame of many targets held by particles, in a few calls on arrays.

Targets fit whose plate has one belief, a fixed number of hypotheses drawn from the motion model, and whose
active agents are at work here and score hypotheses. All others go one by one (`filtering.filter_target`), and
so does a target where an agent fails, or that is searched for.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from functools import lru_cache

import numpy as np

from bayesnet_track.adapt.status import on_call_rule
from bayesnet_track.belief.contract import hypotheses_of
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.composed import kinematics_of
from bayesnet_track.belief.motion.models import KinematicMotion, propagate_rows
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.belief.particles.particle_set import Clouds
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import within
from bayesnet_track.engine.frame_context import FrameContext, ask_together
from bayesnet_track.engine.predicting import PredictedMotion, jump_share, predict_motion
from bayesnet_track.engine.rows.filtered_rows import FilteredRows, weigh
from bayesnet_track.engine.second_steps import is_sudden
from bayesnet_track.engine.state import TargetState, with_agents
from bayesnet_track.engine.targets import ParticleTable, Targets
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure import fit_of
from bayesnet_track.inference.messages import join_plain
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.log_weights import LogWeights


def filter_rows(work: FrameContext, targets: Mapping[str, TargetState]) -> list[FilteredRows]:
    """The targets that fit, predicted and weighed by what their active agents see, by groups."""
    groups = []
    tables, moves = _tables(work, targets)
    for table in tables:
        group = _filter(work, table, {target: moves[target] for target in table.ids if target in moves})
        if len(group):
            groups.append(group)
    return groups


def _tables(
    work: FrameContext, targets: Mapping[str, TargetState]
) -> tuple[list[ParticleTable], Mapping[str, PredictedMotion]]:
    """The targets that fit, those together that are alike, and the motions that depend on more than states.

    Those that are columns already come first.
    """
    arranged = Targets.of(targets).unchanged(work.net.targets)
    tables: dict[Hashable, ParticleTable] = {}
    singles, moves = dict(arranged.others), dict[str, PredictedMotion]()
    key: Hashable
    for table in arranged.particles:
        if work.availability.known or not _scores_here(table.compiled, table.plan):
            continue
        limit = work.net.targets[table.ids[0]].most_particles
        shape = table.clouds.states.shape[1:]
        key = (
            table.compiled.plate.name,
            table.plan.active,
            table.time,
            shape,
            limit,
            id(table.compiled.motion),
        )
        if key in tables:  # they had another number of hypotheses so far
            singles |= {target: table.state(row) for row, target in enumerate(table.ids)}
        else:
            tables[key] = table
    stackable: dict[Hashable, dict[str, TargetState]] = {}
    for target, state in singles.items():
        live, compiled = work.net.targets[target], work.plate_of(target)
        if not plate_fits(compiled):
            continue
        adapted = with_agents(compiled, state, live.looking(work.frame.ordinal))
        if adapted.plan.factors or any(
            observation.agent not in adapted.references for observation in adapted.plan.observations
        ):
            continue
        if work.availability.known or not _scores_here(compiled, adapted.plan):
            continue
        if compiled.moving is not None and adapted.motion_context is not None:
            predicted = _predict(work, compiled, adapted, live.status == "lost")
            if predicted is None:
                continue
            moves[target] = predicted
        motion = moves[target].motion if target in moves else compiled.motion
        shape = particles(adapted.belief).states.shape
        key = (live.template, adapted.plan.active, adapted.time, shape, live.most_particles, id(motion))
        stackable.setdefault(key, {})[target] = adapted
    for key, group in stackable.items():
        added = ParticleTable.of(work.plate_of(next(iter(group))), group)
        tables[key] = tables[key].extended(added) if key in tables else added
    return list(tables.values()), moves


def _predict(
    work: FrameContext, compiled: CompiledPlate, state: TargetState, is_lost: bool
) -> PredictedMotion | None:
    """The motion of a target in this frame; None where some of its hypotheses jump."""
    rule, context = compiled.moving, state.motion_context
    assert rule is not None and context is not None
    if rule.relocalize is not None and jump_share(rule.relocalize, context, is_lost) > 0.0:
        return None
    return predict_motion(compiled, None, context, is_lost, work.frame.time - state.time, work.cache)


@lru_cache(maxsize=64)
def plate_fits(compiled: CompiledPlate) -> bool:
    """True if the targets of a plate may be filtered together."""
    belief = compiled.belief
    if not isinstance(belief, ParticleFilter) or kinematics_of(compiled.motion) is None:
        return False
    settings = belief.settings
    return (
        isinstance(settings.size, int)
        and settings.resample == "systematic"
        and settings.when == "every_frame"
        and settings.proposal.bootstrap is not None
        and compiled.modes is None
        and on_call_rule(compiled.plate) is None
    )


@lru_cache(maxsize=64)
def _scores_here(compiled: CompiledPlate, plan: Plan) -> bool:
    """True if all agents of a plan, one at least, are at work here and score hypotheses of the root."""
    return (
        len(plan.observations) > 0
        and not (plan.draws or plan.views)
        and not any(
            observation.measures or observation.agent in compiled.elsewhere
            for observation in plan.observations
        )
    )


def _filter(work: FrameContext, table: ParticleTable, moves: Mapping[str, PredictedMotion]) -> FilteredRows:
    """The targets of a table, but for those with weights that say nothing, a failed agent, or a search."""
    start, compiled, plan = work.engine.clock(), table.compiled, table.plan
    free = moves[table.ids[0]].motion if moves else compiled.motion
    motion, dt = work.confined(free), work.frame.time - table.time
    states, parents = _move(work, table, motion, dt)
    count, size, fields = states.shape
    hypotheses = hypotheses_of(states.reshape(-1, fields), compiled.motion.fields)
    answers, failed = ask_together(
        work, (compiled, plan, table.references), hypotheses, np.arange(0, count * size + 1, size)
    )
    messages = {agent: answer.reshape(count, size) for agent, answer in answers.items()}
    messages = join_plain(plan, messages, states.shape[:2])
    total = messages.pop(plan.root)
    prior = LogWeights.uniform(size)
    log, log_evidence = weigh(prior.log, total)
    clouds = Clouds(states, compiled.motion.fields, log, np.exp(log))
    filtered = FilteredRows(
        work,
        table,
        clouds,
        prior,
        messages,
        total,
        total,
        log_evidence,
        motion,
        dt,
        parents=parents,
        moves=moves,
    )
    work.charge("belief", start)
    is_usable = np.isfinite(log_evidence)
    is_usable[list(failed)] = False
    if compiled.moving is not None and compiled.moving.relocalize is not None:
        for row in np.flatnonzero(is_usable).tolist():
            fit = fit_of([messages[observation.agent][row] for observation in plan.observations])
            is_usable[row] = not is_sudden(work, table.ids[row], table.base[row], fit)
    for row, faults in failed.items():
        for agent, fault in faults.items():
            work.note_fault(table.ids[row], "observing", agent, fault)
    return filtered if is_usable.all() else filtered.take(np.flatnonzero(is_usable).tolist())


def _move(work: FrameContext, table: ParticleTable, motion: Confined, dt: float) -> tuple[Floats, Ints]:
    """(T, N, D) hypotheses of the frame, and (T, N) those of the frame before that they come from."""
    from bayesnet_track.numerics.resampling import look_up_even_of_each

    root, belief = table.plan.root, table.compiled.belief
    limit = work.net.targets[table.ids[0]].most_particles
    if limit is not None:
        belief = within(belief, limit)
    streams, free = work.engine.streams, motion.motion
    assert isinstance(belief, ParticleFilter)
    size = belief.settings.size
    assert isinstance(size, int)  # else the plate does not fit
    births, moment = work.births_of(table.ids), work.moment
    shifts = streams.uniforms(births, root, moment, "resample")
    parents = look_up_even_of_each(table.clouds.weights, shifts, size)
    draws: Iterable[np.random.Generator] = streams.of_each(births, root, moment, "propagate")
    if not isinstance(free, KinematicMotion) or free.draws_twice:
        draws = [streams.of(birth, root, moment, "propagate") for birth in births]
    if not isinstance(free, KinematicMotion):
        each = zip(table.clouds.states, draws, parents, strict=True)
        return np.array(
            [motion.propagate(states, dt, rng, ancestors) for states, rng, ancestors in each]
        ), parents
    states = propagate_rows(free, table.clouds.states, dt, draws, parents)
    motion.confine(states.reshape(-1, states.shape[2]))
    return states, parents
