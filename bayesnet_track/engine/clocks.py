"""The clocks of cameras in a frame: learnt once from what all targets saw, and given back to each."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesnet_track.adapt.clocks import ClockMessage, ClockReading, Clocks, PlateClocks
from bayesnet_track.adapt.existence import DetectionModel
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.rows.filtered_rows import Together
from bayesnet_track.graph.checked import CLOCK
from bayesnet_track.journal.events.cameras import ClockLearnt
from bayesnet_track.numerics.records import evolve


def first_clocks(engine: Engine) -> Clocks | None:
    """The clocks as the graph says; None where it has none to learn."""
    sds: dict[tuple[str, str], float] = {}
    for compiled in engine.plates.values():
        for (camera, axis), sd in _clocks_of(compiled).values():
            sds[camera, axis] = sd
    if not sds:
        return None
    names = tuple(sds)
    offsets = {camera: place for place, (camera, axis) in enumerate(names) if axis == CLOCK}
    rates = tuple((offsets[camera], place) for place, (camera, axis) in enumerate(names) if axis != CLOCK)
    reported = {camera: ClockReading(0.0, sds[camera, CLOCK]) for camera in offsets}
    spread = np.diag(np.array([*sds.values()]) ** 2)
    return Clocks(names, offsets, rates, np.zeros(len(names)), spread, reported)


def clocks_now(work: FrameContext, history: TrackHistory) -> Clocks | None:
    """The clocks as they are expected in the frame; None where none is learnt."""
    if history.clocks is None:
        return first_clocks(work.engine)
    previous = work.cache.frames.previous
    return history.clocks if previous is None else history.clocks.later(work.frame.time - previous.time)


def plate_clocks(compiled: CompiledPlate, clocks: Clocks | None) -> PlateClocks | None:
    """The clocks as a plate's states have them; None of a plate that no camera with a clock sees."""
    own = _clocks_of(compiled)
    if clocks is None or not own:
        return None
    fields = compiled.motion.fields
    columns = [fields.index(field) for field in own]
    assert compiled.views is not None
    of_view = {
        node: fields.index(view.clock)
        for node, view in compiled.views.views.items()
        if view.clock is not None
    }
    return PlateClocks(clocks, columns, [clocks.names.index(name) for name, _ in own.values()], of_view)


def learn_clocks(
    work: FrameContext, history: TrackHistory, filtered: Together
) -> tuple[Clocks, Mapping[str, Filtered], tuple[ClockLearnt, ...]]:
    """The clocks after the frame, the targets with them, and what is reported."""
    before = clocks_now(work, history)
    assert before is not None
    messages: list[ClockMessage] = []
    for target, filtered_target in filtered.others.items():
        by, belief = plate_clocks(work.plate_of(target), before), filtered_target.step.posterior
        if by is not None and isinstance(belief, GaussianPosterior) and surely_moves(belief):
            messages.append(by.message(belief.mean, belief.covariance))
    clocks, news = before.after(messages).report()
    events = tuple(
        ClockLearnt(work.frame.index, camera, reading.offset_s, reading.sd_s, last.offset_s, last.sd_s)
        for camera, (reading, last) in news.items()
    )
    others = {
        target: _adopted(plate_clocks(work.plate_of(target), clocks), filtered_target)
        for target, filtered_target in filtered.others.items()
    }
    return clocks, others, events


def adopt_clocks(work: FrameContext, history: TrackHistory, clocks: Clocks) -> TrackHistory:
    """The history with unconfirmed tracks that are given the clocks."""
    models: dict[str, DetectionModel] = dict(history.detection_models)
    for plate, model in models.items():
        by, unconfirmed = plate_clocks(work.engine.plates[plate], clocks), model.unconfirmed
        if by is None or not len(unconfirmed):
            continue
        pairs = zip(unconfirmed.mean, unconfirmed.covariance, strict=True)
        mean, covariance = (
            np.array(each) for each in zip(*(by.adopted(*pair) for pair in pairs), strict=True)
        )
        models[plate] = evolve(model, unconfirmed=evolve(unconfirmed, mean=mean, covariance=covariance))
    return evolve(history, detection_models=models)


MOVES = 4.0
"""A target is evidence of a clock if its speed is so many standard deviations."""


def surely_moves(belief: GaussianPosterior) -> bool:
    """True if a target's velocity is clearly another than 0.

    Of one that stands the velocity is the noise of its detections, and so is what a clock would follow from.
    """
    velocity, spread = belief.mean[4:6], belief.covariance[4:6, 4:6]
    return float(velocity @ np.linalg.solve(spread, velocity)) > MOVES**2


def _clocks_of(compiled: CompiledPlate) -> dict[str, tuple[tuple[str, str], float]]:
    """Field of a plate's states -> (camera, what of its clock), and its sd before anything is seen."""
    if compiled.views is None:
        return {}
    views = compiled.views.views
    return {
        error.field: ((views[error.node].seen_by, error.axis), error.sd)
        for error in compiled.views.lasting
        if error.is_clock
    }


def _adopted(by: PlateClocks | None, filtered: Filtered) -> Filtered:
    belief = filtered.step.posterior
    if by is None or not isinstance(belief, GaussianPosterior):
        return filtered
    mean, covariance = by.adopted(belief.mean, belief.covariance)
    posterior = evolve(belief, mean=mean, covariance=covariance)
    return evolve(filtered, step=evolve(filtered.step, posterior=posterior, find_map=lambda: mean))
