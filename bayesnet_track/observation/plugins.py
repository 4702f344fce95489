"""Finding what installed packages declare through an entry-point group, and loading what may be loaded.

To load is to run a package's code. What comes with this package is always loaded. What another one declares
is loaded only where it is named (by a graph, or on the command line) *and* allowed (`allow`,
``--allow-plugins``). To look for it is to read lists of entry points, and runs nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, TypeVar

from bayesnet_track.observation.settings import setting

OWN_PACKAGE = "bayesnet-track"

_allowed: set[str] = set()
_taken: dict[str, dict[str, Any]] = {}
_given: dict[str, dict[str, Any]] = {}


class Named(Protocol):
    """A declaration with a name."""

    @property
    def name(self) -> str:
        """The word that users write."""


Declaration = TypeVar("Declaration", bound=Named)


def allow(names: Iterable[str]) -> None:
    """Let these plug-ins of other packages be loaded in this process, where something names them.

    A single name may stand alone.
    """
    _allowed.update([names] if isinstance(names, str) else names)


def allowed() -> frozenset[str]:
    """Names that have been allowed: a process that works for this one has to be told."""
    return frozenset(_allowed)


def give(group: str, declaration: Named) -> None:
    """Have the declaration among the installed ones of the group, in this process from now on."""
    _given.setdefault(group, {})[declaration.name] = declaration


def given(group: str) -> Mapping[str, Any]:
    """Name -> declaration of what was given to the group."""
    return dict(_given.get(group, {}))


def forget() -> None:
    """Allow nothing, drop what was given, and look again at what is installed."""
    _allowed.clear()
    _taken.clear()
    _given.clear()
    for cached in (_points, _built_in, _load):
        cached.cache_clear()


def installed(
    group: str, kind: type[Declaration], word: str, named: Iterable[str] = ()
) -> Mapping[str, Declaration]:
    """The declarations of `kind` in the group that come with this package, and the allowed ones of `named`.

    By name, sorted; those of other packages that were loaded before, and those of `give`, are among them. A
    package whose declaration cannot be loaded is left out with a warning that calls it a `word`: it must not
    keep the others from working.
    """
    declarations: dict[str, Declaration] = dict(_built_in(group, kind, word))
    for name in sorted({*named} & _allowed - {*declarations}):
        if len(_foreign_points(group).get(name, ())) == 1:
            _load(group, kind, word, name)
    declarations |= _taken.get(group, {}) | _given.get(group, {})
    return dict(sorted(declarations.items()))


def others(group: str) -> dict[str, str]:
    """Name -> package of what other packages declare in the group; nothing is loaded."""
    return {name: ", ".join(_package(p) for p in points) for name, points in _foreign_points(group).items()}


def why_absent(group: str, name: str) -> tuple[str, str] | None:
    """Reason why a plug-in of another package is absent, and its remedy; None if no package has it."""
    points = _foreign_points(group).get(name, ())
    if not points:
        return None
    if len(points) > 1:
        packages = " and ".join(_package(point) for point in points)
        return f"{packages} both have {name!r}", "one package with this name"
    if name not in _allowed:
        return (
            f"{name!r} of the package {_package(points[0])}, which is not allowed to run",
            f"{setting('--allow-plugins', name, repr([name]))}, if you trust that package",
        )
    return f"{name!r} of the package {_package(points[0])}, which cannot be loaded", "one that can"


@cache
def _points(group: str) -> tuple[EntryPoint, ...]:
    return tuple(sorted(entry_points(group=group), key=lambda point: (point.name, point.value)))


def _foreign_points(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    own_names = {point.name for point in _points(group) if _package(point) == OWN_PACKAGE}
    points: dict[str, tuple[EntryPoint, ...]] = {}
    for point in _points(group):
        if point.name not in own_names:
            points[point.name] = (*points.get(point.name, ()), point)
    return points


def _package(point: EntryPoint) -> str:
    """The name of the package that an entry point comes with, as in the index."""
    return "unknown" if point.dist is None else point.dist.name.lower().replace("_", "-")


@cache
def _built_in(group: str, kind: type[Declaration], word: str) -> Mapping[str, Declaration]:
    points = [point for point in _points(group) if _package(point) == OWN_PACKAGE]
    loaded = {point.name: _loaded(point, kind, word) for point in points}
    return {name: declaration for name, declaration in loaded.items() if declaration is not None}


@cache
def _load(group: str, kind: type[Declaration], word: str, name: str) -> None:
    declaration = _loaded(_foreign_points(group)[name][0], kind, word)
    if declaration is not None:
        _taken.setdefault(group, {})[name] = declaration


def _loaded(point: EntryPoint, kind: type[Declaration], word: str) -> Declaration | None:
    try:
        declaration = point.load()
        if not isinstance(declaration, kind):
            raise TypeError(f"{point.value} is a {type(declaration).__name__}, not a {kind.__name__}")
        if declaration.name != point.name:
            raise ValueError(f"it calls itself {declaration.name!r}")
    except Exception as error:
        message = f"the {word} {point.name!r} of {_package(point)} is left out: {error}"
        warnings.warn(message, RuntimeWarning, stacklevel=4)
        return None
    return declaration
