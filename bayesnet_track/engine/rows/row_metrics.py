"""Measures of the rows of a table, as columns; `FrameMetrics` of a target when somebody asks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from statistics import NormalDist
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.gaussian.belief import draw_boxes
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.metrics import CLOUD_SIZE
from bayesnet_track.engine.rows.columns import GIVEN, Rows
from bayesnet_track.journal.encoder import Written, written
from bayesnet_track.journal.frame_columns import ABSENT, texts
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import AREA, FIT, UD, Floats
from bayesnet_track.numerics.distributions import p_after
from bayesnet_track.numerics.gaussian import roots

LEAST = np.array([0.0, 0.0, 1.0, 1.0])
"""Least centre and sides of an estimate, px (`engine.state.inside_frame`)."""


@dataclass(frozen=True, eq=False)
class RowMeasures:
    """Measures of T targets.

    Attributes:
        numbers: (T, 8) in the columns of `numerics.arrays`.
        quiet: (T,) baselines of UD, NaN while unknown.
    """

    numbers: Floats
    quiet: Floats

    @property
    def ud(self) -> Floats:
        """(T,) px^2."""
        return self.numbers[:, UD]

    @property
    def fit(self) -> Floats:
        """(T,) best likelihoods, 0 where nothing was given."""
        return self.numbers[:, FIT]

    @property
    def area(self) -> Floats:
        """(T,) of the mean boxes, px^2."""
        return self.numbers[:, AREA]


class RowMetrics(Sequence[FrameMetrics]):
    """The metrics of one frame: a line per row, then those of targets that start in it.

    Args:
        rows: the targets after the frame.
        measured: what was measured.
        work: the frame's.
        was_lost: (T,) whether the status was lost before it.
        born: the lines of targets that start in the frame.
    """

    def __init__(
        self,
        rows: Rows,
        measured: RowMeasures,
        work: FrameWork,
        was_lost: NDArray[np.bool_],
        born: tuple[FrameMetrics, ...] = (),
    ) -> None:
        self.rows, self.measured, self.born = rows, measured, born
        frame, self._was_lost = work.frame, was_lost
        births = work.births_of(rows.ids)
        # Clouds are drawn when the lines are made: what is kept until then must not hold the frame.
        self._draws = partial(work.engine.streams.of_each, births, rows.rule.root, work.moment, "cloud")
        self._index, self._time_s = frame.index, frame.time_s
        high = np.array([frame.width - 1.0, frame.height - 1.0, 2.0 * frame.width, 2.0 * frame.height])
        self.boxes: Floats = np.minimum(np.maximum(rows.columns.mean[:, :4], LEAST), high)
        self._made: tuple[FrameMetrics, ...] | None = None

    @cached_property
    def _sds(self) -> Floats:
        variances = np.diagonal(self.rows.columns.covariance, axis1=1, axis2=2)[:, :4]
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    @cached_property
    def _scores(self) -> Floats:
        area = np.maximum(self.measured.area, 1.0)
        return self.measured.fit / (1.0 + self.measured.ud / area)

    def with_born(self, born: Sequence[FrameMetrics]) -> RowMetrics:
        """These, and targets that start."""
        if not born:
            return self
        after = RowMetrics.__new__(RowMetrics)
        after.__dict__.update(self.__dict__, born=(*self.born, *born), _made=None)
        return after

    def held(self) -> tuple[list[str], Floats]:
        """Ids and (T, 4) centre boxes, px, of the targets that are not lost."""
        rows = np.flatnonzero(~self._was_lost)
        born = [one for one in self.born if one.status != "lost"]
        places = np.array([one.centre_box for one in born]).reshape(-1, 4)
        ids = [self.rows.ids[row] for row in rows.tolist()]
        return ids + [one.target for one in born], np.concatenate([self.boxes[rows], places])

    def _region(self, share: float) -> Floats:
        """(T, 4) the central `share` of the centres."""
        centre = self.rows.columns.mean[:, :2]
        reach = NormalDist().inv_cdf((1.0 + share) / 2.0) * self._sds[:, :2]
        return np.stack([centre - reach, centre + reach], axis=2).reshape(-1, 4)

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns of `journal.frame_columns`, without hypotheses and without targets that start."""
        now, rule = self.rows.columns, self.rows.rule
        log_evidence, nats, ess, size, agent_ud, ud, _, _ = self.measured.numbers.T
        own = f"/{rule.agent}"
        nothing = np.zeros(len(self.rows.ids))
        p_values = [ABSENT if value is None else value for value in self._p_values()]
        is_given = now.given == GIVEN
        columns: dict[str, NDArray[Any]] = {
            "frame": np.array(self._index, dtype="<i8"),
            "time_s": np.array(self._time_s, dtype="<f8"),
            "target": texts(self.rows.ids),
            "box": np.ascontiguousarray(self.boxes.T),
            "map": np.ascontiguousarray(now.mean[:, :4].T),
            "sd": np.ascontiguousarray(self._sds.T),
            "ud_px2": ud,
            f"ud_nodes/{rule.root}": ud,
            "quiet_px2": np.where(np.isnan(self.measured.quiet), ABSENT, self.measured.quiet),
            "status": texts("lost" if lost else "tracking" for lost in self._was_lost.tolist()),
            "score": self._scores,
            "log_evidence": log_evidence,
            "surprise": nats,
            "ess": ess,
            "learn_rate": nothing,
            "particles": size.astype("<i4"),
            "active": np.full(len(nothing), rule.agent.encode()),
            "silent": np.where(is_given, b"", rule.agent.encode()),
            "kl" + own: nothing,
            "contribution" + own: nats,
            "agent_ud_px2" + own: agent_ud,
            "strength" + own: nats,
            "p_values" + own: np.array(p_values),
        }
        if rule.crowd is not None:
            columns["existence"] = now.existence
        return columns

    def without_clouds(self) -> tuple[FrameMetrics, ...]:
        """The lines without their hypotheses, which take most of the time."""
        return self._made or self._make([Written()] * len(self.rows.ids))

    def statuses(self) -> Iterator[str]:
        """Of each line, in their order."""
        yield from ("lost" if lost else "tracking" for lost in self._was_lost.tolist())
        yield from (line.status for line in self.born)

    def targets(self) -> Iterator[str]:
        """Of each line, in their order."""
        yield from self.rows.ids
        yield from (line.target for line in self.born)

    def _lines(self) -> tuple[FrameMetrics, ...]:
        if self._made is None:
            self._made = self._make(self._clouds())
        return self._made

    def _make(self, clouds: list[Written]) -> tuple[FrameMetrics, ...]:
        now, count = self.rows.columns, len(self.rows.ids)
        columns = zip(
            self.rows.ids,
            _tuples(self.boxes),
            _tuples(now.mean[:, :4]),
            _tuples(self._sds),
            self.measured.numbers.tolist(),
            self.measured.quiet.tolist(),
            self._was_lost.tolist(),
            self._scores.tolist(),
            _tuples(self._region(0.5)),
            _tuples(self._region(0.9)),
            clouds,
            (now.given == GIVEN).tolist(),
            [None] * count if self.rows.rule.crowd is None else now.existence.tolist(),
            self._p_values(),
            strict=True,
        )
        return (*map(self._line, columns), *self.born)

    def _line(self, column: tuple[Any, ...]) -> FrameMetrics:
        rule = self.rows.rule
        target, box, place, sd, numbers, quiet, was_lost, score, region50, region90, cloud, *more = column
        log_evidence, nats, ess, size, agent_ud, ud, _, _ = numbers
        is_given, existence, p_value = more
        return FrameMetrics(
            frame=self._index,
            time_s=self._time_s,
            target=target,
            centre_box=box,
            map=place,
            sd=sd,
            ud_px2=ud,
            ud_nodes={rule.root: ud},
            quiet_px2=None if quiet != quiet else quiet,
            status="lost" if was_lost else "tracking",
            score=score,
            log_evidence=log_evidence,
            surprise=nats,
            ess=ess,
            particles=int(size),
            active=(rule.agent,),
            kl={rule.agent: 0.0},
            contribution={rule.agent: nats},
            agent_ud_px2={rule.agent: agent_ud},
            strength={rule.agent: nats},
            learn_rate=0.0,
            region50=region50,
            region90=region90,
            cloud=cloud,
            silent=() if is_given else (rule.agent,),
            existence=existence,
            p_values={} if p_value is None else {rule.agent: p_value},
        )

    def _clouds(self) -> list[Written]:
        """Hypotheses drawn from the belief of each row."""
        now = self.rows.columns
        clouds = np.empty((len(self.rows.ids), CLOUD_SIZE, 4))
        for row, (lower, rng) in enumerate(zip(roots(now.covariance[:, :4, :4]), self._draws(), strict=True)):
            clouds[row] = draw_boxes(now.mean[row], lower, CLOUD_SIZE, rng)
        return written(np.rint(clouds).astype(np.int64))

    def _p_values(self) -> list[float | None]:
        """P-value of each row's detection under its prediction; None of one that several targets share."""
        rule, now = self.rows.rule, self.rows.columns
        is_shared = rule.crowd is not None and rule.crowd.is_marginal
        found: list[float | None] = [None] * len(self.rows.ids)
        own = np.flatnonzero((now.given == GIVEN) & (not is_shared))
        boxes = now.own[own, :4]
        noise = (rule.association.variances(boxes) * rule.temperature)[:, :, None] * np.eye(4)
        values = p_after(boxes, noise, now.mean[own, :4], now.covariance[own, :4, :4])
        for row, value in zip(own.tolist(), values.tolist(), strict=True):
            found[row] = value
        return found

    @overload
    def __getitem__(self, at: int) -> FrameMetrics: ...

    @overload
    def __getitem__(self, at: slice) -> tuple[FrameMetrics, ...]: ...

    def __getitem__(self, at: int | slice) -> FrameMetrics | tuple[FrameMetrics, ...]:
        return self._lines()[at]

    def __iter__(self) -> Iterator[FrameMetrics]:
        return iter(self._lines())

    def __len__(self) -> int:
        return len(self.rows.ids) + len(self.born)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and self._lines() == tuple(other)

    def __hash__(self) -> int:
        return hash(self._lines())

    def __reduce__(self) -> tuple[type[tuple[FrameMetrics, ...]], tuple[tuple[FrameMetrics, ...]]]:
        return tuple, (self._lines(),)


def _tuples(rows: Floats) -> list[Any]:
    return [*map(tuple, rows.tolist())]
