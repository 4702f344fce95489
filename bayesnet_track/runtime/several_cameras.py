"""Detections of several cameras, given by a program: each time is a step of the cameras with a frame."""

from __future__ import annotations

import copy
from collections.abc import Container, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.starts import check_sizes
from bayesnet_track.engine.step import Engine, State
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.messages import nearest
from bayesnet_track.observation.detector import GIVEN, Scan, of_camera
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.executors import Executing
from bayesnet_track.runtime.frame_clock import Fed
from bayesnet_track.runtime.given_scans import GivenDetections, read_given
from bayesnet_track.runtime.results import FrameSource
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.several import SeveralSources

Size = tuple[int, int]

USUAL_SIZE: Size = (1920, 1080)


@lru_cache(maxsize=16)
def blank_image(width: int, height: int) -> NDArray[np.uint8]:
    """The black BGR image (height, width, 3) of frames that nobody looks at: one for all, read-only."""
    image = np.zeros((height, width, 3), np.uint8)
    image.flags.writeable = False
    return image


def check_cameras(graph: CheckedGraph, named: Any, noun: str) -> None:
    """Check that what is given is a mapping with names of cameras of the graph.

    Raises:
        TypeError: it is no mapping.
        ValueError: a name is none of a camera of the graph, or there is none at all.
    """
    names = ", ".join(graph.several_cameras)
    example = f'{{"{next(iter(graph.several_cameras))}": {noun}, ...}}'
    if not isinstance(named, Mapping):
        raise TypeError(
            f"the graph {graph.spec.name} has the cameras {names}: {noun} are given for each that has a "
            f"frame, {example}, not as {type(named).__name__}"
        )
    for name in named:
        if name not in graph.several_cameras:
            suggestion = nearest(str(name), graph.several_cameras)
            raise ValueError(
                f"{noun} of {name!r}, which is no camera of the graph; there are {names}"
                + (f"; nearest: {suggestion}" if suggestion else "")
            )
    if not named:
        raise ValueError(f"{noun} of no camera; give those of each that has a frame, {example}")


def sizes_of(graph: CheckedGraph, size: Any) -> dict[str, Size]:
    """Width and height of each camera's images: as given for all or for each, else as calibrated.

    Raises:
        StartError: they are not those of the calibrations.
        TypeError, ValueError: as of `check_cameras`.
    """
    each: dict[str, Any] = dict.fromkeys(graph.several_cameras, size)
    if isinstance(size, Mapping):
        check_cameras(graph, size, "sizes")
        each = {name: size.get(name) for name in graph.several_cameras}
    sizes = {
        name: each[name] or calibrated or USUAL_SIZE for name, calibrated in graph.several_cameras.items()
    }
    check_sizes(graph, sizes)
    return sizes


@dataclass(frozen=True, eq=False)
class CamerasFed:
    """The detectors of several cameras, which find what a program gives.

    Attributes:
        graph: the graph.
        sizes: camera -> width and height of its images, px.
        fed: camera -> its detector.
    """

    graph: CheckedGraph
    sizes: Mapping[str, Size]
    fed: Mapping[str, Fed] = field(default_factory=dict)

    @classmethod
    def of(cls, graph: CheckedGraph, size: Any) -> CamerasFed | None:
        """The detectors of a graph; None of one without several cameras. Raises as `sizes_of`."""
        if not graph.several_cameras:
            return None
        return cls(graph, sizes_of(graph, size), {camera: Fed() for camera in graph.several_cameras})

    @property
    def detectors(self) -> dict[str, Fed]:
        """The detectors by the names that an engine has for them."""
        return {of_camera(GIVEN, camera): detector for camera, detector in self.fed.items()}

    def read(self, detections: Any) -> dict[str, GivenDetections]:
        """Camera that has a frame -> its usable detections; raises as `check_cameras` and `read_given`."""
        check_cameras(self.graph, detections, "detections")
        usable = {}
        for camera, boxes in detections.items():
            name = of_camera("detections", camera)
            try:
                usable[camera] = read_given(boxes, self.graph, name).inside(*self.sizes[camera])
            except (TypeError, ValueError) as error:
                raise type(error)(f"{camera}: {error}") from None
        return usable

    @property
    def first_size(self) -> Size:
        """Width and height of the first camera's images, px."""
        return next(iter(self.sizes.values()))

    def frame(self, step: Frame, usable: Mapping[str, GivenDetections]) -> Frame:
        """The step with a frame of each camera whose detections are given: what its detector finds in it."""
        for camera, boxes in usable.items():
            self.fed[camera].now = boxes.detections
        return self.step_of(step, usable)

    def step_of(self, step: Frame, cameras: Container[str]) -> Frame:
        """The step with a frame of each of some cameras, in which nothing was looked for."""
        images = {name: blank_image(*size) for name, size in self.sizes.items() if name in cameras}
        return replace(step, cameras={name: replace(step, image=image) for name, image in images.items()})


def mark(
    detections: Mapping[str, Any],
    usable: Mapping[str, GivenDetections],
    engine: Engine,
    state: State,
    owners: Any,
) -> dict[str, Any]:
    """Copies of the detections of each camera with `tracker_id`, as `owners` finds them by their shares."""
    marked = {}
    for camera, boxes in usable.items():
        ids: NDArray[np.int64] = np.full(boxes.count, -1, dtype=np.int64)
        scan = Scan(boxes.detections.boxes, boxes.detections.scores)
        agents = {
            agent
            for compiled in engine.plates.values()
            for agent, seen_by in compiled.cameras.items()
            if seen_by == camera
        }
        for agent in sorted(agents):
            owner_ids = owners(state, agent, scan, boxes.rows, boxes.count)
            ids = np.where(ids < 0, owner_ids, ids)
        marked[camera] = copy.copy(detections[camera])
        marked[camera].tracker_id = ids
    return marked


Named = Mapping[str, str | PathLike[str]]


def check_named(graph: CheckedGraph, source: object, detections: object) -> None:
    """Refuse sources or detections that are named by cameras for one image, or not named for several.

    Raises:
        TypeError, ValueError: as of `check_cameras`; or the graph has not several cameras.
    """
    for noun, named in (("sources", source), ("detections", detections)):
        if named is None or isinstance(named, SeveralSources):
            continue
        if graph.several_cameras:
            check_cameras(graph, named, noun)
        elif isinstance(named, Mapping):
            raise ValueError(
                f"{noun} of {', '.join(map(str, named))}: the graph {graph.spec.name} has not several "
                "cameras; allowed: one, without a name"
            )


def open_cameras(
    graph: CheckedGraph,
    sources: Any,
    detections: Any,
    executing: Executing | None = None,
    **how: Any,
) -> SeveralSources:
    """The sources of a graph's cameras, each by name, merged by time, and opened where `executing` says.

    `how` is as of `open_source`, `start` and `end` of it are steps.

    Of a camera without a source its detections stand for the frames.

    Raises:
        SourceError: one cannot be read, or two are the same.
        StartError: one has another size than its camera was calibrated in.
        TypeError, ValueError: as of `check_named`; or a camera has neither source nor detections.
    """
    from bayesnet_track.sources.paths import SourceError, shown_address
    from bayesnet_track.sources.sources import open_source

    check_named(graph, sources, detections)
    files = {**(detections or {}), **(sources or {})}
    texts: dict[str, str] = {}
    for camera in graph.several_cameras:
        if camera not in files:
            raise ValueError(
                f"neither a source nor detections of the camera {camera}; the graph {graph.spec.name} "
                f"has {', '.join(graph.several_cameras)}"
            )
        text = str(files[camera])
        first_camera = texts.setdefault(str(Path(text).absolute()), camera)
        if first_camera != camera:
            raise SourceError(
                text,
                f"the source of two cameras, {first_camera} and {camera}: its evidence would count twice",
                "a source of its own for each camera",
                "give each camera once",
            )
    start, end = how.pop("start", None), how.pop("end", None)
    openers: dict[str, Any] = {}
    for camera, size in graph.several_cameras.items():
        text = str(files[camera])
        if executing is None or executing.hosts == "engine":
            lazy = graph.spec.adapt is not None  # a frame that is not chosen is not decoded
            openers[camera] = partial(open_source, text, size=size, lazy=lazy, **how)
        else:
            settings = {name: value for name, value in how.items() if name != "live"}
            origin = Origin("plain", text, shown_address(text), size=size, **settings)
            openers[camera] = partial(executing.open_camera, camera, origin)
    merged = SeveralSources.opened(openers, start, end)
    with ExitStack() as stack:
        stack.callback(merged.close)
        check_sizes(
            graph, {camera: (source.width, source.height) for camera, source in merged.sources.items()}
        )
        stack.pop_all()
    return merged


def named_files(files: str | PathLike[str] | Named | None) -> dict[str, str | PathLike[str]]:
    """Camera -> its file, in the order given; "" of a file that is of one image."""
    if files is None:
        return {}
    return dict(files) if isinstance(files, Mapping) else {"": files}


def by_engine_names(detectors: Mapping[str, Any]) -> dict[str, Any]:
    """The detectors of cameras by the names that an engine has for them."""
    return {of_camera(GIVEN, camera): detector for camera, detector in detectors.items()}


def source_of(source: FrameSource, camera: str) -> Any:
    """The source of one of several cameras; the source itself of one image."""
    return source.sources[camera] if isinstance(source, SeveralSources) else source
