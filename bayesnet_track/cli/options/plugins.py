"""The option by which plug-ins of other packages are allowed to run."""

from __future__ import annotations

import argparse


def add_plugins(parser: argparse.ArgumentParser) -> None:
    """Add ``--allow-plugins`` to a command that reads graphs or loads detectors."""
    parser.add_argument(
        "--allow-plugins",
        action="append",
        default=[],
        type=_names,
        metavar="NAME,...",
        help="cues and detectors of other packages that may be loaded where they are named; see `list`",
    )


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]
