"""Two runs side by side: where their decisions part, how far their estimates are apart, what each cost."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from bayesnet_track.journal.compare_moments import Moment, find_moments
from bayesnet_track.journal.events.births import CandidateConfirmed, TargetStarted
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.reidentification import Returned
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Decision, Switch
from bayesnet_track.journal.text.wording import plural

MOST = 0.9
"""Share of the frames that must have evidence of the same agents for one run to explain the video better."""

NEAR = 0.5
"""Two boxes hold the same target when their centres are nearer than this share of their mean size."""


class RunRecord(Protocol):
    """A run as it was read back."""

    @property
    def name(self) -> str:
        """What to call it."""

    @property
    def events(self) -> Sequence[Event]:
        """The lines of its journal."""

    @property
    def metrics(self) -> Sequence[FrameMetrics]:
        """What was measured, by frame."""

    @property
    def seconds(self) -> Mapping[int, float]:
        """Frame -> seconds that a clock measured; empty when there are none."""

    @property
    def costs_ms(self) -> Mapping[tuple[str, str], float]:
        """(plate, agent) -> declared milliseconds per frame."""


@dataclass(frozen=True)
class Distance:
    """How far the two estimates of a target are apart in one frame: centres in px, and the overlap (IoU)."""

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
    """What two runs have in common, and what not.

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
