"""Estimate the standard deviations of cues at true boxes (thesis, equations 3.4 and 3.9)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.step import make_engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.numerics.distributions import follow, spread_of
from bayesnet_track.observation.cue import Cue, Residual, context_of
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, region_of_boxes

Residuals = Mapping[tuple[str, str], Sequence[Floats]]
"""(agent, parameter) -> the residuals (n,) of each frame that has some, in the parameter's unit."""

SHARES = (0.5, 0.9)
"""Central regions that a standard deviation is to be right about."""

NORMAL_QUANTILES = (0.6744897501960817, 1.6448536269514722)
"""Half widths, in standard deviations, of the central `SHARES` of a Gaussian."""

LEAST_RESIDUALS = 20
"""Fewer do not make an estimate: with 20 it is off by 20 %."""

MEMORY_FRAMES = 5.0
"""Frames over which an sd that follows its target is judged."""

STEP = 1.01
"""Ratio of neighbouring candidates for a standard deviation."""


@dataclass(frozen=True)
class FittedSd:
    """One standard deviation.

    Attributes:
        value: in the parameter's unit.
        residuals: of how many.
        inside: share of the residuals within its central 50 % and 90 %, mean over videos.
        left_out: the same of each video within the sd that is fitted to the others.
        followed: the same, where that sd is where each video starts and follows its target.
    """

    value: float
    residuals: int
    inside: tuple[float, float]
    left_out: tuple[float, float] = (0.0, 0.0)
    followed: tuple[float, float] = (0.0, 0.0)


def residuals_of(graph: CheckedGraph, frames: Iterable[Frame], truth: Floats) -> Residuals:
    """What the agents of the first target differ by at (n, 4) true corner boxes.

    As in tracking, the reference of each agent moves to what it learns at every box by its largest rate; the
    box of a frame is compared with the reference before that. Agents of a part of the target, whose true box
    is not known, and agents without sds that can be estimated are left out.

    Raises:
        ValueError: the truth has fewer boxes than there are frames.
    """
    compiled = next(iter(make_engine(graph).plates.values()))
    cues = {
        agent: cue
        for agent, cue in compiled.cues.items()
        if agent not in compiled.part_of and isinstance(cue, Residual) and isinstance(cue, Cue)
    }
    references: dict[str, Mapping[str, NDArray[np.generic]]] = {}
    found: dict[tuple[str, str], list[Floats]] = {}
    before: Frame | None = None
    for frame in frames:
        if frame.index >= len(truth):
            raise ValueError(f"the truth has {len(truth)} boxes, and the video has more frames")
        cache, before = PlaneCache(FramePair(frame, before)), frame
        box = centre_from_corner(truth[frame.index])
        if not np.isfinite(box).all():
            continue
        for agent, cue in cues.items():
            region = region_of_boxes(box[None], grow=max(context_of(cue), 0.0)).within(frame)
            if region.is_empty:
                continue
            planes = cache.planes(cue.needs, region)
            new = cue.learn(planes, box)
            old = references.get(agent)
            if old is not None:
                assert isinstance(cue, Residual)
                for name, values in cue.residuals(planes, box, old).items():
                    found.setdefault((agent, name), []).append(np.asarray(values, dtype=np.float64))
            rate = compiled.rate_max[agent]
            references[agent] = new if old is None else cue.blend(old, new, rate) if rate else old
    return {key: [one for one in values if len(one)] for key, values in found.items()}


def followed(found: Sequence[Floats], sd: float) -> Floats:
    """The residuals of one video, each over the factor by which the sd had followed the frames before.

    >>> still = followed([np.array([0.1])] * 40, 1.0)
    >>> bool(still[0] == 0.1 and 0.7 < still[-1] < 0.9)
    True
    """
    reference: Mapping[str, NDArray[np.generic]] = {}
    scaled = [np.empty(0)]
    for errors in found:
        scaled.append(errors / spread_of(reference, 1)[0])
        reference = follow(reference, [errors], [sd], MEMORY_FRAMES)
    return np.concatenate(scaled)


def fit_sd(videos: Sequence[Floats]) -> FittedSd | None:
    """The sd whose central 50 % and 90 % hold 50 % and 90 % of the residuals, best in least squares.

    Shares are means over videos: each counts the same, however long it is. Like a median absolute deviation,
    it is not moved by a few gross errors (a reference of another thing, a false match). None when there are
    fewer than `LEAST_RESIDUALS`, or when half of them are 0.

    >>> fit_sd([np.linspace(-3, 3, 601)]).value > 2
    True
    """
    sorted_out = [np.sort(np.abs(one)) for one in videos if len(one)]
    count = sum(map(len, sorted_out))
    if count < LEAST_RESIDUALS:
        return None
    everything = np.concatenate(sorted_out)
    middle, high = (float(np.quantile(everything, q)) for q in (0.5, 0.98))
    if middle <= 0.0:
        return None
    first, last = (int(np.log(value) / np.log(STEP)) for value in (middle / 10.0, high * 2.0))
    grid = STEP ** np.arange(first, last + 1)  # the same candidates, however long each video is
    held = [
        [np.searchsorted(one, q * grid, side="right") / len(one) for q in NORMAL_QUANTILES]
        for one in sorted_out
    ]
    inside = np.mean(held, axis=0).T
    best = int(((inside - SHARES) ** 2).sum(axis=1).argmin())
    return FittedSd(float(grid[best]), count, (float(inside[best, 0]), float(inside[best, 1])))


def shares_inside(videos: Sequence[Floats], sd: float) -> tuple[float, float]:
    """Shares of the residuals in the central 50 % and 90 % of a Gaussian with `sd`, mean over videos."""
    held = [[np.mean(np.abs(one) <= q * sd) for q in NORMAL_QUANTILES] for one in videos if len(one)]
    fifty, ninety = np.mean(held, axis=0)
    return float(fifty), float(ninety)


def fit_sds(videos: Sequence[Residuals]) -> dict[tuple[str, str], FittedSd]:
    """(agent, parameter) -> its standard deviation, from the residuals of each video.

    Raises:
        ValueError: fewer than two videos, no agent has an sd to estimate, or one has too few residuals.
    """
    if len(videos) < 2:
        raise ValueError("sds: one video; two or more are needed, since sds that fit one seldom fit another")
    keys = list(dict.fromkeys(key for one in videos for key in one))
    if not keys:
        raise ValueError("sds: no agent of the target has any to estimate; color_blobs and motion have")
    fitted = {key: _judged([one[key] for one in videos if key in one]) for key in keys}
    missing = [key for key, one in fitted.items() if one is None]
    if missing:
        agent, parameter = missing[0]
        count = sum(len(errors) for one in videos for errors in one.get(missing[0], ()))
        why = "half of them are 0" if count >= LEAST_RESIDUALS else f"{LEAST_RESIDUALS} are needed"
        raise ValueError(
            f"sds: {parameter} of {agent} cannot be estimated from {count} residuals: {why}; give more "
            "videos, or leave out sds"
        )
    return {key: one for key, one in fitted.items() if one is not None}


def _judged(videos: Sequence[Sequence[Floats]]) -> FittedSd | None:
    """An sd with the shares that sds fitted to all other videos hold of each."""
    joined = [np.concatenate([np.empty(0), *found]) for found in videos]
    whole = fit_sd(joined)
    if whole is None:
        return None
    others = [fit_sd([*joined[:k], *joined[k + 1 :]]) or whole for k in range(len(joined))]
    scaled = [one / sd.value for one, sd in zip(joined, others, strict=True)]
    following = [followed(found, sd.value) / sd.value for found, sd in zip(videos, others, strict=True)]
    return replace(whole, left_out=shares_inside(scaled, 1.0), followed=shares_inside(following, 1.0))
