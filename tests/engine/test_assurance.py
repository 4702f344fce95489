"""The guarantee withholds `tracking` and changes nothing else; the alarm is seldom false, and tells why."""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.engine.scoring.outcome import (
    e_value,
    is_assured,
    judge_alarm,
    judge_assurance,
    level_afterwards,
    means_of,
    next_cusum,
    reported_status,
    with_evidence,
    with_recent,
)
from bayesnet_track.engine.scoring.score import ScoreState
from bayesnet_track.graph.spec import Alarm, Guarantee
from bayesnet_track.graph.text.change import set_value
from bayesnet_track.graphs import find_graph
from bayesnet_track.journal.events.statuses import AlarmEnded, AlarmRaised, AssuranceChanged
from bayesnet_track.sources.scenes import make_scene

TWO = Guarantee(above=0.5, frames=2)
ROOT = ("targets", "target", "nodes", "target")


def test_tracking_is_said_while_the_mean_of_the_last_scores_is_above_the_level():
    first = with_recent(ScoreState(), 0.75, TWO)
    second = with_recent(first, 0.25, TWO)
    third = with_recent(second, 0.5, TWO)
    assert third.recent == (0.25, 0.5)
    assert [is_assured(one, TWO) for one in (ScoreState(), first, second, third)] == [
        True,
        True,
        False,
        False,
    ]
    assert [reported_status(s, second, TWO) for s in ("tracking", "uncertain", "lost")] == [
        "uncertain",
        "uncertain",
        "lost",
    ]
    assert reported_status("tracking", second, None) == "tracking"
    assert judge_assurance(first, second, TWO, 7, "1") == AssuranceChanged(7, "1", False, 0.5, 0.5, 2, 0.05)
    assert judge_assurance(second, third, TWO, 8, "1") is None


def test_a_run_that_is_over_has_the_lowest_level_that_its_share_allows():
    assert means_of([0.75, 0.25, 0.5], 2).tolist() == [0.75, 0.5, 0.375]
    means = np.array([0.9, 0.2, 0.5, 0.7])
    # At most half of the frames above: from 0.5 on, and 0.3 is allowed there. All of them: only from 0.8 on.
    assert level_afterwards((0.3, 0.8), means) == 0.5
    assert level_afterwards((0.6, 0.8), means) == 0.6
    assert level_afterwards((0.8, 0.8), means) == 0.8
    assert level_afterwards((0.8, 0.1), means) == 0.1
    # With equal means none may be above where not all may.
    assert level_afterwards((0.3, 0.95), np.full(4, 0.9)) == 0.9
    rng = np.random.default_rng(0)
    for _ in range(200):
        levels, some = np.sort(rng.random(5)), rng.random(7).round(1)
        every = np.concatenate([levels, some, [0.0]])
        fits = [
            a for a in every if any(a >= levels[k] and (some > a).mean() <= (k + 1) / 5 for k in range(5))
        ]
        assert level_afterwards(levels.tolist(), some) == min(fits)


@pytest.mark.parametrize(("score", "cusum"), [(0.0, 3.0), (0.05, 3.0), (0.5, 1.0), (1.0, 1.0)])
def test_evidence_rises_and_falls_by_at_most_one_a_frame(score, cusum):
    assert next_cusum(2.0, score) == pytest.approx(cusum)
    assert next_cusum(0.2, 1.0) == 0.0
    assert next_cusum(1.0, 1.0 / (1.0 + math.exp(1.5))) == pytest.approx(1.5)


def test_the_alarm_is_raised_once_and_ends_with_its_evidence():
    rule, scored, said = Alarm(total=30.0, videos=24), ScoreState(), []
    for frame, score in enumerate([0.9, *[0.01] * 7, *[0.99] * 7]):
        before = scored
        scored, notice = judge_alarm(before, with_evidence(scored, score, frame), rule, frame, "1")
        said += [] if notice is None else [notice]
    # (24 + 1) X / (30 + X) >= 20 from X = 120 = exp(4.79) on: the fifth low score, in frame 5.
    raised = AlarmRaised(5, "1", e_value(5.0, rule), 0.05, 1, 24)
    assert said == [raised, AlarmEnded(14, "1")]
    assert e_value(4.0, rule) < 20.0 <= raised.e_value == pytest.approx(25 * math.e**5 / (30 + math.e**5))


def general(**keys):
    """`general` with more keys at its root."""
    text = find_graph("general").read_text(encoding="utf-8")
    for key, value in keys.items():
        text = set_value(text, (*ROOT, key), value)
    return text


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Lines, events and statuses of 8 frames of a scene and 8 black ones, without and with the keys."""
    scene = make_scene("gray_square", seed=0)
    frames = list(islice(scene.frames, 8))
    frames += [np.zeros_like(frames[0])] * 8
    found = []
    for keys in ({}, {"guarantee": {"above": 0.9, "frames": 3}, "alarm": {"total": 25.5, "videos": 25}}):
        path = tmp_path_factory.mktemp("g") / "g.yaml"
        path.write_text(general(**keys), encoding="utf-8")
        tracker, lines, events, said = Tracker(path, 0), [], [], []
        tracker.init(frames[0], tuple(scene.truth[0]))
        for frame in frames[1:]:
            tracker.update(frame)
            lines.append(tracker.metrics)
            said.append(tracker.status)
            events += tracker.events
        found.append((lines, events, said))
    return found


def test_nothing_but_what_is_reported_changes(seen):
    (plain, _, _), (lines, _, _) = seen
    assert [line.centre_box for line in plain] == [line.centre_box for line in lines]
    assert [line.score for line in plain] == [line.score for line in lines]
    assert all(line.e_value is None for line in plain)


def test_a_run_withholds_tracking_and_raises_the_alarm(seen):
    lines, events, said = seen[1]
    means = [np.mean([one.score for one in lines[max(0, k - 2) : k + 1]]) for k in range(len(lines))]
    for line, status, mean in zip(lines, said, means, strict=True):
        assert "tracking" not in (line.status, status) or mean > 0.9
    assert any(isinstance(one, AssuranceChanged) and not one.assured for one in events)
    (raised,) = [one for one in events if isinstance(one, AlarmRaised)]
    assert raised.since >= 8 and raised.e_value == lines[raised.frame - 1].e_value >= 20.0
