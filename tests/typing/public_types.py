"""What type checkers see of the public names: read by mypy and pyright, never run.

`assert_type` holds what a caller gets. A line with an ignored error holds that a wrong call is one: both
checkers complain of an ignore that is not needed.
"""

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, assert_type

import numpy as np
from numpy.typing import NDArray

import bayesnet_track
from bayesnet_track import (
    Detections,
    GraphSpec,
    Result,
    Run,
    Start,
    Tracker,
    load_graph,
    open_run,
    track,
)
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.observation.cue import Cue, CueDeclaration, CueParameters, Hypotheses, Reference
from bayesnet_track.observation.planes import Plane, Planes

Box = tuple[float, float, float, float]


def of_the_package() -> None:
    assert_type(bayesnet_track.__version__, str)


def of_a_graph(spec: GraphSpec) -> None:
    assert_type(load_graph("general"), CheckedGraph)
    assert_type(load_graph(spec), CheckedGraph)
    load_graph(3)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]


def of_a_tracker(image: NDArray[np.uint8], depth_m: NDArray[np.float64]) -> None:
    tracker = Tracker("general", seed=3, whole_px=True, copy_frames=False)
    assert_type(tracker, Tracker)
    assert_type(tracker.update(image), tuple[bool, Box])
    ok, box = tracker.update(image)
    assert_type(ok, bool)
    assert_type(box, Box)
    assert_type(tracker.xywh, NDArray[np.float64])
    assert_type(tracker.xyxy, NDArray[np.float64])
    assert_type(tracker.cxcywh, NDArray[np.float64])
    assert_type(tracker.plot(image), NDArray[np.uint8])
    _ = tracker.box  # type: ignore[attr-defined]  # pyright: ignore[reportAttributeAccessIssue]
    assert_type(tracker.score, float)
    assert_type(tracker.status, str)
    assert_type(tracker.events, tuple[Event, ...])
    assert_type(tracker.metrics, FrameMetrics)
    assert_type(tracker.targets, tuple[FrameMetrics, ...])
    assert_type(tracker.detections(lost=True), Detections)
    tracker.init(image, (1, 2, 3, 4))
    tracker.init(image, (1, 2, 3))  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    tracker.init(depth_m)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    Tracker(sead=3)  # type: ignore[call-arg]  # pyright: ignore[reportCallIssue]


def of_a_whole_run(starts: list[Start]) -> None:
    results = track("general", "video.mp4", (1, 2, 3, 4))
    assert_type(results, Generator[Result, None, None])
    for result in track("general", "video.mp4", starts, out="run"):
        assert_type(result.targets, Sequence[FrameMetrics])
        assert_type(result.frame.index, int)
        assert_type(result.frame.image, NDArray[np.uint8])
        assert_type(result.seconds, dict[str, float])
        assert_type(result.detections(), Detections)
        assert_type(result.targets[0].xywh, NDArray[np.float64])
        assert_type(result.plot(), NDArray[np.uint8])
    assert_type(starts[0].box, Box)
    assert_type(starts[0].plate, str | None)
    track("general", "video.mp4", (1, 2, 3, 4), "run")  # type: ignore[call-arg]  # pyright: ignore[reportCallIssue]


def of_a_run_that_is_read() -> None:
    run = open_run("runs/mine")
    assert_type(run, Run)
    assert_type(run.metrics, Sequence[FrameMetrics])
    assert_type(run.spec, GraphSpec)
    assert_type(run.seconds, Mapping[int, float])
    assert_type(run.to_dict(), dict[str, list[Any]])
    run.metrics = ()  # type: ignore[misc]  # pyright: ignore[reportAttributeAccessIssue]


def of_detections(found: Detections) -> None:
    assert_type(found.xyxy, NDArray[np.float64])
    assert_type(found.tracker_id, NDArray[np.int64])
    assert_type(len(found), int)
    assert_type(iter(found), Iterator[tuple[NDArray[np.float64], float, int, int, dict[str, Any]]])


@dataclass(frozen=True)
class Bright:
    """A cue of one's own meets the contract by its methods alone."""

    parameters: CueParameters
    needs: tuple[Plane, ...] = ()

    def learn(self, planes: Planes, box: NDArray[np.float64]) -> Reference:
        return {"box": box}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        return new

    def log_likelihood(
        self, planes: Planes, hypotheses: Hypotheses, reference: Reference
    ) -> NDArray[np.float64]:
        return np.zeros(len(hypotheses))


class Blind:
    """Lacks what a cue has."""


def of_a_cue(bright: Bright, blind: Blind) -> None:
    cue: Cue = bright
    wrong: Cue = blind  # type: ignore[assignment]  # pyright: ignore[reportAssignmentType]
    assert_type(CueDeclaration("bright", "How bright it is.", CueParameters, Bright).name, str)
    del cue, wrong
