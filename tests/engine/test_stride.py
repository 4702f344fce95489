"""What is done in every n-th frame is so among the frames that are tracked, whatever their numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.outcome import Outcome, State
from bayesnet_track.engine.step import first_look, make_engine, step
from bayesnet_track.graph.checks.run import check
from bayesnet_track.journal.events.switches import Scheduled
from bayesnet_track.observation.detector import Detections
from bayesnet_track.sources.detection_files import FileDetector

NUMBERS = pytest.mark.parametrize(("first", "stride"), [(0, 1), (1, 2), (0, 2), (2, 3), (4, 5)])


def frames(fakes, first, stride, count):
    """Frames of such numbers, an interval apart."""
    return [replace(fakes.frame(first + stride * n, time=float(n)), stride=stride) for n in range(count)]


def counted(numbers, first, stride):
    return [(number - first) // stride for number in numbers]


@NUMBERS
def test_references_learn_in_every_second_frame(fakes, first, stride):
    rule = {"below": {"ud_px2": 1e6}, "every": 2, "rate_max": 0.5, "early_rate": 0.5}
    nodes = {"root": {"learn": rule}, "a": "root"}
    engine, cues = fakes.engine(nodes, {"a": fakes.gaussian(50.0, 40.0, 3.0)}, rate_max=0.5)
    fakes.play(engine, frames(fakes, first, stride, 9))
    learnt = counted([frame for frame, *_ in cues["a"].learnt], first, stride)[1:]
    assert len(learnt) == 4 and set(np.diff(learnt)) == {2}
    # The rates are those of as many tracked frames since the start.
    same = fakes.engine(nodes, {"a": fakes.gaussian(50.0, 40.0, 3.0)}, rate_max=0.5)
    fakes.play(same[0], frames(fakes, learnt[0] % 2, 1, 9))
    assert cues["a"].blended == pytest.approx(same[1]["a"].blended)


@NUMBERS
def test_agents_on_call_rest_for_as_many_frames(fakes, first, stride):
    root = {
        "belief": {"gaussian": {"filter": "kalman"}},
        "motion": {"random_walk": {"sd_px": {"x": 8.0, "y": 8.0}}},
        "fuse": "product",
        "estimate": "mean",
        "ud_fields": ["x", "y"],
        "adapt": {"agents": ["dear"], "on_call": {"every": 3, "agree": 0.5, "above": {"ud_px2": 1e6}}},
    }
    cues = {name: fakes.Measuring((50.0, 40.0), 4.0) for name in ("cheap", "dear")}
    declared = {name: fakes.declare(cue) for name, cue in cues.items()}
    graph = fakes.graph({"root": root, "cheap": "root", "dear": "root"}, declared)
    outcomes = fakes.play(make_engine(graph, 0, declared), frames(fakes, first, stride, 10))
    assert counted(cues["dear"].asked, first, stride) == [1, 3, 6, 9]
    scheduled = [e for one in outcomes for e in one.events if isinstance(e, Scheduled)]
    assert scheduled and all(e.due == e.frame + e.gap * stride for e in scheduled)


@NUMBERS
def test_a_detector_looks_in_every_second_frame(fakes, first, stride):
    spec = load_graph("kalman_detections").spec
    kind = spec.targets["target"]
    kind = kind.model_copy(update={"birth": kind.birth.model_copy(update={"every": 2})})
    graph = check(spec.model_copy(update={"targets": {"target": kind}}))
    box = np.array([[50.0, 40.0, 20.0, 20.0]])
    seen = frames(fakes, first, stride, 16)
    says = FileDetector({one.index: Detections(box, np.array([0.9]), ("",)) for one in seen})
    engine = make_engine(graph, 0, detectors={"detections": says})
    outcomes = [first_look(engine, Outcome(State(), Lines(), ()), seen[0])]
    for frame in seen[1:]:
        outcomes.append(step(engine, outcomes[-1].state, frame))
    assert len(outcomes[-1].metrics) == 1
    heard = [line.frame for one in outcomes for line in one.metrics if not line.silent]
    assert {*np.diff(counted(heard, first, stride))} == {2}
