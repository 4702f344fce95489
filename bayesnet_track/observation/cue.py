"""The cue contract: what a visual cue declares, what it computes, and how cues are found.

A cue comes in two halves. Its *declaration* (`CueDeclaration`) says its name, its typed parameters and its
price; it is read by `validate`, so importing it must stay cheap (no Numba, no OpenCV at the top of the file).
Its *implementation* (`Cue`) is made from the parameters when tracking starts.

Cues are found through the entry-point group ``bayesnet_track.cues``; the built-in ones use it too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from bayesnet_track.observation.likelihoods import FLOOR, SD_LOG_AREA, SD_LOG_ASPECT
from bayesnet_track.observation.likelihoods import Reference as Reference
from bayesnet_track.observation.likelihoods import blend_arrays as blend_arrays
from bayesnet_track.observation.likelihoods import blend_sizes as blend_sizes
from bayesnet_track.observation.likelihoods import floored as floored
from bayesnet_track.observation.likelihoods import log_logistic as log_logistic
from bayesnet_track.observation.likelihoods import log_size_penalty as log_size_penalty
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.observation.plugins import installed

ENTRY_POINT_GROUP = "bayesnet_track.cues"

Floats = NDArray[np.float64]


class NoParameters(BaseModel):
    """What a cue without parameters takes: unknown keys refused, values immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


class CueParameters(NoParameters):
    """Base of a cue's parameters: a floor, and what the cue adds."""

    floor: float = Field(
        default=FLOOR,
        gt=0,
        lt=1,
        description="Likelihood of an outlier as a share of the best possible likelihood.",
    )


class SizedCueParameters(CueParameters):
    """Parameters of a cue with a size penalty (`log_size_penalty`)."""

    sd_log_area: float = Field(
        default=SD_LOG_AREA,
        gt=0,
        description="Standard deviation of the log of the area ratio to the reference.",
    )
    sd_log_aspect: float = Field(
        default=SD_LOG_ASPECT,
        gt=0,
        description="Standard deviation of the log of the aspect ratio to the reference.",
    )


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Where the target might be.

    Attributes:
        boxes: (N, 4) float64 centre boxes x, y, w, h in pixels.
        fields: further fields by name, (N,) each (rotation, depth, ...).
    """

    boxes: Floats
    fields: Mapping[str, Floats] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.boxes.shape[0])


ANGLE = "angle"
"""Name of the field that says how far the target is turned since its first frame, in degrees, clockwise."""

CONTEXT = 1.0
"""How many box sizes beyond each side of the box a cue may look when it learns, unless it says otherwise."""


@runtime_checkable
class Cue(Protocol):
    """A cue at work: pure functions of planes, hypotheses and reference. Holds no state of its own.

    A cue may have a further attribute ``context: float``: how many box sizes beyond each side of the box
    `learn` looks, `CONTEXT` when it has none. The less, the likelier the planes are there already.
    """

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The planes that `learn` and `log_likelihood` read."""
        ...

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The reference for the target inside the centre box (4,).

        `planes` covers the box grown by its own size on every side, cut to the frame. All numbers in it are
        finite; an agent whose cue breaks this, as one that raises, is out: for the rest of the run when this
        is its first reference, else for a while.
        """
        ...

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """A reference between `old` (rate 0) and `new` (rate 1): eq. 2.15 of the thesis.

        A cue without this method blends its arrays linearly (`blend_arrays`).
        """
        ...

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """(N,) log-likelihood of every hypothesis.

        At most 0, the value of a perfect match, and at least ``log(floor)``. `planes` covers every
        hypothesis' box as far as it lies inside the frame. The part of a box outside the frame counts
        as not matching. A cue that raises, or returns anything but real numbers, NaN, anything above 0 or no
        value above -inf, is left out of the frame, and its agent is out for a while: it is tried again after
        10 frames, and after twice as many with each failure in a row.
        """
        ...


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
    """

    fields: tuple[str, ...]
    mean: Floats
    covariance: Floats
    floor: float = 0.0


@runtime_checkable
class MeasuringCue(Protocol):
    """A cue that finds the target itself and says where: a classical tracker, a detector.

    It is otherwise as a `Cue`, with the same planes and references.
    """

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The planes that `learn` and `measure` read."""
        ...

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """As of a `Cue`."""
        ...

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """As of a `Cue`."""
        ...

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """Where the target is; None when it is not seen, which says nothing about any hypothesis.

        `hypotheses` and their (N,) `weights`, which sum to 1, say where to look: `planes` covers their boxes
        as far as these lie inside the frame.
        """
        ...


CLAIM = "claim"
"""Name, in a reference, of the detection that the target was given for this frame; see `ClaimingCue`."""


@dataclass(frozen=True)
class ClaimRule:
    """Which detection a target is given as its own, and how far off detections are.

    Attributes:
        sd_place: sd of a detection's centre, as a share of its sides.
        sd_size: sd of its sides, as a share of them.
        gate: a detection farther from the prediction than this share of right ones is not the target's.
        least_overlap: nor is one whose intersection over union with the predicted box is smaller.
        looks: exponent of the likelihood that agents which know looks give the detection's box.
    """

    sd_place: float
    sd_size: float
    gate: float
    least_overlap: float
    looks: float

    def variances(self, boxes: Floats) -> Floats:
        """(..., 4) variances in px^2 of x, y, w, h of detections (..., 4)."""
        shares = np.array([self.sd_place, self.sd_place, self.sd_size, self.sd_size])
        return np.asarray((shares * boxes[..., [2, 3, 2, 3]]) ** 2)


@runtime_checkable
class ClaimingCue(MeasuringCue, Protocol):
    """A cue that measures by a detection: one that no other target of its plate is given in this frame.

    When it is asked its reference holds a further array, `CLAIM`: (1, 5) the detection's centre box and
    score, or (0, 5) when the target is given none. What it learns holds no such array.
    """

    @property
    def rule(self) -> ClaimRule:
        """Which detection is the target's."""
        ...


AnyCue = Cue | MeasuringCue


def rule_of(cue: AnyCue) -> ClaimRule:
    """The rule of a cue that is declared to read claims."""
    assert isinstance(cue, ClaimingCue)
    return cue.rule


@runtime_checkable
class LocallyAdaptable(Protocol):
    """A cue that can act on its own uncertainty before it stops itself."""

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A reference (or parameters stored in it) tuned to be sharper; None when nothing is left to try.

        `attempt` counts from 1 within one episode of high uncertainty. There may be many of them: together
        they must go no further than the first, and learning takes the tuning back
        (`bayesnet_track.numerics.sharpening` does both).
        """
        ...


@runtime_checkable
class Turnable(Protocol):
    """A cue that follows the target's rotation: it reads the hypotheses' field `ANGLE` where they have it."""

    def learn_turned(self, planes: Planes, box: Floats, angle: float) -> Reference:
        """As `learn`, for a target turned by `angle` degrees: the reference is of the upright target."""
        ...


@runtime_checkable
class Residual(Protocol):
    """A cue whose standard deviations can be estimated from ground truth (`fit --what sds`)."""

    def residuals(self, planes: Planes, box: Floats, reference: Reference) -> Mapping[str, Floats]:
        """Parameter -> (n,) differences of the centre box (4,) from the reference, in the parameter's unit.

        Each is an error whose standard deviation the parameter is; empty when the box shows nothing of it.
        """
        ...


NAME = re.compile(r"[^\W\d][\w.-]*")
"""What the name of a cue looks like: a key of YAML that needs no quotes."""


def _not_given(parameters: Any) -> AnyCue:
    raise NotImplementedError


@dataclass(frozen=True)
class Making:
    """How a declared cue is made: what its author wrote, and what it may leave out filled in.

    Attributes:
        make: what the author wrote.
        takes_parameters: False where the cue has none.
    """

    make: Callable[..., AnyCue]
    takes_parameters: bool

    def __call__(self, parameters: Any = None) -> AnyCue:
        """The cue; one without `blend` blends its arrays linearly."""
        cue = self.make(parameters) if self.takes_parameters else self.make()
        if not hasattr(cue, "blend"):
            with suppress(AttributeError, TypeError):  # with `__slots__`: it is told that `blend` is missing
                object.__setattr__(cue, "blend", blend_arrays)
        return cue


def context_of(cue: AnyCue) -> float:
    """How many box sizes beyond each side of the box the cue looks when it learns."""
    return float(getattr(cue, "context", CONTEXT))


@dataclass(frozen=True)
class CueDeclaration:
    """What the engine knows of a cue without loading it.

    Attributes:
        name: the word used in graph files.
        summary: one line of what it sees.
        parameters: model of its parameters (a subclass of `CueParameters`), each with a description and unit;
            left out, it has none, and `make` is called without any.
        make: parameters -> implementation; imports what is heavy.
        needs_color: True when it is blind on a gray source.
        cost_ms: declared price of 1000 hypotheses of 60x60 px, planes included, above 0 (rules weigh with it,
            so that a run never depends on a clock).
        rate_max: learning rate this cue wants instead of the graph's `learn.rate_max`, or None.
        opaque: True when it keeps something that cannot be stored: a run that is taken up again where it
            stopped is then another than one that went on.
        is_appearance: False when it does not tell one target from another by its looks: motion, place.
        missing: parameters -> what they need and this computer has not (a library's part, a file), in words,
            or None; `validate` asks it. Without it nothing is needed.
        measures: True for a `MeasuringCue`: it has `measure`, and no `log_likelihood`.
        adapts: True for a `LocallyAdaptable` one: it has `adapt`.
        reads_claim: True for a `ClaimingCue`: it has `rule`.
        reads_angle: True for a `Turnable` one: it has `learn_turned`.
        has_residuals: True for one whose standard deviations can be fitted (`Residual`): it has `residuals`.

    That the methods are there is checked when tracking starts; see `capabilities`.

    Raises:
        ValueError: the name is no word, there is no `make`, or the price is not above 0.
    """

    name: str
    summary: str = ""
    parameters: type[NoParameters] = NoParameters
    make: Callable[..., AnyCue] = _not_given
    needs_color: bool = False
    cost_ms: float = 1.0
    rate_max: float | None = None
    opaque: bool = False
    is_appearance: bool = True
    missing: Callable[[Any], str | None] | None = None
    measures: bool = False
    adapts: bool = False
    reads_claim: bool = False
    reads_angle: bool = False
    has_residuals: bool = False

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and NAME.fullmatch(self.name)):
            raise ValueError(f"cue {self.name!r}: a name of letters, digits and _ is needed, such as my_cue")
        if self.make is _not_given or not callable(self.make):
            raise ValueError(f"cue {self.name!r}: no `make`: a class, or a function that makes the cue")
        if not isinstance(self.make, Making):
            making = Making(self.make, self.parameters is not NoParameters)
            object.__setattr__(self, "make", making)
        if not 0.0 < self.cost_ms < float("inf"):
            raise ValueError(f"cue {self.name!r}: cost_ms {self.cost_ms}; a finite price above 0 is needed")


def installed_cues(named: Iterable[str] = ()) -> Mapping[str, CueDeclaration]:
    """The built-in cues, and those of `named` that other packages bring and that are allowed, by name.

    A package whose cue cannot be loaded is left out with a warning; see `plugins`.
    """
    return installed(ENTRY_POINT_GROUP, CueDeclaration, "cue", named)
