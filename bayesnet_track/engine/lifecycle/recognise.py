"""Is a detection a target that is remembered, or a new one? A Bayes factor of place and appearance.

For a detection z and a remembered target k that was last well seen t frames ago,

    o_k = g(t) . A p_k(z) . r_k(z),  g = exp(-t / tau),  p_k = g N(z; F m_k, F P_k F' + Q + R) + (1 - g) / A,

are its odds against a new target, which may be anywhere in the frame of area A: g that it is still about, N
where its motion model leads it from the belief it had, with R = (side / 4)^2 for the detector's error, and

    r_k = L_k(z) / ((1 - alpha) L_k(elsewhere) + alpha),

L_k the likelihood of a box by all agents of the plate that know looks, with the references of k, 1 for a
perfect match. A new target looks, with alpha = 1 / 20, just like k; else like something elsewhere: half and
half boxes at random places and the boxes of other objects (at random places only, when there are none). So
looks can speak for k by 20 to 1 at most, and against k as far as the agents' floors let them.

P(k | z) = o_k / (1 + sum_j o_j).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.adapt.lifecycle import AppearanceMemory
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.graph.settings.lifecycle import Reidentify
from bayesnet_track.journal.events.lives import Recognition
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import overlap

ELSEWHERE = 64
"""Random boxes with which a detection's likelihood is compared."""

LOOKALIKE = 0.05
"""Share of new targets that look like one that is remembered."""

TOUCHES = 0.1
"""Boxes with a larger intersection over union are not elsewhere."""

DETECTOR_SD = 0.25
"""Sd of a detection's centre, in sqrt(w h)."""


@dataclass(frozen=True, eq=False)
class Compared:
    """One remembered target against M detections: the summands of its log-odds.

    Attributes:
        known: the target.
        away: frame intervals since it was last well seen.
        distance_px: (M,) distances from where its motion leads it.
        fading: log g.
        place: (M,) log(A p_k).
        appearance: (M,) log r_k.
        agents: those that were asked.
    """

    known: AppearanceMemory
    away: float
    distance_px: Floats
    fading: float
    place: Floats
    appearance: Floats
    agents: tuple[str, ...]

    @property
    def log_odds(self) -> Floats:
        """(M,) log o_k."""
        return np.asarray(self.fading + self.place + self.appearance)


@dataclass(frozen=True)
class Match:
    """A detection and the remembered target that it most probably is."""

    detection: int
    recognition: Recognition

    @property
    def is_sure(self) -> bool:
        """True when it is probable enough."""
        return self.recognition.probability >= self.recognition.min_probability


def weigh_place(
    known: AppearanceMemory,
    motion: MotionModel,
    boxes: Floats,
    time: float,
    area_px2: float,
    rule: Reidentify,
) -> tuple[float, Floats, Floats]:
    """log g, (M,) log(A p_k) and (M,) distances in px of centre boxes (M, 4) for a target at `time`."""
    dt = max(time - known.time, 1e-9)
    transition, noise = motion.linearise(known.mean, dt)
    mean = motion.drift(known.mean[None], dt)[0, :2]
    spread = (transition @ known.covariance @ transition.T + noise)[:2, :2]
    d = boxes[:, :2] - mean
    variances = DETECTOR_SD**2 * boxes[:, 2] * boxes[:, 3]
    covariance = spread[None] + variances[:, None, None] * np.eye(2)
    d2 = np.einsum("ni,ni->n", d, np.linalg.solve(covariance, d[:, :, None])[:, :, 0])
    log_normal = -0.5 * d2 - 0.5 * np.linalg.slogdet(covariance)[1] - math.log(2.0 * math.pi)
    fading = -dt / rule.frames
    anywhere = math.log(max(-math.expm1(fading), 1e-300))
    place = np.logaddexp(fading + math.log(area_px2) + log_normal, anywhere)
    return fading, np.asarray(place), np.hypot(d[:, 0], d[:, 1])


def draw_elsewhere(boxes: Floats, width: int, height: int, rng: np.random.Generator) -> Floats:
    """(ELSEWHERE, 4) centre boxes at random places of the frame, with the sizes of `boxes` (M, 4) in turn."""
    centres = rng.uniform([0.0, 0.0], [width - 1.0, height - 1.0], (ELSEWHERE, 2))
    return np.concatenate([centres, boxes[np.arange(ELSEWHERE) % len(boxes), 2:]], axis=1)


def weigh_appearance(boxes: Floats, log_l: Floats, groups: Sequence[tuple[Floats, Floats]]) -> Floats:
    """(M,) log r_k of boxes (M, 4) with log-likelihoods (M,), against groups of boxes with theirs.

    What touches a box is not elsewhere. With nothing elsewhere every new target is a lookalike.
    """
    result = np.zeros(len(boxes))
    for k, box in enumerate(boxes):
        means = []
        for places, values in groups:
            apart = overlap(box, places) <= TOUCHES
            if apart.any():
                means.append(_log_mean(values[apart]))
        alike = [math.log(LOOKALIKE)] if means else [0.0]
        rest = [math.log1p(-LOOKALIKE) + _log_mean(np.array(means))] if means else []
        result[k] = log_l[k] - np.logaddexp.reduce([*alike, *rest])
    return result


def match(compared: Sequence[Compared], detections: int, rule: Reidentify) -> tuple[Match, ...]:
    """Each detection's most probable target, one to one: the best odds of all first, then of what is left.

    A pair that is not sure takes nothing away from others. Detections for which no target is left, or all of
    odds 0, are left out.
    """
    if not compared or not detections:
        return ()
    odds = np.array([one.log_odds for one in compared])
    matches: list[Match] = []
    rows, columns = list(range(len(compared))), list(range(detections))
    while rows and columns:
        left = odds[np.ix_(rows, columns)]
        probability = np.exp(left - np.logaddexp(0.0, _log_sums(left)))
        if not np.isfinite(left).any():
            break
        i, j = np.unravel_index(int(np.argmax(np.where(np.isfinite(left), left, -np.inf))), left.shape)
        k, m = rows[int(i)], columns[int(j)]
        one = Match(m, _recognition(compared, rows, probability[:, int(j)], int(i), m, rule))
        columns.remove(m)
        if _is_contested(odds, k, columns, one):
            one = replace(one, recognition=replace(one.recognition, contested=True))
        matches.append(one)
        if matches[-1].is_sure:
            rows.remove(k)
    return tuple(matches)


def _is_contested(odds: Floats, k: int, others: Sequence[int], match: Match) -> bool:
    """True if another pair has a say in what would have become of this one at another `min_probability`.

    At a lower one, a detection with better odds may take the target first. At a higher one, targets may be
    left that were taken before, or one of the `others`, the detections left, may take target k.
    """
    m = match.detection
    if not match.is_sure:
        return int(np.argmax(odds[k])) != m
    found = match.recognition.probability
    among_all = math.exp(odds[k, m] - np.logaddexp(0.0, np.logaddexp.reduce(odds[:, m])))
    is_freed = found - among_all > 0.1 * min(found, 1.0 - found) + 1e-9
    rivals = odds[k, list(others)]
    return is_freed or bool((np.exp(rivals - np.logaddexp(0.0, rivals)) > found).any())


def _recognition(
    compared: Sequence[Compared], rows: Sequence[int], shares: Floats, best: int, m: int, rule: Reidentify
) -> Recognition:
    one = compared[rows[best]]
    others = {compared[row].known.target: float(shares[i]) for i, row in enumerate(rows) if i != best}
    others["new"] = max(0.0, 1.0 - float(shares.sum()))
    rival = max(others, key=lambda name: others[name])
    return Recognition(
        target=one.known.target,
        probability=float(shares[best]),
        min_probability=rule.min_probability,
        away=one.away,
        distance_px=float(one.distance_px[m]),
        fading=one.fading,
        place=float(one.place[m]),
        appearance=float(one.appearance[m]),
        agents=one.agents,
        rival=rival,
        rival_probability=others[rival],
    )


def _log_mean(values: Floats) -> float:
    top = float(values.max())
    return top if not math.isfinite(top) else top + math.log(float(np.mean(np.exp(values - top))))


def _log_sums(values: Floats) -> Floats:
    """(M,) log of the sums of exp over the rows."""
    return np.asarray(np.logaddexp.reduce(values, axis=0))
