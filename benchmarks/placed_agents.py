"""Cues for `executors.py`, in a module of its own, from which worker processes import them."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.cue import CueDeclaration, CueParameters, Hypotheses, Reference, blend_arrays
from bayesnet_track.observation.planes import Planes

Floats = NDArray[np.float64]


class WorkParameters(CueParameters):
    """How much there is to do."""

    turns: int = 0


@numba.njit(nogil=True, cache=True)  # type: ignore[untyped-decorator]
def _turned(turns: int) -> float:
    value = 0.5
    for _ in range(turns):
        value = 3.7 * value * (1.0 - value)
    return value


@dataclass(frozen=True)
class Work:
    """Looks at nothing, and takes as long as it is told to, without the interpreter's lock."""

    parameters: WorkParameters
    needs = ()

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The box."""
        return {"box": np.array(box)}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linear."""
        return blend_arrays(old, new, rate)

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """A Gaussian around the reference, after the work."""
        _turned(self.parameters.turns)
        away = hypotheses.boxes[:, :2] - reference["box"][:2]
        return np.asarray(-0.5 * (away**2).sum(axis=1) / 400.0)


def make(parameters: WorkParameters) -> Work:
    """The cue."""
    return Work(parameters)


WORK = CueDeclaration("work", "takes as long as it is told to", WorkParameters, make)
