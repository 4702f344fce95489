"""Options that several commands share, and the types of their values. Nothing heavy is imported."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import UsageError

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.observation.image_files import Mask


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


FORMS = ("mot", "boxes", "corners", "polygons")
"""Those of `evaluate.truth`, which is not imported before it is needed."""


def add_truth_format(parser: argparse.ArgumentParser) -> None:
    """`--truth-format`."""
    parser.add_argument(
        "--truth-format",
        choices=FORMS,
        help="what a line of the ground truth holds: MOT, x,y,w,h, left,top,right,bottom, or four corners "
        "(default: what the lines look like)",
    )


def add_plugins(parser: argparse.ArgumentParser) -> None:
    """Add ``--allow-plugins`` and ``--cue-file`` to a command that reads graphs or loads detectors."""
    parser.add_argument(
        "--allow-plugins",
        action="append",
        default=[],
        type=_names,
        metavar="NAME,...",
        help="cues and detectors of other packages that may be loaded; see `list`",
    )
    parser.add_argument(
        "--cue-file",
        action="append",
        default=[],
        metavar="FILE",
        help="Python file with a cue of your own, as CUE = CueDeclaration(...), which graphs may name; its "
        "code is run; may be repeated",
    )


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]


def add_set_option(parser: argparse.ArgumentParser) -> None:
    """`--set`, which may be repeated."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="change a value of the graph: keys joined by dots (targets, the plate and nodes may be "
        "left out), and YAML, as in square.adapt.activate.above.ud_px2=200; may be repeated",
    )


def set_values(
    text: str, changes: Sequence[str], adaptation: bool = True, masks: Mapping[str, Mask] | None = None
) -> CheckedGraph:
    """The graph of a canonical text with other values; `adaptation` is False for all agents always on.

    Raises:
        UsageError: a path or a value that is none; says which names there are, and the nearest.
        GraphError: what comes out fails a check.
    """
    from bayesnet_track.graph.text.change import ChangeError, change_graph

    try:
        return change_graph(text, changes, adaptation, masks)
    except ChangeError as error:
        raise UsageError(f"--set {error}") from error


def add_view_options(parser: argparse.ArgumentParser) -> None:
    """`--view`, `--view-host`, `--view-now`, `--open`."""
    group = parser.add_argument_group("live view")
    group.add_argument(
        "--view",
        nargs="?",
        const=0,
        type=_port,
        metavar="PORT",
        help="show the run live in a browser; it begins when its page is opened, and a missing start "
        "box can be drawn there (default port: a free one)",
    )
    group.add_argument(
        "--view-host",
        default="127.0.0.1",
        metavar="HOST",
        help="address that the view listens at (default 127.0.0.1: only this machine)",
    )
    group.add_argument("--view-now", action="store_true", help="begin before the page is opened")
    group.add_argument("--open", action="store_true", help="open the page in this machine's browser")


def add_address_options(parser: argparse.ArgumentParser) -> None:
    """`--port`, `--view-host`, `--open`, of a command that always has a view."""
    group = parser.add_argument_group("page")
    group.add_argument("--port", type=_port, metavar="PORT", help="port of the page (default a free one)")
    group.add_argument(
        "--view-host",
        default="127.0.0.1",
        metavar="HOST",
        help="address that the page listens at (default 127.0.0.1: this machine alone)",
    )
    group.add_argument("--open", action="store_true", help="open the page in this machine's browser")


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 6 and 1024 <= int(text) < 65536):
        raise argparse.ArgumentTypeError(f"{text!r}: a port from 1024 to 65535 is needed")
    return int(text)
