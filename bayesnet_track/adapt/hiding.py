"""Which covered targets are hidden: pure functions on arrays.

One who is covered is either hidden, and hardly ever detected, or stands in front, and is detected like any
other. Who is hidden stays hidden while both overlap. So the misses of a few frames say who it is, and the one
detection of two people is the other one's from then on. With the probability h that a target which another
covers with probability a is hidden, d_o of a detection in the open and d_h of a hidden one,

    d = (1 - a h) d_o + a h d_h,    P(h | detected) ~ h d_h,    P(h | missed) ~ h (1 - d_h).

At the beginning h is the share of covered targets that are hidden, as far as it is known how often covered
targets are detected.
"""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats

HIDDEN = 0.05
"""Probability that a hidden target is detected."""

LASTS = 0.95
"""How much of what is known of a covered target is still true one frame later."""


def share_hidden(in_the_open: float, covered: float) -> float:
    """Share of covered targets that are hidden, if those are detected with probability `covered`.

    >>> share_hidden(0.9, 0.9), share_hidden(0.9, 0.05)
    (0.0, 1.0)
    """
    least = min(HIDDEN, covered)
    return (in_the_open - min(covered, in_the_open)) / (in_the_open - least) if in_the_open > least else 0.0


def expect_hidden(before: Floats, cover: Floats, share: float) -> Floats:
    """(T,) probabilities of being hidden if covered, from those of the last frame; `cover` (T,) is now's."""
    return np.asarray(share + (before - share) * LASTS * cover)


def detection_of(in_the_open: float, cover: Floats, hidden: Floats) -> Floats:
    """(T,) probabilities of a detection."""
    return np.asarray(in_the_open + cover * hidden * (min(HIDDEN, in_the_open) - in_the_open))


def learn_hidden(hidden: Floats, seen: Floats, in_the_open: float) -> Floats:
    """(T,) probabilities of being hidden after a look in which each was detected with probability `seen`.

    >>> learn_hidden(np.array([0.5, 0.5]), np.array([0.0, 1.0]), 0.9).round(3).tolist()
    [0.905, 0.053]
    """
    low = min(HIDDEN, in_the_open)
    if_seen = hidden * low / np.maximum(hidden * low + (1.0 - hidden) * in_the_open, 1e-300)
    missed = hidden * (1.0 - low)
    if_missed = missed / np.maximum(missed + (1.0 - hidden) * (1.0 - in_the_open), 1e-300)
    return np.asarray(seen * if_seen + (1.0 - seen) * if_missed)
