"""The arguments of `completion`."""

from __future__ import annotations

import argparse
from typing import Any

SHELLS = ("bash", "zsh", "fish")


def add_completion(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    completion = commands.add_parser(
        "completion",
        help="print what lets a shell complete commands, graphs, scenes and files",
        description="Print the completion script of a shell. It knows the graphs, scenes and detectors that "
        "are installed now: make it again after installing others.",
        epilog="bash:  bayesnet-track completion bash > "
        "~/.local/share/bash-completion/completions/bayesnet-track\n"
        "zsh:   bayesnet-track completion zsh > DIR/_bayesnet-track   (DIR is in $fpath)\n"
        "fish:  bayesnet-track completion fish > ~/.config/fish/completions/bayesnet-track.fish",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    completion.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash, zsh or fish")
