"""How well each measurement was predicted: p-values of what agents measured, under the belief before it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import Step
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.numerics.predictive import p_value


def p_values(plate: CheckedTarget, step: Step[Any], hidden: Sequence[bool] = ()) -> dict[str, float]:
    """Agent -> probability of a measurement that is farther from the prediction than its own.

    Of agents at the root that measured, whose message reaches it as a Gaussian. A measurement shared by
    several targets has none, nor has one of functions of the state. Hypotheses in modes in which the target
    is `hidden` are left out.
    """
    found = {}
    for agent in plate.agents:
        one = step.evidence.gaussians.get(agent)
        if one is None or one.choices or plate.agent(agent).parent != plate.root:
            continue
        if one.seen is not None:
            continue
        fields = step.posterior.fields
        columns = [fields.index(name) for name in one.fields]
        if step.predicted:
            parts = [part for part in step.predicted if part.weight > 0]
            weights = np.array([part.weight for part in parts])
            means = np.array([part.mean[columns] for part in parts])
            spreads = np.array([part.covariance[np.ix_(columns, columns)] for part in parts])
            covariances = spreads + one.covariance
        else:
            states, weights = step.support.states, step.prior.weights
            if any(hidden):
                weights = np.where(np.asarray(hidden)[states[:, -1].astype(np.intp)], 0.0, weights)
            means, covariances = states[:, columns], one.covariance[None]
        total = float(weights.sum())
        if total > 0:
            found[agent] = p_value(one.mean, weights / total, means, covariances)
    return found
