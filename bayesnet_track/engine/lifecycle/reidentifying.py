"""Compare detections with a target that is remembered, by its motion and all agents that know looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesnet_track.adapt.lifecycle import AppearanceMemory
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.recognise import Compared, draw_elsewhere, weigh_appearance, weigh_place
from bayesnet_track.graph.settings.lifecycle import Reidentify
from bayesnet_track.inference.compile import compile_plan
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses

LEAST_LOG = -700.0
"""Log-likelihoods are cut here, so that the ratio of two of them is a number."""


def compare(
    work: FrameContext, plate: str, rule: Reidentify, boxes: Floats, others: Floats, known: AppearanceMemory
) -> Compared:
    """One remembered target against detections (M, 4); `others` (K, 4) are boxes of objects in this frame."""
    compiled, frame = work.engine.plates[plate], work.frame
    motion = confined(compiled.moments, frame.width, frame.height)
    area = float(frame.width * frame.height)
    fading, place, distance = weigh_place(known, motion, boxes, frame.time, area, rule)
    agents = tuple(
        agent for agent in compiled.plate.agents if agent in compiled.looks & set(known.references)
    )
    if not frame.has_color:
        agents = tuple(agent for agent in agents if agent not in compiled.color_agents)
    appearance = np.zeros(len(boxes))
    if agents:
        stream = work.stream_of(known.birth, compiled.plate.root)
        random = draw_elsewhere(boxes, frame.width, frame.height, stream("elsewhere"))
        observer = Observer(
            work.cache,
            compiled.cues,
            known.references,
            lambda what: stream(f"recall {what}"),
            availability=work.availability_of(known.target, "recalling"),
        )
        states = np.concatenate([boxes, random, others])
        prior = np.full(len(states), -np.log(len(states)))
        plan = replace(compile_plan(compiled.plate, agents, compiled.cues), factors=())
        evidence = evaluate(plan, observer, Hypotheses(states), prior)
        values = np.clip(evidence.log_likelihood, LEAST_LOG, None)
        agents = tuple(agent for agent in agents if agent in observer.answered)
        own, there, theirs = np.split(values, [len(boxes), len(boxes) + len(random)])
        appearance = weigh_appearance(boxes, own, [(random, there), (others, theirs)])
    return Compared(known, frame.time - known.time, distance, fading, place, appearance, agents)
