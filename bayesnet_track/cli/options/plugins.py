"""The options by which code from elsewhere is allowed to run: plug-ins of other packages, cue files."""

from __future__ import annotations

import argparse


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
