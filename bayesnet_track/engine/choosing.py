"""Choice of the cameras that are on in a step: by expected gain per declared cost, one after the other.

With a camera on a target is detected with probability d, as association expects it, and its covariance is
then P', that of the filter's update by a detection where the target is expected. The gain of a camera is

    sum_i r_i d_i (e(P_i) - e(P'_i)) + e_0 sum_g lambda_g d_g,    e(P) = sqrt(t / (1 + t / e_0^2)),

t the trace of the position's covariance, UD of a Gaussian belief, r_i the probability that target i exists,
and lambda the expected number of undetected targets in the cells of the ground:
lambda <- survival lambda + births, of which a camera that is on leaves 1 - d_g. An unconfirmed track counts
as e_0 until it is detected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayesnet_track.adapt.existence import DetectionModel, UnconfirmedTracks
from bayesnet_track.adapt.lifecycle import CameraBudget, CameraMemory, TrackHistory
from bayesnet_track.adapt.rules import divide_by_cost
from bayesnet_track.engine.cameras import errors_at, plate_errors
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.association import Several
from bayesnet_track.engine.lifecycle.existing import Crowd, expect_crowd, expect_detections
from bayesnet_track.engine.lifecycle.sensing import Mixed
from bayesnet_track.engine.lifecycle.unconfirmed import CrowdRule
from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.targets import Targets
from bayesnet_track.inference.views import Views
from bayesnet_track.journal.events.cameras import CamerasSwitched
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache

CELLS = 16
"""Cells of the ground along the longer side of the area."""

USUAL_SIZE = 0.5, 1.7
"""Width and height of a target, m, where the graph says none."""

ROUNDING = 1e-9
"""Difference of costs that is rounding."""


@dataclass(frozen=True, eq=False)
class CameraEffect:
    """Expected effect of a camera that is on, on N targets and unconfirmed tracks of a plate.

    Attributes:
        detection: (N,) probability that it detects each.
        covariance: (N, D, D) of each that it detects.
        undetected: (G,) probability that it detects a target in each cell.
    """

    detection: Floats
    covariance: Floats
    undetected: Floats


@dataclass(frozen=True, eq=False)
class PlateForecast:
    """Expectation of a plate in a step, before or after some cameras.

    Attributes:
        rules: camera -> the rule of its detections.
        models: camera -> what was learnt of its detections.
        crowd: T targets as they are expected.
        covariance: (N, D, D) of these and of unconfirmed tracks.
        existence: (N,) probability that each exists.
        error: (N,) expected e of each, m.
        in_image: camera -> (G,) whether it shows each cell.
        undetected: (G,) expected number of undetected targets in each cell.
        limit: e_0, m.
    """

    rules: Mapping[str, CrowdRule]
    models: Mapping[str, DetectionModel]
    crowd: Crowd
    covariance: Floats
    existence: Floats
    error: Floats
    in_image: Mapping[str, Floats]
    undetected: Floats
    limit: float

    @property
    def uds_m2(self) -> Floats:
        """(T,) expected UD of the targets."""
        return _traces(self.covariance[: len(self.crowd.mean)])

    def effect(self, camera: str) -> CameraEffect | None:
        """The effect of a camera; None where it does not see the plate."""
        rule = self.rules.get(camera)
        if rule is None:
            return None
        all_of, weights, _ = expect_detections(rule, self.crowd, self.models[camera])
        covariance, expected = self.covariance.copy(), rule.sensor.detect(all_of.mean)
        is_seen = np.zeros(len(covariance))
        is_seen[expected.numbers] = 1.0
        starts = np.concatenate([[0], np.cumsum(is_seen, dtype=np.int64)])
        shares = Mixed(starts, np.arange(len(expected.values)), expected.scores, 1.0 - is_seen)
        rule.sensor.mix(all_of.mean.copy(), covariance, expected, shares)
        coverage = self.in_image[camera] * _usual_detection(self.models[camera], rule)
        return CameraEffect(weights.mean_detection * is_seen, covariance, coverage)

    def gain(self, effect: CameraEffect) -> float:
        """Expected gain of a camera, m."""
        gains = self.existence * effect.detection * (self.error - self._error_after(effect))
        return float(gains.sum() + self.limit * (self.undetected @ effect.undetected))

    def with_effect(self, effect: CameraEffect) -> PlateForecast:
        """The expectation with that camera on, too."""
        detection = effect.detection
        shares = detection[:, None, None]
        return evolve(
            self,
            covariance=(1.0 - shares) * self.covariance + shares * effect.covariance,
            error=(1.0 - detection) * self.error + detection * self._error_after(effect),
            undetected=self.undetected * (1.0 - effect.undetected),
        )

    def _error_after(self, effect: CameraEffect) -> Floats:
        return limited_error(_traces(effect.covariance), self.limit)


Forecasts = Mapping[str, PlateForecast]


def limited_error(ud_m2: Floats, limit: float) -> Floats:
    """Root of UD, m, that approaches `limit` from below.

    >>> limited_error(np.array([0.01, 1.0, 99.0]), 1.0).round(3)
    array([0.1  , 0.707, 0.995])
    """
    return np.asarray(np.sqrt(ud_m2 / (1.0 + ud_m2 / limit**2)))


def _traces(covariance: Floats) -> Floats:
    return np.asarray(covariance[:, 0, 0] + covariance[:, 1, 1])


def _usual_detection(model: DetectionModel, rule: CrowdRule) -> float:
    chain = model.chain(rule.existence)
    return float(chain.detection * (1.0 - chain.blind_share))


@dataclass(frozen=True, eq=False)
class CameraChoice:
    """The camera of the largest gain per cost, and the next one.

    Attributes:
        camera: its name; "" where there is none.
        gain: expected, m.
        forecasts: plate -> the expectation with it on.
        runner_up: the next camera; "" where there is none.
        runner_up_gain: of that one in its place, m.
        runner_up_forecasts: the expectation with that one on in its place.
    """

    camera: str
    gain: float
    forecasts: Forecasts
    runner_up: str
    runner_up_gain: float
    runner_up_forecasts: Forecasts


def choose_camera(forecasts: Forecasts, costs: Mapping[str, float]) -> CameraChoice:
    """The best of some cameras, which have these costs, and the next; of equal ones the first."""
    gains, outcomes = {}, {}
    for camera in costs:
        effects = {plate: forecast.effect(camera) for plate, forecast in forecasts.items()}
        pairs = {plate: (forecasts[plate], effect) for plate, effect in effects.items() if effect is not None}
        gains[camera] = sum(forecast.gain(effect) for forecast, effect in pairs.values())
        outcomes[camera] = {
            **forecasts,
            **{plate: pair[0].with_effect(pair[1]) for plate, pair in pairs.items()},
        }
    rates = divide_by_cost(gains, costs)
    first, second, *_ = (*sorted(costs, key=lambda camera: -rates[camera]), "", "")
    return CameraChoice(
        first,
        gains.get(first, 0.0),
        outcomes.get(first, forecasts),
        second,
        gains.get(second, 0.0),
        outcomes.get(second, forecasts),
    )


def choose_cameras(
    work: FrameContext, targets: Targets, history: TrackHistory, budget: CameraBudget
) -> tuple[CameraMemory, tuple[str, ...], tuple[CamerasSwitched, ...]]:
    """Memory after the step, the cameras with a frame that are on, the best first, and the event.

    Cameras are added while the credit lasts. If one without a frame in this step is better than those with
    one, the credit is saved for it, up to twice the largest cost.
    """
    memory, present = history.cameras, work.frame.cameras or {}
    forecasts: Forecasts = forecast_plates(work, targets, history, budget.undetected)
    credit, largest_credit = memory.credit + budget.per_step, 2.0 * max(budget.costs.values())
    is_full = credit >= largest_credit
    credit = min(credit, max(largest_credit, budget.per_step))
    waiting = {camera: cost for camera, cost in budget.costs.items() if camera in present or not is_full}
    cameras: list[str] = []
    events: tuple[CamerasSwitched, ...] = ()
    prior = forecasts
    choice = choose_camera(forecasts, waiting)
    while choice.camera in present and choice.gain > 0.0 and waiting[choice.camera] <= credit + ROUNDING:
        cameras.append(choice.camera)
        events = (_event(work, tuple(cameras), prior, choice, budget),)
        forecasts, credit = choice.forecasts, credit - waiting.pop(choice.camera)
        choice = choose_camera(forecasts, waiting)
    ground = {plate: forecast.undetected for plate, forecast in forecasts.items()}
    previous = memory.cameras or tuple(budget.costs)  # all cameras are on in the first step
    switched_off = tuple(camera for camera in previous if camera not in cameras)
    events = tuple(evolve(event, switched_off=switched_off) for event in events if {*cameras} != {*previous})
    remembered = CameraMemory(tuple(cameras) or memory.cameras, max(credit, 0.0), ground)
    return remembered, tuple(cameras), events


def choose_ahead(engine: Engine, state: State, frame: Frame) -> tuple[str, ...]:
    """The cameras of a frame that is to come, of which times and sizes are known, that will be on."""
    assert engine.budget is not None
    frames = FramePair(engine.with_inputs(engine.on_clock(frame)), state.previous)
    work = FrameContext(engine, state.net, PlaneCache(frames), state.history.births)
    return choose_cameras(work, Targets.of(state.targets), state.history, engine.budget)[1]


def _event(
    work: FrameContext,
    cameras: tuple[str, ...],
    prior: Forecasts,
    choice: CameraChoice,
    budget: CameraBudget,
) -> CamerasSwitched:
    uds = [_mean_ud(each) for each in (choice.forecasts, prior, choice.runner_up_forecasts)]
    rate = choice.gain / budget.costs[choice.camera]
    return CamerasSwitched(
        work.frame.index,
        cameras,
        (),
        sum(len(forecast.crowd.mean) for forecast in prior.values()),
        _rounded(uds[0]),
        _rounded(uds[1]),
        _rounded(sum(float(forecast.undetected.sum()) for forecast in prior.values())),
        _rounded(choice.gain),
        choice.runner_up,
        _rounded(uds[2]),
        _rounded(choice.runner_up_gain / rate),
    )


def _mean_ud(forecasts: Forecasts) -> float:
    uds = np.concatenate([forecast.uds_m2 for forecast in forecasts.values()])
    return float(uds.mean()) if len(uds) else 0.0


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def forecast_plates(
    work: FrameContext, targets: Targets, history: TrackHistory, limit: float
) -> dict[str, PlateForecast]:
    """Plate -> what is expected of it before a camera is on."""
    states, net = targets.apart(), work.net
    tables = {rows.rule.plate: rows for rows in targets.gaussians}
    forecasts = {}
    for plate, compiled in work.engine.plates.items():
        if CrowdRule.of(compiled) is not None and compiled.views is not None:
            members = {name: state for name, state in states.items() if net.targets[name].template == plate}
            forecasts[plate] = _forecast(Several(work, compiled, tables.get(plate), members), history, limit)
    return forecasts


def _forecast(members: Several, history: TrackHistory, limit: float) -> PlateForecast:
    work, compiled, plate = members.work, members.compiled, members.compiled.plate.name
    agents = {agent: rule for agent in compiled.sensors if (rule := CrowdRule.of(compiled, agent))}
    first = next(iter(agents))
    crowd = members.expect()
    model = history.detection_models.get(plate) or DetectionModel(UnconfirmedTracks.none(crowd.mean.shape[1]))
    crowd, model = expect_crowd(agents[first], work.cache.frames, crowd, model, None)
    errors = plate_errors(compiled, errors_at(work, history))
    rules, models, in_image = {}, {}, {}
    for agent, rule in agents.items():
        rules[rule.camera] = evolve(rule, sensor=rule.sensor.at(work.cache.frames, errors))
        in_image[rule.camera] = cells_in_image(compiled, agent)
        models[rule.camera] = model.by(None if agent == first else agent)
    unconfirmed, settings = model.unconfirmed, agents[first].existence
    covariance = np.concatenate([crowd.covariance, unconfirmed.covariance])
    error = limited_error(_traces(covariance), limit)
    error[len(crowd.mean) :] = limit
    previous, life = work.cache.frames.previous, compiled.lifecycle
    dt = 1.0 if previous is None else work.frame.time - previous.time
    assert compiled.views is not None and life is not None and life.birth is not None
    count = len(cells_of(compiled.views))
    undetected = history.cameras.undetected.get(plate)
    if undetected is None:
        number = settings.births / max(1.0 - settings.survival, 1e-9)
        undetected = np.full(count, min(number, life.birth.max_targets) / max(count, 1))
        for camera, shows in in_image.items():  # all cameras are on in the first step
            undetected = undetected * (1.0 - _usual_detection(models[camera], rules[camera]) * shows)
    undetected = settings.survival**dt * undetected + settings.births * dt / max(count, 1)
    existence = np.concatenate([crowd.existence, unconfirmed.existence])
    return PlateForecast(rules, models, crowd, covariance, existence, error, in_image, undetected, limit)


@lru_cache(maxsize=64)
def cells_of(views: Views) -> Floats:
    """(G, 2) centres of the cells of the area in which targets start, m; none where that is anywhere."""
    if views.area is None:
        return np.empty((0, 2))
    low, high = views.area.min(axis=0), views.area.max(axis=0)
    side = float((high - low).max()) / CELLS
    columns, rows = (np.arange(start + side / 2, end, side) for start, end in zip(low, high, strict=True))
    centres = np.stack(np.meshgrid(columns, rows, indexing="ij"), axis=-1).reshape(-1, 2)
    return centres[views.shares_in_area(centres, np.tile(1e-12 * np.eye(2), (len(centres), 1, 1))) > 0.5]


@lru_cache(maxsize=64)
def cells_in_image(compiled: CompiledPlate, agent: str) -> Floats:
    """(G,) 1.0 where the camera of an agent shows a target in the cell, else 0.0."""
    views, width = compiled.views, len(compiled.moments.fields)
    assert views is not None
    centres = cells_of(views)
    states = np.zeros((len(centres), width))
    states[:, :2] = centres
    for column, (size, number) in enumerate(zip(views.start[2:4], USUAL_SIZE, strict=True), 2):
        states[:, column] = number if size is None else size[0]
    return compiled.sensors[agent].in_image(states, np.tile(1e-12 * np.eye(width), (len(centres), 1, 1)))
