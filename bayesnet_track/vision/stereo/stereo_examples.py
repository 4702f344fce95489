"""How much features of depth vary from example to example: the covariance of the stereo cue, estimated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviations of K features.

    Attributes:
        sd: (K,) estimated, shrunk toward the default.
        raw: (K,) of the examples alone.
        freedom: how many independent deviations the examples hold: their number less that of their groups.
    """

    sd: Floats
    raw: Floats
    freedom: int


def estimate_spread(features: Floats, groups: Ints, default: Floats, prior: float) -> Spread:
    """Standard deviations of features within groups, shrunk toward a default.

    ``sd^2 = (prior default^2 + S) / (prior + n - g)``, S the sum of the squared deviations of n examples from
    the means of their g groups: the mean of the variances that S alone and the default give, as the scaled
    inverse chi-square prior for the variances of a Gaussian weighs them. It makes the diagonal covariance of
    thesis eq. 3.6, "estimated in previous examples".

    Args:
        features: (n, K) of the examples.
        groups: (n,) whole numbers; examples of one number have a mean of their own.
        default: (K,) standard deviations.
        prior: how many independent deviations the default counts for; 0 is without it.

    Raises:
        ValueError: no group has two examples, so that nothing can vary.

    >>> examples, one = np.array([[1.0], [3.0]]), np.zeros(2, np.int64)
    >>> float(estimate_spread(examples, one, np.array([0.5]), 0.0).sd[0] ** 2)  # doctest: +ELLIPSIS
    2.0...
    >>> float(estimate_spread(examples, one, np.array([0.5]), 3.0).sd[0] ** 2)
    0.6875
    """
    _, group = np.unique(groups, return_inverse=True)
    size = np.bincount(group)
    freedom = len(features) - len(size)
    if freedom < 1:
        raise ValueError(
            f"{len(features)} examples in {len(size)} groups: one group of two at least is needed"
        )
    sums = np.zeros((len(size), features.shape[1]))
    np.add.at(sums, group, features)
    squares = ((features - (sums / size[:, None])[group]) ** 2).sum(axis=0)
    sd = np.sqrt((prior * default**2 + squares) / (prior + freedom))
    return Spread(sd, np.sqrt(squares / freedom), freedom)
