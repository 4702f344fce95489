"""The camera's motion, and the flow against the background."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track.cues.motion import CUE
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.vision.motion_planes import CameraPlane, against_background
from tests.cues.moving_scenery import drawn_scenery, seen, shifted

WIDTH, HEIGHT = 320, 240
WHOLE = Region(0, 0, WIDTH, HEIGHT)
CORNERS = np.array([[0, 0], [WIDTH, 0], [0, HEIGHT], [WIDTH, HEIGHT], [WIDTH / 2, HEIGHT / 2]], float)


@pytest.fixture(scope="module")
def scenery() -> np.ndarray:
    return drawn_scenery(WIDTH, HEIGHT)


def about_centre(degrees: float, zoom: float) -> np.ndarray:
    return cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), degrees, zoom)


def frame(index: int, gray: np.ndarray) -> Frame:
    return Frame(index, float(index), cv2.merge([gray] * 3))


def with_target(gray: np.ndarray, x: float, y: float) -> np.ndarray:
    """A patterned square of 80 px, its middle at (x, y)."""
    rng = np.random.default_rng(9)
    pattern = cv2.resize(
        rng.integers(0, 256, (7, 7)).astype(np.float32), (80, 80), interpolation=cv2.INTER_CUBIC
    )
    move = np.array([[1, 0, x - 39.5], [0, 1, y - 39.5]])
    cover = cv2.warpAffine(np.ones((80, 80), np.float32), move, (WIDTH, HEIGHT))
    moved = cv2.warpAffine(pattern, move, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)
    return np.clip(np.rint(gray * (1 - cover) + moved * cover), 0, 255).astype(np.uint8)


def camera(pair: FramePair, only_clear: bool = True) -> np.ndarray:
    return CameraPlane(only_clear).compute(pair, (), WHOLE)


@pytest.mark.parametrize(
    "move",
    [
        shifted(6.3, -3.7),
        shifted(-21.0, 14.5),
        about_centre(2.0, 1.0),
        about_centre(0.0, 1.03),
        about_centre(-1.5, 0.98),
    ],
)
def test_the_motion_of_the_whole_picture(scenery: np.ndarray, move: np.ndarray) -> None:
    """To 0.25 px in the corners; points are found in a picture of half the size to about 0.1 px of it."""
    pair = FramePair(frame(1, seen(scenery, move)), frame(0, seen(scenery, shifted(0, 0))))
    matrix = camera(pair)
    before = (np.column_stack([CORNERS, np.ones(5)]) @ np.linalg.inv(np.vstack([move, [0, 0, 1]])).T)[:, :2]
    assert CORNERS @ matrix[:, :2].T + matrix[:, 2] == pytest.approx(CORNERS - before, abs=0.25)


def test_per_unit_of_time(scenery: np.ndarray) -> None:
    now, then = seen(scenery, shifted(9.0, -6.0)), seen(scenery, shifted(0, 0))
    once = camera(FramePair(frame(1, now), frame(0, then)))
    thrice = camera(FramePair(frame(3, now), frame(0, then)))
    assert thrice == pytest.approx(once / 3)
    assert once @ [100, 100, 1] == pytest.approx([9.0, -6.0], abs=0.25)


def test_a_still_camera_is_exactly_still(scenery: np.ndarray) -> None:
    """Also with grain, and with a target that moves: then no vector changes by a bit."""
    rng = np.random.default_rng(0)
    ground = seen(scenery, shifted(0, 0))
    images = [with_target(ground, 100 + 5 * n, 90) + rng.normal(0, 4, ground.shape) for n in range(2)]
    then, now = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in images)
    assert not camera(FramePair(frame(1, now), frame(0, then))).any()


def test_unknown_is_still(scenery: np.ndarray) -> None:
    now, flat = frame(1, seen(scenery, shifted(4, 4))), np.full((HEIGHT, WIDTH), 99, np.uint8)
    assert not camera(FramePair(now, None)).any()
    assert not camera(FramePair(now, frame(0, now.image[:100, :, 0].copy()))).any()
    for only_clear in (True, False):
        assert not camera(FramePair(now, now), only_clear).any()
        assert not camera(FramePair(frame(1, flat), frame(0, flat)), only_clear).any()
        tiny = np.zeros((1, 1), np.uint8)
        assert not camera(FramePair(frame(1, tiny), frame(0, tiny)), only_clear).any()


def test_one_thing_on_flat_ground_is_no_camera() -> None:
    """All corners move alike, but they are in one place; only `compensate` takes them for the scene."""
    flat = np.full((HEIGHT, WIDTH), 120, np.uint8)
    wide = with_target(flat, 150, 130)
    moved = np.roll(wide, (4, 6), axis=(0, 1))
    pair = FramePair(frame(1, moved), frame(0, wide))
    assert not camera(pair).any()
    assert camera(pair, only_clear=False) @ [160, 120, 1] == pytest.approx([6.0, 4.0], abs=0.25)


@pytest.mark.parametrize("name", ["two_squares", "person_and_board"])
def test_movers_on_plain_ground_are_no_camera(name: str) -> None:
    """Nearly all corners of these scenes are on what moves; the camera rests."""
    frames = make_scene(name).frames
    for n in range(1, 100, 7):
        assert not camera(
            FramePair(Frame(n, float(n), frames[n]), Frame(n - 1, n - 1.0, frames[n - 1]))
        ).any()


def test_against_background() -> None:
    vectors = np.array([[10.0, 20.0, 3.0, 4.0], [0.0, 0.0, 1.0, 1.0]])
    camera = np.array([[0.1, 0.0, 1.0], [0.0, 0.1, -1.0]])
    assert against_background(vectors, camera).tolist() == [[10, 20, 1, 3], [0, 0, 0, 2]]
    assert np.array_equal(against_background(vectors, np.zeros((2, 3))), vectors)
    assert vectors[0, 2] == 3.0


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (5.0, -3.0)])
@pytest.mark.parametrize("mode", ["auto", "compensate", "ignore"])
def test_a_jerk_of_the_camera(scenery: np.ndarray, velocity: tuple[float, float], mode: str) -> None:
    """Learnt while the camera rests; it jerks: only with it taken off is the target still likely."""
    cue = CUE.make(CUE.parameters(camera=mode))
    at = np.array([150.0, 120.0])

    def pair(index: int, jerk: np.ndarray) -> tuple[FramePair, np.ndarray]:
        place = at + index * np.array(velocity)
        then = with_target(seen(scenery, shifted(0, 0)), *(place - velocity))
        now = with_target(seen(scenery, shifted(*jerk)), *(place + jerk))
        return FramePair(frame(index, now), frame(index - 1, then)), np.array([*(place + jerk), 72.0, 72.0])

    quiet, box = pair(1, np.zeros(2))
    reference = cue.learn(PlaneCache(quiet).planes(cue.needs, WHOLE), box)
    # windows of 11 px at the edge of the square hold some background too
    assert reference["flow"] == pytest.approx(velocity, abs=0.6)
    shaken, box = pair(2, np.array([7.0, 5.0]))
    planes = PlaneCache(shaken).planes(cue.needs, WHOLE)
    likelihood = np.exp(cue.log_likelihood(planes, Hypotheses(box[None]), reference))[0]
    assert likelihood > 0.8 if mode != "ignore" else likelihood < 0.03
