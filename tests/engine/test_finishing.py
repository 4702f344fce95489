"""The first half of a target's frame by itself, and the order in which carried targets go."""

from __future__ import annotations

from types import SimpleNamespace

from bayesnet_track.engine.attachment import Rides
from bayesnet_track.engine.filtering import filter_target
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.inference.asking import Availability
from bayesnet_track.observation.planes import FramePair, PlaneCache

NODES = {"root": {"fuse": "product", "belief": {"particles": {"size": 60}}}, "a": "root", "b": "root"}


def work_of(engine, state, frame, **settings):
    cache = PlaneCache(FramePair(frame, state.previous))
    return FrameContext(engine, state.net, cache, state.history.births, **settings)


def test_who_gives_no_answer_is_of_one_frame_only(fakes):
    """Nothing of a frame is kept in the engine: the next one asks again."""
    engine = fakes.engine(NODES, {"a": fakes.gaussian(52, 41, 9), "b": fakes.gaussian(49, 37, 14)})[0]
    state = fakes.play(engine, 1)[-1].state
    out = Availability(2, {("1", "b", "observing"): "late"})
    mute = filter_target(work_of(engine, state, fakes.frame(2), availability=out), "1", state.targets["1"])
    again = filter_target(work_of(engine, state, fakes.frame(2)), "1", state.targets["1"])
    assert mute.missed == {"b": "late"} and mute.plan.active == {"a"}
    assert again.missed == {} and again.plan.active == {"a", "b"}


def test_carriers_come_before_what_they_carry():
    def order(targets, carriers):
        chain = {target: (carrier, None) for target, carrier in carriers.items()}
        return Rides(SimpleNamespace(), SimpleNamespace(), chain).carriers_first(targets)

    assert order("123", {}) == ["1", "2", "3"]
    assert order("123", {"1": "3"}) == ["3", "1", "2"]
    assert order("123", {"1": "2", "2": "3"}) == ["3", "2", "1"]
    assert order("123", {"2": "1", "3": "2"}) == ["1", "2", "3"]
