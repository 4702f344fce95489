"""The silhouette tells a person from a board of the person's colour, and its own UD tells of a glare."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.cues.shape import CUE
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.numerics.log_weights import uncertainty_deviation
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region
from bayesnet_track.sources.scenes import Scene, make_scene


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


def test_its_own_uncertainty_tells_of_the_glare(scene: Scene) -> None:
    """UD of the normalised likelihood over boxes spread evenly within 24 px of the truth."""
    cue, truth = CUE.make(CUE.parameters(floor=0.003)), centre_from_corner(scene.truth)
    reference = cue.learn(planes_of(scene, 0), truth[0])
    offset = np.arange(-24.0, 25.0, 3.0)
    shifts = np.array([(dx, dy, 0.0, 0.0) for dx in offset for dy in offset])
    ud = {}
    for index in (10, 15, 75, 85):
        boxes = truth[index] + shifts
        likelihood = np.exp(cue.log_likelihood(planes_of(scene, index), Hypotheses(boxes), reference))
        best = boxes[np.argmax(likelihood), :2]
        ud[index] = uncertainty_deviation(boxes[:, :2], likelihood / likelihood.sum(), best)
    # a flat likelihood has twice the variance of a uniform law on 17 steps of 3 px, 432 px2, about its middle
    assert min(ud[75], ud[85]) > 400
    assert max(ud[10], ud[15]) < 150
