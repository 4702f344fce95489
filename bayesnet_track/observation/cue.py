"""The cue contract: declaration and capabilities, how cues are found, and what they may raise and return.

A cue comes in two halves. Its *declaration* (`CueDeclaration`) says its name, its typed parameters and its
price; it is read by `validate`, so importing it must stay cheap (no Numba, no OpenCV at the top of the file).
Its *implementation* (`Cue`) is made from the parameters when tracking starts.

Cues are found through the entry-point group ``bayesnet_track.cues``; the built-in ones use it too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from inspect import getattr_static
from pathlib import PurePath
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from bayesnet_track.numerics.arrays import Floats as Floats
from bayesnet_track.observation.labels import Label as Label
from bayesnet_track.observation.labels import LabelRule as LabelRule
from bayesnet_track.observation.likelihoods import FLOOR, SD_LOG_AREA, SD_LOG_ASPECT
from bayesnet_track.observation.likelihoods import Reference as Reference
from bayesnet_track.observation.likelihoods import floored as floored
from bayesnet_track.observation.plugins import installed
from bayesnet_track.observation.protocols import ANGLE as ANGLE
from bayesnet_track.observation.protocols import CONTEXT as CONTEXT
from bayesnet_track.observation.protocols import OBSERVED as OBSERVED
from bayesnet_track.observation.protocols import OWN_DETECTION as OWN_DETECTION
from bayesnet_track.observation.protocols import OWN_LABEL as OWN_LABEL
from bayesnet_track.observation.protocols import AnyCue as AnyCue
from bayesnet_track.observation.protocols import AssociatingCue as AssociatingCue
from bayesnet_track.observation.protocols import AssociationRule as AssociationRule
from bayesnet_track.observation.protocols import Cue as Cue
from bayesnet_track.observation.protocols import GroupCue as GroupCue
from bayesnet_track.observation.protocols import Hypotheses as Hypotheses
from bayesnet_track.observation.protocols import LocallyAdaptable as LocallyAdaptable
from bayesnet_track.observation.protocols import Measurement as Measurement
from bayesnet_track.observation.protocols import MeasuringCue as MeasuringCue
from bayesnet_track.observation.protocols import Residual as Residual
from bayesnet_track.observation.protocols import Turnable as Turnable
from bayesnet_track.observation.protocols import context_of as context_of
from bayesnet_track.observation.protocols import rule_of as rule_of

LOG_LOGISTIC_AT_ZERO = np.logaddexp(0.0, -4.0)


def log_logistic(distances: Floats, halved_at: float) -> Floats:
    """(N,) log-likelihood that falls with a distance as a logistic function, 0 at distance 0.

    -log(1 + exp(4 (d - a) / a)), divided by its value 1 / (1 + e^-4) at distance 0: thesis eq. 3.3,
    corrected. At the distance a = `halved_at` the likelihood is about half of the best.

    >>> np.exp(log_logistic(np.array([0.0, 0.2, 1.0]), 0.2)).round(3).tolist()
    [1.0, 0.509, 0.0]
    """
    return np.asarray(LOG_LOGISTIC_AT_ZERO - np.logaddexp(0.0, 4.0 * (distances - halved_at) / halved_at))


def log_size_penalty(
    boxes: Floats,
    reference_size: Floats,
    sd_log_area: float = SD_LOG_AREA,
    sd_log_aspect: float = SD_LOG_ASPECT,
) -> Floats:
    """(N,) Gaussian penalty in the logs of the area ratio and of the aspect ratio (0 when they agree).

    Thesis 3.1.1 names a Gaussian in area and aspect ratio; here in their logarithms, so that half and twice
    the size cost the same. `boxes` are centre boxes (N, 4), `reference_size` (2,) width and height in pixels.
    """
    width = np.log(boxes[:, 2] / reference_size[0])
    height = np.log(boxes[:, 3] / reference_size[1])
    return np.asarray(
        -0.5 * (((width + height) / sd_log_area) ** 2 + ((width - height) / sd_log_aspect) ** 2)
    )


def blend_arrays(old: Reference, new: Reference, rate: float) -> dict[str, NDArray[Any]]:
    """Name by name ``rate * new + (1 - rate) * old`` (eq. 2.15): the `blend` of a cue without one."""
    return {name: np.asarray(rate * new[name] + (1.0 - rate) * old[name]) for name in old}


def blend_sizes(old: Reference, new: Reference, rate: float | Floats) -> Floats:
    """The array ``size`` of two references blended in its logarithm: half and twice are equally far."""
    return np.asarray(old["size"] * (new["size"] / old["size"]) ** rate)


ENTRY_POINT_GROUP = "bayesnet_track.cues"


class NoParameters(BaseModel):
    """Parameters of a cue that has none: unknown keys are refused, values immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


class AnyParameters(NoParameters):
    """Parameters of a cue of which nothing is known."""

    model_config = ConfigDict(extra="allow")


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


NAME = re.compile(r"[^\W\d][\w.-]*")
"""The names that a cue may have are keys of YAML that need no quotes."""


def _not_given(parameters: Any) -> AnyCue:
    raise NotImplementedError


@dataclass(frozen=True)
class Making:
    """Function that makes a declared cue; parameters that its author left out are filled in.

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


@dataclass(frozen=True)
class CueDeclaration:
    """Properties of a cue that are known without loading it.

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
        files: parameters -> paths of the files that it reads, such as a network's; runs record their SHA-256.
        unused: parameters, numbers of the frames that a run reads (from 0; up to `sys.maxsize` where their
            number is not known) -> a sentence for each thing in its files that the run does not use.
        gives: parameters -> what it measures, of one whose quantities need not be fields of the state: the
            agent's `measures` says what they would be of a state.
        noises: parameters -> quantity: the distribution of its error as an expression of the state, of one of
            which not all errors are Gaussian with a known sd; the engine puts them in its measurements.
        is_confident: parameters -> whether its measurements have a `confidence`; left out, they have none.
        measures: True for a `MeasuringCue`: it has `measure`, and no `log_likelihood`.
        adapts: True for a `LocallyAdaptable` one: it has `adapt`.
        reads_detection: True for a `AssociatingCue`: it has `rule`.
        reads_angle: True for a `Turnable` one: it has `learn_turned`.
        reads: parameters -> fields of the state beside the box without which it says nothing, such as `vx`;
            none when left out.
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
    reads_detection: bool = False
    reads_angle: bool = False
    has_residuals: bool = False
    reads: Callable[[Any], tuple[str, ...]] | None = None
    files: Callable[[Any], tuple[str, ...]] | None = None
    unused: Callable[[Any, range], tuple[str, ...]] | None = None
    gives: Callable[[Any], tuple[str, ...]] | None = None
    noises: Callable[[Any], Mapping[str, str]] | None = None
    is_confident: Callable[[Any], bool] | None = None

    def is_sure(self, parameters: Any) -> bool:
        """True if its measurements have a `confidence`."""
        return self.is_confident is not None and self.is_confident(parameters)

    def can_search(self, parameters: Any) -> bool:
        """True if it says how sure it is at any place of a frame, however often it is asked."""
        return self.is_sure(parameters) and not self.opaque

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


def stand_ins(named: Iterable[str]) -> Mapping[str, CueDeclaration]:
    """The installed cues, and declarations for those of `named` that are not: to show a graph, not run it."""
    unknown = {name: CueDeclaration(name, parameters=AnyParameters, make=_not_here) for name in named}
    return {**unknown, **installed_cues()}


def _not_here(parameters: Any) -> AnyCue:
    raise LookupError("a cue that is not installed here")


FAULTS = (Exception, SystemExit)
"""What is taken for a fault of who raises it; a `sys.exit` in a cue does not end the run either."""


CUE_FILE_MODULE = "bayesnet_track_cue_file_"
"""What the names of modules that are made from cue files begin with."""


def text_of(error: BaseException) -> str:
    """The text of an exception, whatever its own `__str__` does, and the line of a cue file that raised it.

    >>> text_of(ValueError("too dark"))
    'too dark'
    """
    return own_text_of(error) + _place_of(error)


def own_text_of(error: BaseException) -> str:
    """The text of an exception alone."""
    try:
        return str(error)
    except FAULTS as own:
        return f"(without a text: its __str__ raised {type(own).__name__})"


def _place_of(error: BaseException) -> str:
    place, entry = "", error.__traceback__
    while entry is not None:
        if str(entry.tb_frame.f_globals.get("__name__")).startswith(CUE_FILE_MODULE):
            place = f" ({PurePath(entry.tb_frame.f_code.co_filename).name}:{entry.tb_lineno})"
        entry = entry.tb_next
    return place


def said(error: BaseException) -> str:
    """Type and text of an exception.

    >>> said(SystemExit(3))
    'SystemExit: 3'
    """
    return f"{type(error).__name__}: {text_of(error)}"


def real_numbers(returned: Any) -> NDArray[np.float64] | str:
    """A copy as float64; in words what it is where it holds anything but real numbers.

    Parts that are masked, imaginary parts and numbers written as text are not for anybody to interpret.

    >>> real_numbers([1, 2])
    array([1., 2.])
    >>> real_numbers([1j]), real_numbers(["1"]), real_numbers(None)
    ('array of complex128', 'array of <U1', 'NoneType')
    """
    if isinstance(returned, np.ma.MaskedArray):
        return "masked array"
    array = np.asarray(returned)
    if array.dtype.kind in "iuf":
        return np.array(array, dtype=np.float64)
    is_one_object = array.dtype.kind == "O" and array.ndim == 0
    return type(returned).__name__ if is_one_object else f"array of {array.dtype}"


def foreign_part(measured: Measurement) -> str:
    """Name of the part of a measurement that is not of real numbers; empty if all are."""
    for name in ("mean", "covariance", "floor", "confidence"):
        value = getattr(measured, name)
        if name == "confidence" and value is None:
            continue
        if type(value) is float or (type(value) is np.ndarray and value.dtype.kind in "iuf"):
            continue
        converted = real_numbers(value)
        if isinstance(converted, str):
            return f"Measurement whose {name} is of type {converted}"
    return ""


METHODS: Mapping[str, str] = MappingProxyType(
    {
        "measures": "measure",
        "adapts": "adapt",
        "reads_angle": "learn_turned",
        "reads_detection": "rule",
        "has_residuals": "residuals",
    }
)
"""Flag of a declaration -> the method (or property) that a cue has if, and only if, the flag is set."""


class CueError(ValueError):
    """A cue that cannot be used as it is declared; says which, and what is to be changed."""


def make_cue(declaration: CueDeclaration, parameters: Any) -> AnyCue:
    """The cue at work, checked against its declaration.

    Raises:
        CueError: it cannot be made, or can do less or more than is declared; names cue, flag and method.
    """
    try:
        cue = declaration.make(parameters)
    except FAULTS as error:
        if type(error).__module__.startswith("bayesnet_track"):
            raise
        raise CueError(f"cue {declaration.name!r} cannot be made: it raised {said(error)}") from error
    wrong = list(_differences(declaration, cue))
    if wrong:
        raise CueError("\n".join(wrong))
    return cue


def _differences(declaration: CueDeclaration, cue: AnyCue) -> Iterator[str]:
    name = f"cue {declaration.name!r}"
    for needed in ("needs", "learn", "blend"):
        if not _has(cue, needed):
            yield f"{name} has no {needed!r}, which every cue needs"
    if declaration.measures and _has(cue, "log_likelihood"):
        yield (
            f"{name} declares measures=True and has the method 'log_likelihood', too: a cue either measures "
            "or scores; remove the method or the flag"
        )
    elif not declaration.measures and not _has(cue, "log_likelihood") and not _has(cue, "measure"):
        yield f"{name} has no method 'log_likelihood', which every cue needs without measures=True"
    for flag, method in METHODS.items():
        is_declared = bool(getattr(declaration, flag))
        if is_declared and not _has(cue, method):
            yield f"{name} declares {flag}=True and has no method {method!r}: write it, or remove the flag"
        elif not is_declared and _has(cue, method):
            yield (
                f"{name} has the method {method!r} and does not declare {flag}=True: "
                "add the flag to its CueDeclaration, or rename the method"
            )


def _has(cue: AnyCue, name: str) -> bool:
    """True if the cue has the attribute; a property is not asked for its value."""
    return getattr_static(cue, name, None) is not None


def over_frames(rate: float, frames: int) -> float:
    """The rate that makes in one frame what `rate` makes in several: 1 - (1 - rate)^frames.

    >>> over_frames(0.5, 1), over_frames(0.5, 2)
    (0.5, 0.75)
    """
    return rate if frames == 1 else 1.0 - (1.0 - rate) ** frames
