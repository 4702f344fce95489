"""Settings in messages: options where the command line speaks, parameters where Python does."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PACKAGE = str(Path(__file__).resolve().parents[1])

PARAMETERS = {
    "--allow-network": "allow_network=True",
    "--allow-other-machine": "allow_other_machine=True",
    "--allow-plugins": "allow_plugins",
    "--board": "board",
    "--calibration": "calibration",
    "--cue-file": "cues",
    "--depth": "depth",
    "--detections": "detections",
    "--draws": "draws",
    "--end": "end",
    "--executor": "executor",
    "--hosts": "hosts",
    "--keep-beliefs": "keep_beliefs=True",
    "--map": "most_probable=True",
    "--no-live": "live=False",
    "--overwrite": "overwrite=True",
    "--range": "value_range",
    "--right": "right",
    "--set": "changes",
    "--start": "start",
    "--stereo": "side_by_side",
    "--stride": "stride",
    "--truth-format": "form",
    "--workers": "workers",
}
"""Option -> the parameter of the functions that take it, with the value that a flag stands for."""

_commands: list[None] = []
"""One for each command that is carried out in this process."""


class CalibrationNotice(UserWarning):
    """Part of a calibration is not used, or looks unlikely. The command line prints the sentence."""


def callers_depth() -> int:
    """`stacklevel` with which the function that asks warns at the line outside of this package."""
    frame, depth = sys._getframe(2), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGE):
        frame, depth = frame.f_back, depth + 1
    return depth


@contextmanager
def by_command_line() -> Iterator[None]:
    """While it lasts, messages speak to who reads them in a terminal: `setting` names options."""
    _commands.append(None)
    try:
        yield
    finally:
        _commands.pop()


def setting(option: str, value: str = "", in_python: str | None = None) -> str:
    """Words for a setting: an option with its value, or a parameter, whose value is `in_python`.

    >>> setting("--range", "0,255", "(0, 255)")
    'value_range=(0, 255)'
    >>> with by_command_line():
    ...     setting("--range", "0,255", "(0, 255)")
    '--range 0,255'
    """
    joint = "=" if value.startswith("-") else " " if value else ""
    name, equals, fixed = PARAMETERS[option].partition("=")
    return to_caller(
        f"{option}{joint}{value}",
        f"{name}={fixed if equals else value if in_python is None else in_python}",
    )


def to_caller(command_line: str, python: str) -> str:
    """The words for who reads a message: of a command, or of a program that calls the functions.

    >>> to_caller("choose another --start", "choose another frame")
    'choose another frame'
    """
    return command_line if _commands else python
