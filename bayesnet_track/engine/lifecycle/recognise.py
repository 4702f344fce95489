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
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.models import KinematicMotion, linear_moves
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.state import plan_for
from bayesnet_track.graph.settings.lifecycle import Reidentify
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.journal.events.lives import Recognition
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.observation.cue import Hypotheses

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
    """K remembered targets against M detections: the summands of their log-odds.

    Attributes:
        targets: their ids.
        away: (K,) frame intervals since each was last well seen.
        distance_px: (K, M) distances from where their motion leads them.
        fading: (K,) log g.
        place: (K, M) log(A p_k).
        appearance: (K, M) log r_k.
        agents: of each target, those that were asked.
    """

    targets: Sequence[str]
    away: Floats
    distance_px: Floats
    fading: Floats
    place: Floats
    appearance: Floats
    agents: Sequence[tuple[str, ...]]

    @property
    def odds(self) -> Floats:
        """(K, M) log-odds."""
        return self.fading[:, None] + self.place + self.appearance


@dataclass(frozen=True)
class Match:
    """A detection and the remembered target that it most probably is."""

    detection: int
    recognition: Recognition

    @property
    def is_sure(self) -> bool:
        """True when it is probable enough."""
        return self.recognition.probability >= self.recognition.min_probability


def weigh_places(
    memories: Sequence[AppearanceMemory],
    motion: Confined,
    boxes: Floats,
    time: float,
    area_px2: float,
    rule: Reidentify,
) -> tuple[Floats, Floats, Floats]:
    """(K,) log g, (K, M) log(A p_k) and (K, M) distances in px of centre boxes (M, 4) at `time`."""
    dt = np.maximum(time - np.array([memory.time for memory in memories]), 1e-9)
    mean, spread = _expect_places(memories, motion, dt)
    d = boxes[:, :2] - mean[:, None]
    variances = DETECTOR_SD**2 * boxes[:, 2] * boxes[:, 3]
    covariance = spread[:, None] + variances[:, None, None] * np.eye(2)
    d2 = np.einsum("kni,kni->kn", d, np.linalg.solve(covariance, d[..., None])[..., 0])
    log_normal = -0.5 * d2 - 0.5 * np.linalg.slogdet(covariance)[1] - math.log(2.0 * math.pi)
    fading = -dt / rule.frames
    anywhere = np.log(np.maximum(-np.expm1(fading), 1e-300))
    place = np.logaddexp(fading[:, None] + math.log(area_px2) + log_normal, anywhere[:, None])
    return fading, np.asarray(place), np.hypot(d[..., 0], d[..., 1])


def _expect_places(
    memories: Sequence[AppearanceMemory], motion: Confined, dt: Floats
) -> tuple[Floats, Floats]:
    """(K, 2) means and (K, 2, 2) covariances of centres after `dt` (K,) frame intervals."""
    means, free = np.array([memory.mean for memory in memories]), motion.motion
    different, index = np.unique(dt, return_inverse=True)
    if isinstance(free, KinematicMotion) and linear_moves(free, float(dt[0])) is not None:
        moves = [linear_moves(free, step) or free.linearise(means[0], step) for step in different.tolist()]
        transition, noise = (np.array(parts)[index] for parts in zip(*moves, strict=True))
        places = motion.confine(np.einsum("kij,kj->ki", transition, means))
    else:
        pairs = [*zip(means, dt.tolist(), strict=True)]
        moves = [motion.linearise(mean, step) for mean, step in pairs]
        transition, noise = (np.array(parts) for parts in zip(*moves, strict=True))
        places = np.array([motion.drift(mean[None], step)[0] for mean, step in pairs])
    spread = (
        transition @ np.array([memory.covariance for memory in memories]) @ transition.transpose(0, 2, 1)
        + noise
    )
    return places[:, :2], spread[:, :2, :2]


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
            is_apart = overlap(box, places) <= TOUCHES
            if is_apart.any():
                means.append(_log_mean(values[is_apart]))
        lookalikes = [math.log(LOOKALIKE)] if means else [0.0]
        elsewhere = [math.log1p(-LOOKALIKE) + _log_mean(np.array(means))] if means else []
        result[k] = log_l[k] - np.logaddexp.reduce([*lookalikes, *elsewhere])
    return result


def match(compared: Compared, rule: Reidentify) -> tuple[Match, ...]:
    """Each detection's most probable target, one to one: the best odds of all first, then of what is left.

    A pair that is not sure takes nothing away from others. Detections for which no target is left, or all of
    odds 0, are left out.
    """
    odds = compared.odds
    matches: list[Match] = []
    rows, columns = (list(range(count)) for count in odds.shape)
    while rows and columns:
        left = odds if len(matches) == 0 else odds[np.ix_(rows, columns)]
        if not np.isfinite(left).any():
            break
        i, j = divmod(int(np.argmax(np.where(np.isfinite(left), left, -np.inf))), len(columns))
        shares = np.exp(left[:, j] - np.logaddexp(0.0, np.logaddexp.reduce(left[:, j])))
        k, m = rows[i], columns[j]
        best_match = Match(m, _recognition(compared, rows, shares, i, m, rule))
        columns.remove(m)
        if _is_contested(odds, k, columns, best_match):
            best_match = replace(best_match, recognition=replace(best_match.recognition, contested=True))
        matches.append(best_match)
        if matches[-1].is_sure:
            rows.remove(k)
    return tuple(matches)


def _is_contested(odds: Floats, k: int, columns: Sequence[int], match: Match) -> bool:
    """True if another pair has a say in what would have become of this one at another `min_probability`.

    At a lower one, a detection with better odds may take the target first. At a higher one, targets may be
    left that were taken before, or one of the `columns`, the detections left, may take target k.
    """
    m = match.detection
    if not match.is_sure:
        return int(np.argmax(odds[k])) != m
    share = match.recognition.probability
    among_all = math.exp(odds[k, m] - np.logaddexp(0.0, np.logaddexp.reduce(odds[:, m])))
    is_freed = share - among_all > 0.1 * min(share, 1.0 - share) + 1e-9
    rivals = odds[k, list(columns)]
    return is_freed or bool((np.exp(rivals - np.logaddexp(0.0, rivals)) > share).any())


def _recognition(
    compared: Compared, rows: Sequence[int], shares: Floats, index: int, m: int, rule: Reidentify
) -> Recognition:
    k = rows[index]
    rival, rival_probability = "new", max(0.0, 1.0 - float(shares.sum()))
    remaining = np.delete(shares, index)
    if len(remaining) and remaining.max() >= rival_probability:
        second = int(remaining.argmax())
        rival_probability = float(remaining[second])
        rival = compared.targets[rows[second + (second >= index)]]
    return Recognition(
        target=compared.targets[k],
        probability=float(shares[index]),
        min_probability=rule.min_probability,
        away=float(compared.away[k]),
        distance_px=float(compared.distance_px[k, m]),
        fading=float(compared.fading[k]),
        place=float(compared.place[k, m]),
        appearance=float(compared.appearance[k, m]),
        agents=compared.agents[k],
        rival=rival,
        rival_probability=rival_probability,
    )


def _log_mean(values: Floats) -> float:
    top = float(values.max())
    return top if not math.isfinite(top) else top + math.log(float(np.mean(np.exp(values - top))))


LEAST_LOG = -700.0
"""Log-likelihoods are cut here, so that the ratio of two of them is a number."""


def compare_remembered(
    work: FrameContext,
    plate: str,
    rule: Reidentify,
    boxes: Floats,
    objects: Floats,
    memories: Sequence[AppearanceMemory],
) -> Compared:
    """Remembered targets against detections (M, 4); `objects` (K, 4) are boxes of objects in this frame."""
    compiled, frame = work.engine.plates[plate], work.frame
    motion = work.confined(compiled.moments)
    area = float(frame.width * frame.height)
    fading, place, distance = weigh_places(memories, motion, boxes, frame.time, area, rule)
    appearance, agents = np.zeros(place.shape), list[tuple[str, ...]]([()] * len(memories))
    if compiled.looks:
        looks = [_compare_looks(work, compiled, boxes, objects, memory) for memory in memories]
        appearance, agents = np.array([log for log, _ in looks]), [askable for _, askable in looks]
    absences = frame.time - np.array([memory.time for memory in memories])
    return Compared(
        [memory.target for memory in memories], absences, distance, fading, place, appearance, agents
    )


def _compare_looks(
    work: FrameContext, compiled: CompiledPlate, boxes: Floats, objects: Floats, memory: AppearanceMemory
) -> tuple[Floats, tuple[str, ...]]:
    """(M,) log r_k of detections by all agents that know the looks of one target, and these."""
    frame = work.frame
    agents = tuple(agent for agent in compiled.plate.agents if agent in compiled.looks & {*memory.references})
    if not frame.has_color:
        agents = tuple(agent for agent in agents if agent not in compiled.color_agents)
    if not agents:
        return np.zeros(len(boxes)), ()
    stream = work.stream_of(memory.birth, compiled.plate.root)
    random = draw_elsewhere(boxes, frame.width, frame.height, stream("elsewhere"))
    observer = Observer(
        work.cache,
        compiled.cues,
        memory.references,
        lambda purpose: stream(f"recall {purpose}"),
        availability=work.availability_of(memory.target, "recalling"),
    )
    states = np.concatenate([boxes, random, objects])
    prior = np.full(len(states), -np.log(len(states)))
    plan = replace(plan_for(compiled, frozenset(agents)), factors=())
    evidence = evaluate(plan, observer, Hypotheses(states), prior)
    values = np.clip(evidence.log_likelihood, LEAST_LOG, None)
    on_boxes, at_random, theirs = np.split(values, [len(boxes), len(boxes) + len(random)])
    appearance = weigh_appearance(boxes, on_boxes, [(random, at_random), (objects, theirs)])
    return appearance, tuple(agent for agent in agents if agent in observer.answered)
