"""A function per event class that writes its events as JSON text, made once from the types of its fields.

Every frame is written, with a cloud of hypotheses each: walking through the types anew for every value took a
quarter of a small net's frame.
"""

from __future__ import annotations

import math
import operator
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import lru_cache
from itertools import chain
from json.encoder import encode_basestring_ascii
from typing import Any, Union, get_args, get_origin, get_type_hints

FLOAT_DIGITS = 9
_FORM = f"%.{FLOAT_DIGITS}g"
NON_FINITE: Mapping[str, float] = types.MappingProxyType(
    {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
)

Encoder = Callable[[Any], str]
"""The JSON text of a value."""

_NOTHING = object()
"""Equal to no value."""


class EncodedCloud(tuple[tuple[int, ...], ...]):
    """Lists of whole numbers with their text, which was made with those of other targets."""

    text: str


def encode_clouds(lists: Any) -> list[EncodedCloud]:
    """Each of the lists (T, N, 4), whole numbers, with its text.

    >>> import numpy as np
    >>> encode_clouds(np.array([[[1, 2, 3, 4]], [[5, 6, 7, 8]]]))[1].text
    '[[5, 6, 7, 8]]'
    """
    from bayesnet_track.numerics.kernels.text_kernels import texts_of

    numbers, size = iter(lists.ravel().tolist()), lists.shape[1]
    rows = [*zip(numbers, numbers, numbers, numbers, strict=True)]
    clouds = [EncodedCloud(rows[first : first + size]) for first in range(0, len(rows), size)]
    for cloud, text in zip(clouds, texts_of(lists), strict=True):
        cloud.text = text
    return clouds


class JournalError(ValueError):
    """A line that is no event, or an event that is no line."""


def key_of(item: Field[Any]) -> str:
    """The key of a dataclass' field in the file: its name, or the `key` of its metadata."""
    return str(item.metadata.get("key", item.name))


def _encoder_of(hint: Any, place: str) -> Encoder:
    """Raises, when it writes, TypeError, ValueError or KeyError where a value is not of the type."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (types.UnionType, Union):
        return _of_union(inner, place)
    if origin is tuple:
        return _of_list(inner[0], place) if inner[-1] is Ellipsis else _of_tuple(inner, place)
    if origin is not None and issubclass(origin, Mapping):
        return _of_mapping(inner[1], place)
    if is_dataclass(hint):
        return _of_dataclass(hint, place)
    return _SIMPLE[hint]


def members_encoder(kind: Any, place: str) -> Callable[[Any], list[str]]:
    """A writer of the objects of a dataclass: `"name": value` of each field, in order.

    `place` names the object in errors. The function that is returned raises:
        JournalError: a value is not of its field's type.
    """
    hints = get_type_hints(kind)
    parts = [
        (
            item.name,
            hints[item.name],
            f"{encode_basestring_ascii(key_of(item))}: ",
            _encoder_of(hints[item.name], f"{place}.{item.name}"),
            _left_out(item),
        )
        for item in fields(kind)
    ]

    values_of = operator.attrgetter(*(name for name, *_ in parts), "__class__")

    def members(value: Any) -> list[str]:
        encode_clouds = []
        for member, (name, hint, key, encode, left_out) in zip(values_of(value), parts, strict=False):
            if left_out is not _NOTHING and member == left_out:
                continue
            try:
                encode_clouds.append(key + encode(member))
            except JournalError:
                raise
            except (TypeError, ValueError, KeyError) as error:
                raise JournalError(f"{place}.{name}: {short(repr(member))} is not {hint}: {error}") from error
        return encode_clouds

    return members


def _left_out(item: Field[Any]) -> Any:
    """The value of a field that is not written: its default, where it is marked; else one that none has."""
    if not item.metadata.get("left_out_when_empty"):
        return _NOTHING
    return item.default if item.default_factory is MISSING else item.default_factory()


def _of_dataclass(hint: Any, place: str) -> Encoder:
    members = members_encoder(hint, place)

    def encode(value: Any) -> str:
        if type(value) is not hint:
            raise TypeError(type(value).__name__)
        return f"{{{', '.join(members(value))}}}"

    return encode


def _of_union(inner: tuple[Any, ...], place: str) -> Encoder:
    """By the member of the union that a value is of; the first when it is of none."""
    encoders = {kind: _encoder_of(kind, place) for kind in inner if kind is not types.NoneType}
    first = encoders.get(inner[0], _none)
    if types.NoneType in inner:
        encoders[types.NoneType] = _none

    def encode(value: Any) -> str:
        return encoders.get(type(value), first)(value)

    return encode


def _of_list(item: Any, place: str) -> Encoder:
    if item is int:
        return _ints
    if item is float:
        return _floats
    if item == tuple[int, ...]:
        return _int_lists
    encode_item = _encoder_of(item, place)

    def encode(value: Any) -> str:
        return f"[{', '.join([encode_item(part) for part in value])}]"

    return encode


def _of_tuple(items: tuple[Any, ...], place: str) -> Encoder:
    encoders = [_encoder_of(item, place) for item in items]

    def encode(value: Any) -> str:
        return f"[{', '.join([encoder(part) for encoder, part in zip(encoders, value, strict=True)])}]"

    return encode


def _of_mapping(item: Any, place: str) -> Encoder:
    encode_item = _encoder_of(item, place)

    def encode(value: Any) -> str:
        return f"{{{', '.join([f'{_key(key)}: {encode_item(value[key])}' for key in sorted(value)])}}}"

    return encode


def _float(value: Any) -> str:
    text = f"{value:.{FLOAT_DIGITS}g}"
    if "." in text and "e" not in text:
        return text  # as Python's own shortest form of these digits
    number = float(value)
    if not math.isfinite(number):
        return '"NaN"' if math.isnan(number) else '"Infinity"' if number > 0 else '"-Infinity"'
    return repr(float(text) + 0.0)


def _floats(value: Any) -> str:
    """All at once, where all are written with a point and without an exponent."""
    numbers = tuple(value)
    text = _list_of(_FORM, len(numbers)) % numbers
    if text.count(".") == len(numbers) and "e" not in text:
        return text
    return f"[{', '.join(map(_float, numbers))}]"


def _int(value: Any) -> str:
    number = operator.index(value)
    return _bool(number) if isinstance(number, bool) else int.__repr__(number)


def _ints(value: Any) -> str:
    numbers = [operator.index(number) for number in value]
    if {*map(type, numbers)} <= {int}:
        return repr(numbers)
    return f"[{', '.join(map(_int, numbers))}]"


def _int_lists(value: Any) -> str:
    """A cloud has hundreds of numbers, four a row: they are written at once where all are Python's own."""
    if type(value) is EncodedCloud:
        return value.text
    numbers = (*chain.from_iterable(value),)
    if {*map(len, value)} == {4} and {*map(type, numbers)} == {int}:
        return _list_of("[%d, %d, %d, %d]", len(value)) % numbers
    return f"[{', '.join(map(_ints, value))}]"


@lru_cache(maxsize=64)
def _list_of(form: str, count: int) -> str:
    return f"[{', '.join([form] * count)}]"


def _bool(value: Any) -> str:
    return "true" if value else "false"


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("not a text")
    return encode_basestring_ascii(str(value))


@lru_cache(maxsize=1024)
def _key(value: Any) -> str:
    return _text(value)


def _none(value: Any) -> str:
    if value is not None:
        raise TypeError("not null")
    return "null"


def short(text: str) -> str:
    """The text, cut for a message."""
    return text if len(text) <= 120 else f"{text[:117]}..."


_SIMPLE: Mapping[Any, Encoder] = types.MappingProxyType({float: _float, int: _int, bool: _bool, str: _text})
