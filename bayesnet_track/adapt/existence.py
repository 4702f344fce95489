"""Probabilities that targets exist, and of which target detections are: pure functions on arrays.

Integrated probabilistic data association, in the form of Poisson multi-Bernoulli filters: a target exists
with a probability r, is detected with a probability d if it does, and false detections and new targets have
densities over x, y, w, h. With the marginal association probabilities p_ij (`numerics.association`),

    w_ij = r_i d_i N(z_j; m_i, P_i + R_j) / ((1 - r_i d_i) (c(z_j) + b(z_j))),
    r_i' = sum_j p_ij + p_i0 r_i (1 - d_i) / (1 - r_i d_i),

and a detection that is none of the targets' is a new one with probability b / (b + c).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.presence import UNSEEN, Known, Presence, PresenceChain
from bayesnet_track.graph.settings.lifecycle import Existence
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.association import marginalise
from bayesnet_track.numerics.records import evolve

MET = 3
"""Detections at which a false alarm is one that lasts."""


def estimate_chain(
    seen: float, seen_again: float, missed_frames: float, false_frames: float, max_detection: float = 0.99
) -> PresenceChain:
    """The chain by two rates: of detections, and of detections right after one, in the open.

    With the mean length of a run of misses m = `missed_frames`, leave l = 1 / m, enter e and detection d,
    seen = d l / (e + l) and seen_again = d (1 - e), so that e^2 - (1 - l) e + l (seen_again / seen - 1) = 0.

    >>> chain = estimate_chain(0.8, 0.93, 5.0, 5.0)
    >>> share = 1.0 - chain.blind_share
    >>> round(chain.detection * share, 6), round(chain.detection * (1.0 - chain.enter), 6)
    (0.8, 0.93)
    """
    ends = 1.0 / false_frames if false_frames > 1.0 else 1.0
    if missed_frames <= 1.0 or seen_again <= seen:
        return PresenceChain(min(seen, max_detection), 0.0, 1.0, ends)
    leave = 1.0 / missed_frames
    root = (1.0 - leave) ** 2 - 4.0 * leave * (seen_again / seen - 1.0)
    enter = ((1.0 - leave) - math.sqrt(max(root, 0.0))) / 2.0
    return PresenceChain(min(seen_again / (1.0 - enter), max_detection), enter, leave, ends)


def count_lasting(over: Presence, survival: float, false_frames: float) -> tuple[Floats, Floats]:
    """Count false detections that began a lasting false alarm, and all of them: (2,) spots and doubles.

    `over` are tracks and targets that ended. One that was detected n times was a false alarm, of which a
    share 1 - 1 / `false_frames` lasts from look to look, rather than a target of `survival`, by the
    probabilities of these n. Fewer than three detections may have met by chance: alarms of three or more are
    counted, and their share of all that last is known.
    """
    lasts, n = 1.0 - 1.0 / false_frames, np.maximum(over.seen, 1.0)
    log_odds = n * math.log(survival / lasts) + math.log(max(1.0 - survival, 1e-9) * false_frames)
    is_false = np.where(n < MET - 0.5, 1.0, 1.0 / (1.0 + np.exp(np.minimum(log_odds, 700.0))))
    counts = (over.begun * is_false)[:, None] * np.column_stack([1.0 - over.near, over.near])
    lasting = counts[n >= MET - 0.5].sum(axis=0) / lasts ** (MET - 1)
    return lasting, counts.sum(axis=0)


def share_hidden(in_the_open: float, covered: float) -> float:
    """Share of covered targets that are hidden, if those are detected with probability `covered`.

    >>> share_hidden(0.9, 0.9), share_hidden(0.9, 0.05)
    (0.0, 1.0)
    """
    floor = min(UNSEEN, covered)
    return (in_the_open - min(covered, in_the_open)) / (in_the_open - floor) if in_the_open > floor else 0.0


NEGLIGIBLE = 1e-3
"""Detections that are a target's with less probability are left out of its update."""

SURE = 1.0 - 1e-9
"""Largest probability that counts, so that odds are finite."""

START_DETECTION, START_CHANCES = 0.85, 100.0
"""What is assumed of detection before any, and for how many chances of one this counts."""

START_COVERED, START_COVERED_CHANCES = 0.6, 20.0
"""The same of targets that another one covers."""

START_AGAIN = 0.87
"""What is assumed of a detection right after one."""

START_CLUTTER, START_NEAR, START_FRAMES = 1.0, 0.1, 5.0
"""What is assumed of false detections a frame before any, also on targets; for how many frames it counts."""

START_LASTING, START_FALSE = (0.03, 0.2), 10.0
"""Shares of false detections of the background and on targets that begin a lasting one before any; for how
many of them this counts."""

MEMORY_FRAMES, MEMORY_CHANCES, MEMORY_SIZES = 100.0, 2000.0, 500.0
"""How much of the past the estimates rest on: frames, chances of a detection, and detections."""

MOST_LASTING = 0.9
"""Largest share of false detections that last."""

LEAST_ON_TARGETS = 1e-3
"""Least share of the frame that is taken to be on targets."""

SIZE_SD, LEAST_SIZE_SD = 0.5, 0.1
"""Sd of the logarithms of width and height before any detection, and the least that is assumed."""


@dataclass(frozen=True, eq=False)
class UnconfirmedTracks:
    """Detected things that are no target yet: K of them, a Gaussian belief each.

    Attributes:
        mean: (K, D).
        covariance: (K, D, D).
        existence: (K,) probability that it exists.
        first: (K,) frame in which it was first detected.
        born: (K,) time of that frame, frame intervals.
        number: (K,) number of that detection in its frame.
        seen: (K,) looks in which it was more probably detected than not.
        looks: (K,) looks since.
        score: (K,) sum of the scores of its detections.
        values: (K, V) probabilities of what each is, by the labels of its detections; V is 0 without labels.
        presence: of each, beside its existence.
    """

    mean: Floats
    covariance: Floats
    existence: Floats
    first: Ints
    born: Floats
    number: Ints
    seen: Ints
    looks: Ints
    score: Floats
    values: Floats
    presence: Presence

    def __len__(self) -> int:
        return len(self.existence)

    def take(self, rows: NDArray[np.bool_] | Ints) -> UnconfirmedTracks:
        """Some of them."""
        parts: dict[str, Any] = {name: part[rows] for name, part in self._arrays().items()}
        return UnconfirmedTracks(**parts, presence=self.presence.take(rows))

    def _arrays(self) -> dict[str, Any]:
        return {name: part for name, part in vars(self).items() if name != "presence"}

    def extend(self, tracks: UnconfirmedTracks) -> UnconfirmedTracks:
        """These, then others."""
        if not len(tracks):
            return self
        if not len(self):
            return tracks
        arrays = tracks._arrays()
        parts = {name: np.concatenate([part, arrays[name]]) for name, part in self._arrays().items()}
        return UnconfirmedTracks(**parts, presence=self.presence.extend(tracks.presence))

    @classmethod
    def none(cls, width: int) -> UnconfirmedTracks:
        """None, of a state of so many fields."""
        none, integers = np.empty(0), np.empty(0, np.int64)
        moments = np.empty((0, width)), np.empty((0, width, width))
        values = np.empty((0, 0))
        return cls(
            *moments, none, integers, none, integers, integers, integers, none, values, Presence.sure(0)
        )


@dataclass(frozen=True, eq=False)
class Begins:
    """N detections that are none of the targets', and what they begin.

    Attributes:
        density: (N,) density of all such, in units of one a frame anywhere.
        target: (N,) probability that it begins a target.
        spot: (N,) that it begins a lasting false alarm of the background.
        double: (N,) that it begins a lasting second box on a target.
        near: (N,) that it is a second box on a target, lasting or not, if it is no target's.
    """

    density: Floats
    target: Floats
    spot: Floats
    double: Floats
    near: Floats


@dataclass(frozen=True, eq=False)
class DetectionModel:
    """Statistics learnt from all detections of a plate.

    Attributes:
        unconfirmed: what is no target yet.
        clutter: false detections a frame.
        frames: how many frames that rests on.
        hits: detections of targets that nothing covered.
        chances: how many there could have been.
        size_mean: (2,) of log width and log height of detections.
        size_covariance: (2, 2).
        sizes: how many detections that rests on.
        covered_hits: detections of targets that another one covered.
        covered_chances: how many there could have been.
        again_hits: detections of targets that nothing covered, right after one.
        again_chances: how many there could have been.
        near: false detections a frame on targets: those that a target covers.
        begun: (2, 2) shares of false detections, of the background and on targets, that begin a lasting false
            alarm, and how many false detections that rests on.
        known: presence of the targets after the last look.
        further: sensor after the first one -> what its own detections have told, without unconfirmed tracks.
    """

    unconfirmed: UnconfirmedTracks
    clutter: float = START_CLUTTER
    frames: float = START_FRAMES
    hits: float = START_DETECTION * START_CHANCES
    chances: float = START_CHANCES
    size_mean: Floats = field(default_factory=lambda: np.zeros(2))
    size_covariance: Floats = field(default_factory=lambda: SIZE_SD**2 * np.eye(2))
    sizes: float = 0.0
    covered_hits: float = START_COVERED * START_COVERED_CHANCES
    covered_chances: float = START_COVERED_CHANCES
    again_hits: float = START_AGAIN * START_CHANCES
    again_chances: float = START_CHANCES
    near: float = START_NEAR
    begun: Floats = field(default_factory=lambda: np.array([START_LASTING, [START_FALSE] * 2]))
    known: Known = field(default_factory=Known)
    further: Mapping[str, DetectionModel] = field(default_factory=dict)

    def by(self, sensor: str | None) -> DetectionModel:
        """The same tracks, with what the detections of a further sensor have told; None: the first one."""
        if sensor is None:
            return self
        model = self.further.get(sensor) or DetectionModel(self.unconfirmed)
        model_known, shared = model.known, self.known
        if model_known.names != shared.names:
            model_known = Known(shared.names, model_known.of(shared.names))
        presence = evolve(model_known.presence, spot=shared.presence.spot, double=shared.presence.double)
        return evolve(model, unconfirmed=self.unconfirmed, known=evolve(model_known, presence=presence))

    def after(self, sensor: str | None, updated: DetectionModel) -> DetectionModel:
        """After a look of that sensor, which gave `updated`."""
        if sensor is None:
            return updated
        sensor_model = evolve(updated, unconfirmed=updated.unconfirmed.take(np.empty(0, np.int64)))
        new_presence = updated.known.presence
        presence = evolve(self.known.presence, spot=new_presence.spot, double=new_presence.double)
        shared_known = evolve(self.known, presence=presence)
        models = {**self.further, sensor: sensor_model}
        return evolve(self, unconfirmed=updated.unconfirmed, known=shared_known, further=models)

    def chain(self, rule: Existence) -> PresenceChain:
        """The chain of a target's states, by the rates of detections in the open."""
        rate = rule.detection if rule.detection is not None else min(self.hits / self.chances, 0.99)
        rate_again = self.again_hits / self.again_chances
        return estimate_chain(rate, rate_again, rule.missed_frames, rule.false_frames)

    def share_hidden(self, rule: Existence) -> float:
        """Share of covered targets that are hidden."""
        chain = self.chain(rule)
        in_the_open = chain.detection * (1.0 - chain.blind_share)
        covered = rule.covered if rule.covered is not None else self.covered_hits / self.covered_chances
        return share_hidden(in_the_open, covered)

    def clutter_rate(self, rule: Existence) -> float:
        """False detections a frame that no target covers."""
        return rule.clutter if rule.clutter is not None else self.clutter

    def new_share(self, rule: Existence) -> float:
        """Probability that a detection which is none of the targets', and on none, is a new one's."""
        return rule.births / (rule.births + self.clutter_rate(rule))

    def lasting(self, rule: Existence) -> Floats:
        """(2,) shares of false detections, of the background and on targets, that begin a lasting one."""
        if rule.false_frames <= 1.0:
            return np.zeros(2)
        return np.asarray(self.begun[0])

    def begin(self, rule: Existence, cover: Floats, on_targets: float) -> Begins:
        """Detections that are none of the targets', each covered by one with probability `cover` (N,).

        `on_targets` is the share of the frame that is on targets.
        """
        births, spots = rule.births, self.clutter_rate(rule)
        doubles = cover * self.near / max(on_targets, LEAST_ON_TARGETS)
        density, lasting = births + spots + doubles, self.lasting(rule)
        return Begins(
            density,
            births / density,
            lasting[0] * spots / density,
            lasting[1] * doubles / density,
            doubles / (spots + doubles),
        )

    def with_sizes(self, boxes: Floats) -> DetectionModel:
        """After detections (N, 4)."""
        if not len(boxes):
            return self
        from bayesnet_track.numerics.association import follow_sizes

        prior = self.size_mean, self.size_covariance, float(self.sizes)
        mean, covariance = follow_sizes(np.ascontiguousarray(boxes), *prior, SIZE_SD**2)
        sizes = min(self.sizes + len(boxes), MEMORY_SIZES)
        return evolve(self, size_mean=mean, size_covariance=covariance, sizes=sizes)

    def log_density(self, boxes: Floats, area_px2: float) -> Floats:
        """(N,) log density of a box (N, 4) that may be anywhere, of the sizes that detections have."""
        from bayesnet_track.numerics.association import log_size_densities

        moments = self.size_mean, self.size_covariance
        sizes = log_size_densities(np.ascontiguousarray(boxes), *moments, LEAST_SIZE_SD**2)
        return np.asarray(sizes - math.log(area_px2))

    def after_look(self, false: float, on_targets: float = 0.0) -> DetectionModel:
        """After a frame with so many false detections of the background, and on targets."""
        frames = min(self.frames + 1.0, MEMORY_FRAMES)
        clutter = max(self.clutter + (false - self.clutter) / frames, 1e-3)
        return evolve(
            self,
            clutter=clutter,
            near=max(self.near + (on_targets - self.near) / frames, 1e-3),
            frames=frames,
        )

    def after_over(self, over: Presence, rule: Existence) -> DetectionModel:
        """After these tracks and targets ended."""
        if rule.false_frames <= 1.0 or not over.begun.any():
            return self
        lasting, false = count_lasting(over, rule.survival, rule.false_frames)
        count = self.begun[1] + false
        mean = np.minimum(self.begun[0] + (lasting - self.begun[0] * false) / count, MOST_LASTING)
        return evolve(self, begun=np.array([mean, np.minimum(count, MEMORY_SIZES)]))

    def after_chances(
        self, cover: Floats, detected: Floats, existence: Floats, previous: Floats | None = None
    ) -> DetectionModel:
        """After T targets could be detected; `cover` (T,) is how probably another one covers each.

        `previous` (T,) is how probably each was detected in the last look while nothing covered it.
        """
        hits, chances = _faded(self.hits, self.chances, 1.0 - cover, detected, existence)
        covered = _faded(self.covered_hits, self.covered_chances, cover, detected, existence)
        model = evolve(self, hits=hits, chances=chances, covered_hits=covered[0], covered_chances=covered[1])
        if previous is None:
            return model
        repeats = _faded(self.again_hits, self.again_chances, (1.0 - cover) * previous, detected, existence)
        return evolve(model, again_hits=repeats[0], again_chances=repeats[1])


def _faded(
    hits: float, chances: float, share: Floats, detected: Floats, existence: Floats
) -> tuple[float, float]:
    total = chances + float(share @ existence)
    fade = min(1.0, MEMORY_CHANCES / total)
    return (hits + float(share @ detected)) * fade, total * fade


@dataclass(frozen=True, eq=False)
class Expected:
    """T targets and unconfirmed tracks as they are expected.

    Attributes:
        existence: (T,) probability that it exists.
        detection: (T,) probability that it is detected if it does.
    """

    existence: Floats
    detection: Floats


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of a row and a detection.

    Attributes:
        rows: (P,) ascending.
        columns: (P,) the detection.
        values: (P,) what is known of it: a log-likelihood, a weight.
    """

    rows: Ints
    columns: Ints
    values: Floats


@dataclass(frozen=True, eq=False)
class Shared:
    """Association probabilities of targets and detections.

    Attributes:
        existence: (T,) probability that it exists, after the look.
        pairs: pairs with the probability that the detection is the row's, given that it exists.
        missed: (T,) that none is, given that it exists; with the pairs of a row it sums to 1.
        seen: (T,) probability that it was detected.
        free: (N,) probability that the detection is none of theirs.
        gains: (P,) log weights of the pairs that were shared.
    """

    existence: Floats
    pairs: Pairs
    missed: Floats
    seen: Floats
    free: Floats
    gains: Pairs


def share(expected: Expected, likelihoods: Pairs, log_nobody: Floats) -> Shared:
    """Owners of the detections, by pairs with log N(z; m, P + R); `log_nobody` (N,) is log(c + b)."""
    r, detection = np.minimum(expected.existence, SURE), np.minimum(expected.detection, SURE)
    rows, columns = likelihoods.rows, likelihoods.columns
    hit = r * detection
    log_odds = np.log(np.maximum(hit, 1e-300)) - np.log1p(-hit)
    gains = log_odds[rows] + likelihoods.values - log_nobody[columns]
    marginals = marginalise(rows, columns, np.exp(np.minimum(gains, 700.0)), (len(r), len(log_nobody)))
    silent = r * (1.0 - detection) / (1.0 - hit)
    detected: Floats = np.bincount(rows, marginals.pairs, minlength=len(r)).astype(np.float64)
    existence = np.minimum(detected + marginals.missed * silent, 1.0)
    weights = marginals.pairs / np.maximum(existence, 1e-300)[rows]
    relevant = weights >= NEGLIGIBLE
    pairs = Pairs(rows[relevant], columns[relevant], weights[relevant])
    missed = np.clip(1.0 - np.bincount(pairs.rows, pairs.values, minlength=len(r)), 0.0, 1.0)
    return Shared(existence, pairs, missed, detected, marginals.free, evolve(likelihoods, values=gains))
