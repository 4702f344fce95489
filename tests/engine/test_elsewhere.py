"""A missing target of a Gaussian belief is looked for elsewhere by an agent that says how sure it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from bayesnet_track.engine.scoring.score import log_odds
from bayesnet_track.engine.second_steps import APART_BOX, pick_place
from bayesnet_track.engine.step import make_engine
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.journal.events.faults import AgentMissed, Quarantined
from bayesnet_track.observation.cue import Measurement

BOX = (40.0, 50.0, 10.0, 10.0)
AWAY = (4, 9)
"""First and last frame in which nothing is to be seen."""
NEW = np.array([95.0, 22.0])


@dataclass(frozen=True)
class Finder:
    """It sees the target up to `reach` px from where it is asked, and else clutter right there.

    The target is at BOX, then away, then at NEW. Places of which it is asked, and how far
    apart the hypotheses are there, are written down by frame.
    """

    reach: float = 30.0
    beside: float | None = None
    clutter: float = 0.05
    sure: float = 0.99
    breaks: Exception | None = None
    seen: tuple = ()
    asked: dict = field(default_factory=dict)
    extents: dict = field(default_factory=dict)
    needs: tuple = ()

    def learn(self, planes, box):
        return {"box": box}

    def blend(self, old, new, rate):
        return new

    def measure(self, planes, hypotheses, weights, reference):
        frame, place = planes.frame.index, (weights @ hypotheses.boxes)[:2]
        places = self.asked.setdefault(frame, [])
        places.append(place)
        np.testing.assert_allclose(weights, 1.0 / len(weights))
        self.extents.setdefault(frame, []).append(tuple(np.ptp(hypotheses.boxes[:, :2], axis=0)))
        if self.breaks is not None and len(places) > 1:
            raise self.breaks
        true = np.array(BOX[:2]) if frame < AWAY[0] else NEW if frame > AWAY[1] else np.full(2, 1e6)
        there = np.abs(true - place).max() < self.reach
        mean = np.array([*(true if there else place), *BOX[2:]])
        if there and frame > AWAY[1] and self.seen:
            mean = np.array(self.seen)
        if self.beside is not None and len(places) > 1:  # surer of what is near the belief's own place
            there, mean = True, np.array([BOX[0] + self.beside, *BOX[1:]])
        confidence = self.sure if there else self.clutter
        return Measurement(("x", "y", "w", "h"), mean, np.eye(4), confidence=confidence)


@pytest.fixture
def play(fakes):
    """(finder, relocalize) -> outcomes of thirty frames, or as many as said."""

    def run(finder, relocalize, frames=30):
        walk = {"sd_px": {"x": 2.0, "y": 2.0}, "relocalize": relocalize}
        root = {
            "belief": {"gaussian": {"filter": "kalman"}},
            "motion": {"random_walk": {key: value for key, value in walk.items() if value is not None}},
            "fuse": "product",
            "score": {"logistic": {"bias": 0.0, "memory_frames": 0, "confidence": {"finder": 1.0}}},
            "lost": {"score_below": 0.2, "uncertain_below": 0.5, "frames": 1},
        }
        declared = {"finder": fakes.declare(finder, is_confident=lambda parameters: True)}
        engine = make_engine(fakes.graph({"root": root, "finder": "root"}, declared), 0, declared)
        return fakes.play(engine, frames, {"1": BOX})

    return run


def told(outcomes):
    return [event for one in outcomes for event in one.events if isinstance(event, Reappeared)]


def last_place(outcomes):
    return np.array(outcomes[-1].metrics[0].centre_box[:2])


def test_it_is_found_where_it_reappears_and_that_is_told_with_its_numbers(play):
    outcomes = play(Finder(), {"share": 0.1, "grow_box": 1.0})
    (event,) = told(outcomes)
    assert np.abs(last_place(outcomes) - NEW).max() < 0.5
    assert outcomes[-1].metrics[0].status == "tracking"
    assert event.frame > AWAY[1] and event.hypotheses == 0
    odds = 0.1 / 0.9 * math.exp(log_odds(0.99) - log_odds(0.05))
    held = event.held / (1.0 - event.held)
    count = odds / held  # of the places in reach
    assert count == pytest.approx(round(count))
    assert event.within_px == pytest.approx(10.0 * (event.frame - AWAY[0] + 1))
    across, down = min(2 * event.within_px, 40.0 + event.within_px, 119.0), min(50.0 + event.within_px, 99.0)
    assert round(count) == round(across / (10 * APART_BOX)) * round(down / (10 * APART_BOX))


def test_with_less_than_the_share_that_is_told_it_would_not_have(play):
    (event,) = told(play(Finder(), {"share": 0.1, "grow_box": 1.0}))
    found = {
        factor: [
            one.frame for one in told(play(Finder(), {"share": factor * event.turning, "grow_box": 1.0}))
        ]
        for factor in (0.99, 1.01)
    }
    assert event.frame in found[1.01] and event.frame not in found[0.99]


@pytest.mark.parametrize(
    ("finder", "relocalize"),
    [
        (Finder(), None),
        (Finder(clutter=0.15, sure=0.5), {"share": 0.1}),
        (Finder(reach=2.0), {"share": 0.1, "grow_box": 0.1}),
    ],
    ids=["without", "hardly surer than here", "not in reach"],
)
def test_else_it_stays_where_it_is(play, finder, relocalize):
    outcomes = play(finder, relocalize)
    assert told(outcomes) == []
    assert np.abs(last_place(outcomes) - BOX[:2]).max() < 1.0


def test_without_growth_the_whole_frame_is_searched_at_once(play):
    (event,) = told(play(Finder(), {"share": 0.1}))
    assert event.within_px is None and "the whole frame" in event.describe()


def test_all_places_are_looked_at_in_turn_and_only_while_it_is_missing(play):
    finder = Finder(reach=0.0, clutter=0.05)
    outcomes = play(finder, {"share": 0.1})
    lost = [outcome.state.net.targets["1"].status == "lost" for outcome in outcomes]
    assert [len(finder.asked[frame]) > 1 for frame in range(1, 31)] == lost[:-1]
    elsewhere = {tuple(place) for places in finder.asked.values() for place in places[1:2]}
    assert len(elsewhere) == 3 * 2  # of the frame of 120 x 100 px, about 40 px apart


def test_an_agent_is_asked_with_hypotheses_as_far_apart_as_the_places(play):
    finder = Finder(reach=0.0)
    play(finder, {"share": 0.1})
    (extents,) = {extent for places in finder.extents.values() for extent in places[1:2]}
    assert extents == (10.0 * APART_BOX, 10.0 * APART_BOX)


@pytest.mark.parametrize("every", [1, 2, 3, 4])
def test_all_places_have_their_turn_however_seldom_an_agent_runs(every):
    for count in range(1, 50):
        frames = range(3, 3 + 4 * every * count, every)
        assert {pick_place(frame, count) for frame in frames} == set(range(count))


def test_a_target_is_looked_for_once_it_is_uncertain_for_as_long_as_it_takes_to_be_lost(play):
    finder = Finder(clutter=0.3)  # a score between the levels of the two statuses
    outcomes = play(finder, {"share": 0.2})
    status = [outcome.state.net.targets["1"].status for outcome in outcomes]
    away = range(AWAY[0], AWAY[1] + 1)
    assert {status[frame] for frame in away} == {"uncertain"}
    assert [len(finder.asked[frame]) > 1 for frame in away] == [frame > AWAY[0] for frame in away]
    (event,) = told(outcomes)
    assert event.frame > AWAY[1] and np.abs(last_place(outcomes) - NEW).max() < 0.5


def test_an_agent_that_fails_elsewhere_fails_in_that_frame(play):
    outcomes = play(Finder(breaks=RuntimeError("asked twice")), {"share": 0.1})
    assert told(outcomes) == []
    (first, *_) = [event for one in outcomes for event in one.events if isinstance(event, Quarantined)]
    assert "asked twice" in first.describe()
    assert "finder" not in outcomes[first.frame].metrics[0].active


def test_one_that_gives_no_answer_elsewhere_has_no_part_in_the_frame(play):
    """Else a run could not be repeated from what is written of it."""
    outcomes = play(Finder(breaks=AgentUnavailable("its process died")), {"share": 0.1})
    missed = [outcome for outcome in outcomes if any(isinstance(one, AgentMissed) for one in outcome.events)]
    assert missed and told(outcomes) == []
    assert not any("finder" in outcome.metrics[0].active for outcome in missed)


def test_an_agent_of_a_part_does_not_look_for_the_whole(fakes):
    part = {"parent": "root", "fuse": {"latent": {"given": {"sd_px": {"x": 1.0, "y": 1.0}}}}}
    root = {
        "belief": {"gaussian": {}},
        "motion": {"random_walk": {"sd_px": {"x": 2.0, "y": 2.0}, "relocalize": {"share": 0.1}}},
        "fuse": "product",
        "lost": {},
    }
    declared = {"finder": fakes.declare(Finder(), is_confident=lambda parameters: True)}
    finder = {"parent": "part", "agent": "finder"}
    with pytest.raises(GraphError, match="no agent of the whole says how sure it is"):
        fakes.graph({"root": root, "part": part, "finder": finder}, declared)


def test_what_is_seen_beyond_the_frame_or_without_extent_begins_inside(play):
    """The belief of a guest's odd measurement must not end the run."""
    finder = Finder(seen=(-500.0, 22.0, 0.0, 0.0))
    event, *_ = told(play(finder, {"share": 0.1}))
    assert (event.x, event.y) == (0.0, 22.0)


@pytest.mark.parametrize(("beside", "jumps"), [(9.0, False), (11.0, True)])
def test_what_overlaps_the_box_is_not_elsewhere(play, beside, jumps):
    """An agent that is asked of another place may see again what it sees here."""
    assert bool(told(play(Finder(beside=beside), {"share": 0.9}))) == jumps


def test_a_find_beyond_the_square_is_told_with_how_far_it_is(play):
    (event, *_) = told(play(Finder(beside=60.0), {"share": 0.9, "grow_box": 0.1}))
    assert event.within_px == pytest.approx(60.0, abs=1.0)


def test_it_goes_only_where_the_agent_is_surer_than_here_and_than_not(play):
    """However probable a jump is, and however few places there are."""
    for here, there in ((0.7, 0.7), (0.05, 0.45)):
        assert told(play(Finder(clutter=here, sure=there), {"share": 0.99})) == []
    assert told(play(Finder(clutter=0.05, sure=0.55), {"share": 0.99})) != []
