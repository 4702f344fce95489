"""Expressions of a graph at hypotheses: factors, latent states given their parents, measurements.

p(c | h) = p(x | h) p(y | h, x) p(w | h, x, y) p(height | h, x, y, w): each field of the node's own box c is
drawn from a distribution, or has a value, by the parent's box h and the fields of c before it.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.motion.formulas import Undefined
from bayesnet_track.belief.motion.modes import FIELD
from bayesnet_track.graph.checked import PAST, Conditional, MeasuredAs
from bayesnet_track.graph.expressions.distributions import (
    LinearNormal,
    Names,
    distribution_of,
    draw,
    linear_normals_of,
    median,
    moments,
    parameters_of,
    period_of,
)
from bayesnet_track.graph.expressions.evaluate import log_values, values_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import DRAWN, MASK, PARENT, Term, Variable
from bayesnet_track.graph.settings.lifecycle import Join
from bayesnet_track.inference.joint import Factor
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.image_files import Mask
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.observation.protocols import Errors, Seen

Value = Floats | float

ZERO_BELOW = -1e100
"""A log density below this is a density of zero, so that sums of them stay finite."""


@dataclass(frozen=True)
class Weigh:
    """A factor weighs the hypotheses of the node `at` (the root or the nearest latent node above it).

    Attributes:
        factor: the factor node.
        at: the node.
        given_from: whose hypotheses those of a latent node are drawn around; the node itself for the root.
        term: the expression, a density up to a constant.
        constants: the numbers that it uses by name.
        is_prior: it multiplies the root's prior: all nodes from it up to the root are products.
        mask: the image that the expression asks, or None.
        may_be_exact: it stands right below a root whose Gaussian belief, without modes, takes densities of
            linear forms as they are.
    """

    factor: str
    at: str
    given_from: str
    term: Term
    constants: Mapping[str, float]
    is_prior: bool
    mask: Mask | None = None
    may_be_exact: bool = False


@dataclass(frozen=True)
class Flaw:
    """Faults of a factor's values in one frame.

    Attributes:
        undefined: hypotheses of which it has no value; they count as impossible.
        hypotheses: how many there were.
        ignored: no hypothesis was possible, so it was left out of the frame.
    """

    undefined: int
    hypotheses: int
    ignored: bool


@dataclass(frozen=True, eq=False)
class Factors:
    """Findings about a target's factors in one frame.

    Attributes:
        flaws: factor -> what was wrong when it was first evaluated.
        used: factors that were evaluated and not left out.
        undefined: field of a latent node by expressions, ``given head.x`` -> at how many hypotheses its
            distribution has no value.
    """

    flaws: MutableMapping[str, Flaw] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)
    undefined: MutableMapping[str, Undefined] = field(default_factory=dict)


def weigh_factor(
    step: Weigh, hypotheses: Hypotheses, parents: Hypotheses, frames: FramePair, factors: Factors
) -> Floats | None:
    """(N,) log density of a factor, finite or -inf; None where it is left out of the frame.

    `hypotheses` are the hypotheses that it weighs, `parents` those around which they were drawn.

    It is left out where it is zero for all hypotheses that the frame begins with. Of those that are drawn
    later all may be impossible, and then they have no weight.
    """
    flaw = factors.flaws.get(step.factor)
    if flaw is not None and flaw.ignored:
        return None
    size = len(hypotheses)
    names = _names(step, hypotheses, parents, frames)
    log = np.array(np.broadcast_to(log_values(step.term, names), (size,)), dtype=np.float64)
    undefined = np.isnan(log)
    log[undefined | ~(log >= ZERO_BELOW)] = -np.inf
    ignored = bool(size) and step.factor not in factors.used and not np.isfinite(log).any()
    if undefined.any() or ignored:
        factors.flaws.setdefault(step.factor, Flaw(int(undefined.sum()), size, ignored))
    if ignored:
        return None
    factors.used.add(step.factor)
    return log


def linear_factors(
    steps: Sequence[Weigh], logs: Mapping[str, Floats], hypotheses: Hypotheses, frame: Mapping[str, float]
) -> dict[str, tuple[LinearNormal, ...]]:
    """Factor -> the normal densities of linear forms of the state whose product it is, where it is one.

    Of those that the belief takes exactly, and that have a value in the frame, among `logs`.
    """
    densities = {}
    for step in steps:
        if step.may_be_exact and step.factor in logs:
            normals = linear_normals_of(step.term, {**frame, **step.constants})
            state = {*BOX_FIELDS, *hypotheses.fields}
            if normals is not None and all(state.issuperset(normal.form.factors) for normal in normals):
                densities[step.factor] = normals
    return densities


def _names(
    step: Weigh, hypotheses: Hypotheses, parents: Hypotheses, frames: FramePair
) -> dict[str, Value | Mask]:
    """Values of the names of an expression."""
    return {
        **frames.names,
        **{name: hypotheses.boxes[:, k] for k, name in enumerate(BOX_FIELDS)},
        "mode": 0.0,  # where a place is asked about, and no hypothesis: the first mode
        **_of_parents(parents),
        **hypotheses.fields,
        **step.constants,
        **({} if step.mask is None else {MASK: step.mask}),
    }


@dataclass(eq=False)
class PairFlaw:
    """Faults of the factor of a pair in one frame; filled in when it is evaluated.

    Attributes:
        undefined: pairs of hypotheses of which it has no value; they count as impossible.
        pairs: how many there were.
        ignored: for the hypotheses of one of the targets no pair was possible: it was left out there.
    """

    undefined: int = 0
    pairs: int = 0
    ignored: bool = False

    def __bool__(self) -> bool:
        """True if anything was wrong."""
        return self.undefined > 0 or self.ignored


def pair_factor(
    rule: Join, constants: Mapping[str, float], frame: Mapping[str, float], flaw: PairFlaw | None = None
) -> Factor | None:
    """The factor of a join in a frame; None of one without. Pairs of which it has no value are impossible.

    `frame` has the values of names that are the same of all states in it. What is wrong with the factor's
    values is written into `flaw`.
    """
    if rule.factor is None:
        return None
    term = _term(rule.factor)
    fixed = {**frame, **constants}

    def log_density(first: Mapping[str, Floats], second: Mapping[str, Floats]) -> Floats:
        names = {f"a.{name}": values for name, values in first.items()}
        names |= {f"b.{name}": values for name, values in second.items()}
        log = np.asarray(log_values(term, {**names, **fixed}), dtype=np.float64)
        shape = np.broadcast_shapes(*(values.shape for values in names.values()))
        undefined = np.broadcast_to(np.isnan(log), shape)
        defined = np.broadcast_to(np.where(undefined, -np.inf, log), shape)
        if flaw is not None:
            flaw.undefined += int(undefined.sum())
            flaw.pairs += int(undefined.size)
            flaw.ignored |= not (defined > -np.inf).any()
        return defined

    return log_density


@lru_cache(maxsize=64)
def _term(text: str) -> Term:
    return parse(text)


STEP = 1e-3
"""Of numerical derivatives, px."""

LEAST_SIDE = 1.0
"""Sides of boxes are at least so long, px."""


def draw_given(
    conditional: Conditional,
    parents: Hypotheses,
    rng: np.random.Generator | None,
    undefined: MutableMapping[str, Undefined] | None = None,
) -> Floats:
    """(N, 4) own boxes, one drawn for each of the N parents; without `rng` with the median of each field.

    Where an expression has no value, or its distribution has none, the field is the parent's; `undefined`
    then says so by field.
    """
    boxes = parents.boxes.copy()
    for column, name, term in _fields(conditional):
        parameters = parameters_of(term, _latent_names(conditional, parents, boxes), len(parents))
        distribution = distribution_of(term)
        values = median(distribution, parameters) if rng is None else draw(distribution, parameters, rng)
        is_defined = np.isfinite(values)
        boxes[:, column] = np.where(is_defined, values, parents.boxes[:, column])
        if undefined is not None and not is_defined.all():
            undefined.setdefault(name, Undefined(int((~is_defined).sum()), len(is_defined)))
        if column >= 2:
            np.maximum(boxes[:, column], LEAST_SIDE, out=boxes[:, column])
    return boxes


def linearise_given(
    conditional: Conditional, parent: Floats, names: Sequence[str] = ()
) -> tuple[Floats, Floats, Floats]:
    """Own box (4,) at the parent's mean (4 + F,), its Jacobian (4, 4 + F) by that mean, covariance (4, 4).

    The mean is of the parent's box and of F fields with `names`. c = own + A (h - parent) + noise, by
    numerical derivatives: exact where means are linear and sds constant. What is drawn is normal. A field
    without a value is the parent's, as in `draw_given`.
    """
    box, by_parent, noise = parent[:4].copy(), np.eye(4, len(parent)), np.zeros((4, 4))
    steps = STEP * np.eye(len(parent) + 4)
    moves = np.concatenate([np.zeros((1, len(steps))), steps, -steps])
    shifted = parent + moves[:, : len(parent)]
    parents = Hypotheses(shifted[:, :4], dict(zip(names, shifted[:, 4:].T, strict=True)))
    for column, _, term in _fields(conditional):
        mine = box + moves[:, len(parent) :]
        parameters = parameters_of(term, _latent_names(conditional, parents, mine), len(moves))
        sd = float(parameters[1, 0]) if distribution_of(term) else 0.0
        slopes = (parameters[0, 1 : len(steps) + 1] - parameters[0, len(steps) + 1 :]) / (2.0 * STEP)
        if not (
            np.isfinite(parameters[0]).all() and np.isfinite(sd) and (sd > 0 or not distribution_of(term))
        ):
            continue
        box[column] = max(parameters[0, 0], LEAST_SIDE) if column >= 2 else parameters[0, 0]
        by_earlier = slopes[len(parent) : len(parent) + column]
        by_parent[column] = slopes[: len(parent)] + by_earlier @ by_parent[:column]
        noise[column] = by_earlier @ noise[:column]
        noise[column, column] += sd
    return box, by_parent, noise @ noise.T


def log_given(conditional: Conditional, parents: Hypotheses, boxes: Floats) -> Floats:
    """(N, M) log p(c_j | h_i) of own boxes (M, 4), for N parents, over the fields that are drawn.

    -inf where a field that has a value, or is the parent's, differs from it.
    """
    log = np.zeros((len(parents), len(boxes)))
    written = {column: term for column, _, term in _fields(conditional)}
    columns = {name: boxes[None, :, k] for k, name in enumerate(BOX_FIELDS)}
    rows = {name: values[:, None] for name, values in _of_parents(parents).items()}
    names = {**rows, **columns, **conditional.constants}
    for column in range(len(BOX_FIELDS)):
        term = written.get(column)
        if term is None:
            values = parents.boxes[:, column, None]
        elif distribution_of(term):
            log = log + log_values(term, {**names, DRAWN: boxes[None, :, column]})
            continue
        else:
            values = np.broadcast_to(values_of(term, names), log.shape)
            values = np.where(np.isfinite(values), values, parents.boxes[:, column, None])
            values = np.maximum(values, LEAST_SIDE) if column >= 2 else values
        if np.ptp(values) > 0:
            log = np.where(
                np.abs(values - boxes[None, :, column]) > 1e-9 * (1.0 + np.abs(values)), -np.inf, log
            )
    return np.where(np.isnan(log), -np.inf, log)


def _fields(conditional: Conditional) -> list[tuple[int, str, Term]]:
    return [
        (k, name, conditional.fields[name]) for k, name in enumerate(BOX_FIELDS) if name in conditional.fields
    ]


def _latent_names(conditional: Conditional, parents: Hypotheses, boxes: Floats) -> Names:
    mine = {name: boxes[:, k] for k, name in enumerate(BOX_FIELDS)}
    return {**_of_parents(parents), **mine, **conditional.constants}


def _of_parents(parents: Hypotheses) -> dict[str, Floats]:
    fields = {**dict(zip(BOX_FIELDS, parents.boxes.T, strict=True)), **parents.fields}
    return {PARENT + name: values for name, values in fields.items()}


def read_as(measured: Measurement, functions: MeasuredAs, frames: FramePair) -> Measurement:
    """The measurement with h: what its quantities would be of states in these frames."""
    quantities = seen_by(measured.fields, functions, frames)
    choices = tuple((weight, replace(choice, seen=quantities)) for weight, choice in measured.choices)
    errors = None if not functions.errors else errors_by(measured.fields, functions, frames)
    return replace(measured, seen=quantities, choices=choices, errors=errors)


def errors_by(quantities: Sequence[str], functions: MeasuredAs, frames: FramePair) -> Errors:
    """The distributions of errors in these frames, by states."""
    fixed = _fixed(functions, frames)
    terms = [functions.errors[name] for name in quantities]

    def densities(states: Mapping[str, Floats], errors: Floats) -> Floats:
        names = {**in_modes(at_delay(states, functions), functions), **fixed}
        columns = [log_values(term, {**names, DRAWN: errors[:, k]}) for k, term in enumerate(terms)]
        return np.stack([np.broadcast_to(column, (len(errors),)) for column in columns], axis=1)

    return Errors(densities, all(distribution_of(term) == "normal" for term in terms))


def at_prediction(
    measured: Measurement, functions: MeasuredAs, states: Mapping[str, float], frames: FramePair
) -> tuple[Floats, float]:
    """Covariance (K, K) of the errors at a state, and the log density of an error of 0 there.

    Where a distribution has no variance its squared scale stands for it; where there is none, 1.
    """
    fields: dict[str, Floats] = {name: np.array([value]) for name, value in states.items()}
    names: dict[str, Floats | float] = {**fields, **_fixed(functions, frames)}
    variances = []
    for name in measured.fields:
        term = functions.errors[name]
        function, parameters = distribution_of(term), parameters_of(term, names, 1)
        variance = float(moments(function, parameters)[1][0])
        spread = variance if np.isfinite(variance) else float(parameters[1, 0]) ** 2
        variances.append(spread if np.isfinite(spread) and spread > 0 else 1.0)
    assert measured.errors is not None
    log = float(measured.errors.log_density(fields, np.zeros((1, len(variances)))).sum())
    return np.diag(variances), log if np.isfinite(log) else 0.0


def _fixed(functions: MeasuredAs, frames: FramePair) -> dict[str, float]:
    return {**frames.names, **functions.constants}


def at_delay(states: Mapping[str, Floats], functions: MeasuredAs) -> Mapping[str, Floats]:
    """The states as they were when the agent measured: between two frame intervals they change evenly."""
    if not functions.delay:
        return states
    intervals, share = int(functions.delay), functions.delay % 1.0

    def at_lag(name: str, lag: int) -> Floats:
        return states[f"{name}{PAST}{lag}"] if lag else states[name]

    late = {name: at_lag(name, intervals) for name in functions.late}
    if share:
        late = {
            name: (1.0 - share) * value + share * at_lag(name, intervals + 1) for name, value in late.items()
        }
    return {**states, **late}


def in_modes(states: Mapping[str, Floats], functions: MeasuredAs) -> Mapping[str, Floats]:
    """The states with what their combination of mode and values is, where they have the combination alone."""
    if FIELD not in states or all(name in states for name in functions.discrete):
        return states
    combination = states[FIELD].astype(np.intp)
    numbers = {name: np.array(values, dtype=np.float64) for name, values in functions.discrete.items()}
    return {**states, **{name: values[combination] for name, values in numbers.items()}}


def seen_by(quantities: Sequence[str], functions: MeasuredAs, frames: FramePair) -> Seen:
    """h: what quantities would be of states in these frames."""
    fixed = _fixed(functions, frames)
    terms = [functions.terms.get(name, Variable(name)) for name in quantities]

    def values(states: Mapping[str, Floats]) -> Floats:
        names = {**in_modes(at_delay(states, functions), functions), **fixed}
        size = len(next(iter(states.values())))
        return np.stack([np.broadcast_to(values_of(term, names), (size,)) for term in terms], axis=1)

    return Seen(values, np.array([period_of(term, functions.constants) for term in terms]))
