"""Agents on call look after the others, in the same frame, and where these found the target."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from bayesnet_track.engine.compiled import make_engine
from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.step import start_target, step
from bayesnet_track.journal.events.by_hand import Toggled
from bayesnet_track.journal.events.faults import Quarantined
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
    needs: tuple = ()
    asked: list = field(default_factory=list)

    def learn(self, planes, box):
        return {"box": box}

    def blend(self, old, new, rate):
        return new

    def measure(self, planes, hypotheses, weights, reference):
        frame = planes.frame.index
        if frame == self.fails_at:
            raise RuntimeError("no")
        self.asked.append((frame, float(weights @ hypotheses.boxes[:, 0])))
        return Measurement(("x", "y"), np.array([50.0 + 3.0 * frame, 40.0]), self.sd**2 * np.eye(2))


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


def test_it_goes_on_from_bytes_as_if_nothing_had_been(played):
    def stored(engine, state, frame):
        return decode_state(encode_state(state), engine, frame)

    whole = played({"cheap": Measuring(), "dear": Measuring()}, 9)
    again = played({"cheap": Measuring(), "dear": Measuring()}, 9, stored)
    assert [one.metrics for one in whole] == [one.metrics for one in again]
    assert [one.events for one in whole] == [one.events for one in again]
