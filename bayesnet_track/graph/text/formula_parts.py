"""Parts of a net's formula: names of states, distributions by expressions, motions and modes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from bayesnet_track.graph.checked import CheckedTarget, Conditional
from bayesnet_track.graph.checks.motion import drift_of, sds_of
from bayesnet_track.graph.expressions.parse import latex_of, term_text
from bayesnet_track.graph.expressions.terms import DRAWN, Call, Number, Term, Variable, names_in
from bayesnet_track.graph.settings.motion import Mode, Motion
from bayesnet_track.graph.spec import Given, Noise


def text_state(name: str) -> str:
    """A state at the time of a frame."""
    return f"{name}_t"


def escape(name: str) -> str:
    """A name in LaTeX."""
    return name.replace("_", r"\_")


def latent_nodes(target: CheckedTarget) -> list[tuple[str, str, Given]]:
    """Each latent state, the state that it is drawn around, and its noise."""
    states: dict[str, str] = {}
    nodes: list[tuple[str, str, Given]] = []
    for name in target.order:
        if name not in target.children:
            continue
        parent = target.parent[name]
        parent_state = target.root if parent is None else states[parent]
        fuse = target.inference(name).fuse
        latent = fuse.latent if fuse is not None else None
        states[name] = parent_state if latent is None else own_state(target, name)
        if latent is not None:
            nodes.append((states[name], parent_state, latent.given))
    return nodes


def own_state(target: CheckedTarget, name: str) -> str:
    """A latent node's own state; a latent root has two, the target's and its own."""
    return f"{name}_own" if name == target.root else name


def moves(target: CheckedTarget, state: str) -> bool:
    """True if a latent state is remembered, and so a part of what the belief is about."""
    return state in target.children and state != target.root and target.inference(state).motion is not None


def noise(noise: Noise) -> str:
    """The sds of noise, with their units."""
    parts = (
        ("px", noise.sd_px),
        ("√(wh)", noise.sd_box),
        ("log", noise.sd_log),
    )
    terms = [
        f"{field} {getattr(part, field):g} {unit}"
        for unit, part in parts
        for field in type(part).model_fields
        if getattr(part, field) > 0
    ]
    return "sd " + ", ".join(terms) if terms else ""


def given_lines(conditional: Conditional, state: str) -> Iterator[str]:
    """A line a field: ``x of head_t ~ normal(parent.x, 5)``."""
    for name, term in conditional.fields.items():
        distribution = _distribution(term)
        sign, right_side = ("=", term) if distribution is None else ("~", distribution)
        yield f"{name} of {state} {sign} {term_text(right_side)}"
    yield from (f"{name} = {value:g}" for name, value in conditional.constants.items())


def latex_given_lines(conditional: Conditional, state: str) -> Iterator[str]:
    """The same in LaTeX, one line of `align*` each, without its end."""
    for name, term in conditional.fields.items():
        distribution = _distribution(term)
        sign, right_side = ("=", latex_of(term)) if distribution is None else (r"\sim", _latex(distribution))
        yield rf"{name}({state}) &{sign} {right_side}"


def _latex(distribution: Call) -> str:
    """A distribution, whose first parameter is no value: with a comma behind it."""
    return latex_of(distribution).replace(r";\,", r",\,", 1)


def _distribution(term: Term) -> Call | None:
    """The distribution without the value that is drawn from it; None of a value."""
    if isinstance(term, Call) and term.arguments[:1] == (Variable(DRAWN),):
        return Call(term.function, term.arguments[1:], term.at)
    return None


def motion_lines(target: CheckedTarget) -> list[str]:
    """`x_t = x + vx * dt + noise of sd 2 · √dt`, for each field that moves; none for another motion."""
    equations = [_equation_text(*equation) for equation in _equations(target.inference(target.root).motion)]
    return [*equations, *(f"{name} = {value:g}" for name, value in _constants(target))]


def _equation_text(name: str, mean: Term, sd: Term | None) -> str:
    noise = "" if sd is None else f" + noise of sd {_bracketed(sd)} · √dt"
    return f"{name}_t = {term_text(mean)}{noise}"


def latex_motion_lines(target: CheckedTarget) -> list[str]:
    """The same as rows of amsmath's `align*`, without the ends of lines."""
    rows = []
    for name, mean, sd in _equations(target.inference(target.root).motion):
        left_side = latex_of(Variable(name)) + "_{t}"
        if sd is None:
            rows.append(rf"{left_side} &= {latex_of(mean)}")
        else:
            variance = rf"\left({latex_of(sd)}\right)^{{2}} \, \Delta t"
            rows.append(rf"{left_side} &\sim \mathcal{{N}}\left({latex_of(mean)},\, {variance}\right)")
    constants = (rf"{latex_of(Variable(name))} &= {value:g}" for name, value in _constants(target))
    return [*rows, *constants]


def _equations(motion: Motion | None) -> Iterator[tuple[str, Term, Term | None]]:
    """Field, its mean and its sd, of each field that has a drift or noise."""
    if motion is None or motion.expressions is None:
        return
    drifts, sds = drift_of(motion.expressions), sds_of(motion.expressions)
    for name in ("x", "y", "w", "h", *motion.expressions.own):
        if name in drifts or name in sds:
            yield name, drifts.get(name, Variable(name)), sds.get(name)


def _constants(target: CheckedTarget) -> list[tuple[str, float]]:
    root = target.inference(target.root)
    motions = (root.motion, *(mode.motion for mode in (root.modes or {}).values()))
    equations = (equation for motion in motions for equation in _equations(motion))
    names = {name for _, mean, sd in equations for term in (mean, sd) if term for name in names_in(term)}
    return [(name, value) for name, value in target.constants.items() if name in names]


def _bracketed(sd: Term) -> str:
    return term_text(sd) if isinstance(sd, Number | Variable) else f"({term_text(sd)})"


def mode_lines(target: CheckedTarget, describe: Callable[[Motion], str]) -> list[str]:
    """A line for each mode and category of the root, `describe` saying how a motion moves."""
    modes, categories = (
        target.inference(target.root).modes or {},
        target.inference(target.root).category or {},
    )
    lines = [f"mode {name}: {', '.join(_describe_mode(modes, name, describe))}" for name in modes]
    for name, category in categories.items():
        prior = category.prior or dict.fromkeys(category.values, 1.0 / len(category.values))
        lines.append(
            f"{name}: {', '.join(f'{value} {prior[value]:.3g}' for value in category.values)}, and stays"
        )
    return lines


def _describe_mode(modes: Mapping[str, Mode], name: str, describe: Callable[[Motion], str]) -> list[str]:
    mode = modes[name]
    parts = ["moves so" if mode.motion is None else describe(mode.motion)]
    parts += [_equation_text(*equation) for equation in _equations(mode.motion)]
    if mode.next is not None:
        parts.append(f"next {_shares(mode.next)}")
    else:
        follow = mode.then or dict.fromkeys((successor for successor in modes if successor != name), 1.0)
        parts += [f"{mode.mean_frames:g} frames on average", f"then {_shares(follow)}"]
    if mode.hidden is not None:
        parts.append(f"hidden: every agent says {mode.hidden.likelihood:g}")
    return parts


def _shares(row: Mapping[str, float]) -> str:
    total = sum(row.values())
    if len(row) == 1:
        return next(iter(row))
    return ", ".join(f"{name} {share / total:.3g}" for name, share in row.items())
