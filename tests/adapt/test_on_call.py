"""`on_call`: an expensive agent stays on, and runs when it is due or in the frame in which it is needed."""

from __future__ import annotations

import pytest

from bayesnet_track.engine.second_steps import is_due
from bayesnet_track.journal.events.switches import Activated, Deactivated, Scheduled
from bayesnet_track.journal.net import Net, apply, replay
from bayesnet_track.journal.target_net import TargetNet, Turn
from bayesnet_track.journal.text.sentences import explain

ADAPT = {"agents": ["dear"], "on_call": {"every": 4, "agree": 0.6, "above": {"ud_px2": 60.0}}}
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


def played(fakes, cheap, frames=16):
    """Outcomes where the cheap agent sees `cheap(frame)`: where the target is, and how sharply."""

    def see(planes, hypotheses, reference):
        return fakes.gaussian(*cheap(planes.frame.index))(planes, hypotheses, reference)

    engine, cues = fakes.engine(NODES, {"cheap": see, "dear": fakes.gaussian(50.0, 40.0, 2.0)})
    return fakes.play(engine, frames), cues


def runs(outcomes):
    return [one.metrics[0].frame for one in outcomes[1:] if "dear" in one.metrics[0].active]


def scheduled(outcomes):
    return [event for one in outcomes for event in one.events if isinstance(event, Scheduled)]


def test_the_gap_grows_to_its_largest_while_the_two_agree(fakes):
    outcomes, cues = played(fakes, lambda frame: (50.0, 40.0, 3.0))
    assert runs(outcomes) == [1, 3, 6, 10, 14]
    found = scheduled(outcomes)
    assert [(one.frame, one.gap, one.due) for one in found] == [
        (1, 2, 3),
        (3, 3, 6),
        (6, 4, 10),
        (10, 4, 14),
        (14, 4, 18),
    ]
    assert all(one.overlap >= 0.6 and one.called is None for one in found)
    assert not [e for one in outcomes for e in one.events if isinstance(e, Activated | Deactivated)]
    assert all("dear" in one.state.net.targets["1"].active for one in outcomes)
    # References learn in the frames of a run, as much as in all of them.
    assert [line.frame for one in outcomes[1:] for line in one.metrics if line.learn_rate > 0] == runs(
        outcomes
    )
    assert cues["cheap"].blended[2] == pytest.approx(1 - (1 - cues["cheap"].blended[0]) ** 3, rel=0.2)


def test_it_runs_in_the_very_frame_in_which_the_others_are_unsure(fakes):
    outcomes, _ = played(fakes, lambda frame: (50.0, 40.0, 40.0 if frame == 8 else 3.0))
    assert 8 in runs(outcomes) and 7 not in runs(outcomes)
    (event,) = [one for one in scheduled(outcomes) if one.called is not None]
    assert (event.frame, event.was_due) == (8, 10) and event.called.value > 60.0
    line = outcomes[8].metrics[0]
    assert line.frame == 8 and line.ud_px2 < 10.0
    told = explain(event)
    assert told.startswith("frame 8: without dear UD ") and "→ dear at once, not in frame 10" in told


def test_disagreement_makes_it_run_in_every_frame_again(fakes):
    outcomes, _ = played(fakes, lambda frame: (50.0 if frame < 10 else 75.0, 40.0, 3.0), 20)
    assert runs(outcomes)[:4] == [1, 3, 6, 10] and runs(outcomes)[4:7] == [11, 12, 13]
    event = next(one for one in scheduled(outcomes) if one.frame == 10)
    assert event.gap == 1 and event.overlap < 0.6
    assert "< 0.6 → dear in every frame; would have rested at agree ≤" in explain(event)
    assert outcomes[10].state.net.targets["1"].turn is None


def test_the_net_of_a_frame_follows_from_the_decisions(fakes):
    outcomes, _ = played(fakes, lambda frame: (50.0, 40.0, 3.0), 9)
    events = [event for one in outcomes for event in one.events if hasattr(event, "change")]
    starts = [event for one in outcomes for event in one.events if type(event).__name__ == "TargetStarted"]
    for n, one in enumerate(outcomes):
        net = replay([*starts, *events], n + 1)
        assert net.targets["1"].turn == one.state.net.targets["1"].turn


def test_nobody_rests_while_the_target_is_lost():
    net = TargetNet("t", frozenset({"a", "b"}), turn=Turn(due=9, gap=3))
    assert [is_due(net, frame) for frame in (7, 8, 9, 10)] == [False, False, True, True]
    lost = TargetNet("t", frozenset({"a", "b"}), turn=Turn(due=9, gap=3), status="lost")
    assert is_due(lost, 7)


def test_a_rule_that_calls_nobody_schedules_nothing(drive):
    nodes = {"root": {"fuse": "product", "adapt": ADAPT}, "cheap": "root", "dear": "root"}
    assert drive(nodes, [1.0] * 5).of(Scheduled) == []


def test_a_schedule_that_ends_leaves_no_turn():
    event = Scheduled(5, "1", ("a",), "root", 0.4, 0.6, 1, 6, 7)
    nets = Net({"1": TargetNet("t", frozenset({"a"}), turn=Turn(7, 3))})
    assert apply(nets, event).targets["1"].turn is None
