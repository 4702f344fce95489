"""Two runs side by side: where their decisions part, how far their estimates are apart, what each cost."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from bayesnet_track.journal.blocks import Blocks, spans
from bayesnet_track.journal.compare_measures import (
    COLUMNS,
    Apart,
    Distances,
    Figures,
    Predictive,
    RunEvidence,
    Total,
    pair_targets,
    target_ids,
)
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joins import Joined, Parted
from bayesnet_track.journal.events.lives import Returned, TargetStarted
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import Decision

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
    """The number of decisions that both runs took in the same frame, and the moments in which they part."""
    agreed, moments = 0, []
    named = max(len(_types(decisions)) for decisions in (first, second)) > 1
    mine = _by_place(first, {a: (a, b) for a, b in pairs}, lambda target: (target, ""))
    theirs = _by_place(second, {b: (a, b) for a, b in pairs}, lambda target: ("", target))
    for place in dict.fromkeys([*mine, *theirs]):
        a, b = mine.get(place, []), theirs.get(place, [])
        same, rest_a, rest_b = _match(a, b, 0, named)
        agreed += len(same)
        shifted, rest_a, rest_b = _match(rest_a, rest_b, SHIFT, named)
        moments += [Moment(min(x.frame, y.frame), *place, (x,), (y,)) for x, y in shifted]
        unmatched: dict[int, tuple[list[Decision], list[Decision]]] = {}
        for side, events in enumerate((rest_a, rest_b)):
            for event in events:
                unmatched.setdefault(event.frame, ([], []))[side].append(event)
        moments += [Moment(frame, *place, tuple(x), tuple(y)) for frame, (x, y) in unmatched.items()]
    return agreed, tuple(sorted(moments, key=lambda moment: (moment.frame, moment.pair, moment.node)))


def _by_place(
    decisions: Iterable[Decision], pairs: Mapping[str, Pair], unpaired: Callable[[str], Pair]
) -> dict[tuple[Pair, str], list[Decision]]:
    """(ids of the target in both runs, node) -> the decisions of one run in order."""
    decided: dict[tuple[Pair, str], list[Decision]] = defaultdict(list)
    for event in decisions:
        node = getattr(event, "node", "")
        if isinstance(event, Joined | Parted):
            pair = pairs.get(event.other) or unpaired(event.other)
            node = pair[0] or f"{pair[1]} of B"
        decided[pairs.get(event.target) or unpaired(event.target), node].append(event)
    return decided


def _match(
    a: Sequence[Decision], b: Sequence[Decision], max_gap: int, named: bool
) -> tuple[list[tuple[Decision, Decision]], list[Decision], list[Decision]]:
    """Decisions of the same effect at most `max_gap` frames apart, the nearest first; and what is left."""
    frames = [event.frame for event in b]  # in order, as a journal is
    candidates = [
        (abs(x.frame - b[j].frame), i, j)
        for i, x in enumerate(a)
        for j in range(bisect_left(frames, x.frame - max_gap), bisect_right(frames, x.frame + max_gap))
        if _effect(x, named) == _effect(b[j], named)
    ]
    matches: dict[int, int] = {}
    matched: set[int] = set()
    for _, i, j in sorted(candidates):
        if i not in matches and j not in matched:
            matches[i] = j
            matched.add(j)
    return (
        [(a[i], b[j]) for i, j in sorted(matches.items())],
        [event for i, event in enumerate(a) if i not in matches],
        [event for j, event in enumerate(b) if j not in matched],
    )


def _types(decisions: Iterable[Decision]) -> set[str]:
    return {event.template for event in decisions if isinstance(event, TargetStarted | Returned)}


def _effect(event: Decision, named: bool) -> tuple[object, ...]:
    """The effect of a decision, whatever its numbers.

    The name of a type (`named`) distinguishes targets only where a run has several types.
    """
    if isinstance(event, StatusChanged):
        return type(event), event.status
    if isinstance(event, TargetStarted | Returned):
        return type(event), event.template if named else None
    return type(event), getattr(event, "on", None)


class RunRecord(Protocol):
    """A run as it was read back."""

    @property
    def name(self) -> str:
        """The name of the run."""

    @property
    def events(self) -> Sequence[Event]:
        """The lines of its journal."""

    @property
    def metrics(self) -> Sequence[FrameMetrics]:
        """Measurements, by frame."""

    @property
    def seconds(self) -> Mapping[int, float]:
        """Frame -> seconds that a clock measured; empty when there are none."""

    @property
    def costs_ms(self) -> Mapping[tuple[str, str], float]:
        """(plate, agent) -> declared milliseconds per frame."""


@dataclass(frozen=True)
class Comparison:
    """Common parts and differences of two runs.

    Attributes:
        pairs: target ids, the first run's and the second's, of what is taken for the same target.
        alone: target ids that only the first, only the second run has.
        agreed: decisions that both runs took in the same frame.
        moments: where they part, in the order of frames.
        distances: pair -> distance in each frame that both have.
        first_apart: first frame in which an estimate differs at all; None when none does.
        totals: figures of both, over the frames that are compared.
        evidence: log-evidence of both, which compares graphs with the same agents.
        predictive: predictive log densities of both, of each sensor that both have.
        last_frames: last frame of each; what is beyond the earlier one is not compared.
    """

    pairs: tuple[tuple[str, str], ...]
    alone: tuple[tuple[str, ...], tuple[str, ...]]
    agreed: int
    moments: tuple[Moment, ...]
    distances: Mapping[tuple[str, str], Distances]
    first_apart: int | None
    totals: tuple[Total, ...]
    evidence: Total
    last_frames: tuple[int, int]
    predictive: tuple[Total, ...] = ()


def compare(first: RunRecord, second: RunRecord) -> Comparison:
    """Compare two runs over the same source, frame by frame.

    Given targets are paired by id; those that were born by detection by where they are.
    """
    runs = first, second
    sides = [Blocks(run.metrics, COLUMNS) for run in runs]
    last_frames = [max(side.last, *run.seconds, -1) for side, run in zip(sides, runs, strict=True)]
    end = min(last_frames) + 1
    events = [[event for event in run.events if getattr(event, "frame", 0) < end] for run in runs]
    pairs = pair_targets(events, [Blocks(run.metrics, ["box"]) for run in runs], end)
    decisions = [[event for event in of_run if isinstance(event, Decision)] for of_run in events]
    agreed, moments = find_moments(decisions[0], decisions[1], pairs)
    separation, figures = Apart(pairs, sides), [Figures(side) for side in sides]
    evidence, predictive = RunEvidence(), Predictive()
    for span in spans(sides, end):
        blocks = [side.read(*span) for side in sides]
        for of_run, block in zip(figures, blocks, strict=True):
            of_run.add(block)
        rows = separation.add(blocks[0], blocks[1])
        evidence.add(blocks[0], blocks[1], *rows)
        predictive.add(blocks[0], blocks[1], *rows)
    ids = [target_ids(of_run) for of_run in events]
    paired = [{pair[side] for pair in pairs} for side in (0, 1)]
    a, b = (
        of_run.table(some, {frame: s for frame, s in run.seconds.items() if frame < end}, run.costs_ms)
        for of_run, some, run in zip(figures, events, runs, strict=True)
    )
    # A clock's figures differ as much between equal runs on a busy machine.
    better = ("agents per frame", "declared ms per frame", "frames lost", "median UD, px²")
    return Comparison(
        pairs=pairs,
        alone=(
            tuple(target for target in ids[0] if target not in paired[0]),
            tuple(target for target in ids[1] if target not in paired[1]),
        ),
        agreed=agreed,
        moments=moments,
        distances=separation.distances(),
        first_apart=separation.first_apart,
        totals=tuple(Total(name, a[name], b[name], True if name in better else None) for name in a),
        evidence=evidence.total(),
        last_frames=(last_frames[0], last_frames[1]),
        predictive=predictive.totals(),
    )
