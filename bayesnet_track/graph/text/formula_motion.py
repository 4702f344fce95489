"""A motion by expressions, one equation for each field, as text and as LaTeX."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.checks.formulas import drift_of, sds_of
from bayesnet_track.graph.expressions.terms import Number, Term, Variable, names_in
from bayesnet_track.graph.expressions.write import latex_of, text_of


def lines(target: CheckedTarget) -> list[str]:
    """`x_t = x + vx * dt + noise of sd 2 · √dt`, for each field that moves; none for another motion."""
    found = [
        f"{name}_t = {text_of(mean)}" + ("" if sd is None else f" + noise of sd {_bracketed(sd)} · √dt")
        for name, mean, sd in _equations(target)
    ]
    return [*found, *(f"{name} = {value:g}" for name, value in _constants(target))]


def latex_lines(target: CheckedTarget) -> list[str]:
    """The same as rows of amsmath's `align*`, without the ends of lines."""
    found = []
    for name, mean, sd in _equations(target):
        left = latex_of(Variable(name)) + "_{t}"
        if sd is None:
            found.append(rf"{left} &= {latex_of(mean)}")
        else:
            variance = rf"\left({latex_of(sd)}\right)^{{2}} \, \Delta t"
            found.append(rf"{left} &\sim \mathcal{{N}}\left({latex_of(mean)},\, {variance}\right)")
    constants = (rf"{latex_of(Variable(name))} &= {value:g}" for name, value in _constants(target))
    return [*found, *constants]


def _equations(target: CheckedTarget) -> Iterator[tuple[str, Term, Term | None]]:
    """Field, its mean and its sd, of each field that has a drift or noise."""
    motion = target.inference(target.root).motion
    if motion is None or motion.expressions is None:
        return
    drifts, sds = drift_of(motion.expressions), sds_of(motion.expressions)
    for name in ("x", "y", "w", "h", *motion.expressions.fields):
        if name in drifts or name in sds:
            yield name, drifts.get(name, Variable(name)), sds.get(name)


def _constants(target: CheckedTarget) -> list[tuple[str, float]]:
    used = {
        name for _, mean, sd in _equations(target) for term in (mean, sd) if term for name in names_in(term)
    }
    return [(name, value) for name, value in target.constants.items() if name in used]


def _bracketed(sd: Term) -> str:
    return text_of(sd) if isinstance(sd, Number | Variable) else f"({text_of(sd)})"
