"""Lines of metrics: measures, score and belief of a target in one frame, made when somebody asks for them.

Particles of many targets are summarised as arrays, with the bits that each target has alone, and only when
somebody asks for a line of metrics: no rule depends on it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar, overload

import numpy as np

from bayesnet_track.adapt.rule_inputs import Measures
from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.belief.particles.particle_set import Clouds, ParticleSet
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.rows.filtered_rows import Together
from bayesnet_track.engine.scoring.outcome import e_value, reported_status
from bayesnet_track.engine.scoring.score import ScoreState, blur_regions
from bayesnet_track.inference.predictive import p_values
from bayesnet_track.journal.encoder import written
from bayesnet_track.journal.metrics import FrameMetrics, PartMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import effective, kl
from bayesnet_track.numerics.records import Found
from bayesnet_track.observation.cue import Measurement


@dataclass(frozen=True, eq=False)
class Measured:
    """Measures and score of one target, as a line of metrics has them.

    Attributes:
        box: (4,) the estimate's centre box, inside the frame.
        measures: UD, KL, contributions, ...
        scored: what the score remembers.
        score: probability of being on target; None where the graph does not say how it comes about.
        bound: the most that the score may be.
    """

    box: Floats
    measures: Measures
    scored: ScoreState
    score: float | None = None
    bound: float = 1.0


@dataclass(frozen=True, eq=False)
class Heard:
    """Answers of the agents of one target.

    Attributes:
        log_likelihoods: active agent -> (N,) its log-likelihood of each particle of the belief; none for
            other beliefs.
        measured: agent that found the target -> what it measured, in fields of the state.
    """

    log_likelihoods: Mapping[str, Floats] = field(default_factory=dict)
    measured: Mapping[str, Measurement] = field(default_factory=dict)


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
    learnt: tuple[float, float],
    summary: Summary,
) -> FrameMetrics:
    """Line of metrics of a target: its belief in a few numbers, the status that it ran with.

    `learnt` is the share of the largest learning rate, and the estimate's rotation in degrees.
    Without a calibrated score the score is `index`.
    """
    target, stepped, measures = filtered.target, filtered.step, measured.measures
    learn_rate, angle = learnt
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
        status=reported_status(work.net.targets[target].status, measured.scored, root.guarantee),
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
        learn_rate=learn_rate,
        region50=region50,
        region90=region90,
        cloud=summary.cloud,
        silent=measures.silent,
        angle=angle,
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


def _floats(values: object) -> tuple[float, ...]:
    return tuple(np.asarray(values, dtype=np.float64).tolist())


Rows = list[tuple[float, ...]]

CLOUD_SIZE = 48
"""Hypotheses kept per frame, drawn from the posterior, so that they carry no weights."""

SHARES = (0.5, 0.9)
"""Of the centre's weight that lies in the regions."""


@dataclass(frozen=True, eq=False)
class Summary:
    """A belief in a few numbers.

    Attributes:
        variances: (D,) of the states.
        ess: effective number of hypotheses.
        surprise: KL of the belief from its prior, nats.
        regions: of `SHARES`: x_low, x_high, y_low, y_high in px.
        cloud: rounded boxes of some hypotheses.
    """

    variances: Floats
    ess: float
    surprise: float
    regions: Rows
    cloud: tuple[tuple[int, ...], ...]


def find_summaries(
    work: FrameWork, filtered: Mapping[str, Filtered], spreads: Mapping[str, Floats]
) -> Found[Summary]:
    """Target -> its belief in a few numbers, of which `spreads` are the covariances."""
    return Found(filtered, partial(_summarise, work, filtered, spreads))


def find_covariances(filtered: Mapping[str, Filtered]) -> Found[Floats]:
    """Target -> (D, D) covariance of its belief."""
    return Found(filtered, partial(_find_covariances, filtered))


def _summarise(
    work: FrameWork, filtered: Mapping[str, Filtered], spreads: Mapping[str, Floats]
) -> dict[str, Summary]:
    alike, alone = _alike(filtered)
    found = {target: summarise_one(work, target, filtered[target].step, spreads[target]) for target in alone}
    for targets in alike:
        steps = [filtered[target].step for target in targets]
        found |= _summarise_rows(work, targets, steps, np.array([spreads[target] for target in targets]))
    return found


def _find_covariances(filtered: Mapping[str, Filtered]) -> dict[str, Floats]:
    groups = filtered.groups if isinstance(filtered, Together) else ()
    found = dict(pair for group in groups for pair in zip(group.ids, group.clouds.covariances, strict=True))
    alike, alone = _alike(
        {target: one for target, one in filtered.items() if target not in found}
        if len(found) < len(filtered)
        else {}
    )
    found |= {target: filtered[target].step.posterior.covariance for target in alone}
    for targets in alike:
        clouds = Clouds.of([particles(filtered[target].step.posterior) for target in targets])
        found.update(zip(targets, clouds.covariances, strict=True))
    return found


def _alike(filtered: Mapping[str, Filtered]) -> tuple[list[list[str]], list[str]]:
    """Targets of a plate whose particles make an array; then the others."""
    alike: dict[Hashable, list[str]] = {}
    alone: list[str] = []
    for target, one in filtered.items():
        own = one.step.posterior
        if isinstance(own, ParticleSet) and one.step.support is own:
            alike.setdefault((one.plan.root, own.fields, own.states.shape), []).append(target)
        else:
            alone.append(target)
    return list(alike.values()), alone


def summarise_one(work: FrameWork, target: str, step: Step[Posterior], covariance: Floats) -> Summary:
    """The belief of a target after its step in a few numbers, of which the covariance (D, D) is known."""
    posterior, weights = step.posterior, step.support.weights
    cloud = posterior.draw(CLOUD_SIZE, work.stream(target, work.plate_of(target).plate.root)("cloud"))
    return Summary(
        covariance.diagonal(),
        weights.ess,
        kl(weights.log, step.prior.log),
        list(map(tuple, posterior.regions(SHARES).tolist())),
        _rounded(cloud),
    )


def _summarise_rows(
    work: FrameWork, targets: Sequence[str], steps: Sequence[Step[Posterior]], spreads: Floats
) -> dict[str, Summary]:
    from bayesnet_track.numerics.resampling import look_up_even_of_each

    states = np.array([step.support.states for step in steps])
    weights = np.array([step.support.weights.weights for step in steps])
    log = np.array([step.support.weights.log for step in steps])
    variances = np.diagonal(spreads, axis1=1, axis2=2)
    ess = effective(log).tolist()
    surprises = [kl(step.support.weights.log, step.prior.log) for step in steps]
    regions = np.concatenate([_regions(states[:, :, axis], weights) for axis in (0, 1)], axis=2).tolist()
    root = work.plate_of(targets[0]).plate.root
    shifts = work.engine.streams.uniforms(work.births_of(targets), root, work.moment, "cloud")
    chosen = look_up_even_of_each(weights, shifts, CLOUD_SIZE)
    clouds = np.rint(np.take_along_axis(states[:, :, :4], chosen[:, :, None], axis=1)).astype(np.int64)
    return {
        target: Summary(variances[t], ess[t], surprises[t], list(map(tuple, regions[t])), cloud)
        for t, (target, cloud) in enumerate(zip(targets, written(clouds), strict=True))
    }


def _regions(values: Floats, weights: Floats) -> Floats:
    """(T, S, 2) the central `SHARES` of the weight along an axis: values and weights (T, N)."""
    order = values.argsort(axis=1)
    ordered = np.take_along_axis(values, order, axis=1)
    cumulative = np.take_along_axis(weights, order, axis=1).cumsum(axis=1)
    tails = np.array([tail for share in SHARES for tail in ((1.0 - share) / 2.0, (1.0 + share) / 2.0)])
    levels = tails * cumulative[:, -1:]
    before = np.stack([(cumulative < levels[:, k, None]).sum(axis=1) for k in range(len(tails))], axis=1)
    return np.take_along_axis(ordered, before, axis=1).reshape(len(values), len(SHARES), 2)


def _rounded(boxes: Floats) -> tuple[tuple[int, ...], ...]:
    return tuple(map(tuple, np.rint(boxes).astype(np.int64).tolist()))
