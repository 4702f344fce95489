"""Parsers of single values on the command line; what they refuse is told by argparse."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable


def whole_number(least: int) -> Callable[[str], int]:
    """Parser of whole numbers from `least` on."""

    def parse(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 19 and int(text) >= least):
            raise argparse.ArgumentTypeError(f"{text!r}: a whole number from {least} on is needed")
        return int(text)

    return parse


def number(needed: str, below: float = math.inf, most: float = math.inf) -> Callable[[str], float]:
    """Parser of finite numbers above 0, less than `below` and at most `most`; `needed` says so."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not (0.0 < value < below and value <= most):
            raise argparse.ArgumentTypeError(f"{text!r}: {needed}")
        return value

    return parse


metres = number("a length above 0 in metres is needed", below=1e6)
pixels = number("a distance above 0 in px is needed", below=1e9)
milliseconds = number("milliseconds above 0 are needed", below=1e7)
seconds = number("a number of seconds above 0 is needed", below=1e6)
gradient = number("a number above 0, at most 100 is needed", most=100.0)
share = number("a number above 0, at most 1 is needed", most=1.0)


def cells(text: str) -> int:
    """Parser of the cells of a shape grid."""
    if not (text.isascii() and text.isdigit() and 4 <= int(text[:4]) <= 64 and len(text) < 4):
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number from 4 to 64 is needed")
    return int(text)
