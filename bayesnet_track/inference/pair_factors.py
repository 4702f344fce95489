"""Factors of pairs: expressions of the states of two joined targets."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from bayesnet_track.graph.expressions.evaluate import log_values
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import Term
from bayesnet_track.graph.settings.joins import Join
from bayesnet_track.inference.joint_members import Factor
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import Frame


def pair_factor(rule: Join, constants: Mapping[str, float], frame: Frame) -> Factor | None:
    """The factor of a join in a frame; None of one without. Pairs of which it has no value are impossible."""
    if rule.factor is None:
        return None
    term = _term(rule.factor)
    fixed = {"frame_width": float(frame.width), "frame_height": float(frame.height), **constants}

    def log_density(first: Mapping[str, Floats], second: Mapping[str, Floats]) -> Floats:
        names = {f"a.{name}": values for name, values in first.items()}
        names |= {f"b.{name}": values for name, values in second.items()}
        log = np.asarray(log_values(term, {**names, **fixed}), dtype=np.float64)
        shape = np.broadcast_shapes(*(values.shape for values in names.values()))
        return np.broadcast_to(np.where(np.isnan(log), -np.inf, log), shape)

    return log_density


@lru_cache(maxsize=64)
def _term(text: str) -> Term:
    return parse(text)
