"""The arguments of `doctor`."""

from __future__ import annotations

import argparse
from typing import Any


def add_doctor(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    doctor = commands.add_parser(
        "doctor",
        help="check the installation, and print how to repair it",
        description="Check the installation: versions, OpenCV's wheels, codecs, caches, plug-ins, and ten "
        "frames of tracking. The exit code is 1 when something is broken. If nothing else works, "
        "this does: python -m bayesnet_track doctor",
    )
    doctor.add_argument("--json", action="store_true", help="print what was found as JSON")
