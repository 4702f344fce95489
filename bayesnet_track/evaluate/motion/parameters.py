"""What of a motion can be fitted to boxes: its parameters, and the motions that have a closed form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.motion.noise import is_log, noisy
from bayesnet_track.graph import spec
from bayesnet_track.observation.settings import to_caller

DRIVING = ("sd_velocity_px", "sd_acceleration_px")
PARTS = {"sd_px": ("x", "y", "w", "h"), "sd_box": ("x", "y"), "sd_log": ("scale", "aspect")}

Path = tuple[str, ...]


class MotionFitError(ValueError):
    """A motion that cannot be fitted to boxes, or boxes that are too few."""


def check_motion(root: spec.InferenceNode) -> None:
    """Check that a motion's evidence has a closed form.

    Raises:
        MotionFitError: says which key stands in the way, and what is allowed.
    """
    motions = [("motion", root.motion)]
    motions += [(f"modes.{name}.motion", mode.motion) for name, mode in (root.modes or {}).items()]
    allowed = "random_walk, constant_velocity, damped_velocity, constant_acceleration"
    for where, chosen in motions:
        if chosen is None:
            continue
        settings = chosen.settings
        if not isinstance(settings, spec.RandomWalk | spec.ConstantVelocity | spec.ConstantAcceleration):
            raise MotionFitError(f"{where}: {chosen.kind} cannot be fitted; allowed: {allowed}")
        without = to_caller("fit without it, with --set", "fit a graph without it")
        for key, why in (
            ("camera", "boxes do not tell how the camera moves"),
            ("size_reversion", "its long-run sd cannot be told from few frames"),
            ("borders", "reflection has no closed form"),
        ):
            if getattr(settings, key) is not None:
                raise MotionFitError(f"{where}.{chosen.kind}.{key}: {why}; {without}")
    for name, mode in (root.modes or {}).items():
        if mode.hidden is not None:
            raise MotionFitError(
                f"modes.{name}.hidden: boxes do not tell when a target is hidden; fit a graph without it"
            )
    kinds = {_shape(chosen) for _, chosen in motions if chosen is not None}
    if len(kinds) > 1:
        raise MotionFitError(
            "modes: they differ in the fields of their state or in what has noise; make them alike"
        )
    if not dict(parameters_of(root)):
        raise MotionFitError("motion: every sd is 0; only those above 0 are fitted: give one a value")


def parameters_of(root: spec.InferenceNode) -> Iterator[tuple[Path, float]]:
    """Path and value of each parameter that is fitted: sds above 0, heavy tails, durations of modes."""
    assert root.motion is not None
    uses = root.modes is None or any(mode.motion is None for mode in root.modes.values())
    chosen: list[tuple[Path, Any]] = [(("motion", root.motion.kind), root.motion.settings)] if uses else []
    for name, mode in (root.modes or {}).items():
        if mode.motion is not None:
            chosen.append((("modes", name, "motion", mode.motion.kind), mode.motion.settings))
        if mode.mean_frames is not None:
            yield ("modes", name, "mean_frames"), mode.mean_frames
    for where, settings in chosen:
        for key in DRIVING:
            if getattr(settings, key, 0.0) > 0:
                yield (*where, key), getattr(settings, key)
        for key, parts in PARTS.items():
            for part in parts:
                if getattr(getattr(settings, key), part) > 0:
                    yield (*where, key, part), getattr(getattr(settings, key), part)
        if settings.heavy_tail is not None:
            yield (*where, "heavy_tail", "weight"), settings.heavy_tail.weight
            yield (*where, "heavy_tail", "factor"), settings.heavy_tail.factor


def with_value(model: Any, path: Path, value: float) -> Any:
    """A copy of settings with the value at `path`."""
    name = path[0]
    inner = model[name] if isinstance(model, Mapping) else getattr(model, name)
    new = value if len(path) == 1 else with_value(inner, path[1:], value)
    if isinstance(model, Mapping):
        return {**model, name: new}
    kept = {key: getattr(model, key) for key in type(model).model_fields}
    return type(model).model_construct(**kept | {name: new})


def _shape(chosen: spec.Motion) -> tuple[int, tuple[bool, ...], bool]:
    motion = make_motion(chosen)
    return motion.order, tuple(noisy(motion.noise)), is_log(motion.noise)
