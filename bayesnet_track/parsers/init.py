"""The arguments of `init`."""

from __future__ import annotations

import argparse
from typing import Any

from bayesnet_track.cli.starter.ask import QUESTIONS


def add_init(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    init = commands.add_parser(
        "init",
        help="write a commented graph for a task, by a few answers",
        description="Write a graph for a task. In a terminal it asks what no option answers; elsewhere, or "
        "with --yes, the default stands for what is not given.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="\n".join(
            f"--{name}: {'several of' if several else 'one of'}\n"
            + "\n".join(f"  {word:12} {meaning}" for word, meaning in choices.items())
            for name, _, choices, several, _ in QUESTIONS
        ),
    )
    init.add_argument(
        "file", nargs="?", default="mine.yaml", metavar="FILE", help="graph file to write (default mine.yaml)"
    )
    for name, question, choices, several, default in QUESTIONS:
        words = "A,B,..." if several else "WORD"
        told = f"{question.split('?')[0]}? {', '.join(choices)} (default {default or 'nothing'})"
        init.add_argument(f"--{name}", metavar=words, help=told)
    init.add_argument("--yes", action="store_true", help="ask nothing")
    init.add_argument("--overwrite", action="store_true", help="replace the file if it is there")
