"""Elements of SVG, their text and attributes escaped, and scales over frames."""

from __future__ import annotations

import math
import re
from html import escape

_ILLEGAL = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 does not allow even when escaped."""


def xml_text(value: object) -> str:
    """`value` as XML text: escaped, characters that XML forbids replaced."""
    return escape(_ILLEGAL.sub("\ufffd", str(value)), quote=True)


def element(name: str, content: str | None = None, /, **attributes: object) -> str:
    """One element; `content` is markup already. Underscores in attribute names stand for hyphens.

    >>> element("line", x1=1.0, y1=2.5, stroke_width=2, class_="a<b")
    '<line x1="1" y1="2.5" stroke-width="2" class="a&lt;b"/>'
    """
    pairs = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{_value(value)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return f"<{name}{pairs}/>" if content is None else f"<{name}{pairs}>{content}</{name}>"


COLUMNS = 900
"""Curves are thinned to this many columns, each with its lowest and highest value."""
Points = list[tuple[float, float]]


def document(width: float, height: float, title: str, description: str, body: list[str]) -> str:
    """A whole SVG file with an accessible title and description, on a white ground."""
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-labelledby="title description" '
        f'width="{_value(width)}" height="{_value(height)}" viewBox="0 0 {_value(width)} {_value(height)}">'
    )
    parts = [
        head,
        element("title", xml_text(title), id="title"),
        element("desc", xml_text(description), id="description"),
        element("rect", width=width, height=height, fill="#ffffff"),
        *body,
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _value(value: object) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else xml_text(value)


def ticks(first: int, end: int, max_ticks: int = 10) -> list[int]:
    """Round frame numbers, at most one more than `max_ticks`.

    >>> ticks(0, 199)
    [0, 20, 40, 60, 80, 100, 120, 140, 160, 180]
    """
    step = next(
        size * 10**power
        for power in range(19)
        for size in (1, 2, 5)
        if (end - first) / (size * 10**power) <= max_ticks
    )
    return list(range(-(-first // step) * step, end + 1, step))


def decades(low: float, high: float, max_ticks: int = 8) -> list[float]:
    """1, 2, 5 times powers of ten inside a scale; powers of ten alone when there would be too many.

    >>> decades(30.0, 1200.0)
    [50.0, 100.0, 200.0, 500.0, 1000.0]
    """
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1, 2, 5), (1,)):
        levels = [step * 10.0**e for e in exponents for step in steps if low <= step * 10.0**e <= high]
        if len(levels) <= max_ticks:
            return levels
    return levels[:: math.ceil(len(levels) / max_ticks)]


def thin(points: Points) -> Points:
    """At most two points per column of a picture: the lowest and the highest, in their order."""
    if len(points) <= 2 * COLUMNS:
        return points
    thinned: Points = []
    for start in range(COLUMNS):
        some = points[start * len(points) // COLUMNS : (start + 1) * len(points) // COLUMNS]
        ends = {some.index(min(some, key=lambda p: p[1])), some.index(max(some, key=lambda p: p[1]))}
        thinned += [some[k] for k in sorted(ends)]
    return thinned
