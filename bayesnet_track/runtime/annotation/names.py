"""Names of targets: one rule for page, imports and files of answers, and what stands in for a bad name."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable
from functools import partial
from itertools import count

LONGEST_NAME = 80
LONGEST_LABEL = LONGEST_NAME - 10
"""Of a mended name: behind it there is room for a number."""


def describe_fault(name: object) -> str | None:
    """Why a target cannot have this name; None where it can.

    >>> describe_fault("ball 1")
    >>> describe_fault("ball\\u00a01")
    "target 'ball\\\\xa01': a name is printable, on one line"
    """
    if not isinstance(name, str) or not name.strip() or len(name) > LONGEST_NAME:
        return f"a target needs a name of 1 to {LONGEST_NAME} characters"
    if not name.isprintable():
        return f"target {name!r}: a name is printable, on one line"
    if name != name.strip():
        return f"target {name!r}: a name neither begins nor ends with a space"
    return None


def mend_names(
    names: Iterable[str], is_others: Callable[[str, str], bool] = lambda name, new: False
) -> dict[str, str]:
    """Bad name -> the name in its place, of those that have a fault. Two names never become one.

    `is_others` says of a bad name and a new one whether the new one is another target's.

    Other spaces and control characters become a space, what else is not printable goes, and what is too long
    is cut. A name that is taken gets the next free number.

    >>> mend_names(["ball 1", "ball\\u00a01", "\\tcar  1", ""])
    {'ball\\xa01': 'ball 2', '\\tcar  1': 'car 1', '': 'target 1'}
    """
    given = dict.fromkeys(names)
    taken = {name for name in given if describe_fault(name) is None}
    mended = {}
    for name in given:
        if name not in taken:
            mended[name] = _find_free(_tidy(name), partial(_is_taken, name, taken, is_others))
            taken.add(mended[name])
    return mended


def describe_mended(mended: dict[str, str]) -> str:
    """A sentence about names that were mended, each as it is from now on."""
    shown = ", ".join(f"{_short(name)} is now {new!r}" for name, new in list(mended.items())[:5])
    more = f", and {len(mended) - 5} more" if len(mended) > 5 else ""
    return (
        f"names of targets are printable, on one line, of 1 to {LONGEST_NAME} characters, without a space at "
        f"either end: {shown}{more}"
    )


def find_alike(names: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs of different names that differ in case or in how a letter is encoded alone.

    >>> find_alike(["car 1", "Car 1", "car 2"])
    [('car 1', 'Car 1')]
    """
    first: dict[str, str] = {}
    pairs = []
    for name in dict.fromkeys(names):
        other = first.setdefault(unicodedata.normalize("NFKC", name).casefold(), name)
        if other != name:
            pairs.append((other, name))
    return pairs


def _tidy(name: str) -> str:
    spaced = "".join(map(_printable, name))
    return " ".join(spaced.split()) or "target 1"


def _printable(letter: str) -> str:
    if letter.isprintable():
        return letter
    return " " if letter.isspace() or unicodedata.category(letter) == "Cc" else ""


def _is_taken(name: str, taken: set[str], is_others: Callable[[str, str], bool], new: str) -> bool:
    return new in taken or is_others(name, new)


def _find_free(name: str, is_taken: Callable[[str], bool]) -> str:
    if len(name) <= LONGEST_NAME and not is_taken(name):
        return name
    label, number = re.fullmatch(r"(.*?)[ ]*(\d{0,6})", name).groups()  # type: ignore[union-attr]
    label = label[:LONGEST_LABEL].rstrip() or "target"
    return next(free for n in count(int(number or 1)) if not is_taken(free := f"{label} {n}"))


def _short(name: str) -> str:
    return repr(name) if len(name) <= 40 else f"{name[:40]!r}… ({len(name)} characters)"
