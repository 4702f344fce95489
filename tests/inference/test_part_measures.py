"""Parts in a running net: their references, statuses and rules, and what is written down of them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesnet_track.graph.spec import Guard
from bayesnet_track.inference.learn import LearningInputs, SlowReferences, judge
from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.observation.cue import Hypotheses

WHOLE = (60.0, 50.0, 20.0, 40.0)
TIMES = range(1, 13)
HIDDEN = range(6, 11)
"""Frames in which nothing is seen of the torso."""

GIVEN = {"size_box": {"w": 0.5, "h": 0.25}, "sd_px": {"x": 2.0, "y": 2.0}}
HEAD, TORSO = (60.0, 36.0, 10.0, 10.0), (60.0, 54.0, 10.0, 10.0)
"""Where the parts lie in `WHOLE`."""

GIVEN_VARIANCE = 8.0
"""Of `GIVEN`, x and y together, px^2."""


def nodes(**torso):
    return {
        "root": {
            "fuse": "product",
            "ud_fields": ["x", "y"],
            "estimate": "mean",
            "belief": {"particles": {"size": 1000}},
            "motion": {"random_walk": {"sd_px": {"x": 4.0, "y": 4.0}}},
            "learn": {"below": {"ud_px2": 40.0}, "rate_max": 0.1},
        },
        "head": {
            "parent": "root",
            "fuse": {"latent": {"given": {**GIVEN, "offset_box": {"y": -0.35}}}},
            "ud_fields": ["x", "y"],
        },
        "torso": {
            "parent": "root",
            "fuse": {"latent": {"given": {**GIVEN, "offset_box": {"y": 0.1}}}},
            "ud_fields": ["x", "y"],
            **torso,
        },
        "a": "head",
        "b": "torso",
    }


def sharp(fakes, box, floor=0.001):
    return fakes.gaussian(box[0], box[1], 1.5, floor)


def hidden_torso(fakes):
    """What the torso's agent sees: nothing while it is hidden."""

    def see(planes, hypotheses, reference):
        blind = planes.frame.index in HIDDEN
        return (fakes.flat(np.log(0.001)) if blind else sharp(fakes, TORSO))(planes, hypotheses, reference)

    return see


def run(fakes, sees, graph=None, frames=TIMES[-1]):
    engine, cues = fakes.engine(graph or nodes(), sees)
    return fakes.play(engine, frames, {"1": WHOLE}), cues


@pytest.fixture(scope="module")
def hiding(fakes):
    return run(fakes, {"a": sharp(fakes, HEAD), "b": hidden_torso(fakes)})


def parts_of(outcomes, name):
    """frame -> what was written of a part."""
    return {outcome.metrics[0].frame: outcome.metrics[0].parts[name] for outcome in outcomes}


def test_references_are_learnt_inside_the_parts(hiding):
    outcomes, cues = hiding
    for agent, name, first in (("a", "head", HEAD), ("b", "torso", TORSO)):
        (frame, _, box), *later = cues[agent].learnt
        assert (frame, box) == (0, first)
        found = parts_of(outcomes, name)
        for frame, _, box in later:
            np.testing.assert_allclose(box, found[frame].centre_box, rtol=1e-12)


def test_what_is_hidden_is_told_from_the_rest(hiding):
    """1000 hypotheses: the torso's mean strays from where the head puts it by some tenths of a px.

    Seen, both parts are known to sd 1.5 or better; hidden, the torso is known by twice `GIVEN`, the head's
    and its own, and by what the head's agent leaves open.
    """
    outcomes, _ = hiding
    torso = parts_of(outcomes, "torso")
    for frame in TIMES:
        assert np.hypot(*np.subtract(torso[frame].centre_box[:2], TORSO[:2])) < 1.5, frame
        assert torso[frame].status == ("hidden" if frame in HIDDEN else "seen")
        if frame in HIDDEN:
            assert GIVEN_VARIANCE < torso[frame].ud_px2 < 2 * GIVEN_VARIANCE + 2 * 1.5**2
        else:
            assert torso[frame].ud_px2 < 2 * 1.5**2 * 1.2  # the variance of 1000 draws: 5 %
        np.testing.assert_allclose(sum(np.square(torso[frame].sd[:2])), torso[frame].ud_px2)


def test_what_is_hidden_is_not_learnt_and_the_rest_is(hiding):
    _, cues = hiding
    learnt = {agent: {frame for frame, *_ in cues[agent].learnt} for agent in "ab"}
    assert learnt["a"] == {0, *TIMES}
    assert learnt["b"] == {0, *TIMES} - {*HIDDEN}


def test_a_target_with_a_hidden_part_is_not_lost(hiding, fakes):
    outcomes, _ = hiding
    assert {metrics.status for outcome in outcomes for metrics in outcome.metrics} == {"tracking"}
    outcomes, _ = run(fakes, {"a": hidden_torso(fakes), "b": hidden_torso(fakes)})
    changes = [event for outcome in outcomes for event in outcome.events if isinstance(event, StatusChanged)]
    assert changes[0].status == "lost" and changes[0].frame == HIDDEN[2]


def test_the_rules_of_a_part_go_by_its_own_uncertainty(fakes):
    """The spare agent hangs under the torso, and is called when the torso goes into hiding."""
    rules = {"activate": {"above": {"ud_box": 0.07}, "frames": 2}}
    spare = {"parent": "torso", "agent": "c", "active": False}
    sees = {"a": sharp(fakes, HEAD), "b": hidden_torso(fakes), "c": hidden_torso(fakes)}
    outcomes, _ = run(fakes, sees, {**nodes(adapt=rules), "c": spare})
    (called,) = [event for outcome in outcomes for event in outcome.events if isinstance(event, Activated)]
    assert (called.frame, called.node, called.governor) == (HIDDEN[1], "c", "torso")
    assert called.cause.scale_px2 == pytest.approx(100.0)  # the torso's area, not the whole's
    assert called.cause.ud_px2 == parts_of(outcomes, "torso")[called.frame].ud_px2


def test_a_part_that_nobody_watches_is_predicted(fakes):
    graph = nodes() | {"b": {"parent": "torso", "agent": "b", "active": False}}
    outcomes, cues = run(fakes, {"a": sharp(fakes, HEAD), "b": sharp(fakes, TORSO)}, graph, 3)
    last = outcomes[-1].metrics[0].parts["torso"]
    assert last.status == "unwatched" and last.ud_px2 > GIVEN_VARIANCE
    assert [frame for frame, *_ in cues["b"].learnt] == [0]


def test_parts_outside_the_picture_are_learnt_at_its_border(fakes):
    """The frame has 120 columns; the part of this target lies beyond them."""
    graph = nodes()
    graph["torso"]["fuse"] = {"latent": {"given": {**GIVEN, "offset_box": {"x": 2.0}}}}
    engine, cues = fakes.engine(graph, {"a": sharp(fakes, HEAD), "b": fakes.flat()})
    fakes.play(engine, 1, {"1": (100.0, 50.0, 20.0, 40.0)})
    assert cues["b"].learnt[0][2] == (119.0, 50.0, 10.0, 10.0)


def test_parts_are_written_where_there_are_some(hiding, fakes):
    metrics = hiding[0][-1].metrics[0]
    line = to_json(metrics)
    assert to_json(from_json(line)) == line
    assert set(json.loads(line)["parts"]) == {"head", "torso"}
    assert set(json.loads(line)["parts"]["head"]) == {"box", "sd", "ud_px2", "status"}
    plain, _ = run(fakes, {"a": fakes.flat()}, {"root": {}, "a": "root"}, 1)
    assert all("parts" not in json.loads(to_json(outcome.metrics[0])) for outcome in plain)


def test_the_drift_guard_asks_about_the_part(fakes):
    """Both references are compared at the box of the part that the agent looks at."""
    asked = {}

    def see(agent):
        def log_likelihood(planes, hypotheses, reference):
            asked.setdefault(agent, []).append(hypotheses.boxes[0].tolist())
            return np.zeros(len(hypotheses))

        return log_likelihood

    cues = {agent: fakes.Oracle(see(agent)) for agent in "ab"}
    slow, rule = SlowReferences({agent: {} for agent in cues}), Guard(every=1)
    cache, whole = fakes.observer(cues).cache, Hypotheses(np.array([WHOLE]))
    rates = dict.fromkeys(cues, 0.1)
    judge(LearningInputs(cues, cache, whole, {"b": np.array(TORSO)}), slow, slow.slow, rates, rule)
    assert asked == {"a": [list(WHOLE)] * 2, "b": [list(TORSO)] * 2}
