"""What a cue can do is declared once, in its `CueDeclaration`; here it is checked that the cue can do it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from inspect import getattr_static
from types import MappingProxyType
from typing import Any

from bayesnet_track.observation.cue import AnyCue, CueDeclaration
from bayesnet_track.observation.guests import FAULTS, said

METHODS: Mapping[str, str] = MappingProxyType(
    {
        "measures": "measure",
        "adapts": "adapt",
        "reads_angle": "learn_turned",
        "reads_detection": "rule",
        "has_residuals": "residuals",
    }
)
"""Flag of a declaration -> the method (or property) that a cue has if, and only if, the flag is set."""


class CueError(ValueError):
    """A cue that cannot be used as it is declared; says which, and what is to be changed."""


def make_cue(declaration: CueDeclaration, parameters: Any) -> AnyCue:
    """The cue at work, checked against its declaration.

    Raises:
        CueError: it cannot be made, or can do less or more than is declared; names cue, flag and method.
    """
    try:
        cue = declaration.make(parameters)
    except FAULTS as error:
        if type(error).__module__.startswith("bayesnet_track"):
            raise
        raise CueError(f"cue {declaration.name!r} cannot be made: it raised {said(error)}") from error
    wrong = list(_differences(declaration, cue))
    if wrong:
        raise CueError("\n".join(wrong))
    return cue


def _differences(declaration: CueDeclaration, cue: AnyCue) -> Iterator[str]:
    name = f"cue {declaration.name!r}"
    for needed in ("needs", "learn", "blend"):
        if not _has(cue, needed):
            yield f"{name} has no {needed!r}, which every cue needs"
    if declaration.measures and _has(cue, "log_likelihood"):
        yield (
            f"{name} declares measures=True and has the method 'log_likelihood', too: a cue either measures "
            "or scores; remove the method or the flag"
        )
    elif not declaration.measures and not _has(cue, "log_likelihood") and not _has(cue, "measure"):
        yield f"{name} has no method 'log_likelihood', which every cue needs without measures=True"
    for flag, method in METHODS.items():
        is_declared = bool(getattr(declaration, flag))
        if is_declared and not _has(cue, method):
            yield f"{name} declares {flag}=True and has no method {method!r}: write it, or remove the flag"
        elif not is_declared and _has(cue, method):
            yield (
                f"{name} has the method {method!r} and does not declare {flag}=True: "
                "add the flag to its CueDeclaration, or rename the method"
            )


def _has(cue: AnyCue, name: str) -> bool:
    """Whether the cue has it; a property is not asked for its value."""
    return getattr_static(cue, name, None) is not None
