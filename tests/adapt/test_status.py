"""tracking, uncertain and lost by levels of the score."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import Measures, RuleInputs
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.net import Net, apply
from bayesnet_track.journal.target_net import HiddenCause, ScoreCause, TargetNet
from bayesnet_track.journal.text.sentences import explain

LEVELS = {"score_below": 0.25, "uncertain_below": 0.6, "frames": 2}


@pytest.fixture(scope="module")
def statuses(fakes, decide_one):
    """Scores -> (the status that each frame leaves behind, the decisions)."""

    def run(scores, lost=LEVELS, adapt=None):
        root = {"lost": lost, "score": {"logistic": {"bias": 0}}} | ({"adapt": adapt} if adapt else {})
        plate, _ = fakes.plate({"root": root, "a": {"parent": "root", "agent": "a"}})
        live, memory = Net({"1": TargetNet("plate", frozenset("a"))}), RuleMemory.empty(plate)
        after, decisions = [], []
        for k, score in enumerate(scores):
            # UD and fit are those of a target that is lost: the score alone counts.
            measures = Measures({"root": 1e9}, {}, {"a": 0.0}, {"a": 0.0}, {}, 0.0, 400.0)
            now = RuleInputs(k, "1", plate, live.targets["1"], measures, {"a": 1.0}, frozenset(), score=score)
            made, memory = decide_one(now, memory)
            for one in made:
                live = apply(live, one)
            decisions += [one for one in made if isinstance(one, StatusChanged)]
            after.append(live.targets["1"].status)
        return after, decisions, memory

    return run


def test_down_and_up_through_uncertain(statuses):
    after, decisions, _ = statuses([0.9, 0.5, 0.4, 0.2, 0.1, 0.3, 0.4, 0.7, 0.8])
    t, u, x = "tracking", "uncertain", "lost"
    assert after == [t, t, u, u, x, x, u, u, t]
    assert [one.cause for one in decisions] == [
        ScoreCause(0.6, 0.4, 2, 0.5, True, key="uncertain_below", before="tracking"),
        ScoreCause(0.25, 0.1, 2, 0.2, True, key="score_below", before="uncertain"),
        ScoreCause(0.25, 0.4, 2, 0.3, False, key="score_below", before="lost"),
        ScoreCause(0.6, 0.8, 2, 0.7, False, key="uncertain_below", before="uncertain"),
    ]
    assert [explain(one) for one in decisions] == [
        "frame 2: score 0.4 < 0.6 for 2 frames → target 1 uncertain; would have stayed tracked at "
        "lost.uncertain_below ≤ 0.5",
        "frame 4: score 0.1 < 0.25 for 2 frames → target 1 lost; would not have been lost at "
        "lost.score_below ≤ 0.2",
        "frame 6: score 0.4 ≥ 0.25 for 2 frames → target 1 uncertain; would have stayed lost at "
        "lost.score_below > 0.3, the lowest of these scores",
        "frame 8: score 0.8 ≥ 0.6 for 2 frames → target 1 tracked again; would have stayed uncertain at "
        "lost.uncertain_below > 0.7, the lowest of these scores",
    ]


def test_straight_down_and_up(statuses):
    after, (_, found), _ = statuses([0.1, 0.1, 0.9, 0.9])
    assert after == ["tracking", "lost", "lost", "tracking"]
    assert explain(found) == (
        "frame 3: score 0.9 ≥ 0.6 for 2 frames → target 1 found again; would have been uncertain at "
        "lost.uncertain_below > 0.9, the lowest of these scores"
    )


def test_one_level_knows_no_uncertain(statuses):
    after, (_, found), _ = statuses([0.4, 0.4, 0.2, 0.2, 0.3, 0.3], {"score_below": 0.25, "frames": 2})
    assert after == ["tracking", "tracking", "tracking", "lost", "lost", "tracking"]
    assert "→ target 1 found again; would have stayed lost at lost.score_below > 0.3" in explain(found)


def test_a_journal_that_names_neither_key_nor_status_before_is_read():
    found = StatusChanged(8, "1", "tracking", ScoreCause(0.6, 0.8, 1, 0.7, False))
    assert explain(found) == (
        "frame 8: score 0.8 ≥ 0.6 for 1 frame → target 1 found again; would have stayed as it was at "
        "a threshold > 0.7"
    )


def test_one_frame_of_another_kind_starts_the_count_again(statuses):
    after, _, _ = statuses([0.5, 0.7, 0.5, 0.7, 0.5])
    assert set(after) == {"tracking"}


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.01, 0.99), min_size=1, max_size=40), st.integers(1, 4))
def test_a_turning_level_would_have_prevented_it(statuses, scores, frames):
    """Up to the first change, the run with the level that the log names keeps the status one frame longer."""
    rule = {"score_below": 0.3, "frames": frames}
    _, decisions, _ = statuses(scores, rule)
    if not decisions:
        return
    first = decisions[0]
    level = np.nextafter(first.cause.turning, 0)
    _, again, _ = statuses(scores[: first.frame + 1], {**rule, "score_below": float(level)})
    assert again == []


def test_quiet_levels_are_not_measured_while_uncertain(statuses):
    _, _, sure = statuses([0.9] * 6)
    _, _, unsure = statuses([0.5] * 6)
    counts = [memory.baselines["root", frozenset("a")].counts.tolist() for memory in (sure, unsure)]
    assert counts == [[6], [2]]


def test_without_levels_of_the_score_ud_and_fit_decide(statuses):
    after, decisions, _ = statuses([0.99] * 3, {"frames": 3})
    assert after[-1] == "lost" and not isinstance(decisions[0].cause, ScoreCause)


def test_a_target_that_is_probably_hidden_is_lost_at_once_and_found_when_it_is_seen(fakes, decide_one):
    """Nothing fits all the while: where modes say whether it can be seen, that is for them to weigh."""
    plate, _ = fakes.plate({"root": {"lost": {"frames": 2}}, "a": {"parent": "root", "agent": "a"}})
    live, memory = Net({"1": TargetNet("plate", frozenset("a"))}), RuleMemory.empty(plate)
    after, causes = [], []
    for k, hidden in enumerate([0.1, 0.45, 0.7, 0.9, 0.4, 0.6, 0.3, 0.2]):
        measures = Measures({"root": 10.0}, {}, {"a": 0.0}, {"a": 0.0}, {}, 0.0, 400.0)
        now = RuleInputs(
            k,
            "1",
            plate,
            live.targets["1"],
            measures,
            {"a": 1.0},
            frozenset(),
            hiding=HiddenCause(0.5, hidden),
        )
        made, memory = decide_one(now, memory)
        for one in made:
            live = apply(live, one)
        causes += [one.hidden for one in made if isinstance(one, StatusChanged)]
        after.append(live.targets["1"].status)
    t, x = "tracking", "lost"
    assert after == [t, t, x, x, x, x, x, t]
    assert causes == [HiddenCause(0.5, 0.7), None]
