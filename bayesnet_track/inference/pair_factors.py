"""Factors of pairs: expressions of the states of two joined targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayesnet_track.graph.expressions.evaluate import log_values
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import Term
from bayesnet_track.graph.settings.joins import Join
from bayesnet_track.inference.joint import Factor
from bayesnet_track.numerics.arrays import Floats


@dataclass(eq=False)
class PairFlaw:
    """What was wrong with the factor of a pair in one frame; filled in when it is evaluated.

    Attributes:
        undefined: pairs of hypotheses of which it has no value; they count as impossible.
        pairs: how many there were.
        ignored: for the hypotheses of one of the targets no pair was possible: it was left out there.
    """

    undefined: int = 0
    pairs: int = 0
    ignored: bool = False

    def __bool__(self) -> bool:
        """True if anything was wrong."""
        return self.undefined > 0 or self.ignored


def pair_factor(
    rule: Join, constants: Mapping[str, float], frame: Mapping[str, float], found: PairFlaw | None = None
) -> Factor | None:
    """The factor of a join in a frame; None of one without. Pairs of which it has no value are impossible.

    `frame` has the values of names that are the same of all states in it. What is wrong with the factor's
    values is written into `found`.
    """
    if rule.factor is None:
        return None
    term = _term(rule.factor)
    fixed = {**frame, **constants}

    def log_density(first: Mapping[str, Floats], second: Mapping[str, Floats]) -> Floats:
        names = {f"a.{name}": values for name, values in first.items()}
        names |= {f"b.{name}": values for name, values in second.items()}
        log = np.asarray(log_values(term, {**names, **fixed}), dtype=np.float64)
        shape = np.broadcast_shapes(*(values.shape for values in names.values()))
        undefined = np.broadcast_to(np.isnan(log), shape)
        known = np.broadcast_to(np.where(undefined, -np.inf, log), shape)
        if found is not None:
            found.undefined += int(undefined.sum())
            found.pairs += int(undefined.size)
            found.ignored |= not (known > -np.inf).any()
        return known

    return log_density


@lru_cache(maxsize=64)
def _term(text: str) -> Term:
    return parse(text)
