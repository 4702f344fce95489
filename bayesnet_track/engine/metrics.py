"""The line of metrics of a target in one frame: its measures, score and belief in numbers.

Particles of many targets are summarised as arrays, with the bits that each target has alone, and only when
somebody asks for a line of metrics: no rule depends on it.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np

from bayesnet_track.adapt.rule_inputs import Measures
from bayesnet_track.belief.contract import Posterior
from bayesnet_track.belief.particles.particle_set import Clouds, ParticleSet
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.engine.scoring.outcome import e_value, reported_status
from bayesnet_track.engine.scoring.score import ScoreState, blur_regions
from bayesnet_track.graph.checked import PAST, CheckedTarget
from bayesnet_track.graph.spec import InferenceNode
from bayesnet_track.inference.predictive import log_predictive, p_values
from bayesnet_track.inference.views import Views
from bayesnet_track.journal.encoder import encode_clouds
from bayesnet_track.journal.metrics import FrameMetrics, JoinMetrics, PartMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import effective, kl
from bayesnet_track.numerics.records import evolve


@dataclass(frozen=True, eq=False)
class Measured:
    """Measures and score of one target, as a line of metrics has them.

    Attributes:
        box: (4,) the estimate's centre box, inside the frame.
        measures: UD, KL, contributions, ...
        scored: what the score remembers.
        score: probability of being on target; None where the graph does not say how it comes about.
        bound: the most that the score may be.
        existence: probability that the target exists; None where the plate has no `existence`.
    """

    box: Floats
    measures: Measures
    scored: ScoreState
    score: float | None = None
    bound: float = 1.0
    existence: float | None = None


def index(measures: Measures, root: str) -> float:
    """Uncalibrated index in 0..1: how well the best hypothesis fits, times how concentrated the belief is."""
    return measures.fit / (1.0 + measures.ud_px2[root] / max(measures.area_px2, LEAST_AREA))


LEAST_AREA = 1e-9
"""Of an estimate, in the unit of its state: no division by zero."""

CHOICES = frozenset(("mode", "carried"))
"""Fields of hypotheses that are choices, not numbers: they have columns of their own."""


def frame_metrics(
    work: FrameContext,
    target: str,
    measured: Measured,
    baseline_px2: float | None,
    learnt: tuple[float, float],
    summary: BeliefSummary,
) -> FrameMetrics:
    """Line of metrics of a target: its belief in a few numbers, the status that it ran with.

    `learnt` is the share of the largest learning rate, and the estimate's rotation in degrees.
    Without a calibrated score the score is `index`.
    """
    measures, (learn_rate, angle) = measured.measures, learnt
    plate = work.plate_of(target).plate
    root = plate.inference(plate.root)
    score, features = _score_metrics(measured, plate)
    sd, region50, region90 = _widths(summary, root, score, measures.area_px2)
    return FrameMetrics(
        frame=work.frame.index,
        time_s=work.frame.time_s,
        target=target,
        centre_box=_floats(measured.box),
        map=_floats(summary.place),
        sd=sd,
        ud_px2=measures.ud_px2[plate.root],
        ud_nodes=measures.ud_px2,
        quiet_px2=baseline_px2,
        status=reported_status(work.net.targets[target].status, measured.scored, root.guarantee),
        score=score,
        log_evidence=summary.log_evidence,
        surprise=summary.surprise,
        ess=summary.ess,
        particles=summary.hypotheses,
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
        join=summary.join,
        existence=measured.existence,
        features=features,
        parts=_part_metrics(measures),
        e_value=None if root.alarm is None else e_value(measured.scored.cusum, root.alarm),
        p_values=dict(summary.p_values),
        log_predictive=dict(summary.log_predictive),
        state=state_numbers(summary.belief, plate.spec.is_ground),
    )


def state_numbers(belief: Posterior, on_ground: bool = False) -> dict[str, float]:
    """Mean and sd of each field of a belief beside the box, by name; none of hidden choices.

    Of a state in metres also x_m, y_m, w_m, h_m, in space z_m, and xy_corr, the correlation of x and y.
    """
    places = {
        name: place
        for place, name in enumerate(belief.fields[4:], 4)
        if name not in CHOICES and PAST not in name
    }
    if on_ground:
        upright = {"z_m": places.pop("z")} if "z" in places else {}
        places = {f"{name}_m": place for place, name in enumerate(belief.fields[:4])} | upright | places
    if not places:
        return {}
    mean, covariance = belief.mean.tolist(), belief.covariance
    sds = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).tolist()
    means = {name: mean[place] for name, place in places.items()}
    numbers = means | {f"{name}_sd": sds[place] for name, place in places.items()}
    if on_ground:
        scale = sds[0] * sds[1]
        numbers["xy_corr"] = float(covariance[0, 1]) / scale if scale > 0.0 else 0.0
    return numbers


def _score_metrics(measured: Measured, plate: CheckedTarget) -> tuple[float, dict[str, float]]:
    """The score, and the numbers that a calibrated one was computed from."""
    rule = plate.inference(plate.root).score
    if measured.score is None or rule is None:
        return index(measured.measures, plate.root), {}
    return measured.score, {**measured.scored.features(rule.settings), "most": measured.bound}


def _widths(
    summary: BeliefSummary, root: InferenceNode, score: float, area_px2: float
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """(4,) sds of the belief, px, and its regions of 50 and 90 %, widened by the localization error."""
    variances = np.maximum(summary.variances[:4], 0.0)
    region50, region90 = summary.regions
    if root.localization_error is not None:
        side = float(np.sqrt(max(area_px2, 1.0)))
        wide = blur_regions(summary.belief, root.localization_error, score, side)
        region50, region90 = wide.region50, wide.region90
        variances[:2] += wide.variance
    return _floats(np.sqrt(variances)), region50, region90


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
class BeliefSummary:
    """A belief in a few numbers.

    Attributes:
        variances: (D,) of the states.
        ess: effective number of hypotheses.
        surprise: KL of the belief from its prior, nats.
        regions: of `SHARES`: x_low, x_high, y_low, y_high in px.
        cloud: rounded boxes of some hypotheses.
        place: (4,) the MAP state's box.
        log_evidence: log of the frame's evidence.
        hypotheses: how many there are.
        belief: the belief itself, where more than these numbers may be asked for.
        join: what a joint belief says of the target; None for a target that is in none.
        p_values: agent -> probability of a measurement farther from the prediction than its own.
        log_predictive: agent -> log density of what it measured under the prediction.
    """

    variances: Floats
    ess: float
    surprise: float
    regions: Rows
    cloud: tuple[tuple[int, ...], ...]
    place: Floats
    log_evidence: float
    hypotheses: int
    belief: Posterior
    join: JoinMetrics | None = None
    p_values: Mapping[str, float] = field(default_factory=dict)
    log_predictive: Mapping[str, float] = field(default_factory=dict)


def summarise(
    work: FrameContext, filtered: Mapping[str, Filtered], spreads: Mapping[str, Floats]
) -> dict[str, BeliefSummary]:
    """Target -> its belief in a few numbers, of which `spreads` are the covariances."""
    stackable, single = _alike(filtered)
    summaries = {target: summarise_one(work, filtered[target], spreads[target]) for target in single}
    for targets in stackable:
        members = [filtered[target] for target in targets]
        summaries |= _summarise_rows(work, members, np.array([spreads[target] for target in targets]))
    return summaries


def find_covariances(filtered: Mapping[str, Filtered]) -> dict[str, Floats]:
    """Target -> (D, D) covariance of its belief."""
    groups = filtered.groups if isinstance(filtered, FilteredTargets) else ()
    covariances = dict(
        pair for group in groups for pair in zip(group.ids, group.clouds.covariances, strict=True)
    )
    stackable, single = _alike(
        {target: target_step for target, target_step in filtered.items() if target not in covariances}
        if len(covariances) < len(filtered)
        else {}
    )
    covariances |= {target: filtered[target].step.posterior.covariance for target in single}
    for targets in stackable:
        clouds = Clouds.of([particles(filtered[target].step.posterior) for target in targets])
        covariances.update(zip(targets, clouds.covariances, strict=True))
    return covariances


def _alike(filtered: Mapping[str, Filtered]) -> tuple[list[list[str]], list[str]]:
    """Targets of a plate whose particles make an array; then the others."""
    stackable: dict[Hashable, list[str]] = {}
    single: list[str] = []
    for target, target_step in filtered.items():
        posterior = target_step.step.posterior
        if (
            isinstance(posterior, ParticleSet)
            and target_step.step.support is posterior
            and not target_step.plan.views
        ):
            stackable.setdefault(
                (target_step.plan.root, posterior.fields, posterior.states.shape), []
            ).append(target)
        else:
            single.append(target)
    return list(stackable.values()), single


def summarise_one(work: FrameContext, filtered: Filtered, covariance: Floats) -> BeliefSummary:
    """The belief of a target after its step in a few numbers, of which the covariance (D, D) is known."""
    compiled, step = work.plate_of(filtered.target), filtered.step
    root = compiled.plate.root
    if compiled.views is not None:
        return _summarise_in_image(work, filtered, compiled.views, covariance)
    posterior, weights = step.posterior, step.support.weights
    cloud = posterior.draw(CLOUD_SIZE, work.stream(filtered.target, root)("cloud"))
    regions = list(map(tuple, posterior.regions(SHARES).tolist()))
    surprise = kl(weights.log, step.prior.log)
    return _summary(work, filtered, (covariance.diagonal(), weights.ess, surprise, regions, _rounded(cloud)))


def _summarise_in_image(
    work: FrameContext, filtered: Filtered, views: Views, covariance: Floats
) -> BeliefSummary:
    """The same of a belief on the ground, as the box in the image that it is seen as."""
    frame, step = work.frame, filtered.step
    root_node = work.plate_of(filtered.target).plate.root
    box, spread = views.moments(step.posterior.mean, covariance, frame)
    rng = work.stream(filtered.target, root_node)("cloud")
    cloud = box + rng.standard_normal((CLOUD_SIZE, 4)) @ np.linalg.cholesky(spread + np.eye(4) * 1e-9).T
    np.maximum(cloud[:, 2:], 1.0, out=cloud[:, 2:])
    reach = np.outer(
        [NormalDist().inv_cdf((1.0 + share) / 2.0) for share in SHARES], np.sqrt(np.diag(spread)[:2])
    )
    regions = np.stack([box[:2] - reach, box[:2] + reach], axis=2).reshape(-1, 4)
    weights = step.support.weights
    surprise = kl(weights.log, step.prior.log)
    numbers = np.diag(spread), weights.ess, surprise, list(map(tuple, regions.tolist())), _rounded(cloud)
    return evolve(_summary(work, filtered, numbers), place=views.boxes(step.map_state[None], frame)[0])


Numbers = tuple[Floats, float, float, Rows, tuple[tuple[int, ...], ...]]


def _summary(work: FrameContext, filtered: Filtered, numbers: Numbers) -> BeliefSummary:
    """A summary, of which `numbers` come first."""
    step, compiled = filtered.step, work.plate_of(filtered.target)
    hidden = () if compiled.modes is None else compiled.modes.hidden
    return BeliefSummary(
        *numbers,
        step.map_state[:4],
        step.log_density,
        len(step.support.weights),
        step.posterior,
        filtered.join,
        p_values(compiled.plate, step, hidden),
        log_predictive(compiled.plate, step, hidden, compiled.association_rules),
    )


def _summarise_rows(
    work: FrameContext, targets_filtered: Sequence[Filtered], spreads: Floats
) -> dict[str, BeliefSummary]:
    from bayesnet_track.numerics.resampling import look_up_even_of_each

    steps, targets = (
        [region.step for region in targets_filtered],
        [filtered.target for filtered in targets_filtered],
    )
    states = np.array([step.support.states for step in steps])
    weights = np.array([step.support.weights.weights for step in steps])
    log = np.array([step.support.weights.log for step in steps])
    variances = np.diagonal(spreads, axis1=1, axis2=2)
    ess = effective(log).tolist()
    surprises = [kl(step.support.weights.log, step.prior.log) for step in steps]
    regions = np.concatenate([_regions(states[:, :, axis], weights) for axis in (0, 1)], axis=2).tolist()
    root = work.plate_of(targets[0]).plate.root
    shifts = work.engine.streams.uniforms(work.births_of(targets), root, work.moment, "cloud")
    picks = look_up_even_of_each(weights, shifts, CLOUD_SIZE)
    clouds = np.rint(np.take_along_axis(states[:, :, :4], picks[:, :, None], axis=1)).astype(np.int64)
    numbers = zip(
        variances,
        ess,
        surprises,
        (list(map(tuple, filtered)) for filtered in regions),
        encode_clouds(clouds),
        strict=True,
    )
    return {
        filtered.target: _summary(work, filtered, row)
        for filtered, row in zip(targets_filtered, numbers, strict=True)
    }


def _regions(values: Floats, weights: Floats) -> Floats:
    """(T, S, 2) the central `SHARES` of the weight along an axis: values and weights (T, N)."""
    order = values.argsort(axis=1)
    ordered = np.take_along_axis(values, order, axis=1)
    cumulative = np.take_along_axis(weights, order, axis=1).cumsum(axis=1)
    tails = np.array([tail for share in SHARES for tail in ((1.0 - share) / 2.0, (1.0 + share) / 2.0)])
    levels = tails * cumulative[:, -1:]
    ranks = np.stack([(cumulative < levels[:, k, None]).sum(axis=1) for k in range(len(tails))], axis=1)
    return np.take_along_axis(ordered, ranks, axis=1).reshape(len(values), len(SHARES), 2)


def _rounded(boxes: Floats) -> tuple[tuple[int, ...], ...]:
    return tuple(map(tuple, np.rint(boxes).astype(np.int64).tolist()))
