"""A score that goes by the confidence of agents that measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.engine.scoring.score import confidences, log_odds, probability
from bayesnet_track.engine.step import make_engine
from bayesnet_track.graph.spec import Logistic
from bayesnet_track.observation.cue import Measurement

ROOT = {
    "belief": {"gaussian": {"filter": "kalman"}},
    "motion": {"random_walk": {"sd_px": {"x": 8.0, "y": 8.0}}},
    "fuse": "product",
    "ud_fields": ["x", "y"],
}
RULE = {"bias": 0.5, "memory_frames": 0, "confidence": {"sure": 0.75}}


@dataclass(frozen=True)
class Measuring:
    """It measures one place, and is as sure as `says` of a frame; None there: it sees nothing."""

    says: dict
    needs: tuple = ()

    def learn(self, planes, box):
        return {"box": box}

    def blend(self, old, new, rate):
        return new

    def measure(self, planes, hypotheses, weights, reference):
        sure = self.says.get(planes.frame.index, 0.8)
        place = np.array([50.0, 40.0])
        return None if sure is None else Measurement(("x", "y"), place, 4.0 * np.eye(2), confidence=sure)


@pytest.fixture
def lines(fakes):
    """(agent -> cue, what else the root has) -> the lines of nine frames."""

    def play(cues, **settings):
        declared = {
            name: fakes.declare(cue, is_confident=lambda parameters: True) for name, cue in cues.items()
        }
        root = {**ROOT, "score": {"logistic": RULE}, **settings}
        engine = make_engine(
            fakes.graph({"root": root, **dict.fromkeys(cues, "root")}, declared), 0, declared
        )
        return [outcome.metrics[0] for outcome in fakes.play(engine, 9)[1:]]

    return play


def features(lines):
    return [line.features["confidence.sure"] for line in lines]


def test_the_score_goes_by_it_and_no_box_does(lines):
    says = {frame: frame / 10 for frame in range(1, 10)}
    found = lines({"sure": Measuring(says)})
    assert features(found) == pytest.approx([log_odds(says[frame]) for frame in range(1, 10)])
    rule = Logistic(**RULE)
    assert [line.score for line in found] == pytest.approx(
        [1 / (1 + np.exp(-0.5 - 0.75 * log_odds(says[frame]))) for frame in range(1, 10)]
    )
    assert [line.score for line in found] == [probability(rule, line.features) for line in found]
    assert [one.centre_box for one in found] == [one.centre_box for one in lines({"sure": Measuring({})})]


def test_one_that_sees_nothing_has_none(lines):
    found = features(lines({"sure": Measuring({4: None}), "other": Measuring({})}))
    assert found == pytest.approx([log_odds(0.0 if frame == 4 else 0.8) for frame in range(1, 10)])


def test_one_that_rests_stays_at_what_it_said(lines):
    says = {frame: frame / 10 for frame in range(1, 10)}
    on_call = {"agents": ["sure"], "on_call": {"every": 3, "agree": 0.1, "above": {"ud_px2": 1e6}}}
    found = lines({"sure": Measuring(says), "other": Measuring({})}, adapt=on_call)
    ran = [frame for frame, line in enumerate(found, start=1) if "sure" in line.active]
    assert 1 in ran and len(ran) < 9
    last = [max(one for one in ran if one <= frame) for frame in range(1, 10)]
    assert features(found) == pytest.approx([log_odds(says[frame]) for frame in last])


def test_only_what_was_said_counts():
    measured = {
        "a": Measurement(("x",), np.zeros(1), np.eye(1)),
        "b": Measurement(("x",), np.zeros(1), np.eye(1), confidence=0.25),
        "c": Measurement(("x",), np.zeros(1), np.eye(1), confidence=0.5),
    }
    evidence = Evidence(np.zeros(1), {}, measured=measured)
    rule = Logistic(bias=0.0, confidence={"a": 1.0, "b": 1.0, "d": 1.0})
    assert confidences(rule, evidence) == {"confidence.b": pytest.approx(-np.log(3))}


def test_full_confidence_is_worth_no_more_than_a_thousandth_of_doubt():
    assert log_odds(1.0) == log_odds(0.9995) == pytest.approx(np.log(999))
    assert log_odds(0.0) == -log_odds(1.0) and log_odds(0.5) == 0.0
