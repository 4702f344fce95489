"""Cameras in a frame: their clocks, and where they point, learnt from what all targets saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.adapt.cameras import (
    LEVEL,
    ClockMessage,
    ClockReading,
    Clocks,
    Knock,
    PlateClocks,
    Watch,
    adopt,
)
from bayesnet_track.adapt.existence import DetectionModel
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.sensing import Found, PointingShift
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.checked import CLOCK
from bayesnet_track.journal.events.cameras import CameraKnocked, ClockLearnt
from bayesnet_track.numerics.arrays import Floats
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
    clock_fields = _clocks_of(compiled)
    if clocks is None or not clock_fields:
        return None
    fields = compiled.motion.fields
    columns = [fields.index(field) for field in clock_fields]
    assert compiled.views is not None
    of_view = {
        node: fields.index(view.clock)
        for node, view in compiled.views.views.items()
        if view.clock is not None
    }
    return PlateClocks(
        clocks, columns, [clocks.names.index(name) for name, _ in clock_fields.values()], of_view
    )


def learn_clocks(
    work: FrameContext, history: TrackHistory, filtered: FilteredTargets
) -> tuple[Clocks, Mapping[str, Filtered], tuple[ClockLearnt, ...]]:
    """The clocks after the frame, the targets with them, and what is reported."""
    prior = clocks_now(work, history)
    assert prior is not None
    messages: list[ClockMessage] = []
    for target, filtered_target in filtered.others.items():
        copy, belief = plate_clocks(work.plate_of(target), prior), filtered_target.step.posterior
        if copy is not None and isinstance(belief, GaussianPosterior) and surely_moves(belief):
            messages.append(copy.message(belief.mean, belief.covariance))
    clocks, news = prior.after(messages).report()
    events = tuple(
        ClockLearnt(
            work.frame.index, camera, reading.offset_s, reading.sd_s, reported.offset_s, reported.sd_s
        )
        for camera, (reading, reported) in news.items()
    )
    targets = {
        target: _adopted(plate_clocks(work.plate_of(target), clocks), filtered_target)
        for target, filtered_target in filtered.others.items()
    }
    return clocks, targets, events


def adopt_clocks(work: FrameContext, history: TrackHistory, clocks: Clocks) -> TrackHistory:
    """The history with unconfirmed tracks that are given the clocks."""
    models: dict[str, DetectionModel] = dict(history.detection_models)
    for plate, model in models.items():
        copy, unconfirmed = plate_clocks(work.engine.plates[plate], clocks), model.unconfirmed
        if copy is None or not len(unconfirmed):
            continue
        pairs = zip(unconfirmed.mean, unconfirmed.covariance, strict=True)
        mean, covariance = (
            np.array(each) for each in zip(*(copy.adopted(*pair) for pair in pairs), strict=True)
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


def _adopted(copy: PlateClocks | None, filtered: Filtered) -> Filtered:
    belief = filtered.step.posterior
    if copy is None or not isinstance(belief, GaussianPosterior):
        return filtered
    mean, covariance = copy.adopted(belief.mean, belief.covariance)
    posterior = evolve(belief, mean=mean, covariance=covariance)
    return evolve(filtered, step=evolve(filtered.step, posterior=posterior, find_map=lambda: mean))


@dataclass(frozen=True, eq=False)
class Watched:
    """The cameras of a plate in a frame.

    Attributes:
        watches: camera -> what is known of where it points.
        shifts: camera that is off -> by how much.
        news: cameras of which that is new in this frame.
        events: what is to be reported.
    """

    watches: Mapping[str, Watch]
    shifts: Mapping[str, PointingShift]
    news: tuple[str, ...] = ()
    events: tuple[CameraKnocked, ...] = ()

    @classmethod
    def watch(
        cls,
        compiled: CompiledPlate,
        frame: int,
        watches: Mapping[str, Watch],
        looks: Mapping[str, Found],
        targets: tuple[tuple[str, ...], Floats],
    ) -> Watched:
        """The cameras after what they `looks` saw of targets, names and means (T, D), as these are expected.

        A camera whose pose is not said to be uncertain (`bias_px`) is not watched.
        """
        names, means = targets
        updated, looking = dict(watches), []
        for agent, detections in looks.items():
            sensor = compiled.sensors[agent]
            if (bias_px := sensor.bias_sd) > 0.0:
                camera = sensor.camera
                looking.append(camera)
                watch = updated.get(camera, Watch(bias_px))
                updated[camera] = watch.see(names, sensor.boxes(means), detections.values)
        previous = updated
        updated, knocked = _judge(previous, looking)
        events: tuple[CameraKnocked, ...] = ()
        if knocked is not None:
            camera, knock = knocked
            events = (
                CameraKnocked(
                    frame,
                    camera,
                    round(knock.x, 2),
                    round(knock.y, 2),
                    round(float(updated[camera].variance) ** 0.5, 2),
                    frame - knock.frames + 1,
                    knock.agree,
                    knock.targets,
                    round(knock.chi_square, 1),
                ),
            )
        news = tuple(name for name in looking if updated[name].variance != previous[name].variance)
        return cls(updated, _shifts(compiled, updated), news, events)

    def move_target(self, target: TargetState) -> TargetState:
        """A target with what is new."""
        belief = target.belief
        if not self.news or not isinstance(belief, GaussianPosterior):
            return target
        mean, covariance = self.move(belief.mean[None], belief.covariance[None])
        return evolve(target, belief=evolve(belief, mean=mean[0], covariance=covariance[0]))

    def move_tracks(self, model: DetectionModel) -> DetectionModel:
        """Unconfirmed tracks with what is new."""
        waiting = model.unconfirmed
        if not self.news or not len(waiting):
            return model
        mean, covariance = self.move(waiting.mean, waiting.covariance)
        return evolve(model, unconfirmed=evolve(waiting, mean=mean, covariance=covariance))

    def move(self, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """States (T, D), (T, D, D) with what is new: a knock widens the bias, what is learnt narrows it.

        A knock is independent of all that was seen before it; what is learnt of it is evidence on what was
        seen since.
        """
        mean, covariance = mean.copy(), covariance.copy()
        for camera in self.news:
            shift = self.shifts[camera]
            columns = list(shift.columns)
            for row in range(len(mean)):
                marginal = shift.mean, shift.variance * np.eye(len(columns))
                if shift.variance > covariance[row, columns[0], columns[0]]:
                    mean[row, columns] = shift.mean
                    covariance[row, columns, columns] = shift.variance
                else:
                    mean[row], covariance[row] = adopt(mean[row], covariance[row], columns, marginal)
        return mean, covariance


def _shifts(compiled: CompiledPlate, watches: Mapping[str, Watch]) -> dict[str, PointingShift]:
    """Camera that was knocked -> by how much it is off."""
    shifts = {}
    for sensor in compiled.sensors.values():
        watch = watches.get(sensor.camera)
        if watch is not None and watch.variance > 0.0:
            variance = sensor.bias_sd**2 + watch.variance
            shifts[sensor.camera] = PointingShift(sensor.bias_columns, watch.shift, variance)
    return shifts


def _judge(
    watches: Mapping[str, Watch], looking: Sequence[str]
) -> tuple[dict[str, Watch], tuple[str, Knock] | None]:
    """Cameras after a frame that `looking` ones saw, and which of them was knocked, if one was.

    It is the one whose chi-square exceeds the level and that of the others by as much: what all cameras
    show is the targets' own motion.
    """
    knocks = {name: knock for name, watch in watches.items() if (knock := watch.knock()) is not None}
    order = sorted(knocks, key=lambda name: -knocks[name].chi_square)
    second = knocks[order[1]].chi_square if len(order) > 1 else 0.0
    updated = dict(watches)
    if not order or order[0] not in looking or knocks[order[0]].chi_square < LEVEL + second:
        return updated | {name: watches[name].settled() for name in looking}, None
    first = order[0]
    updated[first] = watches[first].knocked(knocks[first])
    return updated, (first, knocks[first])
