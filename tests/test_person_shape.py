"""The silhouette tells a person from a board of the person's colour, and stops itself in a glare."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bayesnet_track import Start, track
from bayesnet_track.cue import Hypotheses
from bayesnet_track.cues.shape import CUE
from bayesnet_track.graph.net import Activated, LocallyAdapted, SelfStopped
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.planes import Frame, FramePair, PlaneCache, Planes, Region
from bayesnet_track.runtime.run import Result
from bayesnet_track.runtime.scene_source import SceneSource
from bayesnet_track.scenes import Scene, make_scene

GLARE = (68, 96)
"""The frames in which the whole person is before the glare."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("person_and_board", 0)


def planes_of(scene: Scene, index: int) -> Planes:
    cache = PlaneCache(FramePair(Frame(index, float(index), scene.frames[index]), None))
    return cache.planes(CUE.make(CUE.parameters()).needs, Region(0, 0, scene.width, scene.height))


def test_person_and_board_differ_in_shape_alone(scene: Scene) -> None:
    cue = CUE.make(CUE.parameters())
    person, board = centre_from_corner(scene.truth), centre_from_corner(scene.others[0])
    reference = cue.learn(planes_of(scene, 0), person[0])
    for index in range(0, 50, 5):
        boxes = Hypotheses(np.stack([person[index], board[index]]))
        values = cue.log_likelihood(planes_of(scene, index), boxes, reference)
        assert values[0] > values[1] + 1.0, index


@pytest.fixture(scope="module")
def results(scene: Scene) -> list[Result]:
    source = SceneSource(scene, "scene:person_and_board")
    return list(track("person_shape", source, [Start(scene.start_box)], seed=0))


def frames_of(results: list[Result], kind: Any) -> list[int]:
    made = [decision for result in results for decision in result.decisions if isinstance(decision, kind)]
    return [decision.frame for decision in made if decision.node == "shape"]


def test_the_person_is_held_throughout(scene: Scene, results: list[Result]) -> None:
    boxes = np.array([result.targets[0].box for result in results])
    assert overlap(boxes, centre_from_corner(scene.truth)).min() > 0.5


def test_shape_stops_itself_under_the_glare_and_comes_back(results: list[Result]) -> None:
    (stopped,) = frames_of(results, SelfStopped)
    assert GLARE[0] - 15 <= stopped <= GLARE[1]  # the person is partly before the glare from frame 50 on
    tuned = frames_of(results, LocallyAdapted)
    assert tuned and max(tuned) < stopped  # it looked for other edges first
    assert [frame > GLARE[1] for frame in frames_of(results, Activated) if frame > 0] == [True]
    assert all("shape" not in result.targets[0].active for result in results[stopped + 1 : GLARE[1]])


def test_its_own_uncertainty_tells_of_the_glare(results: list[Result]) -> None:
    uncertain = [result.targets[0].agent_ud_px2.get("shape") for result in results]
    before = [value for value in uncertain[1:50] if value is not None]
    during = [value for value in uncertain[58:66] if value is not None]
    assert np.median(during) > 4 * np.median(before)
