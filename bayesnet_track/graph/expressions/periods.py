"""Angles among expressions: after how much a value is the same again."""

from __future__ import annotations

import math
from collections.abc import Mapping

from bayesnet_track.graph.expressions.evaluate import values_of
from bayesnet_track.graph.expressions.terms import Call, Term, names_in


def period_of(term: Term, constants: Mapping[str, float]) -> float:
    """After how much the value of a term is the same again: infinite of one that is no angle.

    `atan2(...)` is an angle in radians, and so is it plus or minus anything; times a number it is one of
    another unit.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> period_of(parse("90 - atan2(y, x) * 180 / pi"), {}), period_of(parse("hypot(x, y)"), {})
    (360.0, inf)
    """
    if not isinstance(term, Call):
        return math.inf
    if term.function == "atan2":
        return 2.0 * math.pi
    periods = [period_of(one, constants) for one in term.arguments]
    if term.function in ("neg", "+", "-"):
        return min(periods)
    if term.function in ("*", "/") and min(periods) < math.inf:
        factor = term.arguments[1 - periods.index(min(periods))]
        if term.function == "/" and factor is term.arguments[0]:
            return math.inf
        if any(name not in constants and name != "pi" for name in names_in(factor)):
            return math.inf
        value = abs(float(values_of(factor, constants)))
        return min(periods) * value if term.function == "*" else min(periods) / max(value, 1e-300)
    return math.inf
