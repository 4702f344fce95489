"""Detections of several cameras, given by a program: each time is a step of the cameras with a frame."""

from __future__ import annotations

import copy
from collections.abc import Mapping
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


def check_cameras(graph: CheckedGraph, given: Any, what: str) -> None:
    """Check that what is given is a mapping with names of cameras of the graph.

    Raises:
        TypeError: it is no mapping.
        ValueError: a name is none of a camera of the graph, or there is none at all.
    """
    names = ", ".join(graph.several_cameras)
    example = f'{{"{next(iter(graph.several_cameras))}": {what}, ...}}'
    if not isinstance(given, Mapping):
        raise TypeError(
            f"the graph {graph.spec.name} has the cameras {names}: {what} are given for each that has a "
            f"frame, {example}, not as {type(given).__name__}"
        )
    for name in given:
        if name not in graph.several_cameras:
            close = nearest(str(name), graph.several_cameras)
            raise ValueError(
                f"{what} of {name!r}, which is no camera of the graph; there are {names}"
                + (f"; nearest: {close}" if close else "")
            )
    if not given:
        raise ValueError(f"{what} of no camera; give those of each that has a frame, {example}")


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
    sizes = {name: each[name] or of or USUAL_SIZE for name, of in graph.several_cameras.items()}
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
        return {of_camera(GIVEN, camera): one for camera, one in self.fed.items()}

    def read(self, detections: Any) -> dict[str, GivenDetections]:
        """Camera that has a frame -> its usable detections; raises as `check_cameras` and `read_given`."""
        check_cameras(self.graph, detections, "detections")
        given = {}
        for camera, one in detections.items():
            name = of_camera("detections", camera)
            try:
                given[camera] = read_given(one, self.graph, name).inside(*self.sizes[camera])
            except (TypeError, ValueError) as error:
                raise type(error)(f"{camera}: {error}") from None
        return given

    @property
    def first_size(self) -> Size:
        """Width and height of the first camera's images, px."""
        return next(iter(self.sizes.values()))

    def frame(self, step: Frame, given: Mapping[str, GivenDetections]) -> Frame:
        """The step with a frame of each camera whose detections are given: what its detector finds in it."""
        cameras = {}
        for camera, size in self.sizes.items():
            if camera in given:
                self.fed[camera].now = given[camera].detections
                cameras[camera] = replace(step, image=blank_image(*size))
        return replace(step, cameras=cameras)


def mark(
    detections: Mapping[str, Any],
    given: Mapping[str, GivenDetections],
    engine: Engine,
    state: State,
    owners: Any,
) -> dict[str, Any]:
    """Copies of the detections of each camera with `tracker_id`, as `owners` finds them by their shares."""
    marked = {}
    for camera, one in given.items():
        ids: NDArray[np.int64] = np.full(one.count, -1, dtype=np.int64)
        scan = Scan(one.detections.boxes, one.detections.scores)
        agents = {
            agent
            for compiled in engine.plates.values()
            for agent, own in compiled.cameras.items()
            if own == camera
        }
        for agent in sorted(agents):
            found = owners(state, agent, scan, one.rows, one.count)
            ids = np.where(ids < 0, found, ids)
        marked[camera] = copy.copy(detections[camera])
        marked[camera].tracker_id = ids
    return marked


Named = Mapping[str, str | PathLike[str]]


def check_named(graph: CheckedGraph, source: object, detections: object) -> None:
    """Refuse sources or detections that are named by cameras for one image, or not named for several.

    Raises:
        TypeError, ValueError: as of `check_cameras`; or the graph has not several cameras.
    """
    for what, given in (("sources", source), ("detections", detections)):
        if given is None or isinstance(given, SeveralSources):
            continue
        if graph.several_cameras:
            check_cameras(graph, given, what)
        elif isinstance(given, Mapping):
            raise ValueError(
                f"{what} of {', '.join(map(str, given))}: the graph {graph.spec.name} has not several "
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
        other = texts.setdefault(str(Path(text).absolute()), camera)
        if other != camera:
            raise SourceError(
                text,
                f"the source of two cameras, {other} and {camera}: its evidence would count twice",
                "a source of its own for each camera",
                "give each camera once",
            )
    start, end = how.pop("start", None), how.pop("end", None)
    openers: dict[str, Any] = {}
    for camera, size in graph.several_cameras.items():
        text = str(files[camera])
        if executing is None or executing.hosts == "engine":
            openers[camera] = partial(open_source, text, size=size, **how)
        else:
            settings = {name: value for name, value in how.items() if name != "live"}
            origin = Origin("plain", text, shown_address(text), size=size, **settings)
            openers[camera] = partial(executing.open_camera, camera, origin)
    merged = SeveralSources.opened(openers, start, end)
    with ExitStack() as stack:
        stack.callback(merged.close)
        check_sizes(graph, {camera: (one.width, one.height) for camera, one in merged.sources.items()})
        stack.pop_all()
    return merged


def named_files(given: str | PathLike[str] | Named | None) -> dict[str, str | PathLike[str]]:
    """Camera -> its file, in the order given; "" of a file that is of one image."""
    if given is None:
        return {}
    return dict(given) if isinstance(given, Mapping) else {"": given}


def by_engine_names(detectors: Mapping[str, Any]) -> dict[str, Any]:
    """The detectors of cameras by the names that an engine has for them."""
    return {of_camera(GIVEN, camera): detector for camera, detector in detectors.items()}


def source_of(source: FrameSource, camera: str) -> Any:
    """The source of one of several cameras; the source itself of one image."""
    return source.sources[camera] if isinstance(source, SeveralSources) else source
