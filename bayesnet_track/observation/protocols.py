"""Protocols of cues: the methods that the engine calls, their arguments and results, and association.

How a cue is declared and found is in `cue`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.lenses import shorter_way
from bayesnet_track.observation.labels import Label, LabelRule
from bayesnet_track.observation.likelihoods import Reference, floored
from bayesnet_track.observation.planes import Plane, Planes


@dataclass(frozen=True)
class AssociationRule:
    """Rule of association: the detection that a target is given, and the errors of detections.

    Attributes:
        sd_place: sd of a detection's centre, as a share of its sides.
        sd_size: sd of its sides, as a share of them; infinite where detections are points.
        gate: a detection farther from the prediction than this share of right ones is not the target's.
        min_overlap: nor is one whose intersection over union with the predicted box is smaller.
        appearance: exponent of the likelihood that agents which know the target's appearance give the
            detection's box.
        floor: floor of its measurement where that is the detection's box with errors of `variances` and
            nothing else, so that many targets are measured at once; None where the cue has to be asked.
        sd_place_px: further sd of its centre, px.
        sd_size_px: further sd of its sides, px.
        similarity: what the best assignment has most of: log density of the detections, or overlap.
        first_score: detections of a lower score are given in a second pass, to targets left without one.
        direction: weight of the direction consistency beside the overlap.
        direction_frames: over how many frames the direction of a target is measured.
        recover: whether targets left without a detection are compared by their last one in another pass.
        re_update: whether a target that has a detection again is filtered anew over the gap.
        continue_box: within how many box sides a frame of a target that lost its detections others go on with
            it; 0: never.
        label: how labels of detections are evidence; None where they are none.
    """

    sd_place: float
    sd_size: float
    gate: float
    min_overlap: float
    appearance: float
    floor: float | None = None
    sd_place_px: float = 0.0
    sd_size_px: float = 0.0
    similarity: Literal["density", "iou"] = "density"
    first_score: float = 0.0
    direction: float = 0.0
    direction_frames: int = 3
    recover: bool = False
    re_update: bool = False
    continue_box: float = 0.0
    label: LabelRule | None = None

    def variances(self, boxes: Floats) -> Floats:
        """(..., 4) variances, px^2, of x, y, w, h of detections (..., 4); infinite of sides of points."""
        variances, sides = np.empty(boxes.shape), boxes[..., 2:4]
        np.multiply(sides, self.sd_place, out=variances[..., :2])
        np.multiply(sides, self.sd_size, out=variances[..., 2:])
        variances *= variances
        if self.sd_place_px or self.sd_size_px:
            variances += np.square([self.sd_place_px, self.sd_place_px, self.sd_size_px, self.sd_size_px])
        return variances

    @property
    def is_of_points(self) -> bool:
        """True if the sides of detections say nothing."""
        return self.sd_size == math.inf

    @property
    def remembers(self) -> bool:
        """True if a target's former detections bear on its association or its belief."""
        return self.direction > 0.0 or self.recover or self.re_update


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses of the target's box.

    Attributes:
        boxes: (N, 4) float64 centre boxes x, y, w, h in pixels.
        fields: further fields by name, (N,) each (rotation, depth, ...).
    """

    boxes: Floats
    fields: Mapping[str, Floats] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.boxes.shape[0])

    def copied(self) -> Hypotheses:
        """The same in arrays of its own."""
        return Hypotheses(self.boxes.copy(), {name: values.copy() for name, values in self.fields.items()})

    def part(self, first: int, end: int) -> Hypotheses:
        """Hypotheses from `first` to before `end`, in the same arrays."""
        return Hypotheses(
            self.boxes[first:end], {name: values[first:end] for name, values in self.fields.items()}
        )


ANGLE = "angle"
"""Name of the field that says how far the target is turned since its first frame, in degrees, clockwise."""

CONTEXT = 1.0
"""How many box sizes beyond each side of the box a cue may look when it learns, unless it says otherwise."""


@runtime_checkable
class Cue(Protocol):
    """A cue at work: pure functions of planes, hypotheses and reference. Holds no state of its own.

    A cue may have a further attribute ``context: float``: how many box sizes beyond each side of the box
    `learn` looks, `CONTEXT` when it has none. The less, the likelier the planes are there already. And it may
    have a method ``follow(planes, box, reference, rate)``, which gives in less time what
    ``blend(reference, learn(planes, box), rate)`` does.
    """

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The planes that `learn` and `log_likelihood` read."""

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The reference for the target inside the centre box (4,).

        `planes` covers the box grown by its own size on every side, cut to the frame. All numbers in it are
        finite; an agent whose cue breaks this, as one that raises, is out: for the rest of the run when this
        is its first reference, else for a while.
        """

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """A reference between `old` (rate 0) and `new` (rate 1): eq. 2.15 of the thesis.

        A cue without this method blends its arrays linearly (`blend_arrays`).
        """

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """(N,) log-likelihood of every hypothesis.

        At most 0, the value of a perfect match, and at least ``log(floor)``. `planes` covers every
        hypothesis' box as far as it lies inside the frame. The part of a box outside the frame counts
        as not matching. A cue that raises, or returns anything but real numbers, NaN, anything above 0 or no
        value above -inf, is left out of the frame, and its agent is out for a while: it is tried again after
        10 frames, and after twice as many with each failure in a row.
        """


BOX = ("x", "y", "w", "h")


def _with_mode(states: Mapping[str, Floats], number: int) -> Mapping[str, Floats]:
    size = len(next(iter(states.values())))
    return {**states, "mode": np.full(size, float(number))}


@dataclass(frozen=True, eq=False)
class Seen:
    """Quantities of a measurement as functions of states, where they are no fields of them.

    Attributes:
        function: state field -> (N,), to (N, K) values; NaN where there is none.
        periods: (K,) after how much a quantity is the same again, 2 pi of an angle in radians; infinite of
            those that are no angles.
        shared: fields of the state that a measurement allows for and does not update: errors that other
            targets have, too.
        beyond: mean (D,) and covariance (D, D) of a state -> (K,) and (K, K): what the derivative at the mean
            leaves out of the quantities' mean and covariance; None where that is nothing much.
        covariance: quantities (T, K) expected of states -> (T, K, K) of their errors; None: that of the
            measurement, whatever is expected.
        extra_covariance: (K, K) errors of this measurement besides those of `covariance`.
        linearise: states (T, D) -> (T, K) values and their derivatives (T, K, D), in closed form; None: by
            differences of the function.
    """

    function: Callable[[Mapping[str, Floats]], Floats]
    periods: Floats
    shared: tuple[str, ...] = ()
    beyond: Callable[[Floats, Floats], tuple[Floats, Floats]] | None = None
    covariance: Callable[[Floats], Floats] | None = None
    extra_covariance: Floats | None = None
    linearise: Callable[[Floats], tuple[Floats, Floats]] | None = None

    def in_mode(self, number: int) -> Seen:
        """The same of states that are in a mode of this number and do not say so."""

        def function(states: Mapping[str, Floats]) -> Floats:
            return self.function(_with_mode(states, number))

        return Seen(function, self.periods)

    def less(self, values: Floats, expected: Floats) -> Floats:
        """(N, K) values less what was expected; of angles the shorter way round."""
        return shorter_way(self.periods)(values, expected)


@dataclass(frozen=True, eq=False)
class Errors:
    """Distributions of a measurement's errors that depend on the state, or are not Gaussian.

    Attributes:
        function: states, state field -> (N,), and (N, K) errors, to the (N, K) log densities; NaN where there
            is no distribution.
        is_normal: whether all of them are normal.
        power: exponent on the densities.
    """

    function: Callable[[Mapping[str, Floats], Floats], Floats]
    is_normal: bool = False
    power: float = 1.0

    def in_mode(self, number: int) -> Errors:
        """The same of states that are in a mode of this number and do not say so."""

        def function(states: Mapping[str, Floats], errors: Floats) -> Floats:
            return self.function(_with_mode(states, number), errors)

        return Errors(function, self.is_normal, self.power)

    def log_density(self, states: Mapping[str, Floats], errors: Floats) -> Floats:
        """(N, K) log densities of errors (N, K); -inf where there is no distribution."""
        log = self.power * self.function(states, errors)
        return np.where(np.isnan(log), -np.inf, log)


@dataclass(frozen=True, eq=False)
class Measurement:
    """A Gaussian message: where an agent found the target, instead of a score for every hypothesis.

    Its likelihood of a hypothesis h is exp(-d^2 / 2), d^2 = (mean - h)' covariance^-1 (mean - h): 1 at the
    place itself, as for every cue.

    Attributes:
        fields: the K fields of a hypothesis that were measured, such as ("x", "y").
        mean: (K,) their values, px (and px per frame for velocities).
        covariance: (K, K) of the error, symmetric and positive definite.
        floor: likelihood of an outlier as a share of the best; a belief that takes Gaussian messages as they
            are gates instead.
        choices: where several places may be the target's: (probability, measurement) of each, of the same
            fields and without choices of their own. What they lack of 1 is that none is. `mean` and
            `covariance` then stand for all of them.
        confidence: how sure the agent itself is that this is the target, 0..1; None where it does not say.
            A score can go by it; the belief does not.
        seen: what they would be of a state, where `fields` are no fields of it; the engine sets it.
        errors: their distributions where expressions say them; the engine sets it, and `covariance` then is
            that of the errors at the prediction.
        log_peak: log density of what was measured at the place itself: what the likelihood lacks to be the
            density of a measurement, apart from its floor. None of one whose errors are Gaussian.
        label: what was told beside the place of what the target is; the place's errors do not depend on it.
    """

    fields: tuple[str, ...]
    mean: Floats
    covariance: Floats
    floor: float = 0.0
    choices: tuple[tuple[float, Measurement], ...] = ()
    confidence: float | None = None
    seen: Seen | None = None
    errors: Errors | None = None
    log_peak: float | None = None
    label: Label | None = None

    def in_mode(self, number: int) -> Measurement:
        """The same of states that are in a mode of this number and do not say so."""
        if self.seen is None:
            return self
        errors = None if self.errors is None else self.errors.in_mode(number)
        choices = tuple((weight, measurement.in_mode(number)) for weight, measurement in self.choices)
        return replace(self, seen=self.seen.in_mode(number), errors=errors, choices=choices)

    def log_by_errors(self, states: Mapping[str, Floats]) -> Floats:
        """(N,) log-likelihood of states, state field -> (N,), by `errors`, mixed with the floor."""
        assert self.errors is not None and self.seen is not None
        errors = self.seen.less(self.seen.function(states), self.mean)
        log = self.errors.log_density(states, errors).sum(axis=1)
        peak = self.errors.log_density(states, np.zeros_like(errors)).sum(axis=1)
        exists = np.isfinite(peak)
        relative = np.where(exists, log, -np.inf) - np.where(exists, peak, 0.0)
        if self.floor > 0:
            relative = floored(relative, self.floor)
        return np.where(exists, relative + peak - (self.log_peak or 0.0), -np.inf)

    @property
    def log_constant(self) -> float:
        """Difference of the log density of what was measured and the log-likelihood: -log|2 pi R| / 2."""
        if self.log_peak is not None:
            return self.log_peak
        if self.variances is not None:
            return -0.5 * sum(math.log(2.0 * math.pi * variance) for variance in self.variances)
        return -0.5 * float(np.linalg.slogdet(2.0 * np.pi * self.covariance)[1])

    @property
    def missed(self) -> float:
        """Probability that none of the choices is the target's."""
        return max(1.0 - sum(weight for weight, _ in self.choices), 0.0)

    @cached_property
    def variances(self) -> tuple[float, ...] | None:
        """(K,) those of the errors where they are independent; None where they are not."""
        variances = self.covariance.diagonal()
        independent = np.count_nonzero(self.covariance) == np.count_nonzero(variances)
        return tuple(variances.tolist()) if independent else None


@runtime_checkable
class MeasuringCue(Protocol):
    """A cue that finds the target itself and says where: a classical tracker, a detector.

    It is otherwise as a `Cue`, with the same planes and references.
    """

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The planes that `learn` and `measure` read."""

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """Learn as a `Cue` does."""

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Blend as a `Cue` does."""

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """Measurement of the target; None if it is not seen, which says nothing about any hypothesis.

        `hypotheses` and their (N,) `weights`, which sum to 1, say where to look: `planes` covers their boxes
        as far as these lie inside the frame.
        """


OBSERVED = "observed"
"""Name, in a reference, of what is remembered of the detections a target was given (`adapt.association`)."""

OWN_LABEL = "label"
"""Array of a reference beside `OWN_DETECTION`: what the labels say (`LabelRule.told`)."""

OWN_DETECTION = "claim"
"""Name, in a reference, of the detection that the target was given for this frame; see `AssociatingCue`."""


@runtime_checkable
class AssociatingCue(MeasuringCue, Protocol):
    """A cue that measures by a detection: one that no other target of its plate is given in this frame.

    When it is asked its reference holds a further array, `OWN_DETECTION`: (1, 5) the detection's centre box
    and score, or (0, 5) when the target is given none. Where a plate has `associate: marginal` it is (K, 6):
    each detection that may be the target's, and last the probability that it is. What it learns holds no such
    array.
    """

    @property
    def rule(self) -> AssociationRule:
        """Rule by which a detection is the target's."""


AnyCue = Cue | MeasuringCue


def rule_of(cue: AnyCue) -> AssociationRule:
    """The rule of a cue that is declared to read claims."""
    assert isinstance(cue, AssociatingCue)
    return cue.rule


@runtime_checkable
class LocallyAdaptable(Protocol):
    """A cue that can act on its own uncertainty before it stops itself."""

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A reference (or parameters stored in it) tuned to be sharper; None when nothing is left to try.

        `attempt` counts from 1 within one episode of high uncertainty. There may be many of them: together
        they must go no further than the first, and learning takes the tuning back
        (`bayesnet_track.numerics.log_weights` does both).
        """


class GroupCue(Protocol):
    """The two methods of a cue that score, and learn of, T > 1 targets in one call; it may have either.

    They give the bits of a call for each target, which is what the engine makes for a cue without them, for
    one target, and where they fail. Planes come one for each target, or the same for all; the hypotheses of
    all targets below each other, those of target t from `starts[t]` to before `starts[t + 1]`.
    """

    def log_likelihood_of_each(
        self, planes: Sequence[Planes], hypotheses: Hypotheses, starts: Ints, references: Sequence[Reference]
    ) -> Floats:
        """(N,) `log_likelihood` of the hypotheses, each by the reference of its target."""

    def follow_each(
        self, planes: Sequence[Planes], boxes: Floats, references: Sequence[Reference], rates: Floats
    ) -> Sequence[Reference]:
        """Each target's reference blended at its rate (T,) with what is learnt in its box, of (T, 4)."""


@runtime_checkable
class Turnable(Protocol):
    """A cue that follows the target's rotation: it reads the hypotheses' field `ANGLE` where they have it."""

    def learn_turned(self, planes: Planes, box: Floats, angle: float) -> Reference:
        """Learn a target turned by `angle` degrees: the reference is of the upright target."""


@runtime_checkable
class Residual(Protocol):
    """A cue whose standard deviations can be estimated from ground truth (`fit --what sds`)."""

    def residuals(self, planes: Planes, box: Floats, reference: Reference) -> Mapping[str, Floats]:
        """Parameter -> (n,) differences of the centre box (4,) from the reference, in the parameter's unit.

        Each is an error whose standard deviation the parameter is; empty when the box shows nothing of it.
        """


def context_of(cue: AnyCue) -> float:
    """Box sizes beyond each side of the box that the cue reads when it learns."""
    return float(getattr(cue, "context", CONTEXT))
