"""Grid belief: a discrete distribution over cells, stepped by the General Distribution Filter, and its reset.

General Distribution Filter 1.6 and eq. 5: gamma depends on the region U, which is the bounding box of the
prediction, or the image.

Propagation by the drift and the noise (eqs. 1 to 3), Bayes' rule at the cells (eq. 4), adaptivity by
P^(1/k) (1.5) and the detector of evidence that is not feasible (1.6). The Kalman filter is the special case
of Gaussians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesnet_track.belief.contract import (
    BOX_FIELDS,
    Evaluate,
    Evidence,
    MotionModel,
    Report,
    Step,
    Stream,
    WeightedStates,
    hypotheses_of,
)
from bayesnet_track.belief.grid.cells import (
    GridBelief,
    GridLimits,
    Lattice,
    ask_again,
    limits_of,
    log_gaussian,
    log_measured,
)
from bayesnet_track.belief.grid.motion import predict_grid, scale_sd
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.graph import spec
from bayesnet_track.journal.events.beliefs import BeliefReset
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.distributions import false_reset_level, feasibility, flatten, spreading_matrix
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.observation.cue import Hypotheses, Measurement

COARSE = 4096
"""Most places on the image at which its mean likelihood is taken."""

Ask = Callable[[Floats], Evidence]
"""(N, D) states, equally weighted -> evidence."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """Verdict of the detector.

    Attributes:
        report: the event to be written, or None when the evidence is feasible.
        mean: log of the mean likelihood over the region.
        peak: (x, y) of the most likely place of the image, for a reset over it.
    """

    report: Report | None
    mean: float
    peak: Floats | None = None


def judge_in_box(rule: spec.Reset, prior: GridBelief, box: Floats, log_likelihood: Floats) -> Verdict:
    """gamma over the bounding box: prior masses and log-likelihoods of all its cells, (S, rows, columns)."""
    top = float(log_likelihood.max())
    if not np.isfinite(top):
        return Verdict(None, -np.inf)
    likelihood = np.exp(log_likelihood - top)
    mean = float(likelihood.mean())
    gamma = feasibility(box / box.sum(), likelihood, mean)
    level = _level(rule, box / box.sum(), likelihood)
    area = box.shape[1] * box.shape[2] * prior.lattice.cell_px**2
    return Verdict(_report(rule, gamma, level, area), top + float(np.log(mean)))


def judge_on_image(
    rule: spec.Reset, prior: GridBelief, limits: GridLimits, log_evidence: float, ask: Ask
) -> Verdict:
    """gamma over the image, whose mean likelihood is taken at up to `COARSE` places of its own.

    Without borders (a motion that is not confined) or with agents that fail there, nothing is judged.
    """
    if limits.columns is None or limits.rows is None:
        return Verdict(None, -np.inf)
    lattice = prior.lattice
    (left, right), (top, bottom) = limits.columns, limits.rows
    cells = (right - left + 1) * (bottom - top + 1)
    stride = int(np.ceil(np.sqrt(cells / COARSE)))
    columns = np.arange(left + (right - left) % stride // 2, right + 1, stride)
    rows = np.arange(top + (bottom - top) % stride // 2, bottom + 1, stride)
    x, y = (lattice.anchor[k] + lattice.cell_px * places for k, places in ((0, columns), (1, rows)))
    states = np.tile(prior.mean, (len(columns) * len(rows), 1))
    states[:, 0], states[:, 1] = np.tile(x, len(rows)), np.repeat(y, len(columns))
    evidence = ask(states)
    log_likelihood = evidence.log_likelihood
    log_peak = float(log_likelihood.max())
    if evidence.faults or not np.isfinite(log_peak):
        return Verdict(None, -np.inf)
    likelihood = np.exp(log_likelihood - log_peak)
    mean = float(likelihood.mean())
    gamma = float(np.exp(min(log_evidence - log_peak, 700.0))) / mean
    binned = np.zeros((len(rows), len(columns)))
    masses = prior.positions.sum(axis=0)
    at_row = _nearest(lattice.row + np.arange(masses.shape[0]), rows)
    at_column = _nearest(lattice.column + np.arange(masses.shape[1]), columns)
    np.add.at(binned, (at_row[:, None], at_column[None, :]), masses)
    level = _level(rule, binned, likelihood.reshape(binned.shape))
    peak = states[int(np.argmax(log_likelihood)), :2]
    area = cells * lattice.cell_px**2
    return Verdict(_report(rule, gamma, level, area), log_peak + float(np.log(mean)), peak)


def unknown_velocity(belief: GridBelief, positions: Floats) -> GridBelief:
    """The belief with these masses (S, rows, columns) and nothing known of the velocity."""
    mass = positions[:, None, None] * belief.first_velocities[None, :, :, None, None]
    return replace(belief, mass=mass / mass.sum())


def window_around(belief: GridBelief, place: Floats, limits: GridLimits) -> GridBelief:
    """An even belief of unknown velocity over the window around a place (x, y), cut to the image."""
    lattice = belief.lattice
    spans: list[tuple[int, int]] = []
    for k, bounds in ((0, limits.columns), (1, limits.rows)):
        middle = round((place[k] - lattice.anchor[k]) / lattice.cell_px)
        low, high = middle - limits.window // 2, middle + (limits.window - 1) // 2
        spans.append((low, high) if bounds is None else (max(low, bounds[0]), min(high, bounds[1])))
    (left, right), (top, bottom) = spans
    scales = belief.positions.sum(axis=(1, 2))
    even = np.ones((bottom - top + 1, right - left + 1))
    recentred = replace(belief, lattice=replace(lattice, column=left, row=top))
    return unknown_velocity(recentred, scales[:, None, None] * even)


def _level(rule: spec.Reset, prior: Floats, likelihood: Floats) -> float:
    if rule.false_rate is None and (rule.below is not None or rule.region == "belief"):
        return 1.0 if rule.below is None else rule.below
    return false_reset_level(prior, likelihood, 0.001 if rule.false_rate is None else rule.false_rate)


def _report(rule: spec.Reset, gamma: float, level: float, area: float) -> Report | None:
    if not gamma < level:
        return None
    return lambda frame, target: BeliefReset(frame, target, gamma, level, rule.region, area, rule.then)


def _nearest(places: Ints, coarse: Ints) -> Ints:
    """Index into the evenly spaced `coarse` of the one nearest to each place."""
    step = int(coarse[1] - coarse[0]) if len(coarse) > 1 else 1
    index = np.rint((places - coarse[0]) / step).astype(np.int64)
    return np.asarray(np.clip(index, 0, len(coarse) - 1), dtype=np.int64)


@dataclass(frozen=True)
class GridFilter:
    """The General Distribution Filter, as `settings` say."""

    settings: spec.Grid

    def start(self, box: Floats, motion: MotionModel, stream: Stream) -> GridBelief:
        """All mass in the start box (4,), the velocity as the motion starts it.

        Raises:
            ValueError: the motion needs cells that a grid does not have.
        """
        if motion.fields not in (BOX_FIELDS, (*BOX_FIELDS, "vx", "vy")):
            raise ValueError(f"a grid has cells for x, y, w, h, vx, vy, not for {', '.join(motion.fields)}")
        settings, (mean, covariance) = self.settings, motion.start_moments(box)
        x, y, w, h = (float(v) for v in box)
        if isinstance(motion, Confined):
            x, y = min(max(x, 0.0), motion.width - 1.0), min(max(y, 0.0), motion.height - 1.0)
        scales, velocities = np.zeros(1), np.zeros(1)
        if scale_sd(motion, mean, 1.0) > 0:
            scales = settings.scale_cell * _around_zero(settings.scale_cells)
        first_velocities = np.ones((1, 1))
        if len(mean) > 4:
            velocities = settings.velocity_cell_px * _around_zero(settings.velocity_cells)
            vx, vy = (
                _first(settings, float(np.sqrt(covariance[k, k])) / settings.velocity_cell_px) for k in (4, 5)
            )
            first_velocities = np.outer(vy, vx)
        positions = np.zeros((len(scales), 1, 1))
        positions[len(scales) // 2] = 1.0
        lattice = Lattice((x, y), settings.cell_px, 0, 0, (w, h), scales, velocities)
        empty = GridBelief(np.ones((len(scales), 1, 1, 1, 1)), lattice, first_velocities)
        return unknown_velocity(empty, positions)

    def predict(
        self, prior: GridBelief, motion: MotionModel, dt: float, rng: np.random.Generator
    ) -> GridBelief:
        """The belief after `dt` frame intervals without evidence; `rng` is not used."""
        return predict_grid(prior, motion, dt, self.settings.window)

    def step(
        self, prior: GridBelief, motion: MotionModel, dt: float, evaluate: Evaluate, stream: Stream
    ) -> Step[GridBelief]:
        """The belief after `dt` frame intervals and the evidence of a frame.

        Evidence is taken once per position and scale, at the heaviest cells that together hold all but `cut`
        of the predicted mass; the other cells get none of the posterior. With a detector over the belief's
        box it is taken at all cells of their bounding box. Evidence that leaves no positive, finite weight,
        or that the detector ignores, is not used: the posterior is the prediction.
        """
        # Predict
        predicted = predict_grid(prior, motion, dt, self.settings.window)
        predicted = replace(predicted, mass=flatten(predicted.mass, self.settings.forget**dt))

        # Evaluate
        rule = self.settings.reset
        boxed = rule is not None and rule.region == "belief"
        cells = _heaviest(predicted.positions, self.settings.cut)
        query = _Asked(predicted, _bounding_box(predicted.positions.shape, cells) if boxed else cells)
        evidence = evaluate(query.hypotheses, query.prior.log)

        # Reweight
        try:
            posterior, log_evidence = query.update(evidence)
        except DegenerateWeights as fault:
            return query.step(evidence, predicted, -np.inf, query.prior, degenerate=str(fault))

        # Detect
        if rule is not None:
            verdict = self._judge(rule, query, evidence, log_evidence, motion, evaluate)
            if verdict.report is not None:
                if rule.then == "ignore":
                    return query.step(evidence, predicted, log_evidence, query.prior, report=verdict.report)
                return self._reset(query, evidence, verdict, motion, evaluate)
        return query.step(evidence, posterior, log_evidence, query.weights_of(posterior))

    def _judge(
        self,
        rule: spec.Reset,
        query: _Asked,
        evidence: Evidence,
        log_evidence: float,
        motion: MotionModel,
        evaluate: Evaluate,
    ) -> Verdict:
        if rule.region == "belief":
            masses, log_likelihood = query.box_of(evidence)
            return judge_in_box(rule, query.belief, masses, log_likelihood)
        limits = limits_of(query.belief.lattice, motion, self.settings.window)
        return judge_on_image(
            rule,
            query.belief,
            limits,
            log_evidence,
            partial(ask_again, evaluate, evidence, fields=query.belief.fields),
        )

    def _reset(
        self, query: _Asked, evidence: Evidence, verdict: Verdict, motion: MotionModel, evaluate: Evaluate
    ) -> Step[GridBelief]:
        """Start again from the likelihood over the region; on the image, over the window around its peak."""
        if verdict.peak is None:
            even = np.zeros(query.belief.positions.shape)
            even.ravel()[query.cells] = 1.0
            fresh = _Asked(unknown_velocity(query.belief, even), query.cells)
        else:
            limits = limits_of(query.belief.lattice, motion, self.settings.window)
            belief = window_around(query.belief, verdict.peak, limits)
            fresh = _Asked(belief, _heaviest(belief.positions, 0.0))
            evidence = ask_again(evaluate, evidence, fresh.states, belief.fields, fresh.prior.log)
        try:
            posterior, _ = fresh.update(evidence)
        except DegenerateWeights as fault:
            return fresh.step(evidence, fresh.belief, -np.inf, fresh.prior, degenerate=str(fault))
        return fresh.step(
            evidence, posterior, verdict.mean, fresh.weights_of(posterior), report=verdict.report
        )


class _Asked:
    """The cells of a predicted belief at which evidence is taken: indices into its flat positions."""

    def __init__(self, belief: GridBelief, cells: Ints) -> None:
        self.belief, self.cells = replace(belief, asked=len(cells)), cells
        masses = belief.positions.ravel()[cells]
        with np.errstate(divide="ignore"):
            self.prior = LogWeights.normalise(np.log(masses))[0]
        self.states = belief.boxes(cells)
        if len(belief.fields) > 4:
            v = belief.lattice.velocities
            share = np.divide(1.0, masses, out=np.zeros(len(masses)), where=masses > 0)
            along = [np.tensordot(v, belief.mass.sum(axis=axis), (0, 1)) for axis in (1, 2)]
            speeds = [total.ravel()[cells] * share for total in along]
            self.states = np.column_stack([self.states, *speeds])

    @property
    def hypotheses(self) -> Hypotheses:
        return hypotheses_of(self.states, self.belief.fields)

    def update(self, evidence: Evidence) -> tuple[GridBelief, float]:
        """The posterior and the log-evidence sum beta L; what was measured of velocities acts on their cells.

        Raises:
            DegenerateWeights: nothing positive and finite is left.
        """
        fast = {
            n: m
            for n, m in evidence.gaussians.items()
            if m.seen is None and not set(m.fields) <= set(BOX_FIELDS)
        }
        if fast and evidence.sampled is not None:
            slow = sum(
                (
                    log_measured(m, self.states, self.belief.fields)
                    for n, m in evidence.gaussians.items()
                    if n not in fast
                ),
                evidence.sampled,
            )
            belief = self._measure(list(fast.values()))
            share = belief.positions.ravel()[self.cells] / self.belief.positions.ravel()[self.cells]
            with np.errstate(divide="ignore", invalid="ignore"):
                effective = slow + np.where(share > 0, np.log(share), -np.inf)
        else:
            belief, effective, slow = self.belief, evidence.log_likelihood, evidence.log_likelihood
        with np.errstate(invalid="ignore"):  # -inf + inf is NaN, which `times` refuses
            log_evidence = self.prior.times(effective)[1]
        factor = np.zeros(self.belief.positions.size)
        factor[self.cells] = np.exp(np.minimum(slow - np.max(slow + self.prior.log), 700.0))
        factor = factor.reshape(self.belief.positions.shape)[:, None, None]
        mass = belief.mass * factor
        return replace(self.belief, mass=mass / mass.sum()), log_evidence

    def box_of(self, evidence: Evidence) -> tuple[Floats, Floats]:
        """Masses and log-likelihoods of cells that fill a box, each (S, rows, columns)."""
        indices = np.unravel_index(self.cells, self.belief.positions.shape)
        shape = tuple(int(np.ptp(places)) + 1 for places in indices)
        return np.exp(self.prior.log).reshape(shape), evidence.log_likelihood.reshape(shape)

    def weights_of(self, posterior: GridBelief) -> LogWeights:
        """The posterior weights of the cells."""
        with np.errstate(divide="ignore"):
            return LogWeights.normalise(np.log(posterior.positions.ravel()[self.cells]))[0]

    def step(
        self,
        evidence: Evidence,
        posterior: GridBelief,
        log_evidence: float,
        weights: LogWeights,
        degenerate: str | None = None,
        report: Report | None = None,
    ) -> Step[GridBelief]:
        counted = replace(posterior, asked=len(self.cells))
        return Step(
            posterior=counted,
            log_evidence=log_evidence,
            support=WeightedStates(self.states, weights),
            prior=self.prior,
            evidence=evidence,
            find_map=counted.most_probable,
            degenerate=degenerate,
            reports=() if report is None else (report,),
        )

    def _measure(self, measured: list[Measurement]) -> GridBelief:
        """The belief, not normalised, with the cells' velocities weighed by what was measured of them."""
        shapes = {"x": 4, "y": 3, "w": 0, "h": 0, "vx": 2, "vy": 1}
        mass = self.belief.mass
        for measurement in measured:
            values: list[Floats] = []
            for name in measurement.fields:
                shape = [1] * 5
                shape[shapes[name]] = -1
                values.append(self.belief.values[self.belief.fields.index(name)].reshape(shape))
            mass = mass * np.exp(log_gaussian(measurement, list(np.broadcast_arrays(*values))))
        return replace(self.belief, mass=mass)


def _heaviest(positions: Floats, cut: float) -> Ints:
    """The heaviest cells that hold all but `cut` of the mass, in order of their index."""
    masses = positions.ravel()
    order = np.argsort(-masses, kind="stable")
    cumulative = np.cumsum(masses[order])
    count = int(np.searchsorted(cumulative, (1.0 - cut) * cumulative[-1])) + 1 if cut > 0 else len(masses)
    cells = order[:count]
    return np.sort(cells[masses[cells] > 0])


def _bounding_box(shape: tuple[int, ...], cells: Ints) -> Ints:
    """All cells between the first and the last row and column of some, at every scale."""
    _, row, column = np.unravel_index(cells, shape)
    box = np.zeros(shape, dtype=bool)
    box[:, row.min() : row.max() + 1, column.min() : column.max() + 1] = True
    return np.flatnonzero(box)


def _around_zero(count: int) -> Floats:
    """(count,) whole numbers, the middle one 0."""
    return np.arange(float(count)) - (count - 1) / 2


def _first(settings: spec.Grid, sd: float) -> Floats:
    """(V,) masses of a velocity of which only its sd in cells is known."""
    size = settings.velocity_cells
    line = np.clip(spreading_matrix(size, 1.0, sd)[:, size // 2], 0.0, None)
    return np.asarray(line / line.sum())
