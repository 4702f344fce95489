"""Whether a frame's evidence is feasible under a grid's prediction, and what to do when it is not.

General Distribution Filter 1.6 and eq. 5: gamma depends on the region U, which is the bounding box of the
prediction, or the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.belief.contract import Evidence, Report
from bayesnet_track.belief.grid.cells import GridBelief
from bayesnet_track.belief.grid.window import Limits
from bayesnet_track.graph import spec
from bayesnet_track.journal.events.beliefs import BeliefReset
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.distributions import false_reset_level, feasibility

COARSE = 4096
"""Most places on the image at which its mean likelihood is taken."""

Ask = Callable[[Floats], Evidence]
"""(N, D) states, equally weighted -> evidence."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the detector found.

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
    rule: spec.Reset, prior: GridBelief, limits: Limits, log_evidence: float, ask: Ask
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
    best = float(log_likelihood.max())
    if evidence.faults or not np.isfinite(best):
        return Verdict(None, -np.inf)
    likelihood = np.exp(log_likelihood - best)
    mean = float(likelihood.mean())
    gamma = float(np.exp(min(log_evidence - best, 700.0))) / mean
    binned = np.zeros((len(rows), len(columns)))
    masses = prior.positions.sum(axis=0)
    at_row = _nearest(lattice.row + np.arange(masses.shape[0]), rows)
    at_column = _nearest(lattice.column + np.arange(masses.shape[1]), columns)
    np.add.at(binned, (at_row[:, None], at_column[None, :]), masses)
    level = _level(rule, binned, likelihood.reshape(binned.shape))
    peak = states[int(np.argmax(log_likelihood)), :2]
    area = cells * lattice.cell_px**2
    return Verdict(_report(rule, gamma, level, area), best + float(np.log(mean)), peak)


def unknown_velocity(belief: GridBelief, positions: Floats) -> GridBelief:
    """The belief with these masses (S, rows, columns) and nothing known of the velocity."""
    mass = positions[:, None, None] * belief.first_velocities[None, :, :, None, None]
    return replace(belief, mass=mass / mass.sum())


def window_around(belief: GridBelief, place: Floats, limits: Limits) -> GridBelief:
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
    moved = replace(belief, lattice=replace(lattice, column=left, row=top))
    return unknown_velocity(moved, scales[:, None, None] * even)


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
