"""Where targets start: their boxes, what is refused, and the first frame's nets."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.particles.adaptive_size import formulas_in, static_fields
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.engine.frame_context import FrameContext, route_inputs
from bayesnet_track.engine.outcome import Outcome, State, with_external_inputs
from bayesnet_track.engine.starting import CameraPoints, place_points
from bayesnet_track.engine.step import Engine, finish_first, start_all
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.motion import describe_still_axes
from bayesnet_track.graph.text.messages import nearest
from bayesnet_track.inference.views import views_of
from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import CornerBox, centre_from_corner
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, ways_of_depth
from bayesnet_track.observation.settings import setting
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.paths import SourceError

MOST_TIMES = 10
"""How many times as wide or high as the frame a start box may be: what is near is larger than the picture."""


@dataclass(frozen=True)
class Start:
    """A target to start with.

    Attributes:
        box: top-left corner box x, y, w, h in px, as OpenCV has it.
        plate: name of the plate in the graph; None where it has one.
        points: in place of `box`, of a target that several cameras see: camera -> where its image shows the
            target, a point x, y or a corner box x, y, w, h in px.
    """

    box: CornerBox = (0.0, 0.0, 0.0, 0.0)
    plate: str | None = None
    points: CameraPoints = field(default_factory=dict, hash=False)


MOSTLY_OUTSIDE = 0.5
"""Share of a start box outside of the frame from which it is said."""

DISAGREE_PX = 10.0
"""From so many px on it is said that the cameras of a start disagree."""

LARGEST = 1 << 20
"""Sides of images whose size no calibration says, px, as far as start boxes may reach."""

NOISE = 2
"""Gray levels by which the values of a black frame may differ."""


class StartError(ValueError):
    """A start box, a plate or a first frame from which no target can be tracked."""


def check_given(graph: CheckedGraph, starts: Sequence[Start], width: int, height: int) -> None:
    """Refuse starts as `check_starts` does, and those that fit two classes; say which lie mostly outside.

    Raises:
        StartError: as of `check_starts`, or a start names no class and the graph has several.
    """
    check_starts(graph, starts, width, height)
    for start in starts:
        if start.plate is None and len(graph.targets) > 1:
            box = ",".join(f"{float(value):g}" for value in start.box)
            if start.points:
                box = " ".join(f"{name}=.." for name in start.points)
            ways = " or ".join(f"{name}:{box}" for name in graph.targets)
            raise StartError(
                f"start box {box}: the graph {graph.spec.name} has the classes {', '.join(graph.targets)}, "
                f"and the box names none; write {ways} (in Python Start(box, {next(iter(graph.targets))!r}))"
            )
        if not start.points:
            _say_outside(start.box, width, height)


def check_starts(graph: CheckedGraph, starts: Sequence[Start], width: int, height: int) -> None:
    """Refuse starts from which no target could be tracked in a frame of this size.

    Raises:
        StartError: there is none and nothing is born either, a plate that the graph does not have, a box as
            in `check_box`, or a mask of the graph has another size.
    """
    if not starts and not has_births(graph):
        raise StartError("no start box is given; at least one is needed, or `birth` in the graph")
    for name, mask in graph.masks.items():
        rows, columns = mask.gray.shape
        if (columns, rows) != (width, height):
            raise StartError(
                f"mask {name}: {columns}x{rows} px, and the frames have {width}x{height} px; "
                "allowed: the frames' size; scale its file"
            )
    if not graph.several_cameras:
        check_sizes(graph, dict.fromkeys(graph.spec.cameras, (width, height)))
    for start in starts:
        if start.plate is not None and start.plate not in graph.targets:
            suggestion = nearest(start.plate, graph.targets)
            raise StartError(
                f"no plate {start.plate!r} in graph {graph.spec.name}; there are {', '.join(graph.targets)}"
                + (f"; nearest: {suggestion}" if suggestion else "")
            )
        if graph.several_cameras:
            _check_points(graph, start)
            continue
        if start.points:
            raise StartError(
                f"start as cameras see it ({', '.join(start.points)}): the graph {graph.spec.name} has not "
                "several cameras; allowed: a box x,y,w,h"
            )
        check_box(start.box, width, height)
        _check_stands(graph, start)


def check_sizes(graph: CheckedGraph, sizes: Mapping[str, tuple[int, int]]) -> None:
    """Refuse frames that are not of the size that their camera was calibrated in; camera -> width and height.

    Raises:
        StartError: names the calibration, and both sizes.
    """
    for camera, (width, height) in sizes.items():
        key = graph.spec.cameras[camera].key
        size = graph.calibrations[key].camera.size
        if size is not None and size != (width, height):
            raise StartError(
                f"calibration {key}: of {size[0]}x{size[1]} px, and the frames have {width}x{height} px; "
                "allowed: the size that the camera was calibrated in"
                + ("; one of the two was filmed upright, the other on its side" * (size == (height, width)))
            )


def _check_stands(graph: CheckedGraph, start: Start) -> None:
    """Refuse a box that stands nowhere on the ground, of a target whose state is there."""
    plate = start.plate or next(iter(graph.targets))
    views = views_of(graph.targets[plate])
    if views is not None and views.place(centre_from_corner(start.box)) is None:
        raise StartError(
            f"box {tuple(start.box)} of {plate} stands nowhere on the ground: its foot is at or above the "
            "horizon, or its size fits no place; allowed: a box whose lower edge is where the target stands"
        )


def _check_points(graph: CheckedGraph, start: Start) -> None:
    """Refuse a start that no camera of the graph shows, or whose target is nowhere; say if they disagree.

    Raises:
        StartError: of a box in one image, names of other cameras, numbers that are no point or box inside of
            an image, or a target that is nowhere.
    """
    plate = start.plate or next(iter(graph.targets))
    views = views_of(graph.targets[plate])
    cameras = [] if views is None else [view.seen_by for view in views.views.values()]
    example = f"'{cameras[0]}=X,Y {cameras[-1]}=X,Y'" if cameras else ""
    if not start.points:
        raise StartError(
            f"start box {tuple(start.box)} of {plate}, which several cameras see: a box is of one image; "
            f"allowed: where each camera sees it, {example}"
        )
    for camera, numbers in start.points.items():
        if camera not in cameras:
            raise StartError(
                f"start in camera {camera!r}, which {plate} has no view of; allowed: {', '.join(cameras)}"
            )
        width, height = graph.several_cameras[camera] or (math.inf, math.inf)
        point = tuple(float(number) for number in numbers)
        if len(point) != 2:
            check_box(point, int(min(width, LARGEST)), int(min(height, LARGEST)))
        elif not (-0.5 <= point[0] < width - 0.5 and -0.5 <= point[1] < height - 0.5):
            raise StartError(
                f"start in camera {camera}: the point {point[0]:g},{point[1]:g} lies outside of its "
                f"{width}x{height} image"
            )
    placed = None if views is None else place_points(views, start.points)
    if placed is None:
        raise StartError(
            f"start of {plate} in {', '.join(start.points)}: no place in front of them is seen there; "
            "allowed: points in two cameras or more, which show the same point of the target, or boxes"
        )
    if max(placed[1].values()) > DISAGREE_PX:
        each = ", ".join(f"{camera} by {error:.1f} px" for camera, error in placed[1].items())
        notice(
            f"start of {plate}: the place that agrees best with all cameras is off in {each}: a point that "
            "is another one, a calibration that is wrong, or images of different times"
        )


def check_box(box: object, width: int, height: int) -> Floats:
    """The corner box as an array (4,), when a tracker could start from it in a frame of this size.

    Raises:
        StartError: it is not four finite numbers, has no area, is more than `MOST_TIMES` as wide or high as
            the frame, or does not touch it.
    """
    try:
        numbers: NDArray[Any] = np.ma.asarray(box)
        corner = np.asarray(
            np.ma.filled(numbers, np.nan) if np.ma.is_masked(numbers) else box, dtype=np.float64
        )
        if numbers.dtype.kind not in "iuf" or _has_bool(box):
            corner = np.empty(0)
    except (TypeError, ValueError, OverflowError):
        corner = np.empty(0)
    if corner.shape != (4,) or not np.isfinite(corner).all():
        raise StartError(f"start box {box!r}: four finite numbers x,y,w,h are needed")
    x, y, w, h = (float(v) for v in corner)
    if w < 1 or h < 1:
        raise StartError(f"start box {x:g},{y:g},{w:g},{h:g}: width and height must be at least 1 px")
    if w > MOST_TIMES * width or h > MOST_TIMES * height:
        raise StartError(
            f"start box {x:g},{y:g},{w:g},{h:g}: at most {MOST_TIMES} times the "
            f"{width}x{height} frame is allowed, {MOST_TIMES * width}x{MOST_TIMES * height} px"
        )
    if x >= width or y >= height or x + w <= 0 or y + h <= 0:
        raise StartError(
            f"start box {x:g},{y:g},{w:g},{h:g} lies outside the {width}x{height} frame; "
            "x,y is the top-left corner"
        )
    return corner


def _has_bool(box: object) -> bool:
    """True if a value is True or False, which count as 1 and 0 among numbers."""
    return isinstance(box, Iterable) and any(isinstance(value, bool | np.bool_) for value in box)


def _say_outside(box: CornerBox, width: int, height: int) -> None:
    x, y, w, h = (float(value) for value in box)
    columns, rows = min(x + w, width) - max(x, 0.0), min(y + h, height) - max(y, 0.0)
    share = 1.0 - columns * rows / (w * h)
    fits_as_corners = 0 <= x < w <= width and 0 <= y < h <= height
    is_cut = x + w > width + 1 or y + h > height + 1
    if share <= MOSTLY_OUTSIDE and not (fits_as_corners and is_cut):
        return
    advice = ""
    if fits_as_corners:
        advice = f"; if its numbers are left, top, right, bottom, write {x:g},{y:g},{w - x:g},{h - y:g}"
    notice(
        f"start box {x:g},{y:g},{w:g},{h:g} (left, top, width, height): {100 * share:.2g} % of it lies "
        f"outside of the {width}x{height} frame{advice}"
    )


def say_blank(frame: Frame, starts: Sequence[Start]) -> None:
    """Say so where targets are to start in a frame of one value, which shows none of them."""
    if not starts:
        return
    lowest, highest = int(frame.image.min()), int(frame.image.max())
    if lowest == highest or (not frame.has_color and highest - lowest <= NOISE) or highest <= NOISE:
        notice(
            f"frame {frame.index}, in which the target starts, shows nothing: its values are "
            f"{lowest if lowest == highest else f'{lowest} to {highest}'} everywhere; start in another one "
            f"({setting('--start', 'N')})"
        )


def _say_constants_die_out(engine: Engine) -> None:
    """Say so where particles hold an unknown constant that resampling alone decides about."""
    for plate, compiled in engine.plates.items():
        names = static_fields(compiled.motion)
        if not names or not isinstance(compiled.belief, ParticleFilter):
            continue
        if all(formula.static_discount is None for formula in formulas_in(compiled.motion)):
            notice(
                f"{plate}: {', '.join(names)} neither drifts nor has noise, so that resampling leaves a few "
                "of its first values, surer than the evidence is; write static_discount: 0.98 beside its "
                "fields, or give it a small sd"
            )


def start_targets(
    graph: CheckedGraph,
    engine: Engine,
    frame: Frame,
    starts: Sequence[Start],
    external_inputs: Iterable[Input] = (),
) -> Outcome:
    """The first frame: one net per start, ids "1", "2", ... in their order; then what detectors find."""
    _say_constants_die_out(engine)
    for plate in graph.targets.values():
        for sentence in describe_still_axes(plate):
            notice(sentence)
    routed = route_inputs(engine, State().net, frame.index, external_inputs)
    cache = PlaneCache(FramePair(engine.with_inputs(engine.on_clock(frame)), None))
    work = FrameContext(engine, State().net, cache, {}, routed.availability, routed.by_hand)
    places = {
        str(number): (
            start.plate or next(iter(graph.targets)),
            start.points or np.asarray(centre_from_corner(start.box)),
        )
        for number, start in enumerate(starts, 1)
    }
    return with_external_inputs(finish_first(work, start_all(work, State(), places)), routed)


def check_started(graph: CheckedGraph, first: Outcome) -> None:
    """Refuse a run of which every frame would be without evidence: no agent of any target could start.

    An agent without a first reference learns one later from what the others track; where there are none, and
    no target is born later either, it never does.

    Raises:
        StartError: so it is after the outcome of the first frame; says why of every agent.
    """
    if has_births(graph):
        return
    quarantined: dict[str, dict[str, str]] = {}
    for event in first.events:
        if isinstance(event, Quarantined):
            quarantined.setdefault(event.target, {})[event.node] = event.reason
    for net in first.state.net.targets.values():
        if not net.quarantined.issuperset(graph.targets[net.template].agents):
            return
    reasons = (
        f"target {target}: {agent}: {reason}"
        for target, why in quarantined.items()
        for agent, reason in why.items()
    )
    raise StartError(f"no agent can start, so that nothing can be tracked; {'; '.join(reasons)}")


def has_births(graph: CheckedGraph) -> bool:
    """True when detectors give the graph its targets, so that no start box is needed."""
    return any(plate.spec.birth is not None for plate in graph.targets.values())


def check_depth(engine: Engine, source: object) -> None:
    """Refuse a source without depth for a graph with an agent that needs it.

    Raises:
        SourceError: names the agents, and how to give a pair.
    """
    if getattr(source, "has_depth", False):
        return
    agents = [
        agent
        for compiled in engine.plates.values()
        for agent, cue in compiled.cues.items()
        if any(getattr(plane, "needs_depth", False) for plane in cue.needs)
    ]
    if agents:
        raise SourceError(
            str(getattr(source, "description", "")),
            f"one eye, and {', '.join(agents)} of the graph {'needs' if len(agents) == 1 else 'need'} depth",
            ways_of_depth(),
            "give one of them, or another graph",
        )
