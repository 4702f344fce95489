"""How deep a cue is called: the stack from `Tracker.update` to its `log_likelihood`, printed and bounded.

It passes through `engine.step`, `engine.filtering`, the belief and `inference.messages`; deeper only where a
target is carried or joined.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest

from bayesnet_track import GraphSpec, Tracker
from bayesnet_track.cues.intensity import IntensityCue

MOST = 10
IMAGE = np.full((60, 80, 3), 120, np.uint8)

BELIEFS = {
    "fixed size": {"particles": {"size": 40}},
    "adaptive size": {"particles": {"size": {"kld": {"bin_px": 2.0, "error": 0.1}}, "min": 100, "max": 200}},
    "auxiliary": {"particles": {"size": 40, "proposal": {"auxiliary": {}}}},
    "prior editing": {"particles": {"size": 40, "proposal": {"prior_editing": {"rounds": 2}}}},
    "second pass": {"particles": {"size": 40, "proposal": {"second_pass": {"above_kl": 0}}}},
    "iterated": {"particles": {"size": 40, "proposal": {"iterated": {"above_kl": 0}}}},
    "likelihood mixture": {"particles": {"size": 40, "proposal": {"likelihood_mixture": {}}}},
    "gaussian": {"gaussian": {}},
    "grid": {"grid": {"reset": {"region": "image"}}},
}


def graph_of(belief):
    root = {"fuse": "product", "belief": belief, "motion": {"random_walk": {"sd_px": {"x": 3.0, "y": 3.0}}}}
    nodes = {"root": root, "gray": {"parent": "root", "agent": {"cue": "intensity"}}}
    return GraphSpec.model_validate({"name": "tiny", "targets": {"square": {"nodes": nodes}}})


def names_between(update, frame):
    """Qualified names of the calls between `update` and `frame`, the outermost first; none outside of it."""
    names = []
    while frame.f_code is not update.__code__:
        names.append(f"{frame.f_globals['__name__']}.{frame.f_code.co_qualname}")
        if (frame := frame.f_back) is None:
            return ()
    return tuple(reversed(names))


@pytest.fixture
def stacks(monkeypatch):
    """The stacks above a trivial cue, for a belief."""
    found = {}

    def log_likelihood(self, planes, hypotheses, reference):
        found[names_between(Tracker.update, sys._getframe(1))] = None
        return -0.01 * np.abs(hypotheses.boxes[:, 0] - 40.0)

    monkeypatch.setattr(IntensityCue, "log_likelihood", log_likelihood)

    def follow(belief):
        tracker = Tracker(graph_of(belief))
        tracker.init(IMAGE, (30.0, 20.0, 20.0, 20.0))
        for _ in range(3):
            tracker.update(IMAGE)
        return list(found)

    return follow


@pytest.mark.parametrize("name", BELIEFS)
def test_at_most_ten_calls_lie_between_the_tracker_and_a_cue(name, stacks):
    (*_, deepest) = sorted(stacks(BELIEFS[name]), key=len)
    print("\n".join(("Tracker.update", *deepest, "log_likelihood")))
    assert deepest[0] == "bayesnet_track.engine.step.step"
    assert deepest[-1] == "bayesnet_track.inference.asking.score"
    assert len(deepest) <= MOST
