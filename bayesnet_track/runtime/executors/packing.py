"""Which agents share a worker: those that together cost about as much as the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

WORTH_MOVING = 0.8
"""Agents are packed anew when the busiest worker would then have less than this share of its work."""
NOTEWORTHY_S = 0.0005
"""... and it spends more than this on a frame."""


def pack(costs: Mapping[str, float], workers: int) -> list[set[str]]:
    """Agents for each worker: the most expensive first, each to the worker that has least to do.

    >>> [sorted(own) for own in pack({"a": 3.0, "b": 2.0, "c": 2.0}, 2)]
    [['a'], ['b', 'c']]
    """
    loads, own = [0.0] * workers, [set[str]() for _ in range(workers)]
    for agent in sorted(costs, key=lambda name: (-costs[name], name)):
        worker = loads.index(min(loads))
        own[worker].add(agent)
        loads[worker] += costs[agent]
    return own


def busiest(costs: Mapping[str, float], packing: Sequence[set[str]]) -> float:
    """The load of the worker that has most to do."""
    return max((sum(costs[agent] for agent in own) for own in packing), default=0.0)


def repack(costs: Mapping[str, float], packing: Sequence[set[str]]) -> list[set[str]] | None:
    """A better packing of the same agents, or None where moving them is not worth it."""
    now, better = busiest(costs, packing), pack(costs, len(packing))
    if now < NOTEWORTHY_S or busiest(costs, better) >= WORTH_MOVING * now:
        return None
    return better
