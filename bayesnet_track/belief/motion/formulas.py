"""Motion and measurement by functions: Python's own, or expressions of the graph, x' = f(x, dt) + noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS, LEAST_SIDE_PX, Ancestors
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.motion.start_prior import StartPrior
from bayesnet_track.graph.expressions.evaluate import values_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import Number, Term, Variable, names_in
from bayesnet_track.graph.settings.motion import ByExpressions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import (
    Updated,
    innovation_likelihood,
    linear_update,
    root,
    sigma_points,
    symmetric,
)
from bayesnet_track.numerics.lenses import derivatives
from bayesnet_track.observation.protocols import Seen

Drift = Callable[[Floats, float], Floats]
"""(N, D) states and dt in frame intervals -> (N, D) states after it, without noise."""


@dataclass(frozen=True, eq=False)
class FunctionMotion:
    """A motion model (`belief.contract.MotionModel`) by a function: x' = f(x, dt) + N(0, Q dt).

    A target that turns at an unknown rate::

        def turn(states, dt):
            x, y, w, h, speed, heading, rate = states.T
            middle = heading + rate * dt / 2
            return np.stack([x + speed * dt * np.cos(middle), y + speed * dt * np.sin(middle),
                             w, h, speed, heading + rate * dt, rate], axis=1)

        motion = FunctionMotion(("x", "y", "w", "h", "speed", "heading", "rate"), turn,
                                np.diag([1, 1, 0, 0, 0.2, 0, 0.01]) ** 2, start_sd=(3, 1, 0.1))

    Attributes:
        fields: names of the columns of a state, x, y, w, h first.
        function: f, for many states at once.
        noise: (D, D) Q, the covariance of the noise of one frame interval; or dt -> the covariance over dt.
        jacobian: (D,) state, dt -> (D, D) derivative of f; by central differences when None.
        start_mean: (D - 4,) of the further fields when the target starts; zeros when empty.
        start_sd: (D - 4,) their sds; zeros when empty.
    """

    fields: tuple[str, ...]
    function: Drift
    noise: Floats | Callable[[float], Floats]
    jacobian: Callable[[Floats, float], Floats] | None = None
    start_mean: tuple[float, ...] = ()
    start_sd: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.fields) - 4
        if self.fields[:4] != BOX_FIELDS or len(set(self.fields)) != len(self.fields):
            raise ValueError(f"fields are x, y, w, h and names of their own, not {', '.join(self.fields)}")
        for name in ("start_mean", "start_sd"):
            values = getattr(self, name)
            if len(values) not in (0, count):
                raise ValueError(f"{name} has {len(values)} values for {count} further fields")
        self.covariance(1.0)

    def covariance(self, dt: float) -> Floats:
        """(D, D) of the noise over `dt`.

        Raises:
            ValueError: dt is not positive, or the noise is not a covariance of these fields.
        """
        if not (dt > 0 and np.isfinite(dt)):
            raise ValueError(f"time between frames must be positive and finite, not {dt}")
        size = len(self.fields)
        noise = self.noise(dt) if callable(self.noise) else dt * np.asarray(self.noise, dtype=np.float64)
        covariance = np.asarray(noise, dtype=np.float64)
        if covariance.shape != (size, size) or not np.isfinite(covariance).all():
            raise ValueError(f"noise: a finite ({size}, {size}) covariance, not of shape {covariance.shape}")
        scale = max(float(np.abs(covariance).max()), 1e-300)
        if (
            not np.allclose(covariance, covariance.T, atol=1e-9 * scale)
            or np.linalg.eigvalsh(covariance)[0] < -1e-9 * scale
        ):
            raise ValueError("noise is not symmetric and positive")
        return symmetric(covariance)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(D,) mean and (D, D) covariance of a target first seen in the centre box (4,)."""
        count = len(self.fields) - 4
        mean = np.concatenate([box, self.start_mean or np.zeros(count)]).astype(np.float64)
        sds = np.concatenate([np.zeros(4), self.start_sd or np.zeros(count)])
        return mean, np.diag(sds**2)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states in the centre box (4,), further fields drawn around `start_mean`."""
        mean, covariance = self.start_moments(box)
        return np.asarray(mean + rng.standard_normal((size, len(mean))) * np.sqrt(np.diagonal(covariance)))

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) f of the states.

        Raises:
            ValueError: the function gives another shape, or numbers that are not finite.
        """
        drifted = np.array(self.function(states.copy(), dt), dtype=np.float64)
        if drifted.shape != states.shape:
            raise ValueError(f"the motion's function gave shape {drifted.shape} for states {states.shape}")
        if not np.isfinite(drifted).all():
            raise ValueError("the motion's function gave a state that is not finite")
        return drifted

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) f of the states with noise added; widths and heights stay at least 1 px."""
        if parents is not None:
            states = states.take(parents, axis=0)
        lower = root(self.covariance(dt))
        propagated = self.drift(states, dt) + rng.standard_normal((len(states), lower.shape[1])) @ lower.T
        np.maximum(propagated[:, 2:4], 1.0, out=propagated[:, 2:4])
        return np.asarray(propagated)

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q, each (D, D): the derivative of f at a state (D,), and the covariance of the noise."""
        if self.jacobian is not None:
            return np.asarray(self.jacobian(state, dt), dtype=np.float64), self.covariance(dt)
        return derivative(lambda states: self.drift(states, dt), state), self.covariance(dt)

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) log p(states_m | previous_n) over the directions that have noise."""
        return self.transition(previous, dt).log_density(states)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """p(states | previous) along the eigenvectors of the noise: a rotation, whose Jacobian is 1."""
        lower = root(self.covariance(dt))
        values, vectors = np.linalg.eigh(lower @ lower.T)
        keep = values > 1e-14 * max(float(values[-1]), 1e-300)
        axes, sds = vectors[:, keep], np.sqrt(values[keep])
        means = self.drift(previous, dt) @ axes
        return Transition(
            lambda states: (states @ axes, np.zeros(len(states))),
            means,
            np.broadcast_to(sds, (1, *means.shape)).copy(),
            np.zeros(1),
            lambda points, still: still + (points - still @ axes) @ axes.T,
        )


def derivative(function: Callable[[Floats], Floats], state: Floats) -> Floats:
    """(K, D) derivative at a state (D,) of a function (N, D) -> (N, K), by central differences.

    Steps of eps^(1/3) max(1, |x|), which balance rounding and curvature: about 1e-10 of the scale.
    """
    return np.asarray(derivatives(function, state[None])[0])


def linearise_seen(means: Floats, fields: tuple[str, ...], quantities: Seen) -> tuple[Floats, Floats]:
    """Values h(x) (T, K) of states (T, D), and derivatives (T, K, D); by central differences if need be."""
    if quantities.linearise is not None:
        return quantities.linearise(means)

    def values_at(states: Floats) -> Floats:
        return quantities.function(dict(zip(fields, states.T, strict=True)))

    with np.errstate(all="ignore"):
        centres = values_at(means)
        repeated = np.tile(centres, (2 * means.shape[1], 1))
        return centres, derivatives(
            lambda states: repeated + quantities.less(values_at(states), repeated), means
        )


def extended_update(
    mean: Floats,
    covariance: Floats,
    measured: Floats,
    noise: Floats,
    function: Callable[[Floats], Floats],
    jacobian: Callable[[Floats], Floats] | None = None,
) -> Updated:
    """The update of the extended Kalman filter by z = h(x) + N(0, R) (tracking chapter 3.8).

    Args:
        mean: (D,) before.
        covariance: (D, D) before.
        measured: (K,) z.
        noise: (K, K) R.
        function: h, (N, D) states -> (N, K).
        jacobian: (D,) state -> (K, D) derivative of h; by central differences when None.
    """
    observe = derivative(function, mean) if jacobian is None else jacobian(mean)
    return linear_update(mean, covariance, measured - function(mean[None])[0], observe, noise)


def unscented_update(
    mean: Floats,
    covariance: Floats,
    measured: Floats,
    noise: Floats,
    function: Callable[[Floats], Floats],
    kappa: float = 1.0,
) -> Updated:
    """The same by the unscented transform: h is asked at 2 K + 1 points, K the covariance's rank.

    The points lie at +-sqrt(K + kappa) sds; kappa >= 0 keeps every weight positive, and so the covariance.
    """
    lower = root(covariance)
    width = lower.shape[1]
    if width == 0:
        innovation = measured - function(mean[None])[0]
        d2, log_likelihood = innovation_likelihood(innovation, noise, noise)
        return Updated(mean, covariance, d2, log_likelihood)
    unit = sigma_points(width, width + kappa)
    weights = np.full(len(unit), 0.5 / (width + kappa))
    weights[0] = kappa / (width + kappa)
    values = function(mean + unit @ lower.T)
    expected = weights @ values
    deviations = values - expected
    # h = expected + B u + residual, u the state in units of its sds: B by regression on the points.
    slope = (deviations * weights[:, None]).T @ unit
    residuals = deviations - unit @ slope.T
    # The residuals are noise to the linear update, so that it keeps Joseph's form.
    total_noise = symmetric(noise + (residuals * weights[:, None]).T @ residuals)
    unit_update = linear_update(np.zeros(width), np.eye(width), measured - expected, slope, total_noise)
    d2, log_likelihood = innovation_likelihood(
        measured - expected, symmetric(slope @ slope.T + total_noise), noise
    )
    return Updated(
        mean + lower @ unit_update.mean,
        symmetric(lower @ unit_update.covariance @ lower.T),
        d2,
        log_likelihood,
    )


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
        inputs: names of what is known of the frame that a step leads to, `t` and the graph's inputs.
        static_discount: of kernels that keep hypotheses about unknown constants; None without kernels.
        leaves_image: whether targets go on beyond the frame.
        prior: distributions of fields at the start in place of these; None without any.
        least_side: of widths and heights, in the unit of the state.
        undefined: ``drift x`` or ``sd x`` -> what was found; of this object alone, which is made for a frame.
    """

    fields: tuple[str, ...]
    drifts: Mapping[str, Term]
    sds: Mapping[str, Term]
    constants: Mapping[str, float]
    start_mean: tuple[float, ...] = ()
    start_sd: tuple[float, ...] = ()
    frame: tuple[int, int] | None = None
    inputs: Mapping[str, float] = field(default_factory=dict)
    static_discount: float | None = None
    leaves_image: bool = False
    prior: StartPrior | None = None
    least_side: float = LEAST_SIDE_PX
    undefined: dict[str, Undefined] = field(default_factory=dict, init=False)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(D,) mean and (D, D) covariance of a target first seen in the centre box (4,)."""
        mean = np.concatenate([box, self.start_mean]).astype(np.float64)
        spread = np.diag(np.concatenate([np.zeros(4), self.start_sd]) ** 2)
        return (mean, spread) if self.prior is None else self.prior.moments_of(self.fields, mean, spread, box)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states in the centre box (4,), the further fields drawn around `start_mean`."""
        mean, sds = np.concatenate([box, self.start_mean]), np.concatenate([np.zeros(4), self.start_sd])
        states = np.asarray(mean + rng.standard_normal((size, len(mean))) * sds)
        return states if self.prior is None else self.prior.applied_to(self.fields, states, box, rng)

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) f of the states.

        Raises:
            ValueError: dt is not positive and finite.
        """
        if not (dt > 0 and np.isfinite(dt)):
            raise ValueError(f"time between frames must be positive and finite, not {dt}")
        drifted, names = states.copy(), self._names(states, dt)
        for name, term in self.drifts.items():
            column = self.fields.index(name)
            values = np.broadcast_to(values_of(term, names), (len(states),))
            is_defined = np.isfinite(values)
            self._note(f"drift {name}", is_defined)
            drifted[:, column] = np.where(is_defined, values, states[:, column])
        return drifted

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) f of the states with noise added; widths and heights stay at least 1 px."""
        if parents is not None:
            states = states.take(parents, axis=0)
        propagated, sds = self.drift(states, dt), self.noise(states, dt)
        columns = self._noisy
        propagated[:, columns] += sds[:, columns] * rng.standard_normal((len(states), len(columns)))
        np.maximum(propagated[:, 2:4], self.least_side, out=propagated[:, 2:4])
        return propagated

    def noise(self, states: Floats, dt: float) -> Floats:
        """(N, D) sds over `dt` of the noise that is added to states (N, D)."""
        sds, names = np.zeros(states.shape), self._names(states, dt)
        for name, term in self.sds.items():
            values = np.broadcast_to(values_of(term, names), (len(states),))
            is_defined = np.isfinite(values) & (values >= 0)
            self._note(f"sd {name}", is_defined)
            sds[:, self.fields.index(name)] = np.where(is_defined, values, 0.0) * np.sqrt(dt)
        return sds

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q, each (D, D): the derivative of f at a state (D,), and the covariance of its noise."""
        transition = derivative(lambda states: self.drift(states, dt), state)
        return transition, np.diag(self.noise(state[None], dt)[0] ** 2)

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) log p(states_m | previous_n) over the fields that have noise."""
        return self.transition(previous, dt).log_density(states)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """p(states | previous): a diagonal Gaussian in the fields that have noise."""
        keep = self._noisy

        def states_at(points: Floats, still: Floats) -> Floats:
            states = still.copy()
            states[:, keep] = points
            np.maximum(states[:, 2:4], self.least_side, out=states[:, 2:4])
            return states

        return Transition(
            lambda states: (states[:, keep], np.zeros(len(states))),
            self.drift(previous, dt)[:, keep],
            np.maximum(self.noise(previous, dt)[:, keep], LEAST_SD)[None],
            np.zeros(1),
            states_at,
        )

    def static(self, prior: StartPrior | None = None) -> tuple[str, ...]:
        """Unknown constants: fields that are uncertain at the start, and neither drift nor have noise.

        `prior` is that of a motion in modes around this one.
        """
        prior = self.prior if prior is None else prior
        still = {name for name in self.fields[4:] if self.drifts.get(name, Variable(name)) == Variable(name)}
        by_prior = () if prior is None else tuple(filter(prior.is_uncertain, self.fields[4:]))
        sds = zip(self.fields[4:], self.start_sd, strict=True)
        uncertain = (name for name, sd in sds if sd > 0 or name in by_prior)
        return tuple(name for name in uncertain if name in still and self.sds.get(name, ZERO) == ZERO)

    @cached_property
    def asked(self) -> tuple[str, ...]:
        """Names in the expressions that are neither fields nor constants."""
        mentioned = (name for term in (*self.drifts.values(), *self.sds.values()) for name in names_in(term))
        return tuple(name for name in dict.fromkeys(mentioned) if name not in self.fields)

    @property
    def _noisy(self) -> list[int]:
        return [column for column, name in enumerate(self.fields) if name in self.sds]

    def _names(self, states: Floats, dt: float) -> dict[str, Floats | float]:
        width, height = self.frame if self.frame is not None else (np.nan, np.nan)
        return {
            **dict.fromkeys(self.asked, np.nan),
            **self.inputs,
            **{name: states[:, column] for column, name in enumerate(self.fields)},
            "frame_width": float(width),
            "frame_height": float(height),
            "dt": dt,
            **self.constants,
        }

    def _note(self, expression: str, is_defined: NDArray[np.bool_]) -> None:
        if not is_defined.all():
            self.undefined.setdefault(expression, Undefined(int((~is_defined).sum()), len(is_defined)))


ZERO = Number(0.0)
LEAST_SD = 1e-6
"""Of a density, where an expression says 0: narrow, but with a logarithm."""


def make_formula_motion(settings: ByExpressions, constants: Mapping[str, float]) -> FormulaMotion:
    """The motion that a graph writes as expressions, which were checked."""
    drifts = {name: parse(str(text)) for name, text in settings.drift.items()}
    sds = {name: parse(str(text)) for name, text in settings.sd.items()}
    mentioned = {name for term in (*drifts.values(), *sds.values()) for name in names_in(term)}
    own_fields = settings.own
    return FormulaMotion(
        (*BOX_FIELDS, *own_fields),
        drifts,
        sds,
        {name: value for name, value in constants.items() if name in mentioned},
        tuple(own_field.start for own_field in own_fields.values()),
        tuple(own_field.sd for own_field in own_fields.values()),
        static_discount=settings.static_discount,
    )


def undefined_in(motion: object) -> Mapping[str, Undefined]:
    """Flaws found in the expressions of a motion, or of those inside it; empty for another."""
    if motion is None or isinstance(motion, FormulaMotion):
        return {} if motion is None else motion.undefined
    inner_motions = getattr(motion, "parts", None) or (getattr(motion, "motion", None),)
    return {
        expression: states for inner in inner_motions for expression, states in undefined_in(inner).items()
    }
