"""Agents that give no answer for a reason outside of them: as if switched off, written down, repeated."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.starting import start
from bayesnet_track.engine.step import step
from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.journal.events.faults import AgentMissed, Quarantined, Readmitted
from bayesnet_track.journal.events.load import Toggled
from bayesnet_track.journal.net import Net
from bayesnet_track.observation.planes import FramePair, PlaneCache

BELIEFS = {
    "particles": {"particles": {"size": 80}},
    "second pass": {"particles": {"size": 80, "proposal": {"second_pass": {"above_kl": 0}}}},
    "grid": {"grid": {"reset": {"region": "image"}}},
}


def nodes_of(belief, **root):
    return {"root": {"fuse": "product", "belief": BELIEFS[belief], **root}, "a": "root", "b": "root"}


def dying(fakes, frames, call=1):
    """Gives no answer in these frames from the so-manieth question on."""
    asked = {}

    def see(planes, hypotheses, reference):
        index = planes.frame.index
        asked[index] = asked.get(index, 0) + 1
        if index in frames and asked[index] >= call:
            raise AgentUnavailable("its process died")
        return fakes.gaussian(49, 37, 14)(planes, hypotheses, reference)

    return see


def play(fakes, engine, frames, external_inputs=lambda frame: ()):
    outcomes = fakes.play(engine, 0)
    for index in range(1, frames + 1):
        outcomes.append(step(engine, outcomes[-1].state, fakes.frame(index), external_inputs(index)))
    return outcomes


@pytest.mark.parametrize(
    ("belief", "call"), [("particles", 1), ("second pass", 1), ("second pass", 2), ("grid", 1), ("grid", 2)]
)
def test_the_frame_is_as_if_it_were_switched_off(fakes, belief, call):
    """Also when it had answered once in the same frame: then the frame is weighed anew."""
    a, b = fakes.gaussian(52, 41, 9), fakes.gaussian(49, 37, 14)
    live = play(fakes, fakes.engine(nodes_of(belief), {"a": a, "b": dying(fakes, {3, 4}, call)})[0], 7)
    engine = fakes.engine(nodes_of(belief), {"a": a, "b": b})[0]
    by_hand = {2: (Toggled(2, "1", "b", False),), 4: (Toggled(4, "1", "b", True),)}
    off = play(fakes, engine, 7, lambda frame: by_hand.get(frame, ()))
    assert [o.metrics for o in live] == [o.metrics for o in off]
    missed = [AgentMissed(frame, "1", "b", "its process died") for frame in (3, 4)]
    assert [one for o in live for one in o.external_inputs] == missed
    assert [e for o in live for e in o.events if isinstance(e, AgentMissed)] == missed

    # Given again it repeats, though the agent would answer now.
    again = play(fakes, engine, 7, lambda frame: live[frame].external_inputs)
    assert [(o.metrics, o.events, o.external_inputs) for o in again] == [
        (o.metrics, o.events, o.external_inputs) for o in live
    ]


def test_a_reference_that_is_not_learnt_stays_and_that_repeats(fakes):
    """The agent answers and then gives none while it learns: what it said counts."""

    def mortal(frames):
        def learn(planes, box):
            if planes.frame.index in frames:
                raise AgentUnavailable("its process died")
            return {"box": box}

        return fakes.Oracle(fakes.gaussian(49, 37, 14), reference=learn)

    nodes = nodes_of(
        "particles", learn={"below": {"ud_px2": 1e5}, "rate_max": 0.5}, lost={"above": {"ud_px2": 1e6}}
    )
    a = fakes.gaussian(52, 41, 9)
    live = play(fakes, fakes.engine(nodes, {"a": a, "b": mortal({3})})[0], 5)
    assert live[3].external_inputs == (AgentMissed(3, "1", "b", "its process died", "learning"),)
    assert "b" in live[3].metrics[0].active and live[3].metrics[0].learn_rate > 0

    def boxes(outcome):
        return outcome.state.targets["1"].references["b"]["box"]

    np.testing.assert_array_equal(boxes(live[3]), boxes(live[2]))
    assert (boxes(live[4]) != boxes(live[3])).any()
    again = play(
        fakes, fakes.engine(nodes, {"a": a, "b": mortal(())})[0], 5, lambda frame: live[frame].external_inputs
    )
    np.testing.assert_array_equal(boxes(again[5]), boxes(live[5]))
    assert [(o.metrics, o.events) for o in again] == [(o.metrics, o.events) for o in live]


def test_one_that_misses_three_frames_in_a_row_is_out_for_a_while(fakes):
    """Each frame waits for it; so it is tried more and more rarely."""
    engine = fakes.engine(nodes_of("particles"), {"a": fakes.flat(), "b": dying(fakes, range(2, 99))})[0]
    outcomes = play(fakes, engine, 18)
    events = [e for o in outcomes for e in o.events if isinstance(e, Quarantined | Readmitted)]
    reason = "gave no answer in 3 frames in a row, the last time: its process died"
    assert events == [
        Quarantined(4, "1", "b", reason, 14, 1),
        Readmitted(13, "1", "b", True, 1, 10),
        Quarantined(16, "1", "b", reason, 36, 2),
    ]
    assert [one.frame for o in outcomes for one in o.external_inputs] == [2, 3, 4, 14, 15, 16]


def test_with_every_agent_missing_the_belief_is_prediction_only(fakes):
    ud = np.zeros(9)
    for seed in range(4):
        mute = {"a": dying(fakes, range(1, 99)), "b": dying(fakes, range(1, 99))}
        outcomes = play(fakes, fakes.engine(nodes_of("particles"), mute, seed)[0], 9)
        ud += [o.metrics[0].ud_px2 for o in outcomes[1:]]
        assert all(o.metrics[0].status == "lost" and o.metrics[0].score < 0.05 for o in outcomes[4:])
    assert (np.diff(ud) > 0).all() and ud[-1] > 4 * ud[0]


def test_one_that_gives_no_first_reference_is_out(fakes):
    def learn(planes, box):
        raise AgentUnavailable("its process died")

    engine = fakes.engine(
        nodes_of("particles"), {"a": fakes.flat(), "b": fakes.Oracle(fakes.flat(), reference=learn)}
    )[0]
    work = FrameContext(engine, Net(), PlaneCache(FramePair(fakes.frame(0), None)))
    born = start(work, "1", "plate", np.array(fakes.START), "birth")
    assert born.decisions[1] == Quarantined(0, "1", "b", "gave no first reference: its process died", 10)
    assert work.availability.events == (AgentMissed(0, "1", "b", "its process died", "starting"),)


def test_one_that_gave_no_first_reference_learns_it_later(fakes):
    """It dies in the first frame, and where it is tried again first; then it learns at the estimate."""
    dies_in, learnt = {0, 9}, []

    def learn(planes, box):
        if planes.frame.index in dies_in:
            raise AgentUnavailable("its process died")
        learnt.append((planes.frame.index, tuple(box[:2])))
        return {"box": box}

    see = {"a": fakes.gaussian(52, 41, 6), "b": fakes.Oracle(fakes.gaussian(52, 41, 6), reference=learn)}
    outcomes = play(fakes, fakes.engine(nodes_of("particles"), see)[0], 34)
    events = [e for o in outcomes for e in o.events if isinstance(e, Quarantined | Readmitted)]
    reason = "gave no first reference: its process died"
    assert events == [
        Quarantined(0, "1", "b", reason, 10, 1),
        Readmitted(9, "1", "b", True, 1, 10),
        Quarantined(9, "1", "b", reason, 29, 2),
        Readmitted(28, "1", "b", True, 2, 20),
    ]
    assert learnt[0] == (28, pytest.approx(outcomes[28].metrics[0].centre_box[:2], abs=0.01))
    assert [o.metrics[0].active for o in outcomes[27:30]] == [("a",), ("a",), ("a", "b")]
    missed = [one for o in outcomes for one in o.external_inputs]
    assert missed == [AgentMissed(9, "1", "b", "its process died", "starting")]
