"""The density that a net stands for, as text and as LaTeX.

The posterior of the root is its prediction times the messages of its children. A product multiplies them, a
pool raises them to weights over the active children, a latent node integrates over its own
state.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.checked import Factor as Expression
from bayesnet_track.graph.expressions.write import latex_of, text_of
from bayesnet_track.graph.settings.nodes import pool_exponents
from bayesnet_track.graph.spec import Given, Motion, Noise, OffsetBox, SizeBox
from bayesnet_track.graph.text import formula_given, formula_modes, formula_motion


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
    """The integral of p(own | given) times `inner` over the node's own state."""

    own: str
    given: str
    inner: Factor


Factor = Likelihood | Weight | Product | Integral


def factor_of(target: CheckedTarget, active: Iterable[str] | None = None) -> Factor | None:
    """What the root's children say, of the agents `active` (all when None); None when none is active."""
    working = set(target.agents if active is None else active)
    return _factor(target, target.root, target.root, working)


def formula_text(target: CheckedTarget, active: Iterable[str] | None = None) -> str:
    """The factorisation as text, one equation a line; agents outside `active` are named as left out."""
    factor = factor_of(target, active)
    root = _text_state(target.root)
    before = f"{root}-1"
    predicted = f"p({root} | e_1:t-1)"
    said = "" if factor is None else f" · {_text(factor, inside=False)}"
    lines = [
        f"p({root} | e_1:t) ∝ {predicted}{said}",
        f"{predicted} = ∫ p({root} | {before}) p({before} | e_1:t-1) d {before}",
        f"p({root} | {before}): {_motion(target.inference(target.root).motion)}",
        *formula_motion.lines(target),
        *formula_modes.lines(target, _motion),
    ]
    for name, given, noise in _latent_nodes(target):
        held = _describe_held(target, name)
        written = target.givens.get(name)
        if written is not None:
            lines.append(f"p({_text_state(name)} | {_text_state(given)}): by expressions{held}")
            lines += formula_given.lines(written, _text_state(name))
            continue
        lines.append(
            f"p({_text_state(name)} | {_text_state(given)}): Gaussian{_place(noise)}, {_noise(noise)}{held}"
        )
    lines += [f"{name}({_text_state(at)}) = {_expression(one)}" for name, at, one in _weights(target)]
    left_out = _list_left_out(target, active)
    return "\n".join([*lines, f"left out (switched off): {', '.join(left_out)}"] if left_out else lines)


def formula_latex(target: CheckedTarget, active: Iterable[str] | None = None) -> str:
    """The factorisation as LaTeX (amsmath's `align*`); agents outside `active` are named in a comment."""
    factor = factor_of(target, active)
    root, before = _latex_state(target.root), _latex_state(target.root, "t-1")
    predicted = rf"p({root} \mid e_{{1:t-1}})"
    said = "" if factor is None else rf" \, {_latex(factor, inside=False)}"
    lines = [
        r"\begin{align*}",
        rf"p({root} \mid e_{{1:t}}) &\propto {predicted}{said} \\",
        rf"{predicted} &= \int p({root} \mid {before}) \, p({before} \mid e_{{1:t-1}}) \, d{before}",
    ]
    for line in formula_motion.latex_lines(target):
        lines[-1] += r" \\"
        lines.append(line)
    for name, at, one in _weights(target):
        lines[-1] += r" \\"
        lines.append(rf"{_latex_weight(name, at)} &= {latex_of(one.term)}{_latex_constants(one)}")
    lines.append(r"\end{align*}")
    left_out = _list_left_out(target, active)
    return "\n".join([*lines, f"% left out (switched off): {', '.join(left_out)}"] if left_out else lines)


def _factor(target: CheckedTarget, name: str, state: str, active: set[str]) -> Factor | None:
    if name not in target.children:
        return Likelihood(name, state) if name in active else None
    node = target.inference(name)
    latent = node.fuse is not None and node.fuse.latent is not None
    own = _own_state(target, name) if latent else state
    said = [(child, _factor(target, child, own, active)) for child in target.children[name]]
    speaking: list[tuple[str, Factor]] = [(child, factor) for child, factor in said if factor is not None]
    factors = [child for child, factor in target.factors.items() if factor.parent == name]
    speaking += [(child, Weight(child, own)) for child in factors]
    if not speaking:
        return None
    weights = dict.fromkeys((child for child, _ in speaking), 1.0)
    if node.fuse is not None and node.fuse.pool is not None:
        pooled = [child for child in weights if child not in factors]
        weights |= pool_exponents(node.fuse.shares(pooled), target.correlation(name))
    product = Product(tuple((factor, weights[child]) for child, factor in speaking))
    alone = len(speaking) == 1
    inner: Factor = speaking[0][1] if alone else product
    return Integral(own, state, inner) if latent else inner


def _text(factor: Factor, inside: bool) -> str:
    match factor:
        case Likelihood(agent, state):
            return f"p(e_{agent} | {_text_state(state)})"
        case Weight(name, state):
            return f"{name}({_text_state(state)})"
        case Integral(own, given, inner):
            state = _text_state(own)
            kernel = f"p({state} | {_text_state(given)})"
            return f"[∫ {kernel} · {_text(inner, inside=False)} d {state}]"
        case Product(factors):
            parts = (_text(one, inside=True) + _text_power(weight) for one, weight in factors)
            text = " · ".join(parts)
            return f"[{text}]" if inside else text


def _latex(factor: Factor, inside: bool) -> str:
    match factor:
        case Likelihood(agent, state):
            return rf"p(e_{{\mathrm{{{_escape(agent)}}}}} \mid {_latex_state(state)})"
        case Weight(name, state):
            return _latex_weight(name, state)
        case Integral(own, given, inner):
            state = _latex_state(own)
            kernel = rf"p({state} \mid {_latex_state(given)})"
            return rf"\left[\int {kernel} \, {_latex(inner, inside=False)} \, d{state}\right]"
        case Product(factors):
            parts = (_latex(one, inside=True) + _latex_power(weight) for one, weight in factors)
            text = r" \, ".join(parts)
            return rf"\left[{text}\right]" if inside else text


def _fraction(weight: float) -> Fraction | None:
    near = Fraction(weight).limit_denominator(20)
    return near if abs(float(near) - weight) < 1e-9 else None


def _text_power(weight: float) -> str:
    if weight == 1.0:
        return ""
    near = _fraction(weight)
    if near == Fraction(1, 2):
        return "^½"
    return f"^({near})" if near is not None else f"^{weight:.3g}"


def _latex_power(weight: float) -> str:
    if weight == 1.0:
        return ""
    near = _fraction(weight)
    return f"^{{{near if near is not None else format(weight, '.3g')}}}"


def _text_state(name: str) -> str:
    return f"{name}_t"


def _latex_state(name: str, time: str = "t") -> str:
    return rf"\mathit{{{_escape(name)}}}_{{{time}}}"


def _escape(name: str) -> str:
    return name.replace("_", r"\_")


def _latent_nodes(target: CheckedTarget) -> list[tuple[str, str, Given]]:
    """Each latent state, the state that it is drawn around, and its noise."""
    states: dict[str, str] = {}
    found: list[tuple[str, str, Given]] = []
    for name in target.order:
        if name not in target.children:
            continue
        parent = target.parent[name]
        above = target.root if parent is None else states[parent]
        fuse = target.inference(name).fuse
        latent = fuse.latent if fuse is not None else None
        states[name] = above if latent is None else _own_state(target, name)
        if latent is not None:
            found.append((states[name], above, latent.given))
    return found


def _weights(target: CheckedTarget) -> list[tuple[str, str, Expression]]:
    """Each factor, the state that it is about, and its expression."""
    found = []
    for name, factor in target.factors.items():
        node: str | None = factor.parent
        while node is not None:
            fuse = target.inference(node).fuse
            if fuse is not None and fuse.latent is not None:
                break
            node = target.parent[node]
        found.append((name, target.root if node is None else _own_state(target, node), factor))
    return found


def _expression(factor: Expression) -> str:
    constants = "".join(f", {name} = {value:g}" for name, value in factor.constants.items())
    return text_of(factor.term) + constants + ("" if factor.mask is None else f", mask: {factor.mask}")


def _latex_weight(name: str, state: str) -> str:
    return rf"\mathrm{{{_escape(name)}}}({_latex_state(state)})"


def _latex_constants(factor: Expression) -> str:
    return "".join(
        rf", \quad \mathit{{{_escape(name)}}} = {value:g}" for name, value in factor.constants.items()
    )


def _own_state(target: CheckedTarget, name: str) -> str:
    """A latent node's own state; a latent root has two, the target's and its own."""
    return f"{name}_own" if name == target.root else name


def _describe_held(target: CheckedTarget, state: str) -> str:
    """How a latent state is held, where it is not by hypotheses."""
    belief = target.inference(state).belief if state in target.children else None
    if belief is None or belief.particles is not None:
        return ""
    return "; its likelihood a Gaussian" if belief.gaussian is not None else "; its likelihood on a grid"


def _motion(motion: Motion | None) -> str:
    assert motion is not None
    if motion.expressions is not None:
        return "by expressions" + (", reflected at the borders" if motion.expressions.borders else "")
    settings = motion.settings
    further = [
        f"sd {field} {sd:g} {unit}"
        for field, unit in (("velocity", "px/frame"), ("acceleration", "px/frame²"))
        if (sd := getattr(settings, f"sd_{field}_px", 0.0)) > 0
    ]
    further += (
        [] if settings.inflate is None else [f"up to {settings.inflate.max_factor:g} times that while unsure"]
    )
    further += [] if settings.size_reversion is None else ["around the first size"]
    further += [] if settings.camera is None else ["with the camera"]
    further += [] if settings.borders is None else ["reflected at the borders"]
    if settings.relocalize is not None:
        further.append(f"anywhere with probability {settings.relocalize.share:g} while unsure")
    return ", ".join(filter(None, (motion.kind.replace("_", " "), _noise(settings), *further)))


def _place(given: Given) -> str:
    """Where in its parent's box a part lies."""
    if not given.is_part:
        return ""
    at, size = given.offset_box or OffsetBox(), given.size_box or SizeBox()
    x, y = (
        name if share == 0 else f"{name} {'-' if share < 0 else '+'} {abs(share):g} {side}"
        for name, share, side in (("x", at.x, "w"), ("y", at.y, "h"))
    )
    return f" around ({x}, {y}), {size.w:g} w by {size.h:g} h"


def _noise(noise: Noise) -> str:
    parts = (
        ("px", noise.sd_px),
        ("√(wh)", noise.sd_box),
        ("log", noise.sd_log),
    )
    said = [
        f"{field} {getattr(part, field):g} {unit}"
        for unit, part in parts
        for field in type(part).model_fields
        if getattr(part, field) > 0
    ]
    return "sd " + ", ".join(said) if said else ""


def _list_left_out(target: CheckedTarget, active: Iterable[str] | None) -> list[str]:
    working = set(target.agents if active is None else active)
    return [agent for agent in target.agents if agent not in working]
