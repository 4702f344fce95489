"""Parsers of single values on the command line; what they refuse is told by argparse."""

from __future__ import annotations

import argparse
from collections.abc import Callable


def whole_number(least: int) -> Callable[[str], int]:
    """Parser of whole numbers from `least` on."""

    def parse(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 19 and int(text) >= least):
            raise argparse.ArgumentTypeError(f"{text!r}: a whole number from {least} on is needed")
        return int(text)

    return parse


def metres(text: str) -> float:
    """Parser of lengths."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}: a length above 0 in metres is needed")
    return value


def pixels(text: str) -> float:
    """Parser of a distance in px."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r}: a distance above 0 in px is needed")
    return value


def milliseconds(text: str) -> float:
    """Parser of a time."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e7:
        raise argparse.ArgumentTypeError(f"{text!r}: milliseconds above 0 are needed")
    return value


def cells(text: str) -> int:
    """Parser of the cells of a shape grid."""
    if not (text.isascii() and text.isdigit() and 4 <= int(text[:4]) <= 64 and len(text) < 4):
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number from 4 to 64 is needed")
    return int(text)


def gradient(text: str) -> float:
    """Parser of a gradient in gray levels per pixel."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 100.0:
        raise argparse.ArgumentTypeError(f"{text!r}: a number above 0, at most 100 is needed")
    return value


def share(text: str) -> float:
    """Parser of a share above 0, at most 1."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r}: a number above 0, at most 1 is needed")
    return value
