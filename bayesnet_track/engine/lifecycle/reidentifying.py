"""Compare detections with a target that is remembered, by its motion and all agents that know looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesnet_track.adapt.lifecycle import AppearanceMemory
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.recognise import Compared, draw_elsewhere, weigh_appearance, weigh_places
from bayesnet_track.engine.state import plan_for
from bayesnet_track.graph.settings.lifecycle import Reidentify
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses

LEAST_LOG = -700.0
"""Log-likelihoods are cut here, so that the ratio of two of them is a number."""


def compare_remembered(
    work: FrameContext,
    plate: str,
    rule: Reidentify,
    boxes: Floats,
    objects: Floats,
    memories: Sequence[AppearanceMemory],
) -> Compared:
    """Remembered targets against detections (M, 4); `objects` (K, 4) are boxes of objects in this frame."""
    compiled, frame = work.engine.plates[plate], work.frame
    motion = confined(compiled.moments, frame.width, frame.height, work.inputs)
    area = float(frame.width * frame.height)
    fading, place, distance = weigh_places(memories, motion, boxes, frame.time, area, rule)
    appearance, agents = np.zeros(place.shape), list[tuple[str, ...]]([()] * len(memories))
    if compiled.looks:
        looks = [_compare_looks(work, compiled, boxes, objects, memory) for memory in memories]
        appearance, agents = np.array([log for log, _ in looks]), [askable for _, askable in looks]
    absences = frame.time - np.array([memory.time for memory in memories])
    return Compared(
        [memory.target for memory in memories], absences, distance, fading, place, appearance, agents
    )


def _compare_looks(
    work: FrameContext, compiled: CompiledPlate, boxes: Floats, objects: Floats, memory: AppearanceMemory
) -> tuple[Floats, tuple[str, ...]]:
    """(M,) log r_k of detections by all agents that know the looks of one target, and these."""
    frame = work.frame
    agents = tuple(agent for agent in compiled.plate.agents if agent in compiled.looks & {*memory.references})
    if not frame.has_color:
        agents = tuple(agent for agent in agents if agent not in compiled.color_agents)
    if not agents:
        return np.zeros(len(boxes)), ()
    stream = work.stream_of(memory.birth, compiled.plate.root)
    random = draw_elsewhere(boxes, frame.width, frame.height, stream("elsewhere"))
    observer = Observer(
        work.cache,
        compiled.cues,
        memory.references,
        lambda purpose: stream(f"recall {purpose}"),
        availability=work.availability_of(memory.target, "recalling"),
    )
    states = np.concatenate([boxes, random, objects])
    prior = np.full(len(states), -np.log(len(states)))
    plan = replace(plan_for(compiled, frozenset(agents)), factors=())
    evidence = evaluate(plan, observer, Hypotheses(states), prior)
    values = np.clip(evidence.log_likelihood, LEAST_LOG, None)
    on_boxes, at_random, theirs = np.split(values, [len(boxes), len(boxes) + len(random)])
    appearance = weigh_appearance(boxes, on_boxes, [(random, at_random), (objects, theirs)])
    return appearance, tuple(agent for agent in agents if agent in observer.answered)
