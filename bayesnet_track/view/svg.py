"""The few SVG elements that the pictures are made of; every text and attribute is escaped."""

from __future__ import annotations

import re
from html import escape

_ILLEGAL = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 does not allow even when escaped."""


def text_of(value: object) -> str:
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


def document(width: float, height: float, title: str, description: str, body: list[str]) -> str:
    """A whole SVG file with an accessible title and description, on a white ground."""
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-labelledby="title description" '
        f'width="{_value(width)}" height="{_value(height)}" viewBox="0 0 {_value(width)} {_value(height)}">'
    )
    parts = [
        head,
        element("title", text_of(title), id="title"),
        element("desc", text_of(description), id="description"),
        element("rect", width=width, height=height, fill="#ffffff"),
        *body,
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _value(value: object) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else text_of(value)
