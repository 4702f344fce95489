"""After a live tracker is made, no frame imports a module, and none compiles or loads a kernel."""

import subprocess
import sys

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, Start, Tracker, load_graph
from bayesnet_track.runtime import frame_clock

LATE = """
import gc, json, sys, warnings
import numpy as np
from types import SimpleNamespace
from numba.core.dispatcher import Dispatcher
from bayesnet_track import DetectionsTracker, Start, Tracker, load_graph
from bayesnet_track.runtime import frame_clock
warnings.simplefilter("ignore")
graph = load_graph(sys.argv[1])
rng = np.random.default_rng(4)

def kernels():
    found = (one for one in gc.get_objects() if isinstance(one, Dispatcher))
    return {(one.py_func.__qualname__, str(types)) for one in found for types in one.overloads}

def detections(frame):
    x, y = 20 + 60.0 * np.arange(12) + frame, 40 + 10 * np.arange(12)
    boxes = np.stack([x, y, x + 30, y + 70], axis=1)[rng.random(12) < 0.9]
    boxes[0, :2] = 0
    # They want each other's detections.
    close = np.array([[300, 300, 330, 370]]) + 18.0 * np.arange(8)[:, None] * [1, 0, 1, 0]
    close += rng.normal(0, 5, (8, 1))
    boxes = np.concatenate([boxes, close[rng.random(8) < 0.9]])
    return SimpleNamespace(xyxy=boxes, confidence=np.full(len(boxes), 0.9), data={})

texture = rng.integers(0, 256, (240, 320, 3), dtype=np.uint8)

def picture(frame):
    image, x = texture.copy(), 60 + 3 * frame
    if not 25 <= frame < 40:
        image[100:140, x : x + 40] = (20, 40, 220)
    return image

if sys.argv[2] == "detections":
    tracker = DetectionsTracker(graph, size=(900, 400))
    users = frame_clock.image_users(tracker._engine)
    image = (lambda frame: drawn) if users else (lambda frame: None)
    drawn = rng.integers(0, 256, (400, 900, 3), dtype=np.uint8)
    update = lambda frame: (tracker.update(detections(frame), image(frame)), tracker.targets)
else:
    tracker = Tracker(graph)
    tracker.init(picture(0), Start((60, 100, 40, 40), next(iter(graph.targets))))
    update = lambda frame: tracker.update(picture(frame))
before = set(sys.modules), kernels()
for frame in range(1, 61):
    update(frame)
print(json.dumps([sorted(set(sys.modules) - before[0]), sorted(name for name, _ in kernels() - before[1])]))
"""

DETECTIONS = ("bytetrack", "jpda", "kalman_detections", "oc_sort", "people_detections", "sort")
DRAWN = (
    "adaptive", "bouncing_square", "carried_box", "color_fusion", "crowd",
    "falling_ball", "general", "gray_square", "grid_displacement", "hidden_ball", "kalman_ball",
    "orange_and_gray", "person_leaning", "person_levels", "person_parts", "radar_ball", "road", "road_mask",
    "two_colors", "two_squares", "two_squares_velocity",
)  # fmt: skip


def late(graph, kind):
    """Modules and kernels that frames 1 to 60 needed first, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", LATE, graph, kind], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.strip().splitlines()[-1]


@pytest.mark.slow
def test_no_frame_of_a_crowd_imports_or_compiles():
    assert late("kalman_detections", "detections") == "[[], []]"


@pytest.mark.slow
@pytest.mark.parametrize("graph", DETECTIONS)
def test_no_frame_of_detections_imports_or_compiles(graph):
    assert late(graph, "detections") == "[[], []]"


@pytest.mark.slow
@pytest.mark.parametrize("graph", DRAWN)
def test_no_frame_of_drawn_pictures_imports_or_compiles(graph):
    assert late(graph, "pictures") == "[[], []]"


def test_what_is_made_up_leaves_nothing_behind(monkeypatch):
    """The same results, whether it was rehearsed or not."""
    found = []
    for rehearsed in (True, False):
        monkeypatch.setattr(frame_clock, "_done", set())
        if not rehearsed:
            monkeypatch.setattr(frame_clock, "_rehearse", lambda *given: iter(()))
        tracker = Tracker("two_squares", seed=3)
        image = np.random.default_rng(2).integers(0, 256, (96, 128, 3), dtype=np.uint8)
        tracker.init(image, (30, 30, 24, 24))
        found.append([tracker.update(np.roll(image, n, axis=1)) for n in range(1, 5)])
    assert found[0] == found[1]


def test_it_is_rehearsed_once_for_a_graph(monkeypatch):
    monkeypatch.setattr(frame_clock, "_done", set())
    frames = []
    monkeypatch.setattr(
        frame_clock, "_frame", lambda *given, made=frame_clock._frame: frames.append(1) or made(*given)
    )
    for _ in range(2):
        DetectionsTracker("kalman_detections")
    assert len(frames) == frame_clock.FRAMES


def test_a_cue_of_the_users_own_is_not_asked_about_what_is_made_up(monkeypatch):
    """All else is rehearsed, with a cue that says nothing in its place."""
    engine, graph = Tracker("general")._engine, load_graph("general")
    (plate,) = engine.plates.values()
    own = next(cue for agent, cue in plate.cues.items() if agent not in plate.adaptable)
    monkeypatch.setattr(type(own), "__module__", "a_cue_of_my_own")
    monkeypatch.setattr(type(own), "learn", lambda *given: pytest.fail("it was asked"))
    monkeypatch.setattr(frame_clock, "_done", set())
    outcomes = []
    rehearse = frame_clock._rehearse

    def watched(*given):
        outcomes.extend(rehearse(*given))
        return iter(outcomes)

    monkeypatch.setattr(frame_clock, "_rehearse", watched)
    look = frame_clock._Look((64, 48), True)
    start = Start((10, 10, 20, 20), next(iter(engine.plates)))
    frame_clock.rehearse_boxes(graph, engine, [start], frame_clock._frame(0, look))
    assert len(outcomes) == frame_clock.FRAMES - 1
    events = [str(event) for outcome in outcomes for event in outcome.events]
    assert not [one for one in events if "failed" in one or "raised" in one], events
