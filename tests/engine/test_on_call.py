"""Agents on call look after the others, in the same frame, and where these found the target."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.step import make_engine, start_target, step
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.load import Toggled
from bayesnet_track.journal.events.switches import Scheduled
from bayesnet_track.journal.net import apply
from bayesnet_track.journal.target_net import Turn
from bayesnet_track.observation.cue import Measurement
from bayesnet_track.runtime.checkpoints.state_codec import decode_state, encode_state

ROOT = {
    "belief": {"gaussian": {"filter": "kalman"}},
    "motion": {"random_walk": {"sd_px": {"x": 8.0, "y": 8.0}}},
    "fuse": "product",
    "estimate": "mean",
    "ud_fields": ["x", "y"],
    "adapt": {"agents": ["dear"], "on_call": {"every": 3, "agree": 0.5, "above": {"ud_px2": 60.0}}},
}


@dataclass(frozen=True)
class Measuring:
    """A cue that measures the place x = 50 + 3 t, and writes down when and around where it is asked."""

    sd: float = 2.0
    fails_at: int = -1
    wrong_until: int = 0
    needs: tuple = ()
    asked: list = field(default_factory=list)
    rates: list = field(default_factory=list)

    def learn(self, planes, box):
        return {"box": box}

    def blend(self, old, new, rate):
        self.rates.append(rate)
        return new

    def measure(self, planes, hypotheses, weights, reference):
        frame = planes.frame.index
        if frame == self.fails_at:
            raise RuntimeError("no")
        self.asked.append((frame, float(weights @ hypotheses.boxes[:, 0])))
        x = 50.0 + 3.0 * frame + (12.0 if frame < self.wrong_until else 0.0)
        return Measurement(("x", "y"), np.array([x, 40.0]), self.sd**2 * np.eye(2))


@pytest.fixture
def played(fakes):
    """(agent -> cue, frames) -> outcomes; `between` may change the state, `inputs` are given by frame."""

    def play(cues, frames, between=lambda engine, state, frame: state, inputs=None):
        declared = {name: fakes.declare(cue) for name, cue in cues.items()}
        engine = make_engine(
            fakes.graph({"root": ROOT, **dict.fromkeys(cues, "root")}, declared), 0, declared
        )
        first = start_target(engine, State(), fakes.frame(0), "1", "plate", np.array(fakes.START))
        outcomes = [first]
        for n in range(1, frames + 1):
            frame = fakes.frame(n)
            state = between(engine, outcomes[-1].state, fakes.frame(n - 1))
            outcomes.append(step(engine, state, frame, (inputs or {}).get(n, ())))
        return outcomes

    return play


def active(outcomes):
    return [one.metrics[0].active for one in outcomes[1:]]


def test_it_is_asked_once_a_frame_and_around_what_the_others_found(played):
    cues = {"cheap": Measuring(), "dear": Measuring()}
    outcomes = played(cues, 9)
    assert [frame for frame, _ in cues["cheap"].asked] == list(range(1, 10))
    assert [frame for frame, _ in cues["dear"].asked] == [1, 3, 6, 9]
    assert ["dear" in names for names in active(outcomes)] == [n in (1, 3, 6, 9) for n in range(1, 10)]
    for frame, x in cues["dear"].asked:
        ahead = dict(cues["cheap"].asked)[frame]
        true = 50.0 + 3.0 * frame
        assert abs(x - true) < 0.5 < abs(ahead - true)  # the others search around the prediction


def test_the_others_alone_say_when_it_is_needed(played):
    cues = {"cheap": Measuring(sd=30.0), "dear": Measuring()}
    outcomes = played(cues, 8)
    assert all(names == ("cheap", "dear") for names in active(outcomes))
    assert outcomes[-1].metrics[0].ud_px2 < 10.0


def test_without_others_it_runs_in_every_frame(played):
    cues = {"cheap": Measuring(fails_at=4), "dear": Measuring()}
    outcomes = played(cues, 10)
    assert any(isinstance(event, Quarantined) for event in outcomes[4].events)
    assert [names for names in active(outcomes)][4:] == [("dear",)] * 6


def test_a_person_who_switches_it_on_has_it_run_in_every_frame(played):
    cues = {"cheap": Measuring(), "dear": Measuring()}
    outcomes = played(cues, 10, inputs={4: (Toggled(4, "1", "dear", True),)})
    assert all("dear" in names for names in active(outcomes)[4:])


def test_the_belief_is_weighed_once_where_every_agent_on_call_is_switched_on_by_hand(played, monkeypatch):
    """Weighed twice, the particles would be drawn with other random numbers."""

    def by_hand(engine, state, frame):
        return (
            replace(state, net=apply(state.net, Toggled(0, "1", "dear", True))) if frame.index == 0 else state
        )

    monkeypatch.setitem(ROOT, "belief", {"particles": {"size": 200}})
    called = played({"cheap": Measuring(), "dear": Measuring()}, 6, by_hand)
    monkeypatch.delitem(ROOT, "adapt")
    always = played({"cheap": Measuring(), "dear": Measuring()}, 6)
    assert [one.metrics for one in called] == [one.metrics for one in always]


def test_it_goes_on_from_bytes_as_if_nothing_had_been(played):
    def stored(engine, state, frame):
        return decode_state(encode_state(state), engine, frame)

    whole = played({"cheap": Measuring(), "dear": Measuring()}, 9)
    again = played({"cheap": Measuring(), "dear": Measuring()}, 9, stored)
    assert [one.metrics for one in whole] == [one.metrics for one in again]
    assert [one.events for one in whole] == [one.events for one in again]


def test_that_it_failed_says_nothing_of_the_others(played):
    outcomes = played({"cheap": Measuring(), "dear": Measuring(fails_at=3)}, 14)
    compared = [event.frame for one in outcomes for event in one.events if isinstance(event, Scheduled)]
    assert compared == [1, 13]
    assert outcomes[3].state.net.targets["1"].turn == Turn(due=3, gap=2)


def test_it_runs_in_the_very_frame_in_which_all_others_fail(played, monkeypatch):
    monkeypatch.setitem(ROOT["adapt"]["on_call"], "above", {"ud_px2": 1e6})
    outcomes = played({"cheap": Measuring(fails_at=4), "dear": Measuring()}, 4)
    assert active(outcomes)[1:] == [("cheap",), ("cheap", "dear"), ("dear",)]
    assert not any(isinstance(event, Scheduled) for event in outcomes[4].events)


@pytest.mark.parametrize("failing", ["cheap", "dear"])
def test_those_left_learn_as_much_as_if_no_agent_were_on_call(played, monkeypatch, failing):
    monkeypatch.setitem(ROOT, "learn", {"below": {"ud_px2": 1e6}})
    cues = {name: Measuring(fails_at=9 if name == failing else -1) for name in ("cheap", "dear")}
    played(cues, 14)
    (left,) = cues.keys() - {failing}
    rates = cues[left].rates
    assert rates[0] < rates[1] < rates[2]  # gaps of 1, 2 and 3 frames
    assert rates[-6:] == pytest.approx(6 * rates[:1], rel=1e-3)


def test_the_baseline_is_that_of_those_who_look_first(played, monkeypatch):
    """UD without it would be above twice the baseline with it in every frame."""
    monkeypatch.setitem(ROOT["adapt"]["on_call"], "above", {"ud_baseline": 2.0})
    cues = {"cheap": Measuring(sd=6.0, wrong_until=12), "dear": Measuring(sd=1.0)}
    ran = ["dear" in names for names in active(played(cues, 24))]
    assert ran[-6:].count(True) == 2


def test_it_works_beside_modes_and_the_most_probable_state(played, monkeypatch):
    modes = {"seen": {"mean_frames": 60}, "behind": {"mean_frames": 15, "hidden": {}}}
    for key, value in (("belief", {"particles": {"size": 200}}), ("estimate", "map"), ("modes", modes)):
        monkeypatch.setitem(ROOT, key, value)
    outcomes = played({"cheap": Measuring(), "dear": Measuring()}, 3)
    assert "dear" in active(outcomes)[0]
