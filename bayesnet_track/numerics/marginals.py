"""Marginal association probabilities: how probable it is that each detection is each target's.

A joint association gives every target one detection at most, and every detection one target at most. Its
probability is proportional to the product of the weights w_ij of its pairs, where w_ij is how much likelier
the detection j is as target i's than as nobody's, times P(i is detected) / P(i is not). What is wanted of
each pair is the sum over all joint associations that hold it.

Targets and detections that no pairs connect do not concern each other, so that each connected group is summed
alone: exactly where one of its sides has at most `MOST_EXACT` members, else by belief propagation (Williams &
Lau 2014, "Approximate evaluation of marginal association probabilities with belief propagation"). That is
exact, too, where the pairs form a tree. On loops it converges, and its error grows with how much the weights
tell: in 50 groups of eight targets and eight detections in which every pair is possible, with weights from 1
to the ratio, log-uniform, the largest error of a pair was 0.003 at a ratio of 2, 0.009 at 10, 0.05 at 100 and
0.35 at 10,000.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Ints

MOST_EXACT = 7
"""A connected group is summed exactly when it has at most so many targets, or so many detections."""

SWEEPS, TOLERANCE = 200, 1e-6
"""Belief propagation ends after so many sweeps, or when no message moves by more."""

LARGEST = 1e30
"""Weights are cut here, so that the products of `MOST_EXACT` of them are numbers."""


@dataclass(frozen=True, eq=False)
class Marginals:
    """Probabilities of P pairs of T targets and N detections.

    Attributes:
        pairs: (P,) that the pair belongs together.
        missed: (T,) that none of the detections is the target's.
        free: (N,) that the detection is none of the targets'.
        is_exact: (P,) whether the pair's group was summed exactly.
    """

    pairs: Floats
    missed: Floats
    free: Floats
    is_exact: Bools


def marginalise(
    rows: Ints, columns: Ints, weights: Floats, shape: tuple[int, int], most_exact: int = MOST_EXACT
) -> Marginals:
    """The marginals of pairs (P,) of a target `rows` and a detection `columns`, with weights from 0 on.

    `shape` is T, N. A pair that is not named is impossible.

    Raises:
        ValueError: a weight is negative or no number.

    >>> found = marginalise(np.array([0, 0]), np.array([0, 1]), np.array([3.0, 1.0]), (1, 2))
    >>> [one.round(6).tolist() for one in (found.pairs, found.missed, found.free)]
    [[0.6, 0.2], [0.2], [0.4, 0.8]]
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.marginal_kernels import weigh_pairs

    if not np.all(weights >= 0.0):
        raise ValueError(f"weight {weights[~(weights >= 0.0)][0]:g}; expected a number from 0 on")
    count, found = shape
    # In C order, so that the kernel has one compiled version only.
    rows, columns = (np.ascontiguousarray(one, dtype=np.int64) for one in (rows, columns))
    cut = np.minimum(np.asarray(weights, dtype=np.float64), LARGEST)
    pairs, is_exact = weigh_pairs(rows, columns, cut, count, found, most_exact, SWEEPS, TOLERANCE)
    missed = 1.0 - np.bincount(rows, pairs, minlength=count)
    free = 1.0 - np.bincount(columns, pairs, minlength=found)
    return Marginals(pairs, np.clip(missed, 0.0, 1.0), np.clip(free, 0.0, 1.0), is_exact)
