"""Density that a net stands for, as text and as LaTeX.

The posterior of the root is its prediction times the messages of its children. A product multiplies them, a
pool raises them to weights over the active children, a latent node integrates over its own state. The states
of latent nodes with a motion are a part of what the belief is about.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.checked import Factor as Expression
from bayesnet_track.graph.expressions.parse import latex_of, parse, term_text
from bayesnet_track.graph.expressions.terms import Variable
from bayesnet_track.graph.settings.lifecycle import Join
from bayesnet_track.graph.settings.motion import Mode
from bayesnet_track.graph.settings.net import pool_exponents
from bayesnet_track.graph.spec import Given, Motion, OffsetBox, SizeBox
from bayesnet_track.graph.text.formula_parts import (
    escape,
    given_lines,
    latent_nodes,
    latex_given_lines,
    latex_motion_lines,
    mode_lines,
    motion_lines,
    moves,
    noise,
    own_state,
    text_state,
)


@dataclass(frozen=True)
class Likelihood:
    """p(e_agent | state)."""

    agent: str
    state: str


@dataclass(frozen=True)
class Weight:
    """A factor node's expression of a state."""

    factor: str
    state: str


@dataclass(frozen=True)
class Product:
    """Factors multiplied, each raised to its exponent."""

    factors: tuple[tuple[Factor, float], ...]


@dataclass(frozen=True)
class Integral:
    """The integral of p(latent | parent) times `inner` over the node's own state."""

    latent: str
    parent: str
    inner: Factor


Factor = Likelihood | Weight | Product | Integral


def factor_text(target: CheckedTarget, active: Iterable[str] | None = None) -> Factor | None:
    """Factor of the root's children, of the agents `active` (all when None); None when none is active."""
    working = set(target.agents if active is None else active)
    return _factor(target, target.root, target.root, working)


def formula_text(target: CheckedTarget, active: Iterable[str] | None = None) -> str:
    """The factorisation as text, one equation a line; agents outside `active` are named as left out."""
    factor = factor_text(target, active)
    root = text_state(target.root)
    moving = [(latent, parent) for latent, parent, _ in latent_nodes(target) if moves(target, latent)]
    joint = ", ".join([root, *(text_state(latent) for latent, _ in moving)])
    previous = ", ".join(f"{state}-1" for state in joint.split(", "))
    predicted = f"p({joint} | e_1:t-1)"
    likelihood = "" if factor is None else f" · {_text(factor, nested=False)}"
    steps = [_text_step(latent, parent) for latent, parent in moving]
    lines = [
        f"p({joint} | e_1:t) ∝ {predicted}{likelihood}",
        f"{predicted} = ∫ p({joint} | {previous}) p({previous} | e_1:t-1) d {previous}",
        *([f"p({joint} | {previous}) = {' · '.join([f'p({root} | {root}-1)', *steps])}"] if steps else ()),
        f"p({root} | {root}-1): {_motion(target.inference(target.root).motion)}",
        *motion_lines(target),
        *mode_lines(target, _motion),
    ]
    for name, parent, law_of in latent_nodes(target):
        lines.append(_law(target, name, parent, law_of))
        if name in target.givens:
            lines += given_lines(target.givens[name], text_state(name))
    lines += [
        f"{name}({text_state(state)}) = {_expression(expression)}"
        for name, state, expression in _weights(target)
    ]
    lines += _measured_lines(target)
    left_out = _list_left_out(target, active)
    return "\n".join([*lines, f"left out (switched off): {', '.join(left_out)}"] if left_out else lines)


def _measured_lines(target: CheckedTarget) -> Iterator[str]:
    """Measurements of agents: ``radar: range = hypot(x, y) + noise``, with the constants used."""
    for agent, functions in target.measures.items():
        for quantity, term in functions.terms.items():
            yield f"{agent}: {quantity} = {term_text(term)} + noise"
        yield from (f"{name} = {value:g}" for name, value in functions.constants.items())


def formula_latex(target: CheckedTarget, active: Iterable[str] | None = None) -> str:
    """The factorisation as LaTeX (amsmath's `align*`); agents outside `active` are named in a comment."""
    factor = factor_text(target, active)
    states = [target.root, *(latent for latent, _, _ in latent_nodes(target) if moves(target, latent))]
    root, previous = (", ".join(_latex_state(state, time) for state in states) for time in ("t", "t-1"))
    predicted = rf"p({root} \mid e_{{1:t-1}})"
    likelihood = "" if factor is None else rf" \, {_latex(factor, nested=False)}"
    lines = [
        r"\begin{align*}",
        rf"p({root} \mid e_{{1:t}}) &\propto {predicted}{likelihood} \\",
        rf"{predicted} &= \int p({root} \mid {previous}) \, p({previous} \mid e_{{1:t-1}}) \, d{previous}",
    ]
    rows = [*latex_motion_lines(target), *_latex_mode_lines(target, root, previous)]
    comments = [f"% {line}" for line in mode_lines(target, _motion)]
    for name, parent, law_of in latent_nodes(target):
        if name in target.givens:
            rows += latex_given_lines(target.givens[name], _latex_state(name))
        else:
            comments.append(f"% {_law(target, name, parent, law_of)}")
    rows += [
        rf"{_latex_weight(name, state)} &= {latex_of(expression.term)}{_latex_constants(expression)}"
        for name, state, expression in _weights(target)
    ]
    for row in (*rows, *_measured_latex_lines(target)):
        lines[-1] += r" \\"
        lines.append(row)
    lines += [r"\end{align*}", *comments]
    left_out = _list_left_out(target, active)
    return "\n".join([*lines, f"% left out (switched off): {', '.join(left_out)}"] if left_out else lines)


def _latex_mode_lines(target: CheckedTarget, state: str, previous: str) -> list[str]:
    """The joint prediction of state and mode, and how modes follow, as rows of `align*`; none without modes.

    `state` and `previous` are the root's state in this frame and the last. Rows and columns of the matrix
    are in the order of the graph.
    """
    modes = target.inference(target.root).modes
    if modes is None:
        return []
    kernel = rf"p({state} \mid {previous}, m_{{t}}) \, p({previous}, m_{{t-1}} \mid e_{{1:t-1}})"
    predicted = rf"p({state}, m_{{t}} \mid e_{{1:t-1}})"
    chain = r"P(m_{t} \mid m_{t-1})"
    rows = r" \\ ".join(" & ".join(f"{value:.3g}" for value in row) for row in _matrix(modes))
    matrix = rf"\begin{{pmatrix}} {rows} \end{{pmatrix}}"
    by_steps = next(iter(modes.values())).next is not None
    power = rf"{matrix}^{{\Delta t}}" if by_steps else rf"\exp\left(\Delta t \, {matrix}\right)"
    return [
        rf"{predicted} &= \sum_{{m_{{t-1}}}} {chain} \int {kernel} \, d{previous}",
        rf"{chain} &= \left[{power}\right]_{{m_{{t-1}}, m_{{t}}}}",
    ]


def _matrix(modes: Mapping[str, Mode]) -> list[list[float]]:
    """Transition probabilities of one frame interval, or rates, of each mode (rows) to each (columns)."""
    rows = []
    for name, mode in modes.items():
        if mode.next is not None:
            rows.append([mode.next.get(successor, 0.0) for successor in modes])
            continue
        follow = mode.then or dict.fromkeys((successor for successor in modes if successor != name), 1.0)
        rate, total = 1.0 / (mode.mean_frames or 1.0), sum(follow.values())
        rows.append(
            [-rate if successor == name else rate * follow.get(successor, 0.0) / total for successor in modes]
        )
    return rows


def _measured_latex_lines(target: CheckedTarget) -> Iterator[str]:
    """The same as rows of amsmath's `align*`, without the ends of lines."""
    for agent, functions in target.measures.items():
        for quantity, term in functions.terms.items():
            left_side = latex_of(Variable(f"{agent}.{quantity}"))
            yield rf"{left_side} &= {latex_of(term)} + \varepsilon"
        yield from (f"{latex_of(Variable(name))} &= {value:g}" for name, value in functions.constants.items())


def _law(target: CheckedTarget, name: str, parent: str, law_of: Given) -> str:
    """The law of a latent state given the one above, in words."""
    law = f"Gaussian{_place(law_of)}, {noise(law_of)}"
    if name not in target.givens and moves(target, name):
        walk = target.inference(name).motion
        assert walk is not None
        return f"{_text_step(name, parent)}: {law} in the long run, {noise(walk.settings)} a frame"
    distribution = "by expressions" if name in target.givens else law
    return f"p({text_state(name)} | {text_state(parent)}): {distribution}{_describe_held(target, name)}"


def _place(law: Given) -> str:
    """Place of a part in its parent's box."""
    if not law.is_part:
        return ""
    offset, size = law.offset_box or OffsetBox(), law.size_box or SizeBox()
    x, y = (
        name if share == 0 else f"{name} {'-' if share < 0 else '+'} {abs(share):g} {side}"
        for name, share, side in (("x", offset.x, "w"), ("y", offset.y, "h"))
    )
    return f" around ({x}, {y}), {size.w:g} w by {size.h:g} h"


def _describe_held(target: CheckedTarget, state: str) -> str:
    """Form of a latent state that is not held by hypotheses."""
    belief = target.inference(state).belief if state in target.children else None
    if belief is None or belief.particles is not None:
        return ""
    return "; its likelihood a Gaussian" if belief.gaussian is not None else "; its likelihood on a grid"


def _text_step(node: str, parent: str) -> str:
    """Motion of a state that is remembered."""
    state, parent_state = text_state(node), text_state(parent)
    return f"p({state} | {parent_state}, {state}-1, {parent_state}-1)"


def _factor(target: CheckedTarget, name: str, state: str, active: set[str]) -> Factor | None:
    if name not in target.children:
        return Likelihood(name, state) if name in active else None
    node = target.inference(name)
    latent = node.fuse is not None and node.fuse.latent is not None
    inner_state = own_state(target, name) if latent else state
    child_factors = [(child, _factor(target, child, inner_state, active)) for child in target.children[name]]
    speaking: list[tuple[str, Factor]] = [
        (child, factor) for child, factor in child_factors if factor is not None
    ]
    factors = [child for child, factor in target.factors.items() if factor.parent == name]
    speaking += [(child, Weight(child, inner_state)) for child in factors]
    if not speaking:
        return None
    weights = dict.fromkeys((child for child, _ in speaking), 1.0)
    if node.fuse is not None and node.fuse.pool is not None:
        pooled = [child for child in weights if child not in factors]
        weights |= pool_exponents(node.fuse.shares(pooled), target.correlation(name))
    product = Product(tuple((factor, weights[child]) for child, factor in speaking))
    is_single = len(speaking) == 1
    inner: Factor = speaking[0][1] if is_single else product
    return Integral(inner_state, state, inner) if latent and not moves(target, inner_state) else inner


def _text(factor: Factor, nested: bool) -> str:
    match factor:
        case Likelihood(agent, state):
            return f"p(e_{agent} | {text_state(state)})"
        case Weight(name, state):
            return f"{name}({text_state(state)})"
        case Integral(latent, parent, inner):
            state = text_state(latent)
            kernel = f"p({state} | {text_state(parent)})"
            return f"[∫ {kernel} · {_text(inner, nested=False)} d {state}]"
        case Product(factors):
            parts = (_text(part, nested=True) + _text_power(weight) for part, weight in factors)
            text = " · ".join(parts)
            return f"[{text}]" if nested else text


def _latex(factor: Factor, nested: bool) -> str:
    match factor:
        case Likelihood(agent, state):
            return rf"p(e_{{\mathrm{{{escape(agent)}}}}} \mid {_latex_state(state)})"
        case Weight(name, state):
            return _latex_weight(name, state)
        case Integral(latent, parent, inner):
            state = _latex_state(latent)
            kernel = rf"p({state} \mid {_latex_state(parent)})"
            return rf"\left[\int {kernel} \, {_latex(inner, nested=False)} \, d{state}\right]"
        case Product(factors):
            parts = (_latex(part, nested=True) + _latex_power(weight) for part, weight in factors)
            text = r" \, ".join(parts)
            return rf"\left[{text}\right]" if nested else text


def _fraction(weight: float) -> Fraction | None:
    fraction = Fraction(weight).limit_denominator(20)
    return fraction if abs(float(fraction) - weight) < 1e-9 else None


def _text_power(weight: float) -> str:
    if weight == 1.0:
        return ""
    fraction = _fraction(weight)
    if fraction == Fraction(1, 2):
        return "^½"
    return f"^({fraction})" if fraction is not None else f"^{weight:.3g}"


def _latex_power(weight: float) -> str:
    if weight == 1.0:
        return ""
    fraction = _fraction(weight)
    return f"^{{{fraction if fraction is not None else format(weight, '.3g')}}}"


def _weights(target: CheckedTarget) -> list[tuple[str, str, Expression]]:
    """Each factor, the state that it is about, and its expression."""
    weights = []
    for name, factor in target.factors.items():
        node: str | None = factor.parent
        while node is not None:
            fuse = target.inference(node).fuse
            if fuse is not None and fuse.latent is not None:
                break
            node = target.parent[node]
        weights.append((name, target.root if node is None else own_state(target, node), factor))
    return weights


def _expression(factor: Expression) -> str:
    constants = "".join(f", {name} = {value:g}" for name, value in factor.constants.items())
    return term_text(factor.term) + constants + ("" if factor.mask is None else f", mask: {factor.mask}")


def _latex_weight(name: str, state: str) -> str:
    return rf"\mathrm{{{escape(name)}}}({_latex_state(state)})"


def _latex_state(name: str, time: str = "t") -> str:
    """A state as LaTeX."""
    return rf"\mathit{{{escape(name)}}}_{{{time}}}"


def _latex_constants(factor: Expression) -> str:
    return "".join(
        rf", \quad \mathit{{{escape(name)}}} = {value:g}" for name, value in factor.constants.items()
    )


def _motion(motion: Motion | None) -> str:
    assert motion is not None
    if motion.expressions is not None:
        return "by expressions" + (", reflected at the borders" if motion.expressions.borders else "")
    settings = motion.settings
    parts = [
        f"sd {field} {sd:g} {unit}"
        for field, unit in (("velocity", "px/frame"), ("acceleration", "px/frame²"))
        if (sd := getattr(settings, f"sd_{field}_px", 0.0)) > 0
    ]
    parts += (
        [] if settings.inflate is None else [f"up to {settings.inflate.max_factor:g} times that while unsure"]
    )
    parts += [] if settings.size_reversion is None else ["around the first size"]
    parts += [] if settings.camera is None else ["with the camera"]
    parts += [] if settings.borders is None else ["reflected at the borders"]
    if settings.relocalize is not None:
        jump = settings.relocalize
        when = "unsure" if jump.grow_box is None else f"lost, {jump.grow_box:g} sides farther each frame"
        parts.append(f"anywhere with probability {jump.share:g} while {when}")
        if jump.sudden is not None:
            pans = " and the picture pans" if jump.sudden.pan_box > 0 else ""
            parts.append(f"up to {jump.sudden.reach_box:g} sides away where nothing fits{pans}")
    return ", ".join(filter(None, (motion.kind.replace("_", " "), noise(settings), *parts)))


def _list_left_out(target: CheckedTarget, active: Iterable[str] | None) -> list[str]:
    working = set(target.agents if active is None else active)
    return [agent for agent in target.agents if agent not in working]


_SHARED = "o_t: which one is in front; S_i: evidence of the pixels of box i that the other does not hide"


def join_text(join: Join) -> str:
    """Joint belief of a pair while its nets are joined, one equation a line."""
    first, second = _states(join)
    together = f"{first}_t, {second}_t"
    condition = f"while the beliefs of {first} and {second} overlap by {join.when.overlap:g} or more:"
    lines = [condition if join.when.overlap else f"of every {first} and {second}:"]
    if join.factor is not None:
        lines.append(f"p({together} | e_1:t) ∝ p({first}_t | e_1:t) · p({second}_t | e_1:t) · f({together})")
        lines.append(f"f(a, b) = {term_text(parse(join.factor))}")
    if join.shares_pixels:
        against = f" · e^(-{join.nats:g} c({together}))" if join.nats else ""
        lines.append(
            f"p({together} | e_1:t) ∝ p({first}_t | e_1:t-1) · p({second}_t | e_1:t-1) · "
            f"Σ_o p(o_t) · p(S_{first} | {together}, o_t) · p(S_{second} | {together}, o_t){against}"
        )
        lines.append(_SHARED)
        lines.append(f"p(o_t): {_order(join)}")
        lines += ["c: overlap as a share of the smaller box"] if join.nats else []
    if join.attachment is not None:
        attachment = join.attachment
        lines.append(
            f"p({second}_t | {second}_t-1, {first}_t): with {first}, sd {attachment.sd_px:g} px, while it is "
            f"carried (picked up with probability {attachment.start:g} a frame, stays carried with "
            f"{attachment.stay:g})"
        )
    return "\n".join(lines)


def join_latex(join: Join) -> str:
    """The same as LaTeX (amsmath's `align*`), what is said in words as comments."""
    comments = [f"% {line}" for line in join_text(join).split("\n")]
    if join.factor is not None:
        first, second = (rf"\mathit{{{escape(name)}}}_{{t}}" for name in _states(join))
        each = r" \, ".join(rf"p({name} \mid e_{{1:t}})" for name in (first, second))
        return "\n".join(
            [
                comments[0],
                r"\begin{align*}",
                rf"p({first}, {second} \mid e_{{1:t}}) &\propto {each} \, f({first}, {second}) \\",
                rf"f(a, b) &= {latex_of(parse(join.factor))}",
                r"\end{align*}",
            ]
        )
    if not join.shares_pixels:
        return "\n".join(comments)
    first, second = (rf"\mathit{{{escape(name)}}}_{{t}}" for name in _states(join))
    pixels = [rf"p(S_{k} \mid {first}, {second}, o_t)" for k in (1, 2)]
    against = rf" \, e^{{-{join.nats:g} \, c({first}, {second})}}" if join.nats else ""
    priors = r" \, ".join(rf"p({state} \mid e_{{1:t-1}})" for state in (first, second))
    return "\n".join(
        [
            comments[0],
            r"\begin{align*}",
            rf"p({first}, {second} \mid e_{{1:t}}) &\propto {priors} \sum_{{o_t}} p(o_t) \, "
            rf"{pixels[0]} \, {pixels[1]}{against}",
            r"\end{align*}",
            *comments[2:],
        ]
    )


def _states(join: Join) -> tuple[str, str]:
    kinds = join.between or ("target",)
    return (kinds[0], kinds[1]) if len(set(kinds)) == 2 else (kinds[0], f"other_{kinds[0]}")


def _order(join: Join) -> str:
    if join.occlusion is None:
        return "1/2 each, anew in every frame"
    return f"that of the last frame with probability {join.stay:g}"
