"""Frames that come in between, and targets that others start before: no other frame's draws change."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, Tracker, track
from bayesnet_track.graph.text.load import check_graph
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

FPS, SIDE = 25.0, 20
PARTICLES = {
    "bayesnet": 1,
    "name": "found",
    "targets": {
        "square": {
            "birth": {"detector": "detections", "confirm": {"hits": 2, "of": 2}},
            "death": {"lost_frames": 40, "unseen_frames": 4},
            "nodes": {
                "square": {
                    "belief": {"particles": {"size": 200}},
                    "motion": {"random_walk": {"sd_px": {"x": 6, "y": 6}}},
                    "fuse": "product",
                    "ud_fields": ["x", "y"],
                },
                "intensity": {"parent": "square", "agent": "intensity"},
            },
        }
    },
}
"""Targets that are started by detections, and held by particles that look at the image."""


def drawn(index, squares):
    """A frame with light squares at centres, and their detections."""
    image = np.full((160, 240, 3), 60 + index % 2, np.uint8)
    for x, y in squares:
        image[y - SIDE // 2 : y + SIDE // 2, x - SIDE // 2 : x + SIDE // 2] = 220
    half = SIDE / 2
    boxes = np.array([[x - half, y - half, x + half, y + half] for x, y in squares]).reshape(-1, 4)
    return SimpleNamespace(xyxy=boxes, confidence=np.linspace(0.9, 0.8, len(squares))), image


def walk(frame):
    """Two squares that are there from frame 10 on."""
    return [(60 + 2 * frame, 60), (160 - 2 * frame, 110)] if frame >= 10 else []


def followed(frames):
    """Time in frames -> what is measured of the targets there, of pairs of a time and its squares."""
    tracker, found = DetectionsTracker(check_graph(PARTICLES)), {}
    for number, (time, squares) in enumerate(frames):
        tracker.update(*drawn(number, squares), time_s=time / FPS)
        found[time] = list(tracker.targets)
    return found


def boxes_at(found, time):
    lines = [one for one in found[time] if one.xywh[1] < 130]
    return [(*one.xywh, *one.sd, one.ud_px2, np.array(one.cloud).tolist()) for one in lines]


PLAIN = [(frame, walk(frame)) for frame in range(25)]


def test_a_frame_inserted_before_targets_start_changes_nothing_of_them():
    before = followed(PLAIN)
    after = followed(sorted([*PLAIN, (4.5, []), (7.25, [])]))
    assert len(before[24]) == 2
    for time in range(10, 25):
        assert boxes_at(after, time) == boxes_at(before, time)


def test_a_target_that_starts_and_ends_before_others_changes_nothing_of_them():
    """The others have other ids."""
    flash = [(frame, [(200, 140)] if frame < 3 else walk(frame)) for frame in range(25)]
    before, after = followed(PLAIN), followed(flash)
    assert [one.target for one in before[24]] == ["1", "2"] and [one.target for one in after[24]] == [
        "2",
        "3",
    ]
    for time in range(10, 25):
        assert boxes_at(after, time) == boxes_at(before, time)


@pytest.fixture
def draws(monkeypatch):
    """Moment -> the keys of all draws made there."""
    made = {}
    digest = Streams._digest

    def noted(streams, owner, node, moment, purpose):
        key = digest(streams, owner, node, moment, purpose)
        made.setdefault(moment, set()).add(key)
        return key

    monkeypatch.setattr(Streams, "_digest", noted)
    return made


@pytest.mark.parametrize("times", [[0, 1, 2, 2.5, 3, 4, 5], [0, 1, 2, 4, 5]], ids=["inserted", "dropped"])
@pytest.mark.parametrize("graph", ["two_squares", "general"])
def test_a_frame_more_or_less_leaves_the_draws_of_the_others(graph, times, draws):
    scene = make_scene("two_squares", 0)

    def run(at):
        draws.clear()
        tracker = Tracker(graph, fps=FPS)
        tracker.init(scene.frames[0], scene.start_box, time_s=0.0)
        for time in at[1:]:
            tracker.update(scene.frames[int(time)], time_s=time / FPS)
        tracker.predict(1)
        return {moment: frozenset(keys) for moment, keys in draws.items()}

    plain, other = run([0, 1, 2, 3, 4, 5]), run(times)
    both = plain.keys() & other.keys()
    assert len(both) >= 6 and all(plain[moment] == other[moment] for moment in both)
    assert len(frozenset.union(*plain.values())) == sum(map(len, plain.values()))  # none is used twice


@pytest.mark.slow
def test_the_tracker_and_track_draw_the_same():
    scene = make_scene("two_squares", 0)
    images = list(scene.frames)[:8]
    tracker = Tracker("two_squares", fps=FPS)
    tracker.init(images[0], scene.start_box, time_s=3.0)
    boxes = []
    for index, image in enumerate(images[1:], 1):
        tracker.update(image, time_s=3.0 + index / FPS)
        boxes.append(tracker.metrics.xywh)
    whole = [
        result.targets[0].xywh
        for result in track("two_squares", SceneSource(scene, "two_squares", 8), scene.start_box)
    ]
    np.testing.assert_array_equal(np.array(boxes), np.array(whole[1:]))
