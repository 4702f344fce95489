"""Joins of targets that may depend on each other: memory, and decisions to join and to part."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from bayesnet_track.graph.settings.lifecycle import Join, join_of
from bayesnet_track.journal.events.joins import Joined, Parted
from bayesnet_track.journal.net import Net
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve

Pair = tuple[str, str]
T = TypeVar("T")

LEVEL_FRAMES = 20
"""Frames over which a target's level of evidence is averaged."""

LEVEL_HIDDEN = 0.1
"""Largest hidden share of a target from which its level is measured."""


@dataclass(frozen=True)
class PairMemory:
    """Memory of two joined targets.

    Attributes:
        first_in_front: probability that the first is in front.
        overlap: overlap of the reaches in the last frame.
        apart: overlaps of the last consecutive frames in which it was below the level.
        left_out: whether the pair is left out of a ring.
        flawed: whether its factor had no value for some pairs of hypotheses, or was 0 for all.
    """

    first_in_front: float = 0.5
    overlap: float = 0.0
    apart: tuple[float, ...] = ()
    left_out: bool = False
    flawed: bool = False


@dataclass(frozen=True)
class Level:
    """Usual answers of the agents `active` about a target while it is seen: means over `frames`.

    Attributes:
        active: those agents.
        log: log-likelihood half way between the best hypothesis and the worst.
        best: that of the best one.
        frames: how many.
    """

    active: frozenset[str]
    log: float
    best: float
    frames: int = 1

    def then(self, active: frozenset[str], log: float, best: float) -> Level:
        """With one more frame; from the start again when other agents are active."""
        if active != self.active:
            return Level(active, log, best)
        frames = min(self.frames + 1, LEVEL_FRAMES)
        return Level(
            active, self.log + (log - self.log) / frames, self.best + (best - self.best) / frames, frames
        )


@dataclass(frozen=True, eq=False)
class CarriedHypotheses:
    """Hypotheses of a target that are carried.

    Attributes:
        belief: the belief after the last frame, whose hypotheses they are.
        hypotheses: (N,) 1 where it is carried, else 0.
    """

    belief: object
    hypotheses: Floats


@dataclass(frozen=True, eq=False)
class JoinMemory:
    """Memory of joins between frames.

    Attributes:
        pairs: joined pair -> what is remembered of it.
        levels: target -> its level of evidence.
        carried: target that may be carried -> which of its hypotheses are.
        centres: carrier -> (2,) mean centre by its own evidence.
        hidden: hidden target -> who hides it, and since which frame.
        carriers: carried target -> who carries it, and since which frame.
        crosses: two targets with Gaussian beliefs that factors relate -> (D, D') covariance of their states.
    """

    pairs: Mapping[Pair, PairMemory] = field(default_factory=dict)
    levels: Mapping[str, Level] = field(default_factory=dict)
    carried: Mapping[str, CarriedHypotheses] = field(default_factory=dict)
    centres: Mapping[str, Floats] = field(default_factory=dict)
    hidden: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    carriers: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    crosses: Mapping[Pair, Floats] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Reaches:
    """Places at which beliefs say that their targets are.

    Attributes:
        names: the T targets.
        boxes: (T, 4) mean boxes, px.
        sds: (T, 2) of their centres.
    """

    names: Sequence[str]
    boxes: Floats
    sds: Floats

    @property
    def overlaps(self) -> Floats:
        """(T, T) overlap of the reaches, as a share of the smaller one's area.

        A reach is the mean box, widened by one sd of the centre on each side.
        """
        half = self.boxes[:, 2:] / 2 + self.sds
        low, high = self.boxes[:, :2] - half, self.boxes[:, :2] + half
        sides = np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None])
        areas = np.prod(high - low, axis=1)
        return np.asarray(
            np.prod(np.clip(sides, 0.0, None), axis=2) / np.minimum(areas[:, None], areas[None])
        )


def decide_joins(
    frame: int, rules: tuple[Join, ...], net: Net, reaches: Reaches, memory: JoinMemory
) -> tuple[tuple[Joined | Parted, ...], JoinMemory]:
    """Join every pair that overlaps and has a rule, part every joined pair that has been apart for long.

    Two levels keep it from going back and forth: joining takes one frame with the overlap, parting takes
    `apart_frames` without it. What is remembered of targets that are gone is dropped.
    """
    names, overlaps = reaches.names, reaches.overlaps
    kinds = {name: net.targets[name].template for name in names}
    decisions: list[Joined | Parted] = []
    pairs: dict[Pair, PairMemory] = {}
    joined = {frozenset(pair): pair for pair in net.joins}
    always = any(rule.when.overlap == 0 for rule in rules)
    for i, k in zip(*np.nonzero(np.triu(np.ones_like(overlaps) if always else overlaps, 1)), strict=True):
        first, second = names[i], names[k]
        rule = join_of(rules, kinds[first], kinds[second])
        if frozenset((first, second)) in joined or rule is None or overlaps[i, k] < rules[rule].when.overlap:
            continue
        pair = _order_pair(rules[rule], kinds, first, second)
        overlap = float(overlaps[i, k])
        decisions.append(
            Joined(frame, *pair, (kinds[pair[0]], kinds[pair[1]]), rule, overlap, rules[rule].when.overlap)
        )
        pairs[pair] = PairMemory(overlap=overlap)
    rows = {name: number for number, name in enumerate(names)}
    for pair, join in net.joins.items():
        if pair[0] not in rows or pair[1] not in rows:
            continue
        previous = memory.pairs.get(pair, PairMemory())
        overlap = float(overlaps[rows[pair[0]], rows[pair[1]]])
        when = rules[join.rule].when
        streak = (*previous.apart, overlap) if overlap < when.overlap else ()
        if len(streak) >= when.apart_frames:
            together = frame - join.frame
            decisions.append(Parted(frame, *pair, overlap, when.overlap, len(streak), max(streak), together))
        else:
            pairs[pair] = evolve(previous, overlap=overlap, apart=streak)
    return tuple(decisions), _prune(replace(memory, pairs=pairs), frozenset(names))


def spanning_tree(overlaps: Mapping[Pair, float]) -> tuple[tuple[Pair, ...], dict[Pair, tuple[str, ...]]]:
    """The pairs of largest overlap that close no ring, and each pair left out with the group it is in.

    Kruskal's algorithm; of equal overlaps the earlier pair is taken.
    """
    group: dict[str, list[str]] = {}
    tree: list[Pair] = []
    left_out: list[Pair] = []
    for pair in sorted(overlaps, key=lambda key: -overlaps[key]):
        first, second = (group.setdefault(name, [name]) for name in pair)
        if first is second:
            left_out.append(pair)
            continue
        tree.append(pair)
        first += second
        for name in second:
            group[name] = first
    return tuple(tree), {pair: tuple(group[pair[0]]) for pair in left_out}


def _order_pair(rule: Join, kinds: Mapping[str, str], first: str, second: str) -> Pair:
    """The pair, a carrier first, and the first kind of a factor."""
    ordered = rule.attachment is not None or rule.factor is not None
    carrier = rule.between[0] if ordered and rule.between is not None else None
    return (second, first) if carrier is not None and kinds[second] == carrier else (first, second)


def _prune(memory: JoinMemory, live: frozenset[str]) -> JoinMemory:
    """The memory of live targets; what only joined ones have goes with their last join."""
    joined = {name for pair in memory.pairs for name in pair}
    return JoinMemory(
        pairs=memory.pairs,
        levels=dict(_entries_of(memory.levels, live)),
        carried=dict(_entries_of(memory.carried, joined)),
        centres=dict(_entries_of(memory.centres, joined)),
        hidden=dict(_entries_of(memory.hidden, joined)),
        carriers=dict(_entries_of(memory.carriers, joined)),
        crosses={pair: memory.crosses[pair] for pair in memory.crosses if joined.issuperset(pair)},
    )


def _entries_of(mapping: Mapping[str, T], names: Iterable[str]) -> Iterator[tuple[str, T]]:
    selected = set(names)
    return ((name, value) for name, value in mapping.items() if name in selected)
