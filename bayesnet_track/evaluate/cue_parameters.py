"""Parameters of cues and pools at true boxes: standard deviations of cues, correlation of a pool's errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.filtering import evaluate_at
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.starts import Start, start_targets
from bayesnet_track.engine.step import State, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.numerics.distributions import follow_spread, spread_of
from bayesnet_track.observation.cue import Cue, Residual, context_of
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, region_of_boxes

CueResiduals = Mapping[tuple[str, str], Sequence[Floats]]
"""(agent, parameter) -> the residuals (n,) of each frame that has some, in the parameter's unit."""

SHARES = (0.5, 0.9)
"""Central regions that a standard deviation is to be right about."""

NORMAL_QUANTILES = (0.6744897501960817, 1.6448536269514722)
"""Half widths, in standard deviations, of the central `SHARES` of a Gaussian."""

MIN_RESIDUALS = 20
"""With 20 residuals an sd is off by 20 %, and two independent children seem correlated by 0.16."""

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


def cue_residuals(graph: CheckedGraph, frames: Iterable[Frame], truth: Floats) -> CueResiduals:
    """Residuals of the agents of the first target at (n, 4) true corner boxes.

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
    residuals: dict[tuple[str, str], list[Floats]] = {}
    previous: Frame | None = None
    for frame in frames:
        if frame.index >= len(truth):
            raise ValueError(f"the truth has {len(truth)} boxes, and the video has more frames")
        cache, previous = PlaneCache(FramePair(frame, previous)), frame
        box = centre_from_corner(truth[frame.index])
        if not np.isfinite(box).all():
            continue
        for agent, cue in cues.items():
            region = region_of_boxes(box[None], grow=max(context_of(cue), 0.0)).within(frame)
            if region.is_empty:
                continue
            planes = cache.planes(cue.needs, region)
            learned = cue.learn(planes, box)
            reference = references.get(agent)
            if reference is not None:
                assert isinstance(cue, Residual)
                for name, values in cue.residuals(planes, box, reference).items():
                    residuals.setdefault((agent, name), []).append(np.asarray(values, dtype=np.float64))
            rate = compiled.rate_max[agent]
            references[agent] = (
                learned if reference is None else cue.blend(reference, learned, rate) if rate else reference
            )
    return {key: [errors for errors in values if len(errors)] for key, values in residuals.items()}


def _followed(residuals: Sequence[Floats], sd: float) -> Floats:
    """The residuals of one video, each over the factor by which the sd had followed the frames before.

    >>> still = _followed([np.array([0.1])] * 40, 1.0)
    >>> bool(still[0] == 0.1 and 0.7 < still[-1] < 0.9)
    True
    """
    reference: Mapping[str, NDArray[np.generic]] = {}
    scaled = [np.empty(0)]
    for errors in residuals:
        scaled.append(errors / spread_of(reference, 1)[0])
        reference = follow_spread(reference, [errors], [sd], MEMORY_FRAMES)
    return np.concatenate(scaled)


def fit_sd(videos: Sequence[Floats]) -> FittedSd | None:
    """The sd whose central 50 % and 90 % hold 50 % and 90 % of the residuals, best in least squares.

    Shares are means over videos: each counts the same, however long it is. Like a median absolute deviation,
    it is not moved by a few gross errors (a reference of another thing, a false match). None when there are
    fewer than `MIN_RESIDUALS`, or when half of them are 0.

    >>> fit_sd([np.linspace(-3, 3, 601)]).value > 2
    True
    """
    sorted_out = [np.sort(np.abs(errors)) for errors in videos if len(errors)]
    count = sum(map(len, sorted_out))
    if count < MIN_RESIDUALS:
        return None
    everything = np.concatenate(sorted_out)
    middle, high = (float(np.quantile(everything, q)) for q in (0.5, 0.98))
    if middle <= 0.0:
        return None
    first, end = (int(np.log(value) / np.log(STEP)) for value in (middle / 10.0, high * 2.0))
    grid = STEP ** np.arange(first, end + 1)  # the same candidates, however long each video is
    shares = [
        [np.searchsorted(magnitudes, q * grid, side="right") / len(magnitudes) for q in NORMAL_QUANTILES]
        for magnitudes in sorted_out
    ]
    mean_shares = np.mean(shares, axis=0).T
    index = int(((mean_shares - SHARES) ** 2).sum(axis=1).argmin())
    return FittedSd(float(grid[index]), count, (float(mean_shares[index, 0]), float(mean_shares[index, 1])))


def central_shares(videos: Sequence[Floats], sd: float) -> tuple[float, float]:
    """Shares of the residuals in the central 50 % and 90 % of a Gaussian with `sd`, mean over videos."""
    shares = [
        [np.mean(np.abs(errors) <= q * sd) for q in NORMAL_QUANTILES] for errors in videos if len(errors)
    ]
    fifty, ninety = np.mean(shares, axis=0)
    return float(fifty), float(ninety)


def fit_sds(videos: Sequence[CueResiduals]) -> dict[tuple[str, str], FittedSd]:
    """(agent, parameter) -> its standard deviation, from the residuals of each video.

    Raises:
        ValueError: fewer than two videos, no agent has an sd to estimate, or one has too few residuals.
    """
    if len(videos) < 2:
        raise ValueError("sds: one video; two or more are needed, since sds that fit one seldom fit another")
    keys = list(dict.fromkeys(key for video in videos for key in video))
    if not keys:
        raise ValueError("sds: no agent of the target has any to estimate; color_blobs and motion have")
    fitted = {key: _judged([video[key] for video in videos if key in video]) for key in keys}
    missing = [key for key, sd in fitted.items() if sd is None]
    if missing:
        agent, parameter = missing[0]
        count = sum(len(errors) for video in videos for errors in video.get(missing[0], ()))
        why = "half of them are 0" if count >= MIN_RESIDUALS else f"{MIN_RESIDUALS} are needed"
        raise ValueError(
            f"sds: {parameter} of {agent} cannot be estimated from {count} residuals: {why}; give more "
            "videos, or leave out sds"
        )
    return {key: sd for key, sd in fitted.items() if sd is not None}


def _judged(videos: Sequence[Sequence[Floats]]) -> FittedSd | None:
    """An sd with the shares that sds fitted to all other videos hold of each."""
    joined = [np.concatenate([np.empty(0), *residuals]) for residuals in videos]
    fitted = fit_sd(joined)
    if fitted is None:
        return None
    rest_fits = [fit_sd([*joined[:k], *joined[k + 1 :]]) or fitted for k in range(len(joined))]
    scaled = [errors / sd.value for errors, sd in zip(joined, rest_fits, strict=True)]
    following = [
        _followed(residuals, sd.value) / sd.value for residuals, sd in zip(videos, rest_fits, strict=True)
    ]
    return replace(fitted, left_out=central_shares(scaled, 1.0), followed=central_shares(following, 1.0))


PoolErrors = Mapping[str, Floats]
"""Learned pool -> (n, 2, K) true centre less the estimate of each of its K children, in sqrt(w h) of the true
box; NaN where a child says nothing."""

REACH, PLACES = 0.75, 31
"""Places at which children are asked: so far around the true centre on each side, in sides of the true box,
and so many on each axis."""


@dataclass(frozen=True)
class PoolCorrelation:
    """Correlation of the errors of a pool's children.

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
    pools = {name: plate.children[name] for name in plate.children if plate.correlation(name) is not None}
    if not pools:
        raise ValueError("fusion: no node with fuse: {pool: learned}, whose correlation is to be estimated")
    for name in pools:
        ancestor: str | None = name
        while ancestor is not None:
            fuse = plate.inference(ancestor).fuse
            if fuse is not None and fuse.latent is not None:
                raise ValueError(
                    f"fusion: {name} is about the state of {ancestor}, whose true value no video gives; "
                    "set its correlation by hand"
                )
            ancestor = plate.parent[ancestor]
    return pools


def pool_errors(graph: CheckedGraph, frames: Iterable[Frame], truth: Floats, seed: int = 0) -> PoolErrors:
    """Errors of the children of learned pools, in the frames in which tracking is on target.

    The video is tracked from the first of (n, 4) true corner boxes, so that references are those of a run. In
    every later frame each child is asked about boxes of the true size at `PLACES`^2 places around the true
    centre. Its own estimate is the mean, by likelihood, of those at least half as likely as its best; it says
    nothing where these are more than half of all places.

    Raises:
        ValueError: the truth has fewer boxes than there are frames, or there is no pool to estimate.
    """
    engine = make_engine(graph, seed)
    pools = learned_pools(next(iter(graph.targets.values())))
    errors: dict[str, list[Floats]] = {name: [] for name in pools}
    state: State | None = None
    for frame in frames:
        if frame.index >= len(truth):
            raise ValueError(f"the truth has {len(truth)} boxes, and the video has more frames")
        box = truth[frame.index]
        if state is None:
            x, y, w, h = (float(value) for value in box)
            state = start_targets(graph, engine, frame, [Start((x, y, w, h))]).state
            continue
        previous, state = state, (outcome := step(engine, state, frame)).state
        line = next((metrics for metrics in outcome.metrics if metrics.target == "1"), None)
        if line is None or "1" not in previous.targets or not np.isfinite(box).all():
            continue
        true = centre_from_corner(box)
        if overlap(np.array(line.centre_box)[None], true[None])[0] <= 0.5:
            continue
        cache = PlaneCache(FramePair(frame, previous.previous))
        work = FrameContext(engine, previous.net, cache, previous.history.births)
        offsets = lattice()
        boxes = np.tile(true, (len(offsets), 1))
        boxes[:, :2] += offsets * true[2:]
        messages = evaluate_at(work, "1", previous.targets["1"], boxes).messages
        scale = true[2:] / np.sqrt(true[2] * true[3])
        for pool, children in pools.items():
            estimates = [own_estimate(messages.get(child), offsets) * scale for child in children]
            errors[pool].append(np.stack(estimates, axis=1))
    return {pool: np.array(rows).reshape(-1, 2, len(pools[pool])) for pool, rows in errors.items()}


def lattice() -> Floats:
    """(`PLACES`^2, 2) offsets from a centre, in sides of a box."""
    steps = np.linspace(-REACH, REACH, PLACES)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


def own_estimate(log_likelihood: Floats | None, offsets: Floats) -> Floats:
    """(2,) where a message (N,) at `offsets` (N, 2) says that the target is; NaN when it says nothing."""
    if log_likelihood is None:
        return np.full(2, np.nan)
    likelihood = np.exp(log_likelihood - log_likelihood.max())
    likely = likelihood >= 0.5
    if not likely.any() or likely.mean() > 0.5:
        return np.full(2, np.nan)
    weights = np.where(likely, likelihood, 0.0)
    return np.asarray(weights @ offsets / weights.sum())


def fit_correlation(videos: Sequence[Floats]) -> PoolCorrelation:
    """The mean, over pairs of children, of the correlation of their errors about 0; 0 where it is negative.

    Second moments are means over videos, each of (n, 2, K) residuals: a bias that children share is an error
    that they share, and each video counts the same, however long it is.

    Raises:
        ValueError: no video has `MIN_RESIDUALS` frames in which two children say something.
    """
    usable = [video for video in videos if _said_together(video) >= MIN_RESIDUALS]
    if not usable:
        longest = max((_said_together(video) for video in videos), default=0)
        raise ValueError(
            f"fusion: at most {longest} frames of a video in which the children say something while tracking "
            f"is on target; {MIN_RESIDUALS} are needed"
        )
    moments = [_moments(video) for video in usable]
    value = _mean_correlation(moments)
    without = [
        _mean_correlation(moments[:k] + moments[k + 1 :]) for k in range(len(moments)) if len(moments) > 1
    ] or [value]
    return PoolCorrelation(value, sum(map(_said_together, usable)), (min(without), max(without)))


def _said_together(residuals: Floats) -> int:
    """Frames in which every child says something."""
    return int(np.isfinite(residuals).all(axis=(1, 2)).sum())


def _moments(residuals: Floats) -> Floats:
    """(K, K) mean product of errors over x, y and the frames in which every child says something."""
    complete = residuals[np.isfinite(residuals).all(axis=(1, 2))]
    return np.asarray(np.einsum("nck,ncl->kl", complete, complete) / (2 * len(complete)))


def _mean_correlation(moments: Sequence[Floats]) -> float:
    mean = np.mean(moments, axis=0)
    sd = np.sqrt(np.maximum(np.diag(mean), 1e-12))
    pairs = [mean[a, b] / (sd[a] * sd[b]) for a, b in combinations(range(len(sd)), 2)]
    return float(np.clip(np.mean(pairs), 0.0, 1.0))
