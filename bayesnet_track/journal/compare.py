"""Two runs side by side: where their decisions part, how far their estimates are apart, what each cost."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joins import Joined, Parted
from bayesnet_track.journal.events.lives import CandidateConfirmed, Returned, TargetStarted
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Decision, Switch
from bayesnet_track.journal.text.wording import plural

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
    """The effect of a decision, whatever its numbers.

    The name of a type (`named`) distinguishes targets only where a run has several types.
    """
    if isinstance(event, StatusChanged):
        return type(event), event.status
    if isinstance(event, TargetStarted | Returned):
        return type(event), event.template if named else None
    return type(event), getattr(event, "on", None)


MOST = 0.9
"""Share of the frames that must have evidence of the same agents for one run to explain the video better."""

NEAR = 0.5
"""Two boxes hold the same target when their centres are nearer than this share of their mean size."""


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
class Distance:
    """Distance of the two estimates of a target in one frame: centres in px, and the overlap (IoU)."""

    frame: int
    px: float
    iou: float


@dataclass(frozen=True)
class Total:
    """One figure of both runs; None where it was not measured.

    Attributes:
        name: what it is, with its unit.
        first: the first run's.
        second: the second run's.
        less_is_better: True or False; None where neither is better in itself.
    """

    name: str
    first: float | None
    second: float | None
    less_is_better: bool | None = None


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
        last_frames: last frame of each; what is beyond the earlier one is not compared.
    """

    pairs: tuple[tuple[str, str], ...]
    alone: tuple[tuple[str, ...], tuple[str, ...]]
    agreed: int
    moments: tuple[Moment, ...]
    distances: Mapping[tuple[str, str], tuple[Distance, ...]]
    first_apart: int | None
    totals: tuple[Total, ...]
    last_frames: tuple[int, int]


def compare(first: RunRecord, second: RunRecord) -> Comparison:
    """Compare two runs over the same source, frame by frame.

    Given targets are paired by id; those that were born by detection by where they are.
    """
    last_frames = (_last_frame(first), _last_frame(second))
    first, second = _Cut(first, min(last_frames)), _Cut(second, min(last_frames))
    pairs = pair_targets(first, second)
    agreed, moments = find_moments(
        [event for event in first.events if isinstance(event, Decision)],
        [event for event in second.events if isinstance(event, Decision)],
        pairs,
    )
    distances = {pair: _distances(first.metrics, second.metrics, pair) for pair in pairs}
    apart = [one.frame for line in distances.values() for one in line if one.px > 0 or one.iou < 1]
    known = (_ids(first), _ids(second))
    return Comparison(
        pairs=pairs,
        alone=(
            tuple(target for target in known[0] if target not in dict(pairs)),
            tuple(target for target in known[1] if target not in {b for _, b in pairs}),
        ),
        agreed=agreed,
        moments=moments,
        distances=distances,
        first_apart=min(apart, default=None),
        totals=_totals(first, second),
        last_frames=last_frames,
    )


class _Cut:
    """A run up to a frame."""

    def __init__(self, run: RunRecord, last: int) -> None:
        self.name, self.costs_ms = run.name, run.costs_ms
        self.events = [event for event in run.events if getattr(event, "frame", 0) <= last]
        self.metrics = [line for line in run.metrics if line.frame <= last]
        self.seconds = {frame: seconds for frame, seconds in run.seconds.items() if frame <= last}


def _last_frame(run: RunRecord) -> int:
    return max((*(line.frame for line in run.metrics), *run.seconds), default=-1)


# ------------------------------------------------------------------------------------ which target is which


def pair_targets(first: RunRecord, second: RunRecord) -> tuple[tuple[str, str], ...]:
    """Ids of the same target in both runs: equal where given, else those that are together the longest."""
    born = {
        event.target
        for run in (first, second)
        for event in run.events
        if isinstance(event, CandidateConfirmed)
    }
    given = [target for target in _ids(first) if target in _ids(second) and target not in born]
    left = [_by_frame(run.metrics, set(given)) for run in (first, second)]
    together: Counter[tuple[str, str]] = Counter()
    for frame in left[0].keys() & left[1].keys():
        for a in left[0][frame]:
            for b in left[1][frame]:
                size = math.sqrt(math.sqrt(math.prod(a.centre_box[2:]) * math.prod(b.centre_box[2:])))
                if math.dist(a.centre_box[:2], b.centre_box[:2]) < NEAR * size:
                    together[a.target, b.target] += 1
    pairs = {target: target for target in given}
    for (mine, theirs), _ in sorted(together.items(), key=lambda item: (-item[1], item[0])):
        if mine not in pairs and theirs not in pairs.values():
            pairs[mine] = theirs
    return tuple((target, pairs[target]) for target in _ids(first) if target in pairs)


def _ids(run: RunRecord) -> list[str]:
    started = TargetStarted | Returned
    return list(dict.fromkeys(event.target for event in run.events if isinstance(event, started)))


def _by_frame(metrics: Iterable[FrameMetrics], without: set[str]) -> dict[int, list[FrameMetrics]]:
    found: dict[int, list[FrameMetrics]] = defaultdict(list)
    for line in metrics:
        if line.target not in without:
            found[line.frame].append(line)
    return found


# ------------------------------------------------------------------------------------ what differs in numbers


def _distances(
    first: Sequence[FrameMetrics], second: Sequence[FrameMetrics], pair: tuple[str, str]
) -> tuple[Distance, ...]:
    theirs = {line.frame: line.centre_box for line in second if line.target == pair[1]}
    mine = ((line.frame, line.centre_box) for line in first if line.target == pair[0])
    return tuple(_distance(frame, box, theirs[frame]) for frame, box in mine if frame in theirs)


def _distance(frame: int, a: Sequence[float], b: Sequence[float]) -> Distance:
    sides = [
        max(
            0.0, min(a[k] + a[k + 2] / 2, b[k] + b[k + 2] / 2) - max(a[k] - a[k + 2] / 2, b[k] - b[k + 2] / 2)
        )
        for k in (0, 1)
    ]
    shared = math.prod(sides)
    union = a[2] * a[3] + b[2] * b[3] - shared
    same = tuple(a) == tuple(b)
    return Distance(frame, math.hypot(a[0] - b[0], a[1] - b[1]), 1.0 if same else shared / union)


def _totals(first: RunRecord, second: RunRecord) -> tuple[Total, ...]:
    mine, theirs = _figures(first), _figures(second)
    # A clock's figures differ as much between equal runs on a busy machine.
    better = ("agents per frame", "declared ms per frame", "frames lost", "median UD, px²")
    return tuple(Total(name, mine[name], theirs[name], True if name in better else None) for name in mine)


def total_evidence(first: RunRecord, second: RunRecord, pairs: Iterable[tuple[str, str]]) -> Total:
    """The log-evidence of both, over the frames of `pairs` in which the same agents gave evidence.

    It compares models of one and the same evidence: the graphs must have the same agents. The name says how
    many frames count. Where less than `MOST` of them do, neither is called better: a run that lost its target
    has no evidence in the frames that would have told against it.
    """
    sums, frames, common = [0.0, 0.0], 0, 0
    for mine, theirs in pairs:
        others = {line.frame: line for line in second.metrics if line.target == theirs}
        for line in first.metrics:
            other = others.get(line.frame)
            if line.target != mine or other is None or not (line.kl or other.kl):
                continue
            common += 1
            values = line.log_evidence, other.log_evidence
            if line.kl.keys() == other.kl.keys() and all(map(math.isfinite, values)):
                sums = [total + value for total, value in zip(sums, values, strict=True)]
                frames += 1
    if not frames:
        return Total("log-evidence, nats", None, None)
    name = f"log-evidence, nats ({frames} of {plural(common, 'frame')})"
    return Total(name, sums[0], sums[1], False if frames >= MOST * common else None)


def _figures(run: RunRecord) -> dict[str, float | None]:
    frames = {line.frame for line in run.metrics} | run.seconds.keys()
    count = len(frames)
    kinds = {e.target: e.template for e in run.events if isinstance(e, TargetStarted | Returned)}
    declared = [
        run.costs_ms.get((kinds.get(line.target, ""), agent)) for line in run.metrics for agent in line.active
    ]
    known = [cost for cost in declared if cost is not None]
    # The first frame of a process pays for compiling and loading.
    measured = sorted(seconds for frame, seconds in run.seconds.items() if frame != min(run.seconds))
    uds = sorted(line.ud_px2 for line in run.metrics if math.isfinite(line.ud_px2))

    def per_frame(total: float) -> float | None:
        return total / count if count else None

    return {
        "frames": float(count),
        "targets": float(len(_ids(run))),
        "agents per frame": per_frame(sum(len(line.active) for line in run.metrics)),
        "declared ms per frame": per_frame(sum(known)) if len(known) == len(declared) else None,
        "measured ms per frame": 1000 * sum(measured) / len(measured) if measured else None,
        "measured ms, median frame": 1000 * measured[len(measured) // 2] if measured else None,
        "hypotheses per frame": per_frame(sum(line.particles for line in run.metrics)),
        "reconfigurations": float(sum(isinstance(event, Switch) for event in run.events)),
        "frames lost": float(sum(line.status == "lost" for line in run.metrics)),
        "median UD, px²": uds[len(uds) // 2] if uds else None,
    }
