"""The thesis' Example 2 by automatic detection: both squares are found, and the hidden one comes back."""

from __future__ import annotations

import pytest

from bayesnet_track import track
from bayesnet_track.journal.events.lives import Reacquired, TargetStarted
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.journal.net import Decision, replay
from bayesnet_track.journal.text.story import describe_life
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

HIDDEN = range(18, 31)
"""Frames in which the gray square covers some of the orange one, and those in which the net reacts."""


class EventSink:
    """A sink that keeps events and metrics."""

    def __init__(self):
        self.events, self.metrics = [], []

    def event(self, event):
        self.events.append(event)

    def frame(self, result):
        self.metrics += result.targets


def run(seed, frames=None):
    sink, scene = EventSink(), make_scene("orange_and_gray", seed=seed)
    source = SceneSource(scene, "scene:orange_and_gray", frames)
    results = list(track("orange_and_gray_detected", source, seed=seed, sinks=[sink]))
    return sink, results[-1], centre_from_corner(scene.truth[(frames or 100) - 1])


def goes_as_in_the_thesis(seed):
    sink, last, truth = run(seed)
    born = {event.target: event.template for event in sink.events if isinstance(event, TargetStarted)}
    called = {
        event.node
        for event in sink.events
        if isinstance(event, Activated) and event.target == "1" and event.frame in HIDDEN
    }
    ends = {line.target: line for line in last.targets}
    return (
        born == {"1": "orange", "2": "gray"}
        and {target: line.active for target, line in ends.items()} == {"1": ("color",), "2": ("intensity",)}
        and overlap(ends["1"].centre_box, truth) > 0.5
        and called >= {"motion", "intensity"}
    )


def test_the_hidden_square_is_found_again_with_its_identity():
    sink, last, truth = run(1, frames=40)
    (found,) = [event for event in sink.events if isinstance(event, Reacquired)]
    assert found.target == "1" and found.recognition.probability > 0.5
    assert set(found.recognition.agents) == {"color", "intensity"}
    assert overlap(last.targets[0].centre_box, truth) > 0.5
    decisions = [event for event in sink.events if isinstance(event, Decision)]
    assert {t: one.active for t, one in replay(decisions).targets.items()} == {
        line.target: frozenset(line.active) for line in last.targets
    }
    story = describe_life(sink.events, sink.metrics, "1").splitlines()
    assert story[0].startswith("frame 2: color_backprojection detected it in 3 of its 3 runs since frame 0")
    assert story[-1].startswith("summary: 38 frames, lost in ")


@pytest.mark.slow
def test_both_squares_end_with_the_right_cue_in_19_of_20_runs():
    assert sum(goes_as_in_the_thesis(seed) for seed in range(20)) >= 19
