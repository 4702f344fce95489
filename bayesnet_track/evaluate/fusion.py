"""Estimate how much the errors of a pool's children have in common: the correlation of a learned pool."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bayesnet_track.engine.filtering import evaluate_at
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.starts import Start, start_targets
from bayesnet_track.engine.step import State, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache

Residuals = Mapping[str, Floats]
"""Learned pool -> (n, 2, K) true centre less the estimate of each of its K children, in sqrt(w h) of the true
box; NaN where a child says nothing."""

REACH, PLACES = 0.75, 31
"""Places at which children are asked: so far around the true centre on each side, in sides of the true box,
and so many on each axis."""

LEAST_RESIDUALS = 20
"""Fewer frames make no estimate: with 20, two independent children seem correlated by 0.16 (one sd)."""


@dataclass(frozen=True)
class Correlation:
    """How much the errors of a pool's children have in common.

    Attributes:
        value: the correlation, 0..1.
        frames: residuals that it is estimated from.
        without: the smallest and the largest value without one of the videos.
    """

    value: float
    frames: int
    without: tuple[float, float]


def learned_pools(plate: CheckedTarget) -> dict[str, tuple[str, ...]]:
    """Node with a learned pool -> its children.

    Raises:
        ValueError: there is none, or the true state at one of them is not known: a latent node lies above.
    """
    found = {name: plate.children[name] for name in plate.children if plate.correlation(name) is not None}
    if not found:
        raise ValueError("fusion: no node with fuse: {pool: learned}, whose correlation is to be estimated")
    for name in found:
        above: str | None = name
        while above is not None:
            fuse = plate.inference(above).fuse
            if fuse is not None and fuse.latent is not None:
                raise ValueError(
                    f"fusion: {name} is about the state of {above}, whose true value no video gives; set its "
                    "correlation by hand"
                )
            above = plate.parent[above]
    return found


def residuals_of(graph: CheckedGraph, frames: Iterable[Frame], truth: Floats, seed: int = 0) -> Residuals:
    """What the children of learned pools are off by, in the frames in which tracking is on target.

    The video is tracked from the first of (n, 4) true corner boxes, so that references are those of a run. In
    every later frame each child is asked about boxes of the true size at `PLACES`^2 places around the true
    centre. Its own estimate is the mean, by likelihood, of those at least half as likely as its best; it says
    nothing where these are more than half of all places.

    Raises:
        ValueError: the truth has fewer boxes than there are frames, or there is no pool to estimate.
    """
    engine = make_engine(graph, seed)
    pools = learned_pools(next(iter(graph.targets.values())))
    found: dict[str, list[Floats]] = {name: [] for name in pools}
    state: State | None = None
    for frame in frames:
        if frame.index >= len(truth):
            raise ValueError(f"the truth has {len(truth)} boxes, and the video has more frames")
        box = truth[frame.index]
        if state is None:
            x, y, w, h = (float(value) for value in box)
            state = start_targets(graph, engine, frame, [Start((x, y, w, h))]).state
            continue
        before, state = state, (outcome := step(engine, state, frame)).state
        line = next((one for one in outcome.metrics if one.target == "1"), None)
        if line is None or "1" not in before.targets or not np.isfinite(box).all():
            continue
        true = centre_from_corner(box)
        if overlap(np.array(line.centre_box)[None], true[None])[0] <= 0.5:
            continue
        cache = PlaneCache(FramePair(frame, before.previous))
        work = FrameWork(engine, before.net, cache, before.history.births)
        offsets = lattice()
        boxes = np.tile(true, (len(offsets), 1))
        boxes[:, :2] += offsets * true[2:]
        messages = evaluate_at(work, "1", before.targets["1"], boxes).messages
        scale = true[2:] / np.sqrt(true[2] * true[3])
        for pool, children in pools.items():
            own = [own_estimate(messages.get(child), offsets) * scale for child in children]
            found[pool].append(np.stack(own, axis=1))
    return {pool: np.array(rows).reshape(-1, 2, len(pools[pool])) for pool, rows in found.items()}


def lattice() -> Floats:
    """(`PLACES`^2, 2) offsets from a centre, in sides of a box."""
    steps = np.linspace(-REACH, REACH, PLACES)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


def own_estimate(log_likelihood: Floats | None, offsets: Floats) -> Floats:
    """(2,) where a message (N,) at `offsets` (N, 2) says that the target is; NaN when it says nothing."""
    if log_likelihood is None:
        return np.full(2, np.nan)
    likelihood = np.exp(log_likelihood - log_likelihood.max())
    near = likelihood >= 0.5
    if not near.any() or near.mean() > 0.5:
        return np.full(2, np.nan)
    weights = np.where(near, likelihood, 0.0)
    return np.asarray(weights @ offsets / weights.sum())


def fit_correlation(videos: Sequence[Floats]) -> Correlation:
    """The mean, over pairs of children, of the correlation of their errors about 0; 0 where it is negative.

    Second moments are means over videos, each of (n, 2, K) residuals: a bias that children share is an error
    that they share, and each video counts the same, however long it is.

    Raises:
        ValueError: no video has `LEAST_RESIDUALS` frames in which two children say something.
    """
    usable = [one for one in videos if _said_together(one) >= LEAST_RESIDUALS]
    if not usable:
        most = max((_said_together(one) for one in videos), default=0)
        raise ValueError(
            f"fusion: at most {most} frames of a video in which the children say something while tracking is "
            f"on target; {LEAST_RESIDUALS} are needed"
        )
    moments = [_moments(one) for one in usable]
    value = _mean_correlation(moments)
    without = [
        _mean_correlation(moments[:k] + moments[k + 1 :]) for k in range(len(moments)) if len(moments) > 1
    ] or [value]
    return Correlation(value, sum(map(_said_together, usable)), (min(without), max(without)))


def _said_together(residuals: Floats) -> int:
    """Frames in which every child says something."""
    return int(np.isfinite(residuals).all(axis=(1, 2)).sum())


def _moments(residuals: Floats) -> Floats:
    """(K, K) mean product of errors over x, y and the frames in which every child says something."""
    kept = residuals[np.isfinite(residuals).all(axis=(1, 2))]
    return np.asarray(np.einsum("nck,ncl->kl", kept, kept) / (2 * len(kept)))


def _mean_correlation(moments: Sequence[Floats]) -> float:
    mean = np.mean(moments, axis=0)
    sd = np.sqrt(np.maximum(np.diag(mean), 1e-12))
    pairs = [mean[a, b] / (sd[a] * sd[b]) for a, b in combinations(range(len(sd)), 2)]
    return float(np.clip(np.mean(pairs), 0.0, 1.0))
