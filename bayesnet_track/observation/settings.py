"""Settings in messages: options where the command line speaks, parameters where Python does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

PARAMETERS = {
    "--detections": "detections",
    "--end": "end",
    "--range": "value_range",
    "--start": "start",
    "--stride": "stride",
    "--truth-format": "form",
}
"""Option -> the parameter of the functions that take it."""

_commands: list[None] = []
"""One for each command that is carried out in this process."""


@contextmanager
def by_command_line() -> Iterator[None]:
    """While it lasts, `setting` names options."""
    _commands.append(None)
    try:
        yield
    finally:
        _commands.pop()


def setting(option: str, value: str = "", in_python: str | None = None) -> str:
    """How a setting is given: as an option with its value, or as a parameter, whose value is `in_python`.

    >>> setting("--range", "0,255", "(0, 255)")
    'value_range=(0, 255)'
    >>> with by_command_line():
    ...     setting("--range", "0,255", "(0, 255)")
    '--range 0,255'
    """
    if _commands:
        joint = "=" if value.startswith("-") else " " if value else ""
        return f"{option}{joint}{value}"
    return f"{PARAMETERS[option]}={value if in_python is None else in_python}"
