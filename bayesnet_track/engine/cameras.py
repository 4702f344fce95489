"""Cameras in a frame: their clocks and biases, learnt from what all targets saw, and knocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from bayesnet_track.adapt.cameras import (
    LEVEL,
    CameraErrors,
    ClockReading,
    ErrorMessage,
    Knock,
    PlateErrors,
    Watch,
)
from bayesnet_track.adapt.existence import DetectionModel
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.checked import CLOCK, RATE, LastingError
from bayesnet_track.journal.events.cameras import CameraKnocked, ClockLearnt
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve


def first_errors(engine: Engine) -> CameraErrors | None:
    """The errors that targets share, as the graph says; None where it has none."""
    by_name = {
        name: error for compiled in engine.plates.values() for name, error in _errors_of(compiled).values()
    }
    if not by_name:
        return None
    names = tuple(by_name)
    offsets = {camera: place for place, (camera, axis) in enumerate(names) if axis == CLOCK}
    rates = tuple((offsets[camera], place) for place, (camera, axis) in enumerate(names) if axis == RATE)
    reported = {camera: ClockReading(0.0, by_name[camera, CLOCK].sd) for camera in offsets}
    sds, over_s = (
        np.array([getattr(error, key) for error in by_name.values()], dtype=np.float64)
        for key in ("sd", "over_s")
    )
    spread = np.diag(sds**2)
    return CameraErrors(names, offsets, rates, sds, over_s, np.zeros(len(names)), spread, reported=reported)


def errors_at(work: FrameContext, history: TrackHistory) -> CameraErrors | None:
    """The errors as they are expected in the frame; None where none is shared."""
    errors = first_errors(work.engine) if history.errors is None else history.errors
    return None if errors is None else errors.at(work.frame.time)


def plate_errors(compiled: CompiledPlate, errors: CameraErrors | None) -> PlateErrors | None:
    """The errors as a plate's states have them; None of a plate without any."""
    named = _errors_of(compiled)
    if errors is None or not named:
        return None
    fields = compiled.motion.fields
    columns = {name: fields.index(field) for field, (name, _) in named.items()}
    assert compiled.views is not None
    cameras = {node: view.seen_by for node, view in compiled.views.views.items()}
    view = compiled.views.main
    moves = tuple(zip([0, 1] if view.z is None else [0, 1, view.z], view.speeds, strict=True))
    return PlateErrors(
        errors,
        [*columns.values()],
        [errors.names.index(name) for name in columns],
        {node: columns[name, CLOCK] for node, name in cameras.items() if (name, CLOCK) in columns},
        {
            node: [columns[name, axis] for axis in "xy"]
            for node, name in cameras.items()
            if (name, "x") in columns
        },
        moves,
    )


def learn_errors(
    work: FrameContext, history: TrackHistory, filtered: FilteredTargets
) -> tuple[CameraErrors, Mapping[str, Filtered], tuple[ClockLearnt, ...]]:
    """The errors of cameras after the frame, the targets with them, and what is reported of clocks.

    What surely moves is evidence of clocks, and every target of biases, each by its measurements alone: a
    target that likelihoods have narrowed would be compared with as if they were right.
    """
    prior = errors_at(work, history)
    assert prior is not None
    messages: list[ErrorMessage] = []
    for target, filtered_target in filtered.others.items():
        copy, belief = plate_errors(work.plate_of(target), prior), filtered_target.step.posterior
        if copy is None or not isinstance(belief, GaussianPosterior):
            continue
        moments = belief.measured or (belief.mean, belief.covariance)
        columns = copy.columns if surely_moves(*moments) else [*chain.from_iterable(copy.bias_of.values())]
        if columns:
            messages.append(copy.message(*moments, columns))
    errors, news = prior.after(messages).report()
    events = tuple(
        ClockLearnt(
            work.frame.index, camera, reading.offset_s, reading.sd_s, reported.offset_s, reported.sd_s
        )
        for camera, (reading, reported) in news.items()
    )
    targets = {
        target: _adopted(plate_errors(work.plate_of(target), errors), filtered_target)
        for target, filtered_target in filtered.others.items()
    }
    return errors, targets, events


def adopt_errors(work: FrameContext, history: TrackHistory, errors: CameraErrors) -> TrackHistory:
    """The history with unconfirmed tracks that are given the errors."""
    models: dict[str, DetectionModel] = dict(history.detection_models)
    for plate, model in models.items():
        copy, unconfirmed = plate_errors(work.engine.plates[plate], errors), model.unconfirmed
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


def surely_moves(mean: Floats, covariance: Floats) -> bool:
    """True if a target's velocity is clearly another than 0.

    Of one that stands the velocity is the noise of its detections, and so is what a clock would follow from.
    """
    velocity, spread = mean[4:6], covariance[4:6, 4:6]
    return float(velocity @ np.linalg.solve(spread, velocity)) > MOVES**2


def _errors_of(compiled: CompiledPlate) -> dict[str, tuple[tuple[str, str], LastingError]]:
    """Field of a plate's states -> (camera, axis) and the error, of those that its targets share."""
    if compiled.views is None:
        return {}
    views = compiled.views.views
    return {
        error.field: ((views[error.node].seen_by, error.axis), error)
        for error in compiled.views.lasting
        if error.is_shared
    }


def _adopted(copy: PlateErrors | None, filtered: Filtered) -> Filtered:
    belief = filtered.step.posterior
    if copy is None or not isinstance(belief, GaussianPosterior):
        return filtered
    mean, covariance = copy.adopted(belief.mean, belief.covariance)
    measured = belief.measured and copy.adopted(*belief.measured)
    posterior = evolve(belief, mean=mean, covariance=covariance, measured=measured)
    return evolve(filtered, step=evolve(filtered.step, posterior=posterior, find_map=lambda: mean))


@dataclass(frozen=True, eq=False)
class Watched:
    """The cameras of a plate in a frame.

    Attributes:
        watches: camera -> what is known of where it points.
        copy: errors of cameras as the plate's states have them; None where none is shared.
        shift: columns of the bias of a camera that was knocked in this frame, px by which it is off (2,), and
            their variance; None of none.
        events: what is to be reported.
    """

    watches: Mapping[str, Watch]
    copy: PlateErrors | None = None
    shift: tuple[Sequence[int], Floats, float] | None = None
    events: tuple[CameraKnocked, ...] = ()

    @classmethod
    def watch(
        cls,
        compiled: CompiledPlate,
        frame: int,
        history: tuple[Mapping[str, Watch], CameraErrors | None],
        looks: Mapping[str, Found],
        targets: tuple[tuple[str, ...], Floats],
    ) -> Watched:
        """The cameras after what they `looks` saw of targets, names and means (T, D), as these are expected.

        A camera whose pose is not said to be uncertain (`bias_px`) is not watched.
        """
        (watches, errors), (names, means) = history, targets
        updated, looking = dict(watches), []
        copy = plate_errors(compiled, errors)
        for agent, detections in looks.items():
            sensor = compiled.sensors[agent]
            if (seen_by := sensor.camera) is not None and seen_by.bias_sd > 0.0:
                looking.append(seen_by.name)
                watch = updated.get(seen_by.name, Watch(seen_by.bias_sd))
                updated[seen_by.name] = watch.see(names, sensor.boxes(means), detections.values)
        updated, knocked = _judge(updated, looking)
        if knocked is None or copy is None or errors is None:
            return cls(updated, copy)
        camera, knock = knocked
        event = CameraKnocked(
            frame,
            camera,
            round(knock.x, 2),
            round(knock.y, 2),
            round(knock.variance**0.5, 2),
            frame - knock.frames + 1,
            knock.agree,
            knock.targets,
            round(knock.chi_square, 1),
        )
        assert compiled.views is not None
        node = next(name for name, view in compiled.views.views.items() if view.seen_by == camera)
        shift = copy.bias_of[node], np.array([knock.x, knock.y]), knock.variance
        copy = evolve(copy, errors=errors.shifted(camera, knock))
        return cls(updated, copy, shift, (event,))

    @property
    def errors(self) -> CameraErrors | None:
        """Errors of all cameras; None where none is shared."""
        return None if self.copy is None else self.copy.errors

    def move_target(self, target: TargetState) -> TargetState:
        """A target with the knock of this frame."""
        belief = target.belief
        if self.shift is None or not isinstance(belief, GaussianPosterior):
            return target
        moments = [(belief.mean, belief.covariance), *([belief.measured] if belief.measured else [])]
        means, covariances = self.move(*map(np.array, zip(*moments, strict=True)))
        measured = (means[1], covariances[1]) if belief.measured else None
        belief = evolve(belief, mean=means[0], covariance=covariances[0], measured=measured)
        return evolve(target, belief=belief)

    def move_tracks(self, model: DetectionModel) -> DetectionModel:
        """Unconfirmed tracks with the knock of this frame."""
        waiting = model.unconfirmed
        if self.shift is None or not len(waiting):
            return model
        mean, covariance = self.move(waiting.mean, waiting.covariance)
        return evolve(model, unconfirmed=evolve(waiting, mean=mean, covariance=covariance))

    def move(self, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """States (T, D), (T, D, D) with the knock of this frame, which widens the bias of its camera.

        It is independent of all that was seen before it.
        """
        if self.shift is None:
            return mean, covariance
        columns, shift, variance = self.shift
        mean, covariance = mean.copy(), covariance.copy()
        mean[:, columns] += shift
        covariance[:, columns, columns] += variance
        return mean, covariance


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
    updated[first] = watches[first].knocked()
    return updated, (first, knocks[first])
