"""The motion of one frame: the plate's, with what the last frame and the camera say of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.adapt.rule_inputs import Reading, read_level
from bayesnet_track.adapt.status import next_try
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.composed import Influences, compose_motion, inflation_factor, kinematics_of
from bayesnet_track.belief.motion.delayed import Attached, CameraShift, camera_shift
from bayesnet_track.belief.motion.jumps import Jumping, Search, Within
from bayesnet_track.belief.motion.modes import Modal
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.graph.settings.adapt import Level
from bayesnet_track.graph.settings.motion import Relocalize
from bayesnet_track.journal.events.lives import DetectorFailed
from bayesnet_track.journal.target_net import Fault
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import FAULTS, said
from bayesnet_track.observation.detector import (
    NOTHING,
    Detector,
    DetectorState,
    LearningDetector,
    check_detections,
)
from bayesnet_track.observation.planes import FramePair, PlaneCache, Region

SUREST_JUMP = 1.0 - 1e-9
"""After any time a target may still be where its motion says."""


@dataclass(frozen=True, eq=False)
class MotionContext:
    """Inputs of a target's motion besides its states: arrays and numbers.

    Attributes:
        size: (2,) width and height of the first box, px.
        ud_px2: UD of the last frame; 0 at the start.
        area_px2: area of its estimate.
        quiet_px2: baseline of UD, None while unknown.
        finder: what the detector remembers that looks for it; None when there is none, or it knows no target.
        fault: its last failure.
        influences: what the motion into the last frame depended on; None at the start.
        held: (4,) the last centre box that more probably held it than not, None before any.
        away: frame intervals since then.
    """

    size: Floats
    ud_px2: float
    area_px2: float
    quiet_px2: float | None = None
    finder: DetectorState | None = None
    fault: Fault | None = None
    influences: Influences | None = None
    held: Floats | None = None
    away: float = 0.0

    def reading(self, level: Level) -> Reading | None:
        """UD in a level's unit; None while that is unknown."""
        return read_level(level, self.ud_px2, self.area_px2, self.quiet_px2)


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """The motion of one frame.

    Attributes:
        motion: the model.
        motion_context: the target's, with what its detector remembers now; None where nothing depends on it.
        events: what is written down.
    """

    motion: MotionModel
    motion_context: MotionContext | None = None
    events: tuple[DetectorFailed, ...] = ()

    def after(
        self, ud_px2: float, area_px2: float, quiet_px2: float | None, held_box: Floats | None = None
    ) -> MotionContext | None:
        """The motion context after a frame with these measurements; `held_box` (4,) as in `Measured`."""
        if self.motion_context is None:
            return None
        context = evolve(self.motion_context, ud_px2=ud_px2, area_px2=area_px2, quiet_px2=quiet_px2)
        return context if held_box is None else evolve(context, held=held_box, away=0.0)


def start_motion_context(compiled: CompiledPlate, box: Floats, frames: FramePair) -> MotionContext | None:
    """The motion context of a target that starts in the centre box (4,), which its detector is shown.

    A detector that cannot learn it has nothing to look for and finds nothing. None for a plain motion.
    """
    if compiled.moving is None:
        return None
    state: DetectorState | None = None
    if compiled.finder is not None:
        try:
            state = compiled.finder.start()
            if isinstance(compiled.finder, LearningDetector):
                state = compiled.finder.learn(frames, box, state)
        except FAULTS:
            state = None
    return MotionContext(np.array(box[2:4]), 0.0, float(box[2] * box[3]), None, state)


def predict_motion(
    compiled: CompiledPlate,
    substitute: MotionModel | None,
    context: MotionContext | None,
    is_lost: bool,
    dt: float,
    cache: PlaneCache,
) -> PredictedMotion:
    """The motion over `dt` frame intervals, as it stands before a frame's evidence.

    In this order: the camera moves the states, their sizes are drawn back, noise is added, widened while
    unsure, and with some probability the position is anywhere instead. `substitute` stands in for the plate's
    motion; where that is of a target which may be carried, all this is how it moves on its own.
    """
    settings, plain = compiled.moving, compiled.motion
    parts = plain.parts if isinstance(plain, Modal) else (plain,)
    if settings is None or context is None or all(kinematics_of(part) is None for part in parts):
        return PredictedMotion(compiled.motion if substitute is None else substitute, context)
    inflation = 1.0
    if settings.inflate is not None:
        reading = context.reading(settings.inflate.above)
        if reading is not None:
            inflation = inflation_factor(reading.value / reading.level, settings.inflate.max_factor)
    camera = _follow_camera(cache, dt) if settings.camera is not None else None
    influences = Influences(dt, context.size, inflation, camera)
    motion = compose_motion(compiled.motion, settings, influences)
    predicted = PredictedMotion(motion, evolve(context, influences=influences, away=context.away + dt))
    if settings.relocalize is not None and not compiled.searching:
        predicted = _relocalize(compiled.finder, settings.relocalize, predicted, is_lost, dt, cache)
    if isinstance(substitute, Attached):
        return replace(predicted, motion=replace(substitute, motion=predicted.motion))
    return predicted


def jump_share(settings: Relocalize, context: MotionContext, is_lost: bool) -> float:
    """Probability, per frame interval, that a target is anywhere else than its motion says."""
    reading = context.reading(settings.above)
    unsure = is_lost or (settings.grow_box is None and reading is not None and reading.above)
    return max(settings.share, settings.usual) if unsure else settings.usual


def _follow_camera(cache: PlaneCache, dt: float) -> CameraShift | None:
    from bayesnet_track.vision.motion_planes import CameraPlane

    plane, frame = CameraPlane(), cache.frames.current
    flow = cache.planes([plane], Region(0, 0, frame.width, frame.height))[plane]
    return camera_shift(flow, dt)


def _relocalize(
    finder: Detector | None,
    settings: Relocalize,
    moves: PredictedMotion,
    is_lost: bool,
    dt: float,
    cache: PlaneCache,
) -> PredictedMotion:
    """The motion, or with some probability a jump to where the target may reappear."""
    context, frame = moves.motion_context, cache.frames.current
    assert context is not None
    reading, per_frame = context.reading(settings.above), jump_share(settings, context, is_lost)
    if per_frame == 0.0 or min(frame.width, frame.height) < 3:
        return moves
    state, fault, detections, events = context.finder, context.fault, NOTHING, tuple[DetectorFailed, ...]()
    is_in = fault is None or fault.until is None or fault.until <= frame.index
    if finder is not None and state is not None and is_in:
        try:
            answer, state = finder.detect(cache.frames, state)
            detections = NOTHING if answer is None else check_detections(answer)
        except FAULTS as error:  # a guest's code: whatever it raises must not end the run
            next_frame, times = next_try(frame.index, fault)
            fault = Fault(times, frame.index, next_frame, True)
            name, reason = type(finder).__name__, said(error)
            detections, events = NOTHING, (DetectorFailed(frame.index, name, reason, next_frame, times),)
    probes = settings.by.agents
    search = Search(
        hypotheses=settings.hypotheses * min(per_frame / settings.share, 1.0),
        by=settings.by.kind if settings.by.detector is None else settings.by.detector.detector,
        probes=0 if probes is None else probes.max_boxes,
        boxes=detections.boxes,
        scores=detections.scores,
        ud_px2=context.ud_px2,
        above_px2=0.0
        if reading is None or settings.grow_box is not None
        else reading.level * reading.scale_px2,
    )
    share = min(1.0 - (1.0 - per_frame) ** dt, SUREST_JUMP)
    reach = None
    if settings.grow_box is not None and context.held is not None:
        half_px = settings.grow_box * context.away * float(np.sqrt(context.held[2] * context.held[3]))
        reach = Within.around(context.held, half_px, frame.width, frame.height)
    jumping = Jumping(moves.motion, share, frame.width, frame.height, search, reach)
    assert context.influences is not None
    influences = evolve(context.influences, jump_share=share)
    return PredictedMotion(jumping, evolve(context, finder=state, fault=fault, influences=influences), events)
