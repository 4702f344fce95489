"""Events as lines of JSON and back, for any frozen dataclass of the journal.

A line is ``{"event": <snake_case class name>, <field>: <value>, ...}``: fields in the order of the class,
keys of mappings sorted, floats rounded to 9 significant digits (so that lines are stable and readable),
ASCII only. JSON has no NaN and no infinity; such a float is written as the string "NaN", "Infinity" or
"-Infinity".
"""

from __future__ import annotations

import json
import re
import types
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

from bayesnet_track.journal.encoder import NON_FINITE, JournalError, key_of, members_encoder, short
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.events.runs import JOURNAL_VERSION, RunStarted
from bayesnet_track.journal.metrics import FrameMetrics

__all__ = [
    "JournalError",
    "check_version",
    "describe_other",
    "event_classes",
    "event_name",
    "field_names",
    "from_json",
    "to_json",
    "type_hints",
]

LARGEST = 2**64
"""What a whole number of a journal may be: identities have 64 bits, and sentences are made with floats."""

_CAPITAL = re.compile(r"(?<!^)(?=[A-Z])")


def event_name(kind: type) -> str:
    """The name of an event class in the file.

    >>> event_name(FrameMetrics)
    'frame_metrics'
    """
    return _CAPITAL.sub("_", kind.__name__).lower()


@cache
def event_classes() -> Mapping[str, type]:
    """Every class that a line may hold, by its name in the file."""
    kinds = (*get_args(Event), *get_args(Input), FrameMetrics)
    return types.MappingProxyType({event_name(kind): kind for kind in kinds})


def to_json(event: Event | Input | FrameMetrics) -> str:
    """The line of an event, without its newline.

    Raises:
        JournalError: a value is not of its field's type.
    """
    kind: Any = type(event)  # a union of classes is not hashable to mypy
    begin, members = _writing(kind)
    return f"{{{', '.join([begin, *members(event)])}}}"


def from_json(line: str) -> Event | Input | FrameMetrics:
    """The event of a line: the inverse of `to_json`, up to the rounding of floats.

    Raises:
        JournalError: not JSON, an unknown event, unknown or missing fields, or a value of another type.
    """
    try:
        values = json.loads(line, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise JournalError(f"not a line of JSON ({error}): {short(line)}") from error
    if not isinstance(values, dict) or not isinstance(values.get("event"), str):
        raise JournalError(f'no object with a key "event": {short(line)}')
    name = values.pop("event")
    kind = event_classes().get(name)
    if kind is None:
        raise JournalError(
            f"unknown event {name!r} (of a newer version?); known: {', '.join(sorted(event_classes()))}: "
            f"{short(line)}"
        )
    if kind is RunStarted:
        check_version(values)
    decoded: Event | Input | FrameMetrics = _decode_object(values, kind, name)
    return decoded


def describe_other(problem: str, versions: object, verb: str = "read") -> str:
    """The sentence that refuses such a file.

    Args:
        problem: what of the file is of another version.
        versions: library -> version, as the file has them; anything else where it does not say.
        verb: what to do with it in that version.

    >>> describe_other("format 1 of journals; this version reads format 2", {"bayesnet-track": "0.1.0"})
    ... # doctest: +NORMALIZE_WHITESPACE
    'format 1 of journals; this version reads format 2: read it with bayesnet-track 0.1.0, which wrote it
    (python -m pip install bayesnet-track==0.1.0)'
    """
    writer = versions.get("bayesnet-track") if isinstance(versions, Mapping) else None
    if not isinstance(writer, str):
        return f"{problem}: {verb} it with the version of bayesnet-track that wrote it"
    name = "".join(c for c in writer[:40] if c.isprintable())
    return (
        f"{problem}: {verb} it with bayesnet-track {name}, which wrote it "
        f"(python -m pip install bayesnet-track=={name})"
    )


def check_version(values: Mapping[str, Any]) -> None:
    """Refuse a journal of another format by the members of its first line; raises JournalError."""
    number = values.get("journal")
    if type(number) is int and number != JOURNAL_VERSION:
        problem = f"format {short(str(number))} of journals; this version reads format {JOURNAL_VERSION}"
        raise JournalError(describe_other(problem, values.get("versions")))


@cache
def _writing(kind: Any) -> tuple[str, Callable[[Any], list[str]]]:
    """The beginning of the lines of a class, and the function that writes the members after it."""
    name = event_name(kind)
    if event_classes().get(name) is not kind:
        raise JournalError(f"{kind.__name__} is not an event of the journal")
    return f'"event": "{name}"', members_encoder(kind, name)


@cache
def type_hints(kind: Any) -> Mapping[str, Any]:
    """The types of a dataclass' fields, in order."""
    hints = get_type_hints(kind)
    return {item.name: hints[item.name] for item in fields(kind)}


@cache
def field_names(kind: Any) -> Mapping[str, str]:
    """Key in the file -> name of the dataclass' field, in order."""
    return {key_of(item): item.name for item in fields(kind)}


def _decode(value: Any, hint: Any, place: str) -> Any:
    if type(value) is hint and (hint is not int or -LARGEST <= value <= LARGEST):
        return value
    shape, inner = _shape(hint)
    if shape == "union":
        return None if _absent(inner, value) else _decode(value, _member_with(inner, value), place)
    if shape == "tuple" and isinstance(value, list):
        hints = _per_item(inner, value)
        if tuple(map(type, value)) == hints:  # as most are: nothing is left to decode
            return tuple(value)
        if len(hints) == len(value):
            return tuple(_decode(item, h, place) for item, h in zip(value, hints, strict=True))
    elif shape == "mapping" and isinstance(value, dict):
        return {key: _decode(item, inner[1], place) for key, item in value.items()}
    elif is_dataclass(hint) and isinstance(value, dict):
        return _decode_object(value, hint, place)
    elif hint is float and isinstance(value, str) and value in NON_FINITE:
        return NON_FINITE[value]
    elif hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        with suppress(OverflowError):  # an integer of more than 308 digits
            return float(value)
    raise JournalError(f"{place}: {short(repr(value))} is not {getattr(hint, '__name__', hint)}")


def _decode_object(values: Mapping[str, Any], kind: Any, place: str) -> Any:
    hints, names = type_hints(kind), field_names(kind)
    unknown, missing = values.keys() - names.keys(), _needed(kind) - values.keys()
    if unknown or missing:
        raise JournalError(f"{place}: unknown fields {sorted(unknown)}, missing fields {sorted(missing)}")
    return kind(
        **{names[key]: _decode(value, hints[names[key]], f"{place}.{key}") for key, value in values.items()}
    )


@cache
def _needed(kind: Any) -> frozenset[str]:
    """Keys that an object of a dataclass cannot lack."""
    without = (item for item in fields(kind) if item.default is MISSING and item.default_factory is MISSING)
    return frozenset(map(key_of, without))


@cache
def _shape(hint: Any) -> tuple[str, tuple[Any, ...]]:
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (types.UnionType, Union):
        return "union", inner
    if origin is tuple:
        return "tuple", inner
    if origin is not None and issubclass(origin, Mapping):
        return "mapping", inner
    return "simple", ()


def _absent(inner: tuple[Any, ...], value: Any) -> bool:
    return value is None and types.NoneType in inner


def _member_with(inner: tuple[Any, ...], value: Any) -> Any:
    """The member of a union that has the most keys of an object, in order; the first for other values."""
    if not isinstance(value, Mapping):
        return inner[0]
    members: list[Any] = [kind for kind in inner if is_dataclass(kind)]
    if not members:
        return inner[0]
    return max(members, key=lambda kind: len(type_hints(kind).keys() & value.keys()))


def _per_item(inner: tuple[Any, ...], value: Any) -> tuple[Any, ...]:
    return (inner[0],) * len(value) if inner[-1] is Ellipsis else inner


def _no_constant(word: str) -> Any:
    raise ValueError(f"{word} is not JSON")
