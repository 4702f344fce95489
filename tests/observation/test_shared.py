"""What several cues see, none of them can change, wherever they are at work."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.graph.spec import Guard
from bayesnet_track.inference.learn import LearningInputs, judge, watch
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import (
    Frame,
    FramePair,
    PlaneCache,
    PointMap,
    Region,
    RightEye,
    for_reading,
    shown,
)
from bayesnet_track.runtime.executors.frames import FrameRing, FrameView


def test_a_frame_cannot_be_written_into_and_the_array_of_its_source_can():
    image = np.zeros((4, 5, 3), np.uint8)
    frame = Frame(0, 0.0, image, depth=RightEye(image, None))
    for seen in (frame.image, frame.depth.image, PointMap(image.astype("f4")).points):
        with pytest.raises(ValueError, match="read-only"):
            seen[0] = 1
    image[0] = 7
    assert np.shares_memory(frame.image, image) and frame.image[0, 0, 0] == 7


def test_the_tracker_leaves_the_array_that_it_is_given_as_it_is():
    tracker, image = Tracker("two_squares"), np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)
    tracker.init(image, (20, 20, 20, 20))
    assert image.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        tracker._now.state.previous.image[0] = 1


def test_a_plane_and_what_it_is_made_from_cannot_be_written_into(fakes):
    class Doubled(fakes.Plane):
        def compute(self, frames, inputs, region):
            inputs[0][...] = 9.0

    cache = PlaneCache(FramePair(fakes.frame(0), None))
    level, region = fakes.Plane("level"), Region(0, 0, 9, 9)
    with pytest.raises(ValueError, match="read-only"):
        cache.planes([level], region)[level][0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        cache.planes([Doubled("doubled", (level,))], region)
    assert not cache.planes([level], region)[level].any()


def test_a_worker_maps_the_frames_for_reading_only():
    store = FrameRing()
    try:
        frame = FrameView(store.descriptor).get(store.put(Frame(0, 0.0, np.zeros((4, 5, 3), np.uint8))))
        with pytest.raises(ValueError):
            frame.image.setflags(write=True)
        del frame
    finally:
        store.close()


def test_a_reference_is_shown_without_a_way_to_change_it():
    own = {"level": np.zeros(3), "name": "x"}
    seen = shown(own)
    with pytest.raises(ValueError, match="read-only"):
        seen["level"][0] = 1.0
    with pytest.raises(TypeError):
        seen["more"] = 1.0
    assert own["level"].flags.writeable and shown(seen)["level"] is seen["level"]


def spoiling(what):
    """A cue that writes, from the second frame on, into what others see, and says nothing of it."""

    def see(planes, hypotheses, reference):
        if what == "plane":
            next(iter(planes.values.values()))[...] = 3.0
        elif what == "frame":
            planes.frame.image[...] = 3
        elif what == "reference":
            reference["box"][...] = 3.0
        else:
            reference["box"] = np.ones(4)
        return np.full(len(hypotheses), -0.1)

    return see


@pytest.mark.parametrize("what", ["plane", "frame", "reference", "its names"])
def test_a_cue_that_writes_is_out_and_the_others_are_as_without_it(fakes, what):
    def see(planes, hypotheses, reference):
        level = sum(float(values.mean()) for values in planes.values.values()) + planes.frame.image.mean()
        return -0.5 * ((hypotheses.boxes[:, 0] - 50.0 - level) / 9.0) ** 2

    root, level = {"fuse": "product", "belief": {"particles": {"size": 60}}}, (fakes.Plane("level"),)
    sees = {"a": fakes.Oracle(see, level), "bad": fakes.Oracle(spoiling(what), level)}
    clean, _ = fakes.engine({"root": root, "a": "root"}, {"a": sees["a"]})
    dirty, _ = fakes.engine({"root": root, "a": "root", "bad": "root"}, sees)
    expected, outcomes = fakes.play(clean, 3), fakes.play(dirty, 3)
    assert [one.metrics for one in outcomes[1:]] == [one.metrics for one in expected[1:]]
    (out,) = [event for one in outcomes for event in one.events if isinstance(event, Quarantined)]
    assert out.node == "bad" and ("read-only" in out.reason or "does not support" in out.reason)


def test_agents_that_are_guarded_do_not_share_the_estimate(fakes):
    seen = {}

    def meddle(planes, hypotheses, reference):
        hypotheses.boxes[...] = 0.0
        return np.array([-1.0])

    def look(planes, hypotheses, reference):
        seen["boxes"] = hypotheses.boxes.copy()
        return np.array([-1.0])

    cues = {"a": fakes.Oracle(meddle), "b": fakes.Oracle(look)}
    references = {name: {"box": np.zeros(4)} for name in cues}
    rule = Guard(every=1)
    estimate = Hypotheses(np.array([[50.0, 40.0, 20.0, 20.0]]))
    cache = PlaneCache(FramePair(fakes.frame(1), fakes.frame(0)))
    rates = dict.fromkeys(cues, 0.1)
    judged = judge(
        LearningInputs(cues, cache, estimate), watch(references, set(cues), rule), references, rates, rule
    )
    assert not judged.faults and seen["boxes"].tolist() == estimate.boxes.tolist() == [[50, 40, 20, 20]]


@pytest.mark.parametrize("array", [np.zeros((4, 6)), np.zeros((4, 6)).T, np.zeros((4, 6))[:, 1:3]])
def test_kernels_read_arrays_of_one_kind(array):
    seen = for_reading(array)
    assert seen.flags.c_contiguous and not seen.flags.writeable and array.flags.writeable
    assert seen.shape == array.shape
