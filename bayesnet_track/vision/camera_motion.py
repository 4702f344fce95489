"""The motion of a whole picture, from the motion of points in it: a robust similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats

Complexes = NDArray[np.complex128]

SAMPLES = 128
"""Pairs of points that are tried; with half of the points wrong, all are wrong once in 1e16 pictures."""
ROUNDS = 3
"""Fits to the points that agree, after the best pair."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """The flow of a picture that moves, turns and zooms as a whole.

    Attributes:
        matrix: (2, 3); the flow at (x, y) is matrix @ (x, y, 1), px.
        agree: (P,) bool, the points that move so.
    """

    matrix: Floats
    agree: NDArray[np.bool_]


def similarity(points: Floats, tolerance: float) -> Similarity:
    """The similarity that most points (P, 4) x, y, dx, dy follow to within `tolerance` px.

    Pairs of points by a fixed sequence, each scored by the sum of min(r^2, tolerance^2) (MSAC); standing
    still is one of the candidates, and what fewer than two points give. Then least squares over those
    that agree.
    """
    place, flow = points[:, 0] + 1j * points[:, 1], points[:, 2] + 1j * points[:, 3]
    centre = place.mean() if len(place) else 0j  # near the points, so that nothing is lost to rounding
    place = place - centre
    turn, shift = _candidates(place, flow)
    away = _squares(flow - turn[:, None] * place - shift[:, None])
    best = int(np.minimum(away, tolerance**2).sum(axis=1).argmin())
    a, b = turn[best], shift[best]
    agree = away[best] <= tolerance**2
    for _ in range(ROUNDS):
        if agree.sum() < 2:
            break
        z, f = place[agree], flow[agree]
        middle, mean = z.mean(), f.mean()
        spread = float(_squares(z - middle).sum())
        a = (np.conj(z - middle) * (f - mean)).sum() / spread if spread > 0 else 0j
        b = mean - a * middle
        agree = _squares(flow - a * place - b) <= tolerance**2
    b = b - a * centre
    return Similarity(np.array([[a.real, -a.imag, b.real], [a.imag, a.real, b.imag]]), agree)


def _squares(vectors: Complexes) -> Floats:
    return np.asarray(vectors.real**2 + vectors.imag**2)  # the absolute value takes several times as long


def _candidates(place: Complexes, flow: Complexes) -> tuple[Complexes, Complexes]:
    """Turn and shift of standing still, and of the similarity through each of the sampled pairs."""
    still = np.zeros(1, dtype=np.complex128)
    if len(place) < 2:
        return still, still
    first, second = np.random.default_rng(0).integers(0, len(place), (2, SAMPLES))
    apart = place[second] - place[first]
    usable = apart != 0
    first, second, apart = first[usable], second[usable], apart[usable]
    turn = (flow[second] - flow[first]) / apart
    return np.concatenate([still, turn]), np.concatenate([still, flow[first] - turn * place[first]])
