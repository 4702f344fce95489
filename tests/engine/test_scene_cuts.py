"""A cut loses the targets whose rule asks for it, before anything else is done in its frame."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.journal.events.statuses import SceneCut
from bayesnet_track.journal.net import replay
from bayesnet_track.runtime.checkpoints.state_codec import decode_state, encode_state

SIZE = (120, 160)


def ground(seed):
    """A smooth random image, in colours of its own."""
    import cv2

    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 120, (6, 8, 3)) * rng.uniform(0.3, 1.0, 3)
    return cv2.resize(coarse.astype(np.uint8), SIZE[::-1], interpolation=cv2.INTER_CUBIC)


def scene(seed, x=None):
    """Such an image, with the target where `x` says."""
    image = ground(seed)
    if x is not None:
        image[40:70, x : x + 30] = (0, 140, 255)
        image[50:60, x + 10 : x + 20] = (255, 40, 40)
    return image


BLACK = np.zeros((*SIZE, 3), np.uint8)
BEFORE = [scene(1, 40 + step) for step in range(8)]


def general(**lost):
    """`general` with other settings of `lost`."""
    from bayesnet_track import load_graph

    written = load_graph("general").spec.model_dump(exclude_unset=True)
    written["targets"]["target"]["nodes"]["target"]["lost"] |= lost
    return written


def play(tracker, images):
    tracker.init(images[0], (40.0, 40.0, 30.0, 30.0))
    found = []
    for image in images[1:]:
        tracker.update(image)
        found.append((tracker.status, [e for e in tracker.events if isinstance(e, SceneCut)]))
    return found


@pytest.fixture(scope="module")
def cut():
    """A run whose fourth but last frame begins another scene, without the target, and its tracker."""
    tracker = Tracker(general(scene_cut=0.3))
    return play(tracker, [*BEFORE, *[scene(2)] * 4]), tracker


def test_the_target_is_lost_at_the_cut_and_not_before(cut):
    found, _ = cut
    at = len(BEFORE) - 1
    assert [status for status, _ in found[:at]] == ["tracking"] * at
    assert not any(events for k, (_, events) in enumerate(found) if k != at)
    (event,) = found[at][1]
    assert event.frame == at + 1 and event.distance > event.level == 0.3
    assert all(status == "lost" for status, _ in found[at:])


def test_it_is_searched_for_in_the_whole_frame_and_has_to_be_recognised(cut):
    tracker = cut[1]
    state = tracker._now.state.targets["1"]
    assert state.motion_context.held is None
    assert state.scored.missing == len(BEFORE)


def test_it_is_found_where_the_new_scene_shows_it():
    found = play(Tracker(general(scene_cut=0.3)), [*BEFORE, *[scene(2)] * 2, *[scene(1, 52)] * 12])
    assert [len(events) for _, events in found if events] == [1, 1]
    assert found[-1][0] == "tracking"


def test_black_frames_are_skipped():
    same = play(Tracker(general(scene_cut=0.3)), [*BEFORE, BLACK, BLACK, scene(1, 48)])
    other = play(Tracker(general(scene_cut=0.3)), [*BEFORE, BLACK, BLACK, scene(2)])
    assert not any(events for _, events in same)
    assert [bool(events) for _, events in other][-3:] == [False, False, True]


def test_without_the_rule_nothing_is_looked_at():
    tracker = Tracker(general(scene_cut=None))
    found = play(tracker, [*BEFORE, scene(2)])
    assert not any(events for _, events in found)
    assert tracker._now.state.scene is None


def test_the_scene_is_stored_with_the_state(cut):
    tracker = cut[1]
    state, engine = tracker._now.state, tracker._engine
    again = decode_state(encode_state(state), engine, state.previous)
    assert np.array_equal(again.scene.colors, state.scene.colors)
    assert np.array_equal(again.scene.cells, state.scene.cells)


def test_a_replayed_net_is_lost_in_the_frame_of_the_cut():
    from bayesnet_track.journal.events.lives import TargetStarted

    started = TargetStarted(0, "1", "target", (1.0, 1.0, 2.0, 2.0), ("color",))
    cut = SceneCut(5, "1", 0.8, 0.25, 0.8, 0.8)
    assert replay([started, cut], 4).targets["1"].status == "tracking"
    assert replay([started, cut], 5).targets["1"].status == "lost"
