"""The first half of the frame of many targets held by particles, in a few calls on arrays.

Targets fit whose plate has one belief, a fixed number of hypotheses drawn from the motion model, and whose
active agents all score several targets at once (`CrowdCue`). All others go one by one, to the same bytes
(`filtering.filter_target`), and so do all where an agent fails.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import Evidence, Step
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.belief.motion.moved_rows import propagate_rows
from bayesnet_track.belief.particles.adaptive_size import start_size
from bayesnet_track.belief.particles.belief import FindMap, ParticleFilter
from bayesnet_track.belief.particles.particle_set import Inputs, ParticleSet
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.moving.predicting import PredictedMotion
from bayesnet_track.engine.rows.shared_planes import planes_of_each
from bayesnet_track.engine.state import TargetState, with_agents
from bayesnet_track.inference.executor import Serial, is_elsewhere
from bayesnet_track.inference.measure_rows import is_flat
from bayesnet_track.inference.messages import join_plain
from bayesnet_track.inference.observe import ROUNDING, ZERO_BELOW
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import CrowdCue, Hypotheses
from bayesnet_track.observation.guests import FAULTS
from bayesnet_track.observation.shared import shown


def filter_rows(work: FrameWork, before: Mapping[str, TargetState]) -> dict[str, Filtered]:
    """Those of the targets that fit, predicted and weighed by what their active agents see."""
    alike: dict[Hashable, dict[str, TargetState]] = {}
    for target, state in before.items():
        live, compiled = work.net.targets[target], work.plate_of(target)
        if not plate_fits(compiled) or live.most_particles is not None:
            continue
        own = with_agents(compiled, state, live.looking(work.frame.index))
        if own.plan.factors or not asks_together(work, compiled, own):
            continue
        key = (live.template, own.plan.active, own.time, particles(own.belief).states.shape)
        alike.setdefault(key, {})[target] = own
    found: dict[str, Filtered] = {}
    for group in alike.values():
        found |= _filter(work, group)
    return found


@lru_cache(maxsize=64)
def plate_fits(compiled: CompiledPlate) -> bool:
    """Whether the targets of a plate may be filtered together."""
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
    )


@lru_cache(maxsize=256)
def _scores_crowds(compiled: CompiledPlate, agent: str) -> bool:
    cue = compiled.cues[agent]
    return isinstance(cue, CrowdCue) and not is_elsewhere(cue)


def _filter(work: FrameWork, before: Mapping[str, TargetState]) -> dict[str, Filtered]:
    """Targets of a plate with the same active agents and as many hypotheses; without those that failed."""
    started = work.engine.clock()
    states = list(before.values())
    compiled, plan = work.plate_of(next(iter(before))), states[0].plan
    moved, dt = _move(work, compiled, before)
    count, size = moved.shape[:2]
    boxes = np.ascontiguousarray(moved[:, :, :4]).reshape(-1, 4)
    answers = ask_together(work, compiled, states, boxes, np.arange(0, count * size + 1, size))
    if answers is None:
        return {}
    messages = {agent: answer.reshape(count, size) for agent, answer in answers.items()}
    total = join_plain(plan, messages, moved.shape[:2])[plan.root]
    prior = LogWeights.uniform(moved.shape[1])
    log = prior.log + total
    top = log.max(axis=1)
    is_usable = np.isfinite(top)
    with np.errstate(invalid="ignore"):
        shares = np.exp(log - top[:, None])
        log_evidence = top + np.log(shares.sum(axis=1))
        log -= log_evidence[:, None]
    weights = np.exp(log)
    for array in (log, weights):
        array.setflags(write=False)
    motion = confined(compiled.motion, work.frame.width, work.frame.height)
    predicted = PredictedMotion(compiled.motion)
    found: dict[str, Filtered] = {}
    for t, (target, state) in enumerate(before.items()):
        if not is_usable[t]:
            continue
        own = LogWeights(log[t])
        own.__dict__["weights"] = weights[t]
        posterior = ParticleSet(moved[t], compiled.motion.fields, own)
        inputs = Inputs(
            particles(state.belief), motion, dt, _ask_nobody, work.stream(target, compiled.plate.root)
        )
        evidence = Evidence(total[t], {agent: message[t] for agent, message in messages.items()})
        step = Step(
            posterior,
            float(log_evidence[t]),
            posterior,
            prior,
            evidence,
            FindMap(total[t], moved[t], inputs),
        )
        found[target] = Filtered(target, state, step, (), predicted, plan)
    work.charge("belief", started)
    return found


def _ask_nobody(hypotheses: Hypotheses, prior_log: Floats) -> Evidence:
    raise AssertionError("the frame's hypotheses were weighed already")


def _move(
    work: FrameWork, compiled: CompiledPlate, before: Mapping[str, TargetState]
) -> tuple[Floats, float]:
    """(T, N, D) hypotheses of the frame, and the time since the last one."""
    from bayesnet_track.numerics.kernels.resampling_kernels import look_up_even_of_each

    belief, motion = compiled.belief, compiled.motion
    assert isinstance(belief, ParticleFilter) and isinstance(motion, KinematicMotion)
    beliefs, root, frame = [particles(one.belief) for one in before.values()], compiled.plate.root, work.frame
    dt = frame.time - next(iter(before.values())).time
    weights = np.array([one.weights.weights for one in beliefs])
    shifts = work.engine.streams.uniforms(before, root, frame.index, "resample")
    parents = look_up_even_of_each(weights, shifts, start_size(belief.settings))
    streams = [work.stream(target, root)("propagate") for target in before]
    known = np.array([one.states for one in beliefs])
    moved = propagate_rows(motion, known, dt, streams, parents)
    confined(motion, frame.width, frame.height).confine(moved.reshape(-1, moved.shape[2]))
    return moved, dt


def asks_together(work: FrameWork, compiled: CompiledPlate, state: TargetState) -> bool:
    """Whether a target's active agents, one at least, score hypotheses of several targets at once."""
    plan = state.plan
    return (
        not work.availability.known
        and isinstance(work.engine.executor, Serial)
        and len(plan.observations) > 0
        and all(
            _scores_crowds(compiled, one.agent) and one.agent in state.references for one in plan.observations
        )
    )


def ask_together(
    work: FrameWork, compiled: CompiledPlate, states: Sequence[TargetState], boxes: Floats, starts: Ints
) -> dict[str, Floats] | None:
    """Agent -> (N,) its log-likelihoods; None where one fails, or says something that cannot be used.

    Those of target t are `starts[t]` to `starts[t + 1] - 1` of the boxes (N, 4). All have the same agents.
    """
    messages: dict[str, Floats] = {}
    for one in states[0].plan.observations:
        cue: Any = compiled.cues[one.agent]
        try:
            planes = planes_of_each(work, cue.needs, boxes, starts)
            started = work.engine.clock()
            references = [shown(state.references[one.agent]) for state in states]
            said = cue.log_likelihood_of_each(planes, boxes.copy(), starts, references)
            said = np.asarray(said, dtype=np.float64).reshape(len(boxes))
        except FAULTS:
            return None
        work.charge(one.agent, started)
        if not (said.max() <= ROUNDING and said.min() >= ZERO_BELOW):
            return None
        messages[one.agent] = said if one.temperature == 1.0 else said / one.temperature
    return messages
