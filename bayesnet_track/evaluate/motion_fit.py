"""Noise and modes of a motion that maximise the evidence of measured boxes, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.motion.modes import make_modes
from bayesnet_track.belief.motion.noise import is_log, noisy
from bayesnet_track.evaluate.motion_evidence import Hypothesis, log_evidence, noisy_columns
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
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
    fittable = "random_walk, constant_velocity, damped_velocity, constant_acceleration"
    for place, motion in motions:
        if motion is None:
            continue
        settings = motion.settings
        if not isinstance(settings, spec.RandomWalk | spec.ConstantVelocity | spec.ConstantAcceleration):
            raise MotionFitError(f"{place}: {motion.kind} cannot be fitted; allowed: {fittable}")
        without = to_caller("fit without it, with --set", "fit a graph without it")
        for key, why in (
            ("camera", "boxes do not tell how the camera moves"),
            ("size_reversion", "its long-run sd cannot be told from few frames"),
            ("borders", "reflection has no closed form"),
        ):
            if getattr(settings, key) is not None:
                raise MotionFitError(f"{place}.{motion.kind}.{key}: {why}; {without}")
    for name, mode in (root.modes or {}).items():
        if mode.hidden is not None:
            raise MotionFitError(
                f"modes.{name}.hidden: boxes do not tell when a target is hidden; fit a graph without it"
            )
    kinds = {_shape(motion) for _, motion in motions if motion is not None}
    if len(kinds) > 1:
        raise MotionFitError(
            "modes: they differ in the fields of their state or in what has noise; make them alike"
        )
    if not dict(fitted_parameters(root)):
        raise MotionFitError("motion: every sd is 0; only those above 0 are fitted: give one a value")


def fitted_parameters(root: spec.InferenceNode) -> Iterator[tuple[Path, float]]:
    """Path and value of each parameter that is fitted: sds above 0, heavy tails, durations of modes."""
    assert root.motion is not None
    uses = root.modes is None or any(mode.motion is None for mode in root.modes.values())
    motions: list[tuple[Path, Any]] = [(("motion", root.motion.kind), root.motion.settings)] if uses else []
    for name, mode in (root.modes or {}).items():
        if mode.motion is not None:
            motions.append((("modes", name, "motion", mode.motion.kind), mode.motion.settings))
        if mode.mean_frames is not None:
            yield ("modes", name, "mean_frames"), mode.mean_frames
    for prefix, settings in motions:
        for key in DRIVING:
            if getattr(settings, key, 0.0) > 0:
                yield (*prefix, key), getattr(settings, key)
        for key, parts in PARTS.items():
            for part in parts:
                if getattr(getattr(settings, key), part) > 0:
                    yield (*prefix, key, part), getattr(getattr(settings, key), part)
        if settings.heavy_tail is not None:
            yield (*prefix, "heavy_tail", "weight"), settings.heavy_tail.weight
            yield (*prefix, "heavy_tail", "factor"), settings.heavy_tail.factor


def with_value(model: Any, path: Path, value: float) -> Any:
    """A copy of settings with the value at `path`."""
    name = path[0]
    inner = model[name] if isinstance(model, Mapping) else getattr(model, name)
    replaced = value if len(path) == 1 else with_value(inner, path[1:], value)
    if isinstance(model, Mapping):
        return {**model, name: replaced}
    fields = {key: getattr(model, key) for key in type(model).model_fields}
    return type(model).model_construct(**fields | {name: replaced})


def _shape(choice: spec.Motion) -> tuple[int, tuple[bool, ...], bool]:
    motion = make_motion(choice)
    return motion.order, tuple(noisy(motion.noise)), is_log(motion.noise)


REACH = 1000.0
"""Estimates are sought within this factor of where the search begins."""
LEAST_WEIGHT, MOST_WEIGHT = 0.001, 0.95
LEAST_FACTOR = 1.05
MOST_TRIED, MOST_STARTS = 5000, 300
FACTORS = {"sd": (1.0, 0.3, 3.0, 0.1, 10.0), "error": (1.0, 0.3, 3.0), "mean_frames": (1.0, 0.3, 3.0)}
"""Factors on the graph's own values at the starts. Every sd of a mode has the same one."""
VALUES = {"weight": (0.05, 0.3), "factor": (3.0, 10.0)}
"""Values at the starts, beside the graph's own."""


def search_places(paths: Sequence[Path], values: Floats) -> Floats:
    """Values (..., P) on the scales of the search: log odds of a share, logarithms of the rest."""
    with np.errstate(invalid="ignore", divide="ignore"):  # others than shares may be 1 or more
        return np.asarray(np.log(values) - np.where(_are_shares(paths), np.log1p(-values), 0.0))


def search_values(paths: Sequence[Path], places: Floats) -> Floats:
    """The values (..., P) at places."""
    with np.errstate(over="ignore"):
        return np.asarray(np.where(_are_shares(paths), 1.0 / (1.0 + np.exp(-places)), np.exp(places)))


def bounds_of(paths: Sequence[Path], first: Floats) -> tuple[Floats, Floats]:
    """Least and largest places: durations of at least a frame, tails that are wider and not all there is."""
    low, high = first - np.log(REACH), first + np.log(REACH)
    for k, path in enumerate(paths):
        if path[-1] == "mean_frames":
            low[k] = 0.0
        elif path[-1] == "factor":
            low[k] = np.log(LEAST_FACTOR)
        elif path[-1] == "weight":
            low[k], high[k] = search_places([path] * 2, np.array([LEAST_WEIGHT, MOST_WEIGHT]))
    return low, high


def starts_of(begin: Mapping[Path, float]) -> Floats:
    """(S, P) values from which the search may begin, the given ones first; at most `MOST_STARTS`.

    At each of them the sds of modes are in the order of the given ones: the graph alone says which mode is
    the calm one.
    """
    tried = [_tried(group, begin) for group in sorted({_group(path) for path in begin})]
    counts = [len(each) for each in tried]
    rng = np.random.default_rng(0)
    if prod(counts) <= MOST_TRIED:
        picks = list(product(*map(range, counts)))
    else:
        picks = [(0,) * len(counts), *rng.integers(0, counts, (MOST_TRIED, len(counts))).tolist()]
    rows = []
    for numbers in picks:
        row = dict(begin)
        for each, number in zip(tried, numbers, strict=True):
            row |= each[number]
        if _order(row) == _order(begin):
            rows.append(list(row.values()))
    permuted = np.sort(1 + rng.permutation(len(rows) - 1)[: MOST_STARTS - 1])
    return np.array(rows)[[0, *permuted]]


def _group(path: Path) -> tuple[str, str]:
    """Kind of a parameter and, of an sd, its mode: what is in a group changes together at the starts."""
    if path[-1] in VALUES or path[-1] == "mean_frames":
        return path[-1], ""
    if path[0] == "error":
        return "error", ""
    return "sd", path[1] if path[0] == "modes" else ""


def _tried(group: tuple[str, str], begin: Mapping[Path, float]) -> list[dict[Path, float]]:
    """Values of a group's parameters at the starts, as they are given first."""
    kind = group[0]
    values = {path: value for path, value in begin.items() if _group(path) == group}
    if kind in VALUES:
        return [values, *(dict.fromkeys(values, value) for value in VALUES[kind])]
    lower_limit = 1.0 if kind == "mean_frames" else 0.0
    return [
        {path: max(factor * value, lower_limit) for path, value in values.items()} for factor in FACTORS[kind]
    ]


def _order(values: Mapping[Path, float]) -> dict[Path, list[str]]:
    """Key of an sd -> the modes that have it, from the smallest value on."""
    choices: dict[Path, list[tuple[float, str]]] = {}
    for path, value in values.items():
        kind, mode = _group(path)
        if kind == "sd":
            key = path[4:] if path[0] == "modes" else path[2:]  # without the names of mode and motion
            choices.setdefault(key, []).append((value, mode))
    return {key: [mode for _, mode in sorted(each)] for key, each in choices.items()}


def _are_shares(paths: Sequence[Path]) -> NDArray[np.bool_]:
    return np.array([path[-1] == "weight" for path in paths])


FEWEST_FRAMES = 20
QUANTILE = 1.6448536269514722
"""A Gaussian lies within so many sds with a probability of 90 %."""
SEARCHES = 2
"""How many of the most likely starts are followed to the end."""
LARGEST_SD = 1.0
"""An estimate is not known if its logarithm, or log odds, has a larger sd: 90 % span a factor of 27."""
GRADIENT_STEP, CURVATURE_STEP = 1e-4, 1e-2
ERRORS = (("error", "place"), ("error", "size"))
"""Where the sds of the boxes' own errors stand among the parameters; they are in no graph."""


@dataclass(frozen=True)
class FittedParameter:
    """A fitted parameter.

    Attributes:
        path: keys below the root node; one of `ERRORS` for an error of the boxes.
        value: by maximum evidence.
        low: lower end of the 90 % interval.
        high: upper end.
        graph_value: the graph's own value; NaN for an error of the boxes.
        is_known: whether the boxes determine it: its interval, of a share that of its odds, spans less than a
            factor of 27.
    """

    path: Path
    value: float
    low: float
    high: float
    graph_value: float
    is_known: bool


@dataclass(frozen=True)
class FittedMotion:
    """Fitted noise and modes of a motion.

    Attributes:
        estimates: of each parameter.
        log_evidence: at the estimates.
        log_evidence_before: with the graph's own values, the boxes' errors fitted to them.
        frames: frames with a box, the first of each track left out.
    """

    estimates: tuple[FittedParameter, ...]
    log_evidence: float
    log_evidence_before: float
    frames: int


def fit_motion(
    root: spec.InferenceNode, tracks: Sequence[Floats], error_sd: float | None = None
) -> FittedMotion:
    """The noise of the root's motion, and how long its modes last, that explain `tracks` best.

    Intervals are of the observed information: the evidence's curvature in the logarithms of the parameters,
    and in the log odds of a share.

    Args:
        root: the node with the motion.
        tracks: (T, 4) centre boxes of each target, NaN where it was not seen.
        error_sd: sd of the boxes' errors, px; fitted as well when None.

    Raises:
        MotionFitError: the motion has no closed form, or the boxes are too few.
    """
    from scipy.optimize import minimize

    check_motion(root)
    trimmed = [track for track in map(_trimmed, tracks) if len(track) > 1]
    frames = sum(int(np.isfinite(track[:, 0]).sum()) - 1 for track in trimmed)
    if frames < FEWEST_FRAMES:
        raise MotionFitError(
            f"{frames} frames with a box after the first; at least {FEWEST_FRAMES} are needed"
        )
    parameters = dict(fitted_parameters(root))
    begin = parameters if error_sd is not None else parameters | _first_errors(root, trimmed)
    paths = list(begin)
    fixed = None if error_sd is None else _given_errors(root, trimmed, error_sd)

    def evidence(places: Floats) -> Floats:
        """(B,) at B places, each on the scales of the parameters."""
        rows = search_values(paths, places).tolist()
        hypotheses = [_hypothesis(root, dict(zip(paths, row, strict=True)), fixed) for row in rows]
        each = [log_evidence(track, hypotheses) for track in trimmed]
        return np.asarray(np.sum(each, axis=0))

    starts = search_places(paths, starts_of(begin))
    first = starts[0]
    low, high = bounds_of(paths, first)
    starts = np.clip(starts, low, high)
    likeliest = np.argsort(-np.nan_to_num(evidence(starts), nan=-np.inf), kind="stable")[:SEARCHES]
    ends = [
        minimize(
            lambda place: _with_gradient(evidence, place),
            starts[number],
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(low, high, strict=True)),
        )
        for number in likeliest
    ]
    optimum = min(ends, key=lambda end: float(end.fun)).x
    at_bound = (optimum - low < 1e-3) | (high - optimum < 1e-3)
    sds = _sds(_curvature(evidence, optimum), at_bound)
    errors = np.array([path in ERRORS for path in paths])
    evidence_before = evidence(np.where(errors, optimum, first)[None])[0]
    return FittedMotion(
        _estimates(paths, optimum, sds, parameters),
        float(evidence(optimum[None])[0]),
        float(evidence_before),
        frames,
    )


def _hypothesis(
    root: spec.InferenceNode, values: Mapping[Path, float], fixed: tuple[float, float] | None
) -> Hypothesis:
    for path, value in values.items():
        if path not in ERRORS:
            root = with_value(root, path, value)
    assert root.motion is not None
    default_motion = make_motion(root.motion)
    error = fixed or (values.get(ERRORS[0], 1.0), values.get(ERRORS[1], 1.0))
    if root.modes is None:
        return Hypothesis((default_motion,), None, error)
    mode_motions = (None if mode.motion is None else make_motion(mode.motion) for mode in root.modes.values())
    return Hypothesis(
        tuple(default_motion if motion is None else motion for motion in mode_motions),
        make_modes(root.modes),
        error,
    )


def _trimmed(track: Floats) -> Floats:
    """The track from its first box on."""
    measured = np.flatnonzero(np.isfinite(track).all(axis=1))
    return track[measured[0] :] if len(measured) else track[:0]


def _first_errors(root: spec.InferenceNode, tracks: Sequence[Floats]) -> dict[Path, float]:
    """Start of the search for the boxes' errors: what their second differences allow."""
    motion = make_motion(_any_motion(root))
    columns = noisy_columns(motion)
    first_errors: dict[Path, float] = {}
    for path, is_size in zip(ERRORS, (False, True), strict=True):
        group_columns = [k for k in columns if (k > 1) is is_size]
        if not group_columns:
            continue
        rows = [
            np.log(track[:, group_columns])
            if group_columns[0] > 1 and is_log(motion.noise)
            else track[:, group_columns]
            for track in tracks
        ]
        jerks = np.concatenate([np.diff(row, 2, axis=0).ravel() for row in rows])
        jerks = jerks[np.isfinite(jerks)]
        spread = float(np.median(np.abs(jerks))) / 3 if len(jerks) else 0.0
        first_errors[path] = max(spread, 0.05 if group_columns[0] < 2 or not is_log(motion.noise) else 0.002)
    return first_errors


def _given_errors(root: spec.InferenceNode, tracks: Sequence[Floats], error_sd: float) -> tuple[float, float]:
    if not is_log(make_motion(_any_motion(root)).noise):
        return error_sd, error_sd
    sides = np.concatenate([track[np.isfinite(track[:, 2]), 2:].ravel() for track in tracks])
    return error_sd, error_sd / float(np.median(sides))


def _any_motion(root: spec.InferenceNode) -> spec.Motion:
    assert root.motion is not None
    mode_motions = [mode.motion for mode in (root.modes or {}).values() if mode.motion is not None]
    return mode_motions[0] if root.modes is not None and len(mode_motions) == len(root.modes) else root.motion


def _with_gradient(evidence: Callable[[Floats], Floats], place: Floats) -> tuple[float, Floats]:
    """Minus the log-evidence and its gradient, by central differences in one pass."""
    shifts = GRADIENT_STEP * np.eye(len(place))
    values = evidence(np.concatenate([place[None], place + shifts, place - shifts]))
    forward, backward = values[1 : len(place) + 1], values[len(place) + 1 :]
    return -float(values[0]), -(forward - backward) / (2 * GRADIENT_STEP)


def _curvature(evidence: Callable[[Floats], Floats], place: Floats) -> Floats:
    """(P, P) second derivatives of the log-evidence, by central differences in one pass."""
    size, shifts = len(place), CURVATURE_STEP * np.eye(len(place))
    pairs = [(i, j) for i in range(size) for j in range(i + 1)]
    rows = [
        place + first * shifts[i] + second * shifts[j]
        for i, j in pairs
        for first in (1, -1)
        for second in (1, -1)
    ]
    values = evidence(np.array(rows)).reshape(-1, 4)
    curvature = np.zeros((size, size))
    for (i, j), (upper_both, upper_first, upper_second, neither) in zip(pairs, values, strict=True):
        curvature[i, j] = curvature[j, i] = (upper_both - upper_first - upper_second + neither) / (
            4 * CURVATURE_STEP**2
        )
    return curvature


def _sds(curvature: Floats, at_bound: NDArray[np.bool_]) -> Floats:
    """(P,) sds on the scales of the search; inf where the boxes do not determine the value."""
    sds, free = np.full(len(curvature), np.inf), np.flatnonzero(~at_bound)
    information = -curvature[np.ix_(free, free)]
    if len(free) and np.linalg.eigvalsh(information)[0] > 0:
        sds[free] = np.sqrt(np.diagonal(np.linalg.inv(information)))
    return sds


def _estimates(
    paths: Sequence[Path], optimum: Floats, sds: Floats, parameters: Mapping[Path, float]
) -> tuple[FittedParameter, ...]:
    reach = QUANTILE * sds
    values, low, high = (
        search_values(paths, place).tolist() for place in (optimum, optimum - reach, optimum + reach)
    )
    return tuple(
        FittedParameter(
            path, values[k], low[k], high[k], parameters.get(path, np.nan), bool(sds[k] <= LARGEST_SD)
        )
        for k, path in enumerate(paths)
    )
