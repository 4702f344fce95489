"""Finding what installed packages declare through an entry-point group, the built-in ones included."""

from __future__ import annotations

import warnings
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, TypeVar


class Named(Protocol):
    """A declaration with a name."""

    @property
    def name(self) -> str:
        """The word that users write."""
        ...


Declaration = TypeVar("Declaration", bound=Named)


def declared(group: str, kind: type[Declaration], word: str) -> dict[str, Declaration]:
    """Every declaration of `kind` in the group, by name, sorted.

    A package whose declaration cannot be loaded, or has the name of another, is left out with a warning that
    calls it a `word`: it must not keep the others from working.
    """
    found: dict[str, Declaration] = {}
    for point in sorted(entry_points(group=group), key=_built_in_first):
        try:
            declaration = point.load()
            if not isinstance(declaration, kind):
                raise TypeError(f"{point.value} is a {type(declaration).__name__}, not a {kind.__name__}")
            if declaration.name in found:
                raise ValueError(f"another {word} has the name {declaration.name!r}")
        except Exception as error:
            where = f"of {point.dist.name} " if point.dist is not None else ""
            message = f"the {word} {point.name!r} {where}is left out: {error}"
            warnings.warn(message, RuntimeWarning, stacklevel=3)
            continue
        found[declaration.name] = declaration
    return dict(sorted(found.items()))


def _built_in_first(point: EntryPoint) -> tuple[bool, str, str]:
    return not point.value.startswith("bayesnet_track."), point.name, point.value
