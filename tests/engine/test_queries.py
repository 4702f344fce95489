"""The stage of queries: there only when asked for, the same answers for rows and for single targets."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from bayesnet_track import DetectionsTracker, load_graph
from bayesnet_track.engine.queries import frame_names
from bayesnet_track.engine.step import make_engine
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graphs import find_graph
from bayesnet_track.observation.planes import Frame, FramePair


def with_queries(name: str, queries: dict[str, object]):
    graph = yaml.safe_load(find_graph(name).read_text(encoding="utf-8"))
    return check_graph({**graph, "queries": queries})


def test_the_stage_is_there_when_a_graph_asks() -> None:
    asked = with_queries("two_squares", {"q": {"of": "square", "value": "x"}})
    assert "queries" in [stage.name for stage in make_engine(asked).stages]
    assert "queries" not in [stage.name for stage in make_engine(load_graph("two_squares")).stages]


def test_the_interval_of_frames_is_that_of_their_times() -> None:
    image = np.zeros((4, 6, 3), dtype=np.uint8)
    names = frame_names(FramePair(Frame(3, 3.0, image, True, 0.12), Frame(1, 1.0, image, True, 0.04)))
    assert names == {
        "frame_width": 6.0,
        "frame_height": 4.0,
        "dt": 2.0,
        "t": 3.0,
        "frame_s": pytest.approx(0.04),
    }
    assert math.isnan(frame_names(FramePair(Frame(0, 0.0, image, True, 0.0), None))["frame_s"])
    untimed = frame_names(
        FramePair(Frame(1, 1.0, image, True, math.nan), Frame(0, 0.0, image, True, math.nan))
    )
    assert math.isnan(untimed["frame_s"])


def test_an_answer_does_not_depend_on_the_other_targets() -> None:
    queries = {
        "left": {"of": "target", "probability": "hypot(x - 100, y - 100) < 4"},
        "speed": {"of": "target", "value": "hypot(vx, vy)"},
    }
    graph = with_queries("kalman_detections", queries)
    places = np.array([[100.0, 100], [300, 300], [500, 200]])
    answers = []
    for count in (1, 3):
        tracker, rng = DetectionsTracker(graph, size=(640, 480)), np.random.default_rng(1)
        for step in range(8):
            centres = places[:count] + step + rng.normal(0, 1, (3, 2))[:count]
            boxes = np.hstack([centres - 10, centres + 10])
            tracker.update(SimpleNamespace(xyxy=boxes, confidence=np.ones(count)))
        first = min(tracker.queries["left"], key=int)
        answers.append({name: asked[first] for name, asked in tracker.queries.items()})
    assert answers[0] == answers[1]
