"""Agents that look at the images of several cameras, in drawn rooms, through the front door."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.numerics.boxes import shares_inside
from bayesnet_track.observation.cue import CueDeclaration
from tests.engine.test_several_cameras import CAMERAS, boxes_of
from tests.runtime.room import RATES, detections_in, place_at, sources_in, write_room

LATE = ((5.4, 12.5), (-0.4, 0.0))
"""A walk into the image of `east`."""


def run(folder, cues=(), **how):
    graph = write_room(folder, **how)
    return list(track(graph, sources_in(folder), detections=detections_in(folder), cues=cues))


@dataclass(frozen=True)
class Numbers:
    """A plane of the numbers of the current frame and the one before (-1: there is none)."""

    margin: ClassVar[None] = None
    inputs: ClassVar[tuple] = ()
    is_points: ClassVar[bool] = True

    def compute(self, frames, inputs, region):
        return np.array([frames.current.index, -1 if frames.previous is None else frames.previous.index])


class Witness:
    """Writes down which frames it is shown, and remembers the colour of the box that it learnt."""

    needs = (Numbers(),)

    def __init__(self, calls):
        self.calls = calls

    def note(self, method, planes, box):
        size = planes.frame.width, planes.frame.height
        self.calls.append((method, size, *planes[Numbers()].tolist(), box))

    def learn(self, planes, box):
        self.note("learn", planes, box)
        x, y = np.round(box[:2]).astype(int)
        return {"color": planes.frame.image[y, x].astype(float)}

    def blend(self, learned, recent, rate):
        return learned

    def log_likelihood(self, planes, hypotheses, reference):
        self.note("score", planes, hypotheses.boxes.mean(axis=0))
        assert reference["color"][2] > 150 > 60 > reference["color"][0]
        return np.zeros(len(hypotheses))


@pytest.fixture
def calls():
    return []


def witness(calls):
    return CueDeclaration("witness", make=lambda: Witness(calls))


def shown(calls, camera, methods=("learn", "score")):
    return [call for call in calls if call[1] == CAMERAS[camera].size and call[0] in methods]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*no detection is of the last")
def test_an_image_agent_of_the_second_camera_adds_to_detections_of_the_first(tmp_path):
    """`south` tells the depth badly; `east` sees it from the side."""
    worse, better = (
        run(tmp_path, count=14, agents=agents, detected_until=0.2)[-1] for agents in ((), ("color",))
    )
    (without,), (target,) = worse.targets, better.targets
    assert target.state["y_m_sd"] < 0.95 * without.state["y_m_sd"]
    place = place_at(better.frame.time_s)
    assert np.hypot(target.state["x_m"] - place[0], target.state["y_m"] - place[1]) < 0.05


@pytest.mark.slow
def test_agents_are_shown_the_frames_of_their_own_camera(tmp_path, calls):
    """Their sizes, numbers and frames before are those of the camera, which has its own rate."""
    run(tmp_path, [witness(calls)], count=12, agents=("witness",))
    for camera, rate in RATES.items():
        scored = shown(calls, camera, ("score",))
        numbers = sorted({call[2] for call in scored})
        assert numbers == list(range(2, 12 * rate // 20))
        for _, _, number, before, box in scored:
            assert before == number - 1
            np.testing.assert_allclose(box, boxes_of(camera, place_at(number / rate))[0], atol=6.0)


@pytest.mark.slow
def test_a_camera_learns_a_target_when_it_first_sees_most_of_it(tmp_path, calls):
    run(tmp_path, [witness(calls)], count=20, agents=("witness",), walk=LATE)
    seen = [
        n
        for n in range(10)
        if shares_inside(boxes_of("east", place_at(n / RATES["east"], LATE)), *CAMERAS["east"].size)[0] >= 0.5
    ]
    assert 2 < seen[0] < 8
    first = shown(calls, "east")[0]
    assert first[0] == "learn"
    assert abs(first[2] - seen[0]) <= 1
    assert all(call[2] >= first[2] for call in shown(calls, "east"))
    assert min(call[2] for call in shown(calls, "south")) < 2 * first[2]


def test_an_agent_that_fails_in_one_camera_is_quarantined_there_alone(tmp_path):
    class Broken(Witness):
        def log_likelihood(self, planes, hypotheses, reference):
            if planes.frame.width == CAMERAS["east"].size[0]:
                raise ValueError("blind in the east")
            return np.zeros(len(hypotheses))

    broken = CueDeclaration("witness", make=lambda: Broken([]))
    results = run(tmp_path, [broken], count=8, agents=("witness",))
    out = [event for result in results for event in result.decisions if type(event).__name__ == "Quarantined"]
    assert {(event.node, event.reason) for event in out} == {
        ("witness.east", "raised ValueError: blind in the east")
    }
    assert "witness.south" in results[-1].targets[0].active
