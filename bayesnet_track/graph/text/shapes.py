"""Type annotations of the specification taken apart, and what a value of one looks like, in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from bayesnet_track.graph.settings.base import Choice, PluginChoice
from bayesnet_track.graph.text.messages import listed, shown_name


@dataclass(frozen=True)
class Shape:
    """A type annotation taken apart: alternatives without None, each with its constraints."""

    kinds: tuple[Any, ...]
    constraints: tuple[Any, ...] = ()

    @property
    def only(self) -> Any:
        """The single alternative, or None."""
        return self.kinds[0] if len(self.kinds) == 1 else None


def shape_of(annotation: Any, constraints: Iterable[Any] = ()) -> Shape:
    """Strips `Annotated` and `None` off an annotation."""
    flat = list(_flatten(constraints))
    while True:
        if hasattr(annotation, "__metadata__"):
            flat += _flatten(annotation.__metadata__)
            annotation = annotation.__origin__
            continue
        members = [a for a in get_args(annotation) if a is not type(None)] if _is_union(annotation) else []
        if len(members) != 1:
            break
        annotation = members[0]
    return Shape(tuple(members or [annotation]), tuple(flat))


def expects(annotation: Any, constraints: Iterable[Any] = ()) -> str:
    """What a value of this type looks like, in words; empty for a type the language does not use.

    >>> from bayesnet_track.graph.settings.base import Share
    >>> expects(Share), expects(Literal["map", "best"] | None)
    ('a number above 0, at most 1', 'one of map, best')
    """
    shape = shape_of(annotation, constraints)
    if shape.only is None:
        return " or ".join(filter(None, (expects(kind) for kind in shape.kinds)))
    kind = shape.only
    origin = get_origin(kind)
    if origin is Literal:
        words = [shown_name(word) for word in get_args(kind)]
        return words[0] if len(words) == 1 else f"one of {', '.join(words)}"
    if origin is tuple or origin is list:
        return f"a list, each {expects(get_args(kind)[0])}"
    if origin is not None and issubclass(origin, Mapping):
        return f"a mapping, each {expects(get_args(kind)[1])}"
    if not isinstance(kind, type):
        return ""
    if issubclass(kind, Choice):
        return f"one of {', '.join(kind.model_fields)}"
    if issubclass(kind, PluginChoice):
        return f"a {kind.WORD}, or one {kind.WORD} with its parameters"
    if issubclass(kind, BaseModel):
        return f"a mapping with {listed(kind.model_fields)}" if kind.model_fields else "no settings"
    plain = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}.get(kind, "")
    if not plain:
        return ""
    if any(_get(c, "pattern") for c in shape.constraints):
        return "a letter, then up to 63 letters, digits or _"
    return plain + ",".join(_limits(shape.constraints))


def _limits(constraints: Iterable[Any]) -> Iterator[str]:
    words = (
        ("gt", " above {}"),
        ("ge", " at least {}"),
        ("lt", " below {}"),
        ("le", " at most {}"),
        ("multiple_of", " a multiple of {}"),
        ("max_length", " of at most {} characters"),
    )
    for constraint in constraints:
        for attribute, text in words:
            bound = _get(constraint, attribute)
            if bound is not None:
                yield text.format(f"{bound:.15g}" if isinstance(bound, float) else bound)


def _flatten(constraints: Iterable[Any]) -> Iterator[Any]:
    for constraint in constraints:
        if isinstance(constraint, FieldInfo):
            yield from constraint.metadata
        else:
            yield constraint


def _get(constraint: Any, attribute: str) -> Any:
    return getattr(constraint, attribute, None)


def _is_union(annotation: Any) -> bool:
    return get_origin(annotation) in (Union, UnionType)
