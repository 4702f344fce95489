"""Agents that measure, and nets evaluated on given hypotheses."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track.inference.compile import compile_plan
from bayesnet_track.inference.messages import evaluate
from bayesnet_track.observation.cue import Hypotheses, Measurement, blend_arrays


class Measurer:
    """A cue that measures what `see(hypotheses, weights)` says, and writes down what it was asked about."""

    def __init__(self, see, needs=()):
        self.see, self.needs, self.asked = see, needs, []

    def learn(self, planes, box):
        return {"box": box}

    def blend(self, old, new, rate):
        return blend_arrays(old, new, rate)

    def measure(self, planes, hypotheses, weights, reference):
        self.asked.append((hypotheses.boxes.copy(), weights.copy()))
        return self.see(hypotheses, weights)


def place(x, y, sd=3.0, floor=0.0):
    """Always the same measurement of x and y."""
    measured = Measurement(("x", "y"), np.array([x, y]), sd**2 * np.eye(2), floor)
    return Measurer(lambda hypotheses, weights: measured)


def nothing():
    return Measurer(lambda hypotheses, weights: None)


@pytest.fixture(scope="session")
def asked(fakes):
    """(nodes, agent -> cue or what an oracle sees, boxes, prior log-weights) -> plan, evidence."""

    def run(nodes, sees, boxes, beta=None, active=None, seed=0, observer=None, fields=None):
        plate, _ = fakes.plate(nodes)
        cues = {agent: fakes.Oracle(see) if callable(see) else see for agent, see in sees.items()}
        plan = compile_plan(plate, cues if active is None else active, cues)
        log = np.full(len(boxes), -np.log(len(boxes))) if beta is None else np.asarray(beta)
        observer = observer or fakes.observer(cues, seed=seed)
        return plan, evaluate(plan, observer, Hypotheses(boxes, fields or {}), log)

    return run


@pytest.fixture(scope="session")
def measuring():
    return SimpleNamespace(Measurer=Measurer, place=place, nothing=nothing)
