"""Notices: what of an input is not used, or not as it stands there."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TextIO

from bayesnet_track.numerics.compile_watch import CacheWarning
from bayesnet_track.observation.settings import CalibrationNotice, callers_depth

SHOWN = 5


class InputNotice(UserWarning):
    """Part of an input is not used, or not as it stands there. The command line prints the sentence."""


HEARD = (InputNotice, CacheWarning, CalibrationNotice)
"""What the command line prints by itself."""


def notice(text: str) -> None:
    """Warn of `text` at the line outside of this package that led here.

    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     notice("tracks.csv: 2 of 30 boxes are left out")
    >>> print(caught[0].message)
    tracks.csv: 2 of 30 boxes are left out
    """
    warnings.warn(text, InputNotice, stacklevel=callers_depth())


@contextmanager
def heard(hear: Callable[[str], object]) -> Iterator[None]:
    """Hand each notice given inside to `hear`, once for each text, instead of warning of it."""
    delivered: set[str] = set()
    former = warnings.showwarning

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if not issubclass(category, HEARD):
            former(message, category, filename, lineno, file, line)
        elif str(message) not in delivered:
            delivered.add(str(message))
            hear(str(message))

    with warnings.catch_warnings():
        for kind in HEARD:
            warnings.simplefilter("always", kind)
        warnings.showwarning = show
        yield


def few(values: Sequence[object]) -> str:
    """The first values, and how many more there are, for messages.

    >>> few([3, 4, 9])
    '3, 4, 9'
    >>> few(range(100))
    '0, 1, 2, 3, 4 and 95 more'
    """
    text = ", ".join(map(str, values[:SHOWN]))
    return text if len(values) <= SHOWN else f"{text} and {len(values) - SHOWN} more"
