"""What cues and detectors, which anybody writes, may raise and return without ending a run."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.cue import Measurement

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
    place, at = "", error.__traceback__
    while at is not None:
        if str(at.tb_frame.f_globals.get("__name__")).startswith(CUE_FILE_MODULE):
            place = f" ({PurePath(at.tb_frame.f_code.co_filename).name}:{at.tb_lineno})"
        at = at.tb_next
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
    """Which part of a measurement is not of real numbers; empty when all are."""
    for name in ("mean", "covariance", "floor", "confidence"):
        value = getattr(measured, name)
        if name == "confidence" and value is None:
            continue
        if type(value) is float or (type(value) is np.ndarray and value.dtype.kind in "iuf"):
            continue
        found = real_numbers(value)
        if isinstance(found, str):
            return f"Measurement whose {name} is of type {found}"
    return ""
