"""Which piece of a track goes on as which: tracks cut where they are doubtful, and the odds of each link.

A track is cut where another one is close, where it is not shown, and where it ends: what is left are
*tracklets*, each of one identity. A link says that the start of one continues the end of another. Its odds
are

    N(r; g) N(dv; g) N(ds; g) / null  x  prior,      r = x_start - x_end - g (v_end + v_start) / 2

over g frames, in sides of the box: with the mean of both velocities r and their difference dv are independent
where velocities walk randomly. All three spreads are measured in the run, on pieces of tracklets that are g
frames apart. The null is a target anywhere in the frame, as fast and as large as all others. Every start has
one end at most, and every end one start: the marginals of all links are those of `numerics.association`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Ints

REACH = 120
"""Frames over which a track may go on as another one."""
LEAST_CLEAR = 4
"""Frames of a tracklet between two doubtful places; fewer are doubtful themselves."""
WINDOW = 6
"""Frames at a tracklet's end, or start, by which its place and velocity are taken there."""
NEAR = 0.8
"""Tracks are close when centres are nearer than so many widths, and heights, in the mean of both."""
GAPS = (2, 4, 8, 16, 32, 64)
"""Frames at which the spreads are measured."""
OUTLYING, WIDER = 0.1, 3.0
"""Share of places and velocities that are off by a wider spread, and how much wider."""
TRUST = 0.6
"""Exponent of the likelihood ratio: tracks are smoother than what they follow, and errors last."""
KEEP, CHANGE = 3.0, -1.0
"""Log prior odds that a track goes on as itself, and as another one, against that it is new."""
LAPSE, MET = 0.01, 1.5
"""Least probability of an exchange of two that met, whatever their motion says; they did within so many sides
and three times the usual way."""
LEAST_ODDS = -9.0
"""Links with smaller log odds are left out, but for that of a track with itself."""


@dataclass(frozen=True, eq=False)
class TrackPath:
    """The path of one target in a run.

    Attributes:
        target: its id.
        frame: (N,) rising.
        boxes: (N, 4) centre boxes, px.
        shown: (N,) whether the box shows it: it is neither lost nor hidden.
    """

    target: str
    frame: Ints
    boxes: Floats
    shown: Bools


@dataclass(frozen=True, eq=False)
class Tracklet:
    """A piece of a path between doubtful places.

    Attributes:
        path: number of its path.
        begin: row of the path with which it begins, its doubtful place before it included.
        first: first clear row.
        last: last clear row.
        frames: numbers of the first and of the last clear frame.
        states: (2, 6) x, y, velocities of x and y in a frame, log w, log h; there.
    """

    path: int
    begin: int
    first: int
    last: int
    frames: tuple[int, int]
    states: Floats


@dataclass(frozen=True, eq=False)
class Spreads:
    """Spreads of what tracklets do in g frames, measured in the run.

    Attributes:
        place: (G,) sd of r, in sides.
        velocity: (G,) sd of the change of velocity, sides a frame.
        size: (G,) sd of the change of log w and log h.
        fast: sd of velocities of all, sides a frame.
        large: sd of log w and log h of all.
        usual: (2,) their means.
    """

    place: Floats
    velocity: Floats
    size: Floats
    fast: float
    large: float
    usual: Floats

    def at(self, gap: Floats) -> tuple[Floats, Floats, Floats]:
        """The three spreads at gaps (L,); beyond those measured as velocities walk: g^1.5 and g^0.5."""
        log, log_gaps = np.log(np.maximum(gap, 1.0)), np.log(np.array(GAPS, dtype=float))
        beyond = np.maximum(log - log_gaps[-1], 0.0)
        tables = ((self.place, 1.5), (self.velocity, 0.5), (self.size, 0.5))
        place, velocity, size = (
            np.exp(np.interp(log, log_gaps, np.log(table)) + slope * beyond) for table, slope in tables
        )
        return place, velocity, size


@dataclass(frozen=True, eq=False)
class Links:
    """Links: which tracklet may go on as which.

    Attributes:
        ends: (L,) tracklet that ends.
        starts: (L,) tracklet that starts.
        log_odds: (L,) against both a new target and an end.
        count: tracklets.
    """

    ends: Ints
    starts: Ints
    log_odds: Floats
    count: int


def cut_paths(paths: Sequence[TrackPath]) -> list[Tracklet]:
    """The tracklets of all paths, by path and row. A path that is never clear is one tracklet."""
    is_close = _close_rows(paths)
    pieces = []
    for number, path in enumerate(paths):
        doubtful = ~path.shown | is_close[number]
        doubtful[1:] |= np.diff(path.frame) > 1
        runs = [run for run in _runs(~doubtful) if run[1] - run[0] + 1 >= LEAST_CLEAR]
        begin = 0
        for first, final in runs or [(0, len(path.frame) - 1)]:
            pieces.append(_tracklet(number, path, (begin, first, final)))
            begin = final + 1
    return pieces


def _runs(clear: Bools) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], clear.astype(np.int8), [0]])))
    return [(int(first), int(end) - 1) for first, end in zip(edges[::2], edges[1::2], strict=True)]


def _tracklet(number: int, path: TrackPath, rows: tuple[int, int, int]) -> Tracklet:
    begin, first, final = rows
    states = np.array(
        [
            _state(path, first, min(first + WINDOW, final), 0),
            _state(path, max(final - WINDOW, first), final, 1),
        ]
    )
    return Tracklet(number, begin, first, final, (int(path.frame[first]), int(path.frame[final])), states)


def _state(path: TrackPath, first: int, final: int, at_end: int) -> Floats:
    """Place, velocity and size at one end of rows of a path."""
    boxes, row = path.boxes, final if at_end else first
    steps = max(float(path.frame[final] - path.frame[first]), 1.0)
    velocity = (boxes[final, :2] - boxes[first, :2]) / steps
    sizes = np.log(np.maximum(boxes[first : final + 1, 2:], 1.0))
    return np.concatenate([boxes[row, :2], velocity, np.median(sizes, axis=0)])


def _close_rows(paths: Sequence[TrackPath]) -> list[Bools]:
    """Of each path in which rows another one is close."""
    from scipy.spatial import cKDTree

    is_close = [np.zeros(len(path.frame), dtype=bool) for path in paths]
    if not paths:
        return is_close
    frame = np.concatenate([path.frame for path in paths])
    boxes = np.concatenate([path.boxes for path in paths])
    path_of = np.concatenate([np.full(len(path.frame), k) for k, path in enumerate(paths)])
    row = np.concatenate([np.arange(len(path.frame)) for path in paths])
    order = np.argsort(frame, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1):
        if len(rows) < 2:
            continue
        frame_boxes = boxes[rows]
        # In sides of the largest box: what is near there may be near.
        scale = frame_boxes[:, 2:].max(axis=0)
        pairs = cKDTree(frame_boxes[:, :2] / scale).query_pairs(NEAR, p=np.inf, output_type="ndarray")
        a, b = pairs[:, 0], pairs[:, 1]
        is_near = np.all(
            np.abs(frame_boxes[a, :2] - frame_boxes[b, :2])
            < NEAR * (frame_boxes[a, 2:] + frame_boxes[b, 2:]) / 2.0,
            axis=1,
        )
        for k in rows[np.unique(pairs[is_near])].tolist():
            is_close[path_of[k]][row[k]] = True
    return is_close


def measure_spreads(paths: Sequence[TrackPath], tracklets: Sequence[Tracklet]) -> Spreads:
    """The spreads of a run; where it has too few pieces, those of a slow walk."""
    tables = np.full((3, len(GAPS)), np.nan)
    pooled = [_moves(paths, tracklets, gap) for gap in GAPS]
    for place, moves in enumerate(pooled):
        if len(moves[0]) >= 30:
            # Robust: a swap that nobody saw is no motion.
            tables[:, place] = [1.4826 * np.median(np.abs(values)) for values in moves]
    defaults = np.array([[0.05], [0.02], [0.03]]) * np.array(GAPS)[None] ** np.array([[1.0], [0.5], [0.3]])
    slopes = np.array([1.5, 0.5, 0.5])
    for place in range(len(GAPS)):
        missing = np.isnan(tables[:, place])
        grown = defaults[:, place]
        if place:
            grown = tables[:, place - 1] * (GAPS[place] / GAPS[place - 1]) ** slopes
        tables[missing, place] = grown[missing]
    tables = np.maximum.accumulate(np.maximum(tables, 0.01 * np.array([[1.0], [0.2], [1.0]])), axis=1)
    states = np.array([tracklet.states for tracklet in tracklets]).reshape(-1, 6)
    sides = np.exp(states[:, 4:].mean(axis=1, keepdims=True))
    fast = float(np.sqrt(np.mean((states[:, 2:4] / sides) ** 2))) if len(states) else 0.1
    usual_size = states[:, 4:].mean(axis=0) if len(states) else np.zeros(2)
    large = float(states[:, 4:].std()) if len(states) else 0.3
    return Spreads(tables[0], tables[1], tables[2], max(fast, 0.02), max(large, 0.1), usual_size)


def _moves(
    paths: Sequence[TrackPath], tracklets: Sequence[Tracklet], gap: int, limit: int = 4000
) -> tuple[Floats, Floats, Floats]:
    """r, dv and ds of pieces of tracklets that are `gap` frames apart."""
    moves: list[tuple[Floats, Floats, Floats]] = []
    for tracklet in tracklets:
        path = paths[tracklet.path]
        for row in range(tracklet.first + WINDOW, tracklet.last - gap - WINDOW + 1, max(gap // 2, 3)):
            end = _state(path, row - WINDOW, row, 1)
            start = _state(path, row + gap, row + gap + WINDOW, 0)
            moves.append(_move(end[None], start[None], np.array([float(gap)])))
        if len(moves) > limit:
            break
    if not moves:
        return np.empty(0), np.empty(0), np.empty(0)
    place, velocity, size = (np.concatenate([move[k].ravel() for move in moves]) for k in range(3))
    return place, velocity, size


def _move(ends: Floats, starts: Floats, gap: Floats) -> tuple[Floats, Floats, Floats]:
    """(L, 2) each: r, dv and ds of ends and starts (L, 6), in sides of the end."""
    side = np.exp(ends[:, 4:].mean(axis=1, keepdims=True))
    mean = (ends[:, 2:4] + starts[:, 2:4]) / 2.0
    r = (starts[:, :2] - ends[:, :2] - gap[:, None] * mean) / side
    return r, (starts[:, 2:4] - ends[:, 2:4]) / side, starts[:, 4:] - ends[:, 4:]


def find_links(
    tracklets: Sequence[Tracklet],
    spreads: Spreads,
    size: tuple[int, int],
    prior: tuple[float, float] = (KEEP, CHANGE),
) -> Links:
    """All links that may be, of frames of `size` px."""
    count = len(tracklets)
    if not count:
        return Links(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), 0)
    frames = np.array([tracklet.frames for tracklet in tracklets])
    path = np.array([tracklet.path for tracklet in tracklets])
    states = np.array([tracklet.states for tracklet in tracklets])
    order = np.argsort(frames[:, 0], kind="stable")
    first = frames[order, 0]
    lows = np.searchsorted(first, frames[:, 1], side="right")
    highs = np.searchsorted(first, frames[:, 1] + REACH, side="right")
    goes_on = np.append(path[1:] == path[:-1], False)
    pairs = [order[low:high] for low, high in zip(lows.tolist(), highs.tolist(), strict=True)]
    ends = np.repeat(np.arange(count), [len(some) for some in pairs])
    # What is within reach, and every track with itself.
    continued = np.flatnonzero(goes_on)
    key = np.unique(np.append(ends * count + np.concatenate(pairs), continued * count + continued + 1))
    ends, starts = key // count, key % count
    is_own = (starts == ends + 1) & goes_on[ends]
    gap = (frames[starts, 0] - frames[ends, 1]).astype(float)
    log = log_ratio(states[ends, 1], states[starts, 0], gap, spreads, size)
    # A jump of a track that is itself is no more than an outlier.
    log_odds = TRUST * np.where(is_own, np.maximum(log, LEAST_ODDS), log) + np.where(
        is_own, prior[0], prior[1]
    )
    side = np.exp(states[ends, 1, 4:].mean(axis=1))
    distance = np.hypot(*(states[starts, 0, :2] - states[ends, 1, :2]).T) / side
    met = ~is_own & (distance < MET + 3.0 * spreads.fast * gap)
    log_odds = _with_lapses(ends, starts, log_odds, is_own, met)
    likely = is_own | (log_odds > LEAST_ODDS)
    return Links(ends[likely], starts[likely], log_odds[likely], count)


def _with_lapses(ends: Ints, starts: Ints, log_odds: Floats, is_own: Bools, met: Bools) -> Floats:
    """The log odds, so that two that met have exchanged identities with probability `LAPSE` at least."""
    row = {pair: k for k, pair in enumerate(zip(ends.tolist(), starts.tolist(), strict=True))}
    lifted, lapse_odds = log_odds.copy(), np.log(LAPSE)
    for k in np.flatnonzero(met).tolist():
        # b goes on as j, so that the end before j goes on as what b goes on as now.
        b, j = int(ends[k]), int(starts[k])
        exchange, previous, following = row.get((j - 1, b + 1)), row.get((j - 1, j)), row.get((b, b + 1))
        if (
            exchange is None
            or previous is None
            or following is None
            or not (is_own[previous] and is_own[following] and met[exchange])
        ):
            continue
        exchanged = log_odds[previous] + log_odds[following] + lapse_odds
        if log_odds[k] < exchanged / 2.0 and log_odds[k] + log_odds[exchange] < exchanged:
            lifted[k] = exchanged - max(log_odds[exchange], exchanged / 2.0)
    return lifted


def log_ratio(ends: Floats, starts: Floats, gap: Floats, spreads: Spreads, size: tuple[int, int]) -> Floats:
    """(L,) log-likelihood ratios of starts (L, 6) that continue ends (L, 6), and of any other."""
    moves, sds = _move(ends, starts, gap), spreads.at(gap)
    log = sum(_log_density(move, sd[:, None]) for move, sd in zip(moves, sds, strict=True))
    side = np.exp(ends[:, 4:].mean(axis=1))
    null = -np.log(size[0] * size[1] / side**2)
    null = null + _log_normal(starts[:, 2:4] / side[:, None], spreads.fast).sum(axis=1)
    null = null + _log_normal(starts[:, 4:] - spreads.usual, spreads.large).sum(axis=1)
    return np.asarray(log - null)


def _log_normal(deviation: Floats, sd: float | Floats) -> Floats:
    return np.asarray(-0.5 * (deviation / sd) ** 2 - np.log(sd) - 0.5 * np.log(2.0 * np.pi))


def _log_density(deviation: Floats, sd: Floats) -> Floats:
    """(L,) of both coordinates (L, 2), some of them outlying together."""
    inlier, outlier = _log_normal(deviation, sd).sum(axis=1), _log_normal(deviation, WIDER * sd).sum(axis=1)
    return np.asarray(np.logaddexp(np.log(1.0 - OUTLYING) + inlier, np.log(OUTLYING) + outlier))
