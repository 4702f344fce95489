"""The most probable chains of tracklets, the probability of each link, and the identities that they give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.adapt.tracklets import Links, Tracklet, TrackPath
from bayesnet_track.numerics.arrays import Floats, Ints

HIDDEN, LASTING, FARTHEST = 0.5, 0.3, 2.0
"""In a doubtful place: sides by which a box is farther from an identity where it is not shown, and nearer
where it had it in the row before; and beyond which it is not its own."""


@dataclass(frozen=True, eq=False)
class LinkPosterior:
    """Probabilities of links, and the most probable ones together.

    Attributes:
        links: the links, with those that answers name.
        probability: (L,) of each.
        new: (T,) that a tracklet's start continues none.
        chosen: tracklet -> the one that it continues, in the most probable assignment.
    """

    links: Links
    probability: Floats
    new: Floats
    chosen: Mapping[int, int]

    def of(self, start: int) -> dict[int | None, float]:
        """The ends that a start may continue, by falling probability; None for nothing."""
        mine = np.flatnonzero(self.links.starts == start)
        shares: dict[int | None, float] = dict(
            zip(self.links.ends[mine].tolist(), self.probability[mine].tolist(), strict=True)
        )
        shares[None] = float(self.new[start])
        return dict(sorted(shares.items(), key=lambda share: -share[1]))


def infer(links: Links, answers: Mapping[int, int | None] | None = None) -> LinkPosterior:
    """The posterior given answers: start -> the end that it continues, or None; no end in two of them."""
    from bayesnet_track.numerics.association import LARGEST, marginalise

    answers = answers or {}
    fixed = {(end, start) for start, end in answers.items() if end is not None}
    fixed_ends = {end for end, _ in fixed}
    free = np.array(
        [
            start not in answers and end not in fixed_ends
            for end, start in zip(links.ends.tolist(), links.starts.tolist(), strict=True)
        ],
        dtype=bool,
    )
    ends = np.append(links.ends[free], [end for end, _ in fixed]).astype(np.int64)
    starts = np.append(links.starts[free], [start for _, start in fixed]).astype(np.int64)
    log_odds = np.append(links.log_odds[free], np.full(len(fixed), np.log(LARGEST)))
    conditioned = Links(ends, starts, log_odds, links.count)
    marginals = marginalise(ends, starts, np.exp(np.minimum(log_odds, 60.0)), (links.count, links.count))
    return LinkPosterior(conditioned, marginals.pairs, marginals.free, _most_probable(conditioned))


def _most_probable(links: Links) -> dict[int, int]:
    """Start -> end of the assignment with the largest product of odds."""
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    # A link that is less probable than none is never part of it.
    useful = np.flatnonzero(links.log_odds > 0.0)
    ends, starts, gain = links.ends[useful], links.starts[useful], links.log_odds[useful]
    shape = (2 * links.count, 2 * links.count)
    _, label = connected_components(
        coo_matrix((np.ones(len(ends)), (ends, starts + links.count)), shape), False
    )
    assignment: dict[int, int] = {}
    order = np.argsort(label[ends], kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(label[ends][order])) + 1) if len(order) else []:
        rows, row = np.unique(ends[part], return_inverse=True)
        columns, column = np.unique(starts[part], return_inverse=True)
        table = np.zeros((len(rows), len(columns)))
        table[row, column] = gain[part]
        for a, b in zip(*linear_sum_assignment(table, maximize=True), strict=True):
            if table[a, b] > 0.0:
                assignment[int(columns[b])] = int(rows[a])
    return assignment


def label_rows(
    paths: Sequence[TrackPath], tracklets: Sequence[Tracklet], assignment: Mapping[int, int]
) -> list[list[str]]:
    """The identity of every row of every path: that of the first tracklet of its chain.

    Between an end and the start that continues it in another path, it changes where both were closest.
    """
    names: list[str] = []
    counts: dict[str, int] = {}
    order = sorted(range(len(tracklets)), key=lambda k: (tracklets[k].frames[0], k))
    label: dict[int, str] = {}
    for k in order:
        if k in assignment and assignment[k] in label:
            label[k] = label[assignment[k]]
            continue
        name = paths[tracklets[k].path].target
        counts[name] = counts.get(name, 0) + 1
        while counts[name] > 1 and f"{name}.{counts[name]}" in {path.target for path in paths}:
            counts[name] += 1
        label[k] = name if counts[name] == 1 else f"{name}.{counts[name]}"
    names = [label[k] for k in range(len(tracklets))]
    rows = [[""] * len(path.frame) for path in paths]
    for k, tracklet in enumerate(tracklets):
        is_last = k + 1 == len(tracklets) or tracklets[k + 1].path != tracklet.path
        end = len(paths[tracklet.path].frame) if is_last else tracklet.last + 1
        # What stands before a path's first clear row, and behind its last one, is of it alone.
        start = tracklet.first if _follows(tracklets, k) else 0
        rows[tracklet.path][start:end] = [names[k]] * (end - start)
    _label_doubtful(paths, tracklets, _Between.of(tracklets, assignment, names), rows)
    return _without_two(paths, rows)


def _follows(tracklets: Sequence[Tracklet], k: int) -> bool:
    return k > 0 and tracklets[k - 1].path == tracklets[k].path


@dataclass(frozen=True, eq=False)
class _Between:
    """Expected places of identities between an end and the start that continues it.

    Attributes:
        names: of L links the identity.
        frames: (L, 2) of the end and of the start.
        states: (L, 2, 6) there.
    """

    names: list[str]
    frames: Ints
    states: Floats

    @classmethod
    def of(
        cls, tracklets: Sequence[Tracklet], assignment: Mapping[int, int], names: Sequence[str]
    ) -> _Between:
        pairs = [(end, start) for start, end in assignment.items()]
        frames = [(tracklets[end].frames[1], tracklets[start].frames[0]) for end, start in pairs]
        states = [(tracklets[end].states[1], tracklets[start].states[0]) for end, start in pairs]
        return cls(
            [names[start] for _, start in pairs],
            np.array(frames, dtype=np.int64).reshape(-1, 2),
            np.array(states).reshape(-1, 2, 6),
        )

    def at(self, frame: int) -> tuple[list[str], Floats]:
        """The identities that are between two tracklets in a frame, and their places (K, 2)."""
        current = np.flatnonzero((self.frames[:, 0] < frame) & (frame < self.frames[:, 1]))
        span = (self.frames[current, 1] - self.frames[current, 0]).astype(float)[:, None]
        t = (frame - self.frames[current, 0])[:, None] / span
        (p, q), (u, v) = (
            np.moveaxis(self.states[current][..., part], 1, 0) for part in (slice(0, 2), slice(2, 4))
        )
        # The cubic with these places and velocities at both ends.
        place = (1 + 2 * t) * (1 - t) ** 2 * p + t * (1 - t) ** 2 * span * u
        place = place + t**2 * (3 - 2 * t) * q + t**2 * (t - 1) * span * v
        return [self.names[k] for k in current.tolist()], place


def _label_doubtful(
    paths: Sequence[TrackPath], tracklets: Sequence[Tracklet], between: _Between, rows: list[list[str]]
) -> None:
    """Label the rows between tracklets, frame by frame: each with the identity that is expected nearest."""
    waiting: dict[int, list[tuple[int, int]]] = {}
    for k, tracklet in enumerate(tracklets):
        if _follows(tracklets, k):
            for row in range(tracklet.begin, tracklet.first):
                waiting.setdefault(int(paths[tracklet.path].frame[row]), []).append((tracklet.path, row))
    for frame in sorted(waiting):
        names, places = between.at(frame)
        entries = waiting[frame]
        if not names:
            continue
        boxes = np.array([paths[path].boxes[row] for path, row in entries])
        offset = np.abs(boxes[:, None, :2] - places) / boxes[:, None, 2:]
        cost = offset.max(axis=2)
        for place, (path, row) in enumerate(entries):
            previous = rows[path][row - 1] if row else ""
            cost[place] += HIDDEN * (not paths[path].shown[row])
            cost[place] -= LASTING * np.array([name == previous for name in names])
        for a, b in zip(*assign_least(np.minimum(cost, FARTHEST)), strict=True):
            path, row = entries[a]
            if cost[a, b] < FARTHEST:
                rows[path][row] = names[b]


def assign_least(cost: Floats) -> tuple[Ints, Ints]:
    """Rows and columns of the assignment with the least cost."""
    from scipy.optimize import linear_sum_assignment

    return linear_sum_assignment(cost)  # type: ignore[no-any-return]


def _without_two(paths: Sequence[TrackPath], rows: list[list[str]]) -> list[list[str]]:
    """The same with no identity twice in a frame: the path that comes later keeps it."""
    owner: dict[tuple[str, int], tuple[int, int]] = {}
    for number, path in enumerate(paths):
        for row, frame in enumerate(path.frame.tolist()):
            key = (rows[number][row], frame)
            if key in owner:
                earlier, place = owner[key]
                rows[earlier][place] = ""
            owner[key] = (number, row)
    return rows
