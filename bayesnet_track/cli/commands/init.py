"""The command `init`: a few answers become a commented graph, which is checked before it is written."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayesnet_track.cli.commands.answer import OK, UsageError, complain, say, writing
from bayesnet_track.cli.starter.ask import QUESTIONS, ask_all, chosen
from bayesnet_track.cli.starter.compose import graph_text
from bayesnet_track.cli.starter.task import Task

NO_NAMES = frozenset({"null", "true", "false"})
"""Words that YAML takes for something else."""


def init(options: argparse.Namespace) -> int:
    """Write a first graph for a task."""
    path = Path(options.file)
    with writing(path):
        if path.exists() and not options.overwrite:
            raise UsageError(f"{path} is there already; `--overwrite` replaces it")
    given = {name: getattr(options, name) for name, *_ in QUESTIONS if getattr(options, name) is not None}
    if options.yes or not sys.stdin.isatty():
        given = {name: default for name, *_, default in QUESTIONS} | given
    try:
        text = graph_text(_task(path, ask_all(given, _ask, complain)), str(path))
    except ValueError as error:
        raise UsageError(str(error)) from error
    _check(text)
    _write(path, text)
    say(f"wrote {path}; its first lines say what to do next")
    return OK


def _task(path: Path, answers: Mapping[str, str]) -> Task:
    """The task of these answers; the graph is called as the file is."""
    words = {}
    for name, _, choices, several, _ in QUESTIONS:
        try:
            words[name] = chosen(answers[name], choices, several)
        except ValueError as error:
            raise UsageError(f"--{name}: {error}") from error
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)[:60]
    return Task(
        name=name if name[:1].isalpha() and name.lower() not in NO_NAMES else f"graph_{name}",
        follow=words["follow"][0],
        apart=words["apart"],
        hard=frozenset(words["hard"]),
        speed=words["speed"][0],
        belief=words["belief"][0],
        budget=words["budget"][0],
    )


def _ask(prompt: str) -> str:
    sys.stderr.write(prompt)
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        raise UsageError("the answers ended; give the rest by options, or --yes")
    return line


def _check(text: str) -> None:
    """A graph that cannot be loaded would be an error of this program."""
    from bayesnet_track.graph.checks.run import check
    from bayesnet_track.graph.text.read import read_graph

    check(*read_graph(text, "init"))


def _write(path: Path, text: str) -> None:
    with writing(path):
        path.write_text(text, encoding="utf-8")


def add_init(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    init = commands.add_parser(
        "init",
        help="write a commented graph from a few answers about the task",
        description="Write a graph for a task. In a terminal it asks the questions that no option answers; "
        "elsewhere, or with --yes, it takes the defaults.",
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
        help_text = f"{question.split('?')[0]}? {', '.join(choices)} (default {default or 'nothing'})"
        init.add_argument(f"--{name}", metavar=words, help=help_text)
    init.add_argument("--yes", action="store_true", help="ask nothing")
    init.add_argument("--overwrite", action="store_true", help="replace the file if it exists")
