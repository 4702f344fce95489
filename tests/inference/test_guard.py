"""The drift guard: what parts, what is held and pulled back, and what follows."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track.graph.spec import Guard
from bayesnet_track.inference.learn import LearningInputs, SlowReferences, changes, guard, judge, watch
from bayesnet_track.observation.cue import Hypotheses, blend_arrays
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache

AT = Hypotheses(np.array([[50.0, 40.0, 20.0, 20.0]]))


class Level:
    """Scores what is seen, a number, against the number of its reference: -|seen - level|."""

    needs = ()

    def __init__(self, seen=0.0):
        self.seen = seen

    def learn(self, planes, box):
        return {"level": np.array([self.seen])}

    def blend(self, old, new, rate):
        return blend_arrays(old, new, rate)

    def log_likelihood(self, planes, hypotheses, reference):
        return -np.abs(self.seen - reference["level"]) * np.ones(len(hypotheses))


class Follower(SimpleNamespace):
    """A cue with a guard, frame by frame: `see(value, rate)` is one learning frame."""

    def see(self, value, rate=0.1):
        self.cue.seen = value
        cues, references, rates = {"a": self.cue}, {"a": {"level": self.level}}, {"a": rate}
        image = np.zeros((80, 100, 3), np.uint8)
        cache = PlaneCache(FramePair(Frame(self.frame, float(self.frame), image), None))
        lesson = LearningInputs(cues, cache, AT)
        judged = judge(lesson, self.watched, references, rates, self.rule)
        assert not judged.faults
        if "a" not in judged.held and rate > 0:
            references = {"a": self.cue.blend(references["a"], self.cue.learn(None, None), rate)}
        moved, after, faults = guard(lesson, self.watched, judged, references, rates, self.rule)
        assert not faults
        self.events += changes(self.frame, "1", self.watched, after, judged, self.rule)
        self.level, self.watched, self.frame = moved["a"]["level"], after, self.frame + 1
        return float(self.level[0])

    @property
    def slow(self):
        return float(self.watched.slow["a"]["level"][0])


def follower(**settings):
    rule = Guard(**{"every": 1, **settings})
    first = {"a": {"level": np.zeros(1)}}
    cue = Level()
    return Follower(
        cue=cue,
        rule=rule,
        level=np.zeros(1),
        watched=watch(first, {"a"}, rule),
        frame=1,
        events=[],
    )


def test_a_reference_that_creeps_away_is_held_and_pulled_back():
    """What is seen moves by 0.05 a frame; unguarded the reference would follow it without end."""
    one, free = follower(rate=0.002, apart_nats=1.0, pull=0.05), follower(apart_nats=1e9)
    for k in range(200):
        one.see(0.05 * k, rate=0.2), free.see(0.05 * k, rate=0.2)
    assert float(free.level[0]) > 9.0
    assert float(one.level[0]) < 3.0 and one.slow < 0.5
    event = one.events[0]
    assert event.parted and event.node == "a" and event.own - event.slow > event.apart_nats == 1.0


def test_it_learns_again_when_they_agree():
    one = follower(rate=0.0, apart_nats=1.0, pull=0.0)
    one.level = np.array([3.0])
    assert one.see(3.0) == 3.0 and one.see(3.0) == 3.0  # held: own 0, slow -3
    assert one.see(0.5) == pytest.approx(
        3.0 - 0.1 * 2.5
    )  # own -2.5, slow -0.5: the slow one explains it better
    assert [(event.parted, event.frames) for event in one.events] == [(True, 0), (False, 2)]


def test_the_slow_one_follows_at_its_rate_whatever_the_spacing():
    every, seldom = follower(rate=0.01), follower(rate=0.01, every=5)
    for one in (every, seldom):
        one.level = np.array([0.5])
        for _ in range(100):
            one.see(0.5, rate=1e-12)
    assert every.slow == pytest.approx(0.5 * (1 - 0.99**100))
    assert seldom.slow == pytest.approx(every.slow)


def test_what_has_parted_is_pulled_back_at_its_rate_whatever_the_spacing():
    every, seldom = (follower(rate=0.0, pull=0.02, apart_nats=1.0, every=k) for k in (1, 5))
    for one in (every, seldom):
        one.level = np.array([3.0])
        for _ in range(10):
            one.see(3.0, rate=1e-12)
    assert float(every.level[0]) == pytest.approx(3.0 * 0.98**10)
    assert float(seldom.level[0]) == pytest.approx(float(every.level[0]))


def test_frames_that_are_not_learnt_from_count_nothing():
    one = follower(pull=0.5)
    one.level = np.array([3.0])
    before = one.watched
    assert one.see(3.0, rate=0.0) == 3.0
    assert one.watched is before and one.events == []


def test_between_comparisons_a_parted_reference_stays_held():
    one = follower(every=3, rate=0.0, pull=0.0)
    one.level = np.array([3.0])
    seen = [one.see(2.0, rate=0.5) for _ in range(5)]
    assert seen == [2.5, 2.25, 2.25, 2.25, 2.25]  # compared in the third frame: held there and after


def test_without_a_guard_nothing_is_watched():
    references = {"a": {"level": np.zeros(1)}}
    assert watch(references, {"a"}, None).slow == {}
    judged = judge(LearningInputs({"a": Level()}, None, AT), SlowReferences(), references, {"a": 0.1}, None)
    assert judged.gaps == {} and judged.held == frozenset()


def test_only_looks_are_guarded():
    references = {"a": {"level": np.zeros(1)}, "speed": {"level": np.ones(1)}}
    assert set(watch(references, {"a"}, Guard()).slow) == {"a"}


def test_a_cue_that_raises_is_named():
    class Broken(Level):
        def log_likelihood(self, planes, hypotheses, reference):
            raise ArithmeticError("no")

    cache = PlaneCache(FramePair(Frame(1, 1.0, np.zeros((80, 100, 3), np.uint8)), None))
    references, rule = {"a": {"level": np.zeros(1)}}, Guard(every=1)
    watched = watch(references, {"a"}, rule)
    judged = judge(LearningInputs({"a": Broken()}, cache, AT), watched, references, {"a": 0.1}, rule)
    assert judged.faults == {"a": "raised ArithmeticError while guarded: no"}


def test_a_blend_that_is_not_finite_is_named_and_not_taken():
    class Broken(Level):
        def blend(self, old, new, rate):
            return {"level": np.full(1, np.nan)}

    cues, references, rule = {"a": Broken(2.0)}, {"a": {"level": np.full(1, 2.0)}}, Guard(every=1)
    cache = PlaneCache(FramePair(Frame(1, 1.0, np.zeros((80, 100, 3), np.uint8)), None))
    watched = watch({"a": {"level": np.zeros(1)}}, {"a"}, rule)
    lesson = LearningInputs(cues, cache, AT)
    judged = judge(lesson, watched, references, {"a": 0.1}, rule)
    moved, after, faults = guard(lesson, watched, judged, references, {"a": 0.1}, rule)
    assert judged.held == {"a"} and moved == references and after.slow == watched.slow
    assert faults == {"a": "made a reference whose 'level' is not finite"}
