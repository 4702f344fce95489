"""Where a target will be: its belief some frames ahead, with no evidence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bayesnet_track.belief.contract import MotionModel, Posterior
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.composed import compose_motion
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.queries import forecast_numbers
from bayesnet_track.engine.scoring.score import blur_regions
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.journal.metrics import FrameMetrics, HasBox
from bayesnet_track.numerics.streams import moment_of
from bayesnet_track.observation.timed_columns import values_at


@dataclass(frozen=True)
class Forecast(HasBox):
    """Expected state of a target some frames ahead.

    Attributes:
        target: target id.
        ahead: frames after the last one.
        centre_box: mean centre x, y, width, height, px.
        sd: of x, y, w, h, px.
        region50: bounds of the central 50 % of the centre: x_low, x_high, y_low, y_high, px.
        region90: the same of the central 90 %.
        queries: what the belief answers to the queries of the graph, by name: conditions and numbers of one
            target that do not read `frame_s`.
    """

    target: str
    ahead: int
    centre_box: tuple[float, ...]
    sd: tuple[float, ...]
    region50: tuple[float, ...]
    region90: tuple[float, ...]
    queries: Mapping[str, float] = field(default_factory=dict)


def check_forecasts(graph: GraphSpec) -> None:
    """Refuse forecasts of targets on the ground; raises ValueError."""
    name = next((name for name, target in graph.targets.items() if target.is_ground), None)
    if name is not None:
        raise ValueError(
            f"forecasts are of boxes in the image, and the state of {name} is on the ground, in m"
        )


def forecast(
    engine: Engine,
    state: TargetState,
    birth: str,
    measured: FrameMetrics,
    frames: int,
    size: tuple[int, int],
) -> list[Forecast]:
    """The belief of one target 1 to `frames` frames ahead.

    Args:
        engine: of the run.
        state: what is known of the target after the last frame.
        birth: what its draws are keyed by.
        measured: what was measured of it there.
        frames: how far to look.
        size: width and height of the image.

    The motion is the graph's, its noise as wide as in the last frame; that the camera goes on moving or that
    the target jumps is not expected. Inputs by frame are those of the frames to come; others
    stay as they are.
    """
    compiled = engine.plates[state.plan.target]
    free = _motion_of(compiled, state)
    belief, forecasts = state.belief, []
    for horizon in range(1, frames + 1):
        coming = measured.frame + horizon
        numbers = values_at(engine.inputs, (coming, coming - 1), (measured.time_s, measured.time_s))
        inputs = {"t": state.time + horizon, **numbers}
        motion = confined(free, *size, inputs)
        stream = engine.streams.of(birth, compiled.plate.root, moment_of(state.time + horizon), "forecast")
        belief = compiled.belief.predict(belief, motion, 1.0, stream)
        expected = _described(compiled, belief, measured, horizon)
        if engine.queries:
            answers = forecast_numbers(engine, compiled.plate.name, (measured.target, belief), size, inputs)
            expected = replace(expected, queries=answers)
        forecasts.append(expected)
    return forecasts


def _motion_of(compiled: CompiledPlate, state: TargetState) -> MotionModel:
    context = state.motion_context
    if compiled.moving is None or context is None or context.influences is None:
        return compiled.motion
    return compose_motion(compiled.motion, compiled.moving, replace(context.influences, dt=1.0, camera=None))


def _described(compiled: CompiledPlate, belief: Posterior, measured: FrameMetrics, horizon: int) -> Forecast:
    mean, variances = belief.mean[:4], np.clip(np.diagonal(belief.covariance)[:4], 0.0, None).copy()
    region50, region90 = belief.regions((0.5, 0.9))
    error = compiled.plate.inference(compiled.plate.root).localization_error
    if error is not None:
        wide = blur_regions(belief, error, measured.score, float(np.sqrt(max(mean[2] * mean[3], 1.0))))
        region50, region90 = wide.region50, wide.region90
        variances[:2] += wide.variance
    return Forecast(
        measured.target,
        horizon,
        tuple(mean.tolist()),
        tuple(np.sqrt(variances).tolist()),
        tuple(float(value) for value in region50),
        tuple(float(value) for value in region90),
    )
