"""`sample_every`: an agent that was switched off still looks at every k-th frame, and only then is learnt."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.load import Toggled
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.net import Net as LiveNets
from bayesnet_track.journal.net import apply
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.observation.cue import over_frames

ADAPT = {
    "activate": {"above": {"ud_px2": 60.0}},
    "deactivate": {"below": {"ud_px2": 40.0}, "frames": 1, "drop": "most_expensive", "sample_every": 3},
}
NODES = {
    "root": {
        "fuse": "product",
        "ud_fields": ["x", "y"],
        "adapt": ADAPT,
        "learn": {"below": {"ud_px2": 1000.0}},
    },
    "cheap": "root",
    "dear": "root",
}


def played(fakes, cheap_sd, frames=14):
    sees = {"cheap": fakes.gaussian(50.0, 40.0, cheap_sd), "dear": fakes.gaussian(50.0, 40.0, 2.0)}
    engine, _ = fakes.engine(NODES, sees)
    (compiled,) = engine.plates.values()
    compiled.costs_ms.update({"cheap": 1.0, "dear": 9.0})
    return fakes.play(engine, frames)


def test_the_dearest_goes_and_looks_at_every_third_frame(fakes):
    outcomes = played(fakes, 3.0)
    (off,) = [event for one in outcomes for event in one.events if isinstance(event, Deactivated)]
    assert (off.node, off.sample_every, off.index) == ("dear", 3, {"cheap": 1.0, "dear": 9.0})
    after = [one.metrics[0] for one in outcomes if one.metrics[0].frame > off.frame]
    assert len(after) > 6
    for line in after:
        looks = line.frame % 3 == 0
        assert line.active == (("cheap", "dear") if looks else ("cheap",))
        assert (line.learn_rate > 0.0) == looks
    assert explain(off).endswith("stayed on at deactivate ≤ " + explain(off).rsplit(" ", 1)[1])
    assert "→ dear off (most expensive cue: 9 ms), still evaluated every 3 frames; would have" in explain(off)


@pytest.mark.parametrize(("first", "stride"), [(1, 2), (2, 3), (4, 5)])
def test_with_a_stride_it_looks_at_every_third_tracked_frame(fakes, first, stride):
    numbers = [first + stride * n for n in range(15)]
    frames = [replace(fakes.frame(k, time=float(n)), stride=stride) for n, k in enumerate(numbers)]
    outcomes = played(fakes, 3.0, frames)
    (off,) = [event for one in outcomes for event in one.events if isinstance(event, Deactivated)]
    after = [one.metrics[0] for one in outcomes if one.metrics[0].frame > off.frame]
    looks = [line.frame // stride for line in after if "dear" in line.active]
    assert len(looks) >= 3 and {b - a for a, b in pairwise(looks)} == {3}
    assert looks == [line.frame // stride for line in after if line.learn_rate > 0.0]


def test_it_comes_back_as_soon_as_the_others_are_unsure(fakes):
    """Alone, the cheap agent's belief has a UD far above the 60 px² that call for help."""
    events = [event for one in played(fakes, 15.0) for event in one.events]
    switched = [event for event in events if isinstance(event, Activated | Deactivated)]
    assert [type(event) for event in switched[:2]] == [Deactivated, Activated]
    assert switched[1].node == "dear" and switched[1].frame == switched[0].frame + 1


def test_what_failed_or_is_in_a_persons_hand_does_not_glance():
    net = LiveNets({"1": TargetNet("t", frozenset({"a"}), sampled={"b": 2})})
    assert net.targets["1"].looking(4) == {"a", "b"} and net.targets["1"].looking(5) == {"a"}
    for decision in (Quarantined(3, "1", "b", "raised"), Toggled(3, "1", "b", False)):
        assert apply(net, decision).targets["1"].looking(4) == {"a"}


@pytest.mark.parametrize("rate", [0.0, 0.03, 1.0])
def test_a_glance_teaches_what_each_frame_would_have(rate):
    left = 1.0
    for _ in range(3):
        left *= 1.0 - rate
    assert over_frames(rate, 3) == pytest.approx(1.0 - left)
