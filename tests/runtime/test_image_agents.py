"""Agents that look at the images of several cameras, in drawn rooms, through the front door."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import ClassVar

import av
import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.numerics.boxes import shares_inside
from bayesnet_track.observation.cue import CueDeclaration
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.sources.several import SeveralSources
from bayesnet_track.sources.sources import open_source
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


def write_h264(path, source):
    """The video with a key frame in every fourth one, and pictures between that refer to later ones."""
    with av.open(str(path), "w") as container, av.open(str(source)) as frames:
        stream = container.add_stream("libx264", rate=frames.streams.video[0].average_rate)
        stream.width, stream.height, stream.pix_fmt = *CAMERAS[path.stem].size, "yuv420p"
        stream.options = {
            "x264-params": "keyint=4:min-keyint=4:bframes=2:b-adapt=0:scenecut=0",
            "preset": "fast",
        }
        for frame in frames.decode(video=0):
            frame.pts = None
            container.mux(stream.encode(frame.reformat(format="yuv420p")))
        container.mux(stream.encode())


def outputs_of(run):
    unequal = {"manifest.json", "timings.jsonl", "recipe.json", "run.json"}  # they tell how it was opened
    return {
        path.name: path.read_bytes() for path in run.iterdir() if path.is_file() and path.name not in unequal
    }


@pytest.mark.slow
@pytest.mark.parametrize("agents", [(), ("color", "motion")])
def test_only_frames_that_are_chosen_are_decoded_and_results_are_those_of_all(tmp_path, agents):
    graph = write_room(tmp_path, agents=agents)
    graph.write_text(json.dumps({**json.loads(graph.read_text()), "adapt": {"cost_per_step": 0.4}}))
    videos = {camera: tmp_path / f"{camera}.mp4" for camera in RATES}
    for camera, path in videos.items():
        write_h264(path, sources_in(tmp_path)[camera])
    named = {"detections": detections_in(tmp_path), "tracks_csv": True}
    with SeveralSources({camera: open_source(str(path)) for camera, path in videos.items()}) as decoded:
        list(track(graph, decoded, out=tmp_path / "decoded", **named))
    results = list(track(graph, videos, out=tmp_path / "whole", **named))
    made = [image.is_made for result in results[1:] for image in result.frame.cameras.values()]
    looks = 2 if agents else 1  # at the frame before, too
    assert 0 < sum(made) <= looks * 0.4 * len(results) < 0.7 * len(made)
    assert outputs_of(tmp_path / "whole") == outputs_of(tmp_path / "decoded")
    begun = track(graph, videos, out=tmp_path / "broken", **named)
    for _ in range(13):
        next(begun)
    begun.close()
    assert len(list(resume(tmp_path / "broken"))) == len(results) - 13
    assert outputs_of(tmp_path / "broken") == outputs_of(tmp_path / "whole")
