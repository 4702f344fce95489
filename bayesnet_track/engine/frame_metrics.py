"""What is written down of one target in one frame: as `FrameMetrics`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TypeVar, overload

import numpy as np

from bayesnet_track.adapt.rule_inputs import Measures
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.findings import Learnt, Measured
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.scoring.assurance import e_value, said_status
from bayesnet_track.engine.scoring.score import blur_regions
from bayesnet_track.engine.summaries import Summary
from bayesnet_track.inference.predictive import p_values
from bayesnet_track.journal.metrics import FrameMetrics, PartMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import Frame

Value = TypeVar("Value")


class Lines(Sequence[FrameMetrics]):
    """The lines of one frame, made when the first of them is asked for.

    Which targets they are of and their centre boxes, `boxes`, are known before.

    >>> lines = Lines([lambda: "first", lambda: "second"])
    >>> len(lines), lines[1], lines == ("first", "second")
    (2, 'second', True)
    """

    def __init__(
        self, makers: Sequence[Callable[[], FrameMetrics]], boxes: Mapping[str, Floats] | None = None
    ) -> None:
        self._makers, self._count, self._boxes = makers, len(makers), boxes
        self._made: tuple[FrameMetrics, ...] | None = None

    def boxes(self) -> Iterator[tuple[str, tuple[float, ...]]]:
        """Target and centre box of each line, in their order."""
        if self._made is None and self._boxes is not None:
            return ((target, _floats(box)) for target, box in self._boxes.items())
        return ((line.target, line.centre_box) for line in self._lines())

    def _lines(self) -> tuple[FrameMetrics, ...]:
        if self._made is None:
            self._made = tuple(make() for make in self._makers)
            self._makers = ()  # what they were made of is not needed any more
        return self._made

    @overload
    def __getitem__(self, at: int) -> FrameMetrics: ...

    @overload
    def __getitem__(self, at: slice) -> tuple[FrameMetrics, ...]: ...

    def __getitem__(self, at: int | slice) -> FrameMetrics | tuple[FrameMetrics, ...]:
        return self._lines()[at]

    def __iter__(self) -> Iterator[FrameMetrics]:
        return iter(self._lines())

    def __len__(self) -> int:
        return self._count

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and self._lines() == tuple(other)

    def __hash__(self) -> int:
        return hash(self._lines())

    def __reduce__(self) -> tuple[type[tuple[FrameMetrics, ...]], tuple[tuple[FrameMetrics, ...]]]:
        return tuple, (self._lines(),)


class WhenAsked(Mapping[str, Value]):
    """Target -> what `make` makes of it, such as a covariance, when it is asked for."""

    def __init__(self, targets: Iterable[str], make: Callable[[str], Value]) -> None:
        self._targets, self._make = dict.fromkeys(targets), make

    def __getitem__(self, target: str) -> Value:
        if target not in self._targets:
            raise KeyError(target)
        return self._make(target)

    def __iter__(self) -> Iterator[str]:
        return iter(self._targets)

    def __len__(self) -> int:
        return len(self._targets)


def index(measures: Measures, root: str) -> float:
    """Uncalibrated index in 0..1: how well the best hypothesis fits, times how concentrated the belief is."""
    return measures.fit / (1.0 + measures.ud_px2[root] / max(measures.area_px2, 1.0))


def frame_metrics(
    work: FrameWork,
    filtered: Filtered,
    measured: Measured,
    baseline_px2: float | None,
    learnt: Learnt,
    summary: Summary,
) -> FrameMetrics:
    """What is written down of a target: its belief in a few numbers, the status that it ran with.

    Without a calibrated score the score is `index`.
    """
    target, stepped, measures = filtered.target, filtered.step, measured.measures
    plate, modes = work.plate_of(target).plate, work.plate_of(target).modes
    variances = np.maximum(summary.variances[:4], 0.0)
    score, features = index(measures, plate.root), {}
    root = plate.inference(plate.root)
    if measured.score is not None and root.score is not None:
        rule = root.score.settings
        score, features = measured.score, {**measured.scored.features(rule), "most": measured.bound}
    region50, region90 = summary.regions
    if root.localization_error is not None:
        side = float(np.sqrt(max(measures.area_px2, 1.0)))
        wide = blur_regions(stepped.posterior, root.localization_error, score, side)
        region50, region90 = wide.region50, wide.region90
        variances[:2] += wide.variance
    return FrameMetrics(
        frame=work.frame.index,
        time_s=work.frame.time_s,
        target=target,
        centre_box=_floats(measured.box),
        map=_floats(stepped.map_state[:4]),
        sd=_floats(np.sqrt(variances)),
        ud_px2=measures.ud_px2[plate.root],
        ud_nodes=measures.ud_px2,
        quiet_px2=baseline_px2,
        status=said_status(work.net.targets[target].status, measured.scored, root.guarantee),
        score=score,
        log_evidence=stepped.log_evidence,
        surprise=summary.surprise,
        ess=summary.ess,
        particles=len(stepped.support.weights),
        active=tuple(a for a in plate.agents if a in measures.kl),
        kl=dict(measures.kl),
        contribution=dict(measures.contribution),
        agent_ud_px2=dict(measures.agent_ud_px2),
        strength=dict(measures.strength),
        learn_rate=learnt.rate,
        region50=region50,
        region90=region90,
        cloud=summary.cloud,
        silent=measures.silent,
        angle=learnt.angle,
        join=filtered.join,
        existence=filtered.before.existence,
        features=features,
        parts=_part_metrics(measures),
        e_value=None if root.alarm is None else e_value(measured.scored.rise, root.alarm),
        p_values=p_values(plate, stepped, () if modes is None else modes.hidden),
    )


def _part_metrics(measures: Measures) -> dict[str, PartMetrics]:
    return {
        name: PartMetrics(_floats(part.box), _floats(part.sd), part.ud_px2, part.status)
        for name, part in measures.parts.items()
    }


def first_frame_metrics(
    frame: Frame,
    target: str,
    size: int,
    active: tuple[str, ...],
    box: Floats,
    parts: Mapping[str, Floats],
) -> FrameMetrics:
    """The frame in which the target starts: its box is known, and by it those of its parts (4,)."""
    where = _floats(box)
    point = (where[0], where[0], where[1], where[1])
    return FrameMetrics(
        frame=frame.index,
        time_s=frame.time_s,
        target=target,
        centre_box=where,
        map=where,
        sd=(0.0, 0.0, 0.0, 0.0),
        ud_px2=0.0,
        ud_nodes={},
        quiet_px2=None,
        status="tracking",
        score=1.0,
        log_evidence=0.0,
        surprise=0.0,
        ess=float(size),
        particles=size,
        active=active,
        kl={},
        contribution={},
        agent_ud_px2={},
        strength={},
        learn_rate=1.0,
        region50=point,
        region90=point,
        cloud=(),
        parts={name: PartMetrics(_floats(at), (0.0,) * 4, 0.0, "seen") for name, at in parts.items()},
    )


def _floats(values: object) -> tuple[float, ...]:
    return tuple(np.asarray(values, dtype=np.float64).tolist())
