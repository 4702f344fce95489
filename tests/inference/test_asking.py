"""A cue is asked about a group: what it is given, and what becomes of its answers."""

import numpy as np
import pytest

from bayesnet_track.inference.asking import AgentUnavailable, Missing, follow, score
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.likelihoods import ReferenceRows

BOXES = np.arange(24.0).reshape(6, 4)
STARTS = np.array([0, 1, 3, 6])
REFERENCES = [{"at": np.array([float(t)])} for t in range(3)]
PLANES = ["first", "second", "third"]


class Noted:
    """Minus the first column and the reference; it spoils what it is given, and knows who asked what."""

    def __init__(self):
        self.asked = []

    def log_likelihood(self, planes, hypotheses, reference):
        self.asked.append((planes, len(hypotheses), float(reference["at"][0])))
        values = -hypotheses.boxes[:, 0] - hypotheses.fields["angle"] - reference["at"][0]
        hypotheses.boxes[:] = hypotheses.fields["angle"][:] = np.nan
        return values

    def learn(self, planes, box):
        return {"at": box[:1]}

    def blend(self, old, new, rate):
        return {"at": (1 - rate) * old["at"] + rate * new["at"]}


def ask(cue, references=REFERENCES):
    angles = np.arange(6.0)
    values, faults = score(cue, PLANES, Hypotheses(BOXES, {"angle": angles}), STARTS, references)
    assert BOXES.tolist() == np.arange(24.0).reshape(6, 4).tolist() and angles.tolist() == [*range(6)]
    return values, faults


@pytest.mark.parametrize("references", [REFERENCES, ReferenceRows({"at": np.arange(3.0)[:, None]})])
def test_each_target_is_scored_by_its_own_planes_and_reference(references):
    values, faults = ask(cue := Noted(), references)
    owner = np.repeat(range(3), np.diff(STARTS))
    assert faults == {} and values.tolist() == (-BOXES[:, 0] - range(6) - owner).tolist()
    assert cue.asked == [("first", 1, 0.0), ("second", 2, 1.0), ("third", 3, 2.0)]


def test_a_reference_is_for_reading():
    class Writing(Noted):
        def log_likelihood(self, planes, hypotheses, reference):
            reference["new"] = np.zeros(1)

    _, faults = ask(Writing(), ReferenceRows({"at": np.arange(3.0)[:, None]}))
    assert faults.keys() == {0, 1, 2} and "TypeError" in faults[0]


def test_who_gives_no_answer_is_missing_and_who_answers_wrongly_is_told_what():
    class Failing(Noted):
        def log_likelihood(self, planes, hypotheses, reference):
            if planes == "first":
                raise AgentUnavailable("late")
            return super().log_likelihood(planes, hypotheses, reference)[:2]

    values, faults = ask(Failing())
    assert faults == {0: Missing("late"), 2: "returned an array of shape (2,) for 3 hypotheses"}
    assert values[1:3].tolist() == [-4 - 1 - 1, -8 - 2 - 1]


def test_a_form_for_all_is_asked_once_of_more_than_one_target():
    class Together(Noted):
        def log_likelihood_of_each(self, planes, hypotheses, starts, references):
            self.asked.append(len(hypotheses))
            return np.full(len(hypotheses), -7.0)

    cue = Together()
    assert ask(cue)[0].tolist() == [-7.0] * 6 and cue.asked == [6]
    one = Hypotheses(BOXES[:2], {"angle": np.zeros(2)})
    values, _ = score(cue, PLANES[:1], one, np.array([0, 2]), REFERENCES[:1])
    assert values.tolist() == [0.0, -4.0]


@pytest.mark.parametrize("rows", [False, True])
def test_a_target_that_cannot_learn_keeps_its_reference(rows):
    class Failing(Noted):
        def learn(self, planes, box):
            return {"at": box[:1] * (np.inf if planes == "second" else 1.0)}

    known = ReferenceRows({"at": np.arange(3.0)[:, None]}) if rows else REFERENCES
    moved, faults = follow(Failing(), PLANES, BOXES[:3], known, np.array([0.5, 0.5, 1.0]))
    assert faults == {1: "made a reference whose 'at' is not finite"}
    assert [float(one["at"][0]) for one in moved] == [0.0, 1.0, 8.0]
    assert isinstance(moved, ReferenceRows) == rows
