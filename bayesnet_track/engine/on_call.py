"""Agents on call run after the others, in the frames in which they are due or needed.

The others' answers are remembered, so that only the belief is weighed a second time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import OnCallOutcome, Reading, baseline_level, read_level
from bayesnet_track.adapt.status import is_due, on_call_rule
from bayesnet_track.belief.contract import Posterior, Step, estimate, hypotheses_of
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.state import TargetState, plan_for
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure import state_columns
from bayesnet_track.inference.observe import Observer, Question, ask_agents
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import overlap_of_two
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import region_of_boxes

By = Callable[[Plan], Step[Posterior]]
"""Another step of the frame, by the agents of a plan."""


def plan_without_calls(work: FrameContext, target: str, state: TargetState) -> Plan:
    """The plan of the agents that look at a frame first.

    `before.plan` itself when none is left out: nothing is to be weighed again then.
    """
    plate, plan = work.plate_of(target).plate, state.plan
    if on_call_rule(plate) is None:
        return plan
    by_hand = work.net.targets[target].by_hand
    first = {agent for agent in plan.active if plate.governor[agent] != plate.root or agent in by_hand}
    return plan_for(work.plate_of(target), frozenset(first)) if first and first != plan.active else plan


def call_agents(
    work: FrameContext,
    target: str,
    state: TargetState,
    observer: Observer,
    steps: tuple[Plan, Step[Posterior], By],
) -> tuple[Plan, Step[Posterior], OnCallOutcome | None]:
    """The agents that took part in the frame, its step, and what became of those on call.

    `steps` are the agents that look first, their step, and what makes another. Those on call run, too,
    where none of the first gave an answer. Then, or where they gave none themselves, nothing can be compared.
    """
    plan, first, step_of = steps
    plate, net = work.plate_of(target).plate, work.net.targets[target]
    root = plate.inference(plate.root)
    agents = tuple(
        observation.agent for observation in state.plan.observations if observation.agent not in plan.active
    )
    first_estimate = estimate(root.estimate, first)
    reading = _read(plate, state.memory, plan, first, first_estimate)
    due = is_due(net, work.frame.index) or plan.active <= _without_answer(observer)
    if not due and (reading is None or not reading.above):
        return plan, first, OnCallOutcome(agents, ran=False)
    _ask_around(state.plan, observer, agents, hypotheses_of(first_estimate[None], first.posterior.fields))
    combined, failed = step_of(state.plan), _without_answer(observer)
    ran = tuple(agent for agent in agents if agent not in failed)
    if not ran or plan.active <= failed:
        return state.plan, combined, None
    share = overlap_of_two(first_estimate[:4], estimate(root.estimate, combined)[:4])
    cause = None if due or reading is None else reading.cause(1, reading.value)
    return state.plan, combined, OnCallOutcome(ran, True, share, cause)


def _without_answer(observer: Observer) -> set[str]:
    return observer.faults.keys() | observer.missed.keys()


def _ask_around(plan: Plan, observer: Observer, agents: Collection[str], hypotheses: Hypotheses) -> None:
    """Ask the agents that measure, once a frame, where the others found the target: they search around it."""
    observations = [
        observation
        for observation in plan.observations
        if observation.agent in agents and observation.measures and observation.at == plan.root
    ]
    ask_agents(
        Question({plan.root: hypotheses}, np.zeros(1), region_of_boxes(hypotheses.boxes)),
        observer,
        observations,
    )


def _read(
    plate: CheckedTarget, memory: RuleMemory, plan: Plan, step: Step[Posterior], state: Floats
) -> Reading | None:
    """UD of a step by the agents of a plan, without those on call; its estimate is `state` (D,)."""
    rule = on_call_rule(plate)
    assert rule is not None
    ud_px2 = step.posterior.uncertainty(step.map_state, state_columns(plate, plate.root))
    # Of more agents the baseline is lower: they would always be called.
    quiet = (
        baseline_level(plate, plan.active, memory, plate.root) if rule.above.kind == "ud_baseline" else None
    )
    return read_level(rule.above, ud_px2, float(state[2] * state[3]), quiet)
