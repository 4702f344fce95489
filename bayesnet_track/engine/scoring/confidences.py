"""How sure agents are themselves that what they measured is the target, as features of a score."""

from __future__ import annotations

import math

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.graph.settings.scores import confidence_feature
from bayesnet_track.graph.spec import Logistic

SUREST = 0.999
"""More confidence than this, or less than 1 minus this, says no more."""


def confidences(rule: Logistic, evidence: Evidence) -> dict[str, float]:
    """Feature of the score -> log odds of the confidence of an agent; only of those that ran in the frame.

    An agent that saw nothing has none.
    """
    measured = {agent: evidence.measured[agent] for agent in rule.confidence if agent in evidence.measured}
    said = {agent: 0.0 if own is None else own.confidence for agent, own in measured.items()}
    return {confidence_feature(agent): log_odds(own) for agent, own in said.items() if own is not None}


def log_odds(confidence: float) -> float:
    """log(p / (1 - p)) of a confidence 0..1, which counts as at most `SUREST`.

    >>> round(log_odds(0.9), 3), round(log_odds(1.0), 3), round(log_odds(0.0), 3)
    (2.197, 6.907, -6.907)
    """
    p = min(max(confidence, 1.0 - SUREST), SUREST)
    return math.log(p / (1.0 - p))
