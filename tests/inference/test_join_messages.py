"""Messages joined from what agents said, without asking one: silent nodes, what is left out."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.inference.compile import compile_plan
from bayesnet_track.inference.messages import join_messages
from bayesnet_track.observation.cue import Hypotheses, Measurement

BOXES = np.array([[10.0 * k, 5.0, 4.0, 4.0] for k in range(4)])
EVEN = np.full(4, -np.log(4.0))
A, B, C = (
    np.array([0.0, -1.0, -2.0, -3.0]),
    np.array([-3.0, 0.0, -1.0, -1.0]),
    np.array([-1.0, -1.0, 0.0, -9.0]),
)
PLACE = Measurement(("x", "y"), np.array([10.0, 5.0]), 4.0 * np.eye(2))
NODES = {
    "root": {"fuse": "product"},
    "one": {"parent": "root", "fuse": {"pool": {"a": 3.0, "b": 1.0}}},
    "two": {"parent": "root", "fuse": {"pool": "equal"}},
    "a": "one",
    "b": "one",
    "c": "two",
    "d": "two",
}


@pytest.fixture
def joined(fakes):
    """(what agents said, what they measured) -> what is joined of it."""
    plate, cues = fakes.plate(NODES)

    def join(said, measured=None):
        plan = compile_plan(plate, said, cues)
        return join_messages(plan, said, measured or {}, {}, Hypotheses(BOXES), EVEN)

    return join


@pytest.mark.parametrize(("silent", "heard"), [(("a", "b"), ("c", "d")), (("c", "d"), ("a", "b"))])
def test_a_node_whose_agents_saw_nothing_leaves_the_others_as_they_are(joined, silent, heard):
    """Whichever of the nodes comes first in the plan."""
    said = {agent: np.zeros(4) for agent in silent} | {heard[0]: A, heard[1]: B}
    found = joined(said, dict.fromkeys(silent))
    node = {"a": "one", "c": "two"}
    assert node[silent[0]] not in found.messages
    np.testing.assert_array_equal(found.messages["root"], found.messages[node[heard[0]]])
    weights = (0.75, 0.25) if heard[0] == "a" else (0.5, 0.5)
    np.testing.assert_allclose(found.messages["root"], weights[0] * A + weights[1] * B, rtol=1e-12)
    assert found.gaussians == {} and found.sampled is None


def test_the_weight_of_an_agent_that_saw_nothing_goes_to_the_others(joined):
    found = joined({"a": np.zeros(4), "b": B, "c": C}, {"a": None})
    np.testing.assert_allclose(found.messages["one"], B, rtol=1e-12)
    np.testing.assert_allclose(found.messages["root"], B + C, rtol=1e-12)


def test_a_measurement_reaches_the_root_with_its_share_and_the_rest_without_it(joined):
    said = {"a": A, "b": B, "c": C, "d": A}
    found = joined(said, {"a": PLACE})
    np.testing.assert_allclose(found.gaussians["a"].covariance, PLACE.covariance / 0.75, rtol=1e-12)
    np.testing.assert_array_equal(found.gaussians["a"].mean, PLACE.mean)
    np.testing.assert_allclose(found.sampled, 0.25 * B + 0.5 * C + 0.5 * A, rtol=1e-12)
    np.testing.assert_allclose(found.messages["root"], 0.75 * A + 0.25 * B + 0.5 * (C + A), rtol=1e-12)


def test_what_was_said_stays_as_it_is(joined):
    said, measured = {"a": A.copy(), "b": B.copy(), "c": C.copy()}, {"a": PLACE}
    found = joined(said, measured)
    assert list(said) == ["a", "b", "c"] and measured == {"a": PLACE}
    assert set(found.messages) == {"a", "b", "c", "one", "two", "root"}
    for agent, message in (("a", A), ("b", B), ("c", C)):
        np.testing.assert_array_equal(said[agent], message)


def test_nothing_said_is_no_message(joined):
    found = joined({"a": np.zeros(4)}, {"a": None})
    assert set(found.messages) == {"a"} and found.gaussians == {} and found.sampled is None
