"""Reading JSON, XML and numbers of files that others wrote, with errors that say what is wrong."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as Tree
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bayesnet_track.runtime.annotation.answers import Box
from bayesnet_track.runtime.annotation.formats.document import MismatchError

CHUNK = 1 << 16
LARGEST_FRAME = 10**9


def read_json(path: Path) -> Any:
    """The content of a JSON file in UTF-8, UTF-16 or UTF-32; raises MismatchError where it is none."""
    try:
        return json.loads(path.read_bytes(), object_pairs_hook=_once)
    except RecursionError as error:
        raise MismatchError(f"{path}: it is no JSON that can be read (nested too deeply)") from error
    except ValueError as error:
        raise MismatchError(f"{path}: it is no JSON ({error})") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen = set[str]()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"an object has the key {twice!r} twice")
    return found


class _Builder(Tree.TreeBuilder):
    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise MismatchError("it has a <!DOCTYPE>, which may declare entities; CVAT writes none")


def read_xml(path: Path) -> Tree.Element:
    """The root of an XML file without a DTD, in any encoding; raises MismatchError where it is none."""
    parser = Tree.XMLParser(target=_Builder())
    data = path.read_bytes()
    try:
        for start in range(0, len(data), CHUNK):  # an error in a chunk ends it
            parser.feed(data[start : start + CHUNK])
        root: Tree.Element = parser.close()
    except MismatchError as error:
        raise MismatchError(f"{path}: {error}") from error
    except (Tree.ParseError, ValueError, LookupError) as error:
        raise MismatchError(f"{path}: it is no XML ({error})") from error
    return root


def number(value: object, name: str, place: str) -> float:
    """A number, or a text of one; NaN and infinity are numbers here. Raises MismatchError."""
    try:
        if not isinstance(value, str | int | float) or isinstance(value, bool):
            raise ValueError
        return float(value)
    except OverflowError:
        return math.inf
    except ValueError as error:
        raise MismatchError(f"{place}: {name} {_shown(value)}; a number is needed") from error


def whole(value: object, name: str, place: str) -> int:
    """A whole number below 10⁹, or a text of one; raises MismatchError."""
    found = number(value, name, place)
    if not (math.isfinite(found) and found.is_integer() and abs(found) <= LARGEST_FRAME):
        raise MismatchError(f"{place}: {name} {_shown(value)}; a whole number is needed")
    return int(found)


def corner_box(values: object, name: str, place: str) -> Box:
    """Four numbers x, y, w, h; raises MismatchError."""
    if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != 4:
        raise MismatchError(f"{place}: {name} {_shown(values)}; four numbers x, y, w, h are needed")
    x, y, w, h = (number(value, name, place) for value in values)
    return x, y, w, h


def identity(value: object, name: str, place: str) -> str:
    """An identity as text, exactly: a number is the same as its text. Raises MismatchError."""
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int | str) or value == "":
        raise MismatchError(f"{place}: {name} {_shown(value)}; a whole number or a text is needed")
    return str(value)


def needed(one: object, keys: Iterable[str], place: str) -> Mapping[str, Any]:
    """An object that has all the keys; raises MismatchError."""
    if not isinstance(one, Mapping):
        raise MismatchError(f"{place}: {_shown(one)}; an object is needed")
    for key in keys:
        if key not in one:
            raise MismatchError(f"{place}: the key {key!r} is missing; it has {', '.join(one) or 'none'}")
    return one


def listed(values: object, place: str) -> list[Any]:
    """A list; raises MismatchError."""
    if not isinstance(values, list):
        raise MismatchError(f"{place}: {_shown(values)}; a list is needed")
    return values


def _shown(value: object) -> str:
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**40 else "a number of many digits"
    return text if len(text) <= 60 else f"{text[:57]}..."
