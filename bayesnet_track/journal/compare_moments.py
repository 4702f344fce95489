"""Where two runs part: decisions that only one of them took, or that each took otherwise or later."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from bayesnet_track.journal.events.births import TargetStarted
from bayesnet_track.journal.events.joins import Joined, Parted
from bayesnet_track.journal.events.reidentification import Returned
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.net.net import Decision

SHIFT = 10
"""Frames by which the same decision may come earlier or later and still count as the same moment."""


Pair = tuple[str, str]


@dataclass(frozen=True)
class Moment:
    """Decisions about one node of one target that only one run took, or that each took otherwise or later.

    Attributes:
        frame: the earlier of the frames.
        pair: ids of the target in the first and in the second run; empty in one that does not have it.
        node: the agent, or the other target of a join; empty for the target as a whole.
        first: what the first run decided; empty when nothing.
        second: what the second run decided.
    """

    frame: int
    pair: Pair
    node: str
    first: tuple[Decision, ...]
    second: tuple[Decision, ...]

    @property
    def target(self) -> str:
        """Id of the target in the first run, else in the second."""
        return self.pair[0] or self.pair[1]


def find_moments(
    first: Sequence[Decision], second: Sequence[Decision], pairs: Sequence[Pair]
) -> tuple[int, tuple[Moment, ...]]:
    """How many decisions both runs took in the same frame, and the moments in which they part."""
    agreed, moments = 0, []
    named = max(len(_types(one)) for one in (first, second)) > 1
    mine = _by_place(first, {a: (a, b) for a, b in pairs}, lambda target: (target, ""))
    theirs = _by_place(second, {b: (a, b) for a, b in pairs}, lambda target: ("", target))
    for place in dict.fromkeys([*mine, *theirs]):
        a, b = mine.get(place, []), theirs.get(place, [])
        same, rest_a, rest_b = _match(a, b, 0, named)
        agreed += len(same)
        shifted, rest_a, rest_b = _match(rest_a, rest_b, SHIFT, named)
        moments += [Moment(min(x.frame, y.frame), *place, (x,), (y,)) for x, y in shifted]
        for frame in sorted({event.frame for event in (*rest_a, *rest_b)}):
            only_a = tuple(event for event in rest_a if event.frame == frame)
            only_b = tuple(event for event in rest_b if event.frame == frame)
            moments.append(Moment(frame, *place, only_a, only_b))
    return agreed, tuple(sorted(moments, key=lambda moment: (moment.frame, moment.pair, moment.node)))


def _by_place(
    decisions: Iterable[Decision], pairs: Mapping[str, Pair], alone: Callable[[str], Pair]
) -> dict[tuple[Pair, str], list[Decision]]:
    """(ids of the target in both runs, node) -> the decisions of one run in order."""
    found: dict[tuple[Pair, str], list[Decision]] = defaultdict(list)
    for event in decisions:
        node = getattr(event, "node", "")
        if isinstance(event, Joined | Parted):
            other = pairs.get(event.other) or alone(event.other)
            node = other[0] or f"{other[1]} of B"
        found[pairs.get(event.target) or alone(event.target), node].append(event)
    return found


def _match(
    a: Sequence[Decision], b: Sequence[Decision], within: int, named: bool
) -> tuple[list[tuple[Decision, Decision]], list[Decision], list[Decision]]:
    """Decisions of the same effect at most `within` frames apart, the nearest first; and what is left."""
    near = [
        (abs(x.frame - y.frame), i, j)
        for i, x in enumerate(a)
        for j, y in enumerate(b)
        if abs(x.frame - y.frame) <= within and _effect(x, named) == _effect(y, named)
    ]
    used: dict[int, int] = {}
    taken: set[int] = set()
    for _, i, j in sorted(near):
        if i not in used and j not in taken:
            used[i] = j
            taken.add(j)
    return (
        [(a[i], b[j]) for i, j in sorted(used.items())],
        [event for i, event in enumerate(a) if i not in used],
        [event for j, event in enumerate(b) if j not in taken],
    )


def _types(decisions: Iterable[Decision]) -> set[str]:
    return {event.template for event in decisions if isinstance(event, TargetStarted | Returned)}


def _effect(event: Decision, named: bool) -> tuple[object, ...]:
    """What a decision changes, whatever its numbers.

    The name of a type (`named`) distinguishes targets only where a run has several types.
    """
    if isinstance(event, StatusChanged):
        return type(event), event.status
    if isinstance(event, TargetStarted | Returned):
        return type(event), event.template if named else None
    return type(event), getattr(event, "on", None)
