"""A whole run by evidence on the crossing squares: the test calls for motion, and a run repeats exactly."""

from __future__ import annotations

from itertools import islice

import pytest

from bayesnet_track import GraphSpec, Start, load_graph
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.target_net import Concentration
from bayesnet_track.runtime.run import run
from bayesnet_track.sources.scenes import two_squares
from bayesnet_track.sources.scenes.library import SceneSource

TEST = {"concentrated": {"within_box": 0.5}}


def by_evidence(guard):
    written = load_graph("two_squares").spec.model_dump(exclude_none=True)
    root = written["targets"]["square"]["nodes"]["square"]
    root["adapt"] = {
        "activate": {"unless": TEST, "which": "information_per_ms"},
        "deactivate": {"when": TEST, "frames": 6, "drop": "min_information_per_ms"},
    }
    root["learn"]["guard"] = guard
    return GraphSpec.model_validate(written)


def decisions(frames, guard):
    scene = two_squares(0)
    source = SceneSource(scene, "scene:two_squares")
    results = islice(run(load_graph(by_evidence(guard)), source, [Start(scene.start_box)], seed=0), frames)
    return [decision for result in results for decision in result.decisions]


def test_motion_is_called_when_the_belief_splits():
    """The squares meet in frame 25 (UD calls motion in the same frame, see the first graph)."""
    made = decisions(32, {})
    switches = [d for d in made if isinstance(d, Activated | Deactivated)]
    first, called = switches[:2]
    assert isinstance(first, Deactivated) and first.node == "motion" and first.frame == 6
    assert isinstance(called, Activated) and called.node == "motion" and 20 <= called.frame <= 28
    for switch in switches:
        assert isinstance(switch.cause, Concentration)
        assert (switch.cause.vouched < 0.9) == isinstance(switch, Activated)
    assert called.expected.keys() == {"motion"} and first.index["motion"] < first.index["color"]


@pytest.mark.slow
def test_a_run_repeats_exactly():
    one, two = ([to_json(d) for d in decisions(60, {"every": 1})] for _ in range(2))
    assert len(one) > 3 and one == two
