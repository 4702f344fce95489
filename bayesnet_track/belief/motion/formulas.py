"""Motion by expressions of the graph: x' = f(x, dt) + noise, for every field of the state its own formula."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS, Ancestors
from bayesnet_track.belief.motion.functions import derivative
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.graph.expressions.evaluate import values_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import Term, names_in
from bayesnet_track.graph.settings.motion import ByExpressions
from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True)
class Undefined:
    """States at which an expression of a motion has no value, when it was first asked in a frame.

    Attributes:
        states: how many.
        asked: of how many.
    """

    states: int
    asked: int


@dataclass(frozen=True, eq=False)
class FormulaMotion:
    """A motion model (`belief.contract.MotionModel`): field by field f(x, dt) + N(0, sd(x)^2 dt).

    A field without a formula stays as it is, one without an sd has no noise. Noise is that of the state
    before the step. Where a formula has no value the field stays, and where an sd has none, or is negative,
    there is no noise; `undefined` says so.

    Attributes:
        fields: names of the columns of a state, x, y, w, h first.
        drifts: field -> its f.
        sds: field -> its sd for one frame interval.
        constants: numbers that they use by name.
        start_mean: (D - 4,) of the further fields when the target starts.
        start_sd: (D - 4,) their sds.
        frame: columns and rows of the frame; None before one is known.
        undefined: ``drift x`` or ``sd x`` -> what was found; of this object alone, which is made for a frame.
    """

    fields: tuple[str, ...]
    drifts: Mapping[str, Term]
    sds: Mapping[str, Term]
    constants: Mapping[str, float]
    start_mean: tuple[float, ...] = ()
    start_sd: tuple[float, ...] = ()
    frame: tuple[int, int] | None = None
    undefined: dict[str, Undefined] = field(default_factory=dict, init=False)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(D,) mean and (D, D) covariance of a target first seen in the centre box (4,)."""
        mean = np.concatenate([box, self.start_mean]).astype(np.float64)
        return mean, np.diag(np.concatenate([np.zeros(4), self.start_sd]) ** 2)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states in the centre box (4,), the further fields drawn around `start_mean`."""
        mean, covariance = self.start_moments(box)
        return np.asarray(mean + rng.standard_normal((size, len(mean))) * np.sqrt(np.diagonal(covariance)))

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) f of the states.

        Raises:
            ValueError: dt is not positive and finite.
        """
        if not (dt > 0 and np.isfinite(dt)):
            raise ValueError(f"time between frames must be positive and finite, not {dt}")
        moved, names = states.copy(), self._names(states, dt)
        for name, term in self.drifts.items():
            column = self.fields.index(name)
            values = np.broadcast_to(values_of(term, names), (len(states),))
            known = np.isfinite(values)
            self._note(f"drift {name}", known)
            moved[:, column] = np.where(known, values, states[:, column])
        return moved

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) f of the states with noise added; widths and heights stay at least 1 px."""
        if parents is not None:
            states = states.take(parents, axis=0)
        new, sds = self.drift(states, dt), self.noise(states, dt)
        columns = self._noisy
        new[:, columns] += sds[:, columns] * rng.standard_normal((len(states), len(columns)))
        np.maximum(new[:, 2:4], 1.0, out=new[:, 2:4])
        return new

    def noise(self, states: Floats, dt: float) -> Floats:
        """(N, D) sds over `dt` of the noise that is added to states (N, D)."""
        found, names = np.zeros(states.shape), self._names(states, dt)
        for name, term in self.sds.items():
            values = np.broadcast_to(values_of(term, names), (len(states),))
            known = np.isfinite(values) & (values >= 0)
            self._note(f"sd {name}", known)
            found[:, self.fields.index(name)] = np.where(known, values, 0.0) * np.sqrt(dt)
        return found

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q, each (D, D): the derivative of f at a state (D,), and the covariance of its noise."""
        transition = derivative(lambda states: self.drift(states, dt), state)
        return transition, np.diag(self.noise(state[None], dt)[0] ** 2)

    def log_density(self, new: Floats, old: Floats, dt: float) -> Floats:
        """(M, N) log p(new_m | old_n) over the fields that have noise."""
        return self.transition(old, dt).log_density(new)

    def transition(self, old: Floats, dt: float) -> Transition:
        """p(new | old): a diagonal Gaussian in the fields that have noise."""
        keep = self._noisy

        def states_at(points: Floats, still: Floats) -> Floats:
            states = still.copy()
            states[:, keep] = points
            np.maximum(states[:, 2:4], 1.0, out=states[:, 2:4])
            return states

        return Transition(
            lambda states: (states[:, keep], np.zeros(len(states))),
            self.drift(old, dt)[:, keep],
            np.maximum(self.noise(old, dt)[:, keep], LEAST_SD)[None],
            np.zeros(1),
            states_at,
        )

    @property
    def _noisy(self) -> list[int]:
        return [column for column, name in enumerate(self.fields) if name in self.sds]

    def _names(self, states: Floats, dt: float) -> dict[str, Floats | float]:
        width, height = self.frame if self.frame is not None else (np.nan, np.nan)
        return {
            **{name: states[:, column] for column, name in enumerate(self.fields)},
            "frame_width": float(width),
            "frame_height": float(height),
            "dt": dt,
            **self.constants,
        }

    def _note(self, what: str, known: NDArray[np.bool_]) -> None:
        if not known.all():
            self.undefined.setdefault(what, Undefined(int((~known).sum()), len(known)))


LEAST_SD = 1e-6
"""Of a density, where an expression says 0: narrow, but with a logarithm."""


def make_formula_motion(settings: ByExpressions, constants: Mapping[str, float]) -> FormulaMotion:
    """The motion that a graph writes as expressions, which were checked."""
    drifts = {name: parse(str(text)) for name, text in settings.drift.items()}
    sds = {name: parse(str(text)) for name, text in settings.sd.items()}
    used = {name for term in (*drifts.values(), *sds.values()) for name in names_in(term)}
    further = settings.fields
    return FormulaMotion(
        (*BOX_FIELDS, *further),
        drifts,
        sds,
        {name: value for name, value in constants.items() if name in used},
        tuple(one.start for one in further.values()),
        tuple(one.sd for one in further.values()),
    )


def undefined_in(motion: object) -> Mapping[str, Undefined]:
    """What was found of the expressions of a motion, or of the one inside it; empty for another."""
    while motion is not None and not isinstance(motion, FormulaMotion):
        motion = getattr(motion, "motion", None)
    return {} if motion is None else motion.undefined
