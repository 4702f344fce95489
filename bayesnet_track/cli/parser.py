"""Parser of the command line: its commands, its first screen, and the nearest name for a wrong word."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from textwrap import fill
from typing import Any, NoReturn

from bayesnet_track.cli.commands import (
    annotate,
    batch,
    calibrate,
    compare,
    detect,
    diagnose,
    export,
    fit,
    graphs,
    learn,
    review,
    runs,
    tracking,
)
from bayesnet_track.cli.doctor import add_doctor
from bayesnet_track.sources.paths import hide_secrets

GROUPS: Mapping[str, tuple[str, ...]] = {
    "see it work": ("demo", "doctor", "list", "completion"),
    "track": ("run", "batch", "resume", "verify"),
    "label a video": ("annotate",),
    "look at a run": ("report", "log", "plot", "diagnose", "smooth", "export"),
    "measure": ("score", "compare", "what-if"),
    "write a graph": ("init", "validate", "graph", "simulate", "schema"),
    "fit to your videos": ("fit", "learn-shape", "learn-stereo"),
    "detect; calibrate cameras": ("detect", "calibrate", "cameras"),
}
"""Title -> its commands."""

EXAMPLES: Mapping[str, str] = {
    "demo": "demo crowd",
    "doctor": "doctor",
    "list": "list people",
    "completion": "completion bash",
    "run": "run general --source video.mp4 --init 57,21,31,45 --out runs/mine",
    "batch": "batch general --source '*.mp4' --init-from '{name}.txt' --out runs/all",
    "annotate": "annotate video.mp4 --out labels/mine --open",
    "resume": "resume runs/mine",
    "verify": "verify runs/mine",
    "report": "report runs/mine --open",
    "log": "log runs/mine --why 120",
    "plot": "plot runs/mine --out mine.svg",
    "smooth": "smooth runs/mine --out runs/mine_smoothed",
    "diagnose": "diagnose runs/mine",
    "export": "export runs/mine --format coco --out tracks.json",
    "score": "score runs/mine --truth groundtruth.txt",
    "compare": "compare runs/a runs/b --html differences.html",
    "what-if": "what-if runs/mine --set target.belief.particles.size=1000",
    "init": "init mine.yaml",
    "validate": "validate mine.yaml",
    "graph": "graph general --formula",
    "simulate": "simulate general --source video.mp4 --init 57,21,31,45 --png prior.png",
    "schema": "schema > graph.schema.json",
    "fit": "fit general --source a.mp4 --truth a.txt --out mine.yaml",
    "learn-shape": "learn-shape person.npz --source a.mp4 --truth a.txt",
    "learn-stereo": "learn-stereo --source left --right right --calibration pair.yaml --truth a.txt",
    "detect": "detect motion --source video.mp4 --out detections.txt",
    "cameras": "cameras street.yaml --source street.mp4 --out cameras.png",
    "calibrate": "calibrate ground street.mp4 --points points.csv --out street.yaml",
}
"""Command -> one that does something useful, without the program's name."""


def describe_commands(commands: argparse._SubParsersAction[Any]) -> str:
    """The groups, each command with its line and its example."""
    lines = {choice.dest: choice.help or "" for choice in commands._choices_actions}
    width = max(map(len, lines))
    text_lines: list[str] = []
    for title, names in GROUPS.items():
        text_lines += [f"{title}:"]
        for name in names:
            text_lines += [
                f"  {name:{width}}  {lines[name]}",
                f"  {'':{width}}  $ bayesnet-track {EXAMPLES[name]}",
            ]
    return "\n".join(text_lines)


def add_examples(commands: argparse._SubParsersAction[Any]) -> None:
    """Let the help of every command end with its example, and its description keep to the terminal."""
    for name, parser in commands.choices.items():
        parser.description = parser.description and fill(parser.description, 79)
        example = f"example:\n  bayesnet-track {EXAMPLES[name]}"
        parser.epilog = f"{parser.epilog}\n\n{example}" if parser.epilog else example
        parser.formatter_class = argparse.RawDescriptionHelpFormatter


_CHOICE = re.compile(
    r"argument (?P<what>.*?): invalid choice: '?(?P<word>.*?)'?"
    r"(, maybe you meant .*?\?)? \(choose from (?P<names>.*)\)",  # argparse suggests since Python 3.15
    re.DOTALL,
)


class Parser(argparse.ArgumentParser):
    """Of a command: says what is wrong, the nearest option or command, and where all are listed."""

    given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as inherited, and remember the arguments."""
        self.given = list(args or ())
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line, a suggestion and where to look; exits with code 2."""
        unknown = [] if isinstance(self, MainParser) else [self.describe_option(w) for w in self.unknown()]
        suggestion = hide_secrets(suggest(message))
        text = "; ".join([*unknown, suggestion] if "required" in message else [suggestion])
        self.exit(2, f"{self.prog}: {text}\n`{self.prog} --help` lists what there is\n")

    def refuse(self, extras: Sequence[str]) -> NoReturn:
        """Refuse words that belong to no argument."""
        options = [self.describe_option(word) for word in extras if re.match(r"--?[A-Za-z]", word)]
        fault = f"unexpected {' '.join(extras)!r}; write a value without spaces, as 1,2,3,4, or in quotes"
        self.error("; ".join(options) or fault)

    def unknown(self) -> Iterable[str]:
        """Words that were given as options and begin no option of the parser."""
        words = (word.partition("=")[0] for word in self.given if re.match(r"--[A-Za-z]", word))
        return (
            word for word in words if not any(name.startswith(word) for name in self._option_string_actions)
        )

    def describe_option(self, word: str) -> str:
        """The message that there is no such option."""
        option = word.partition("=")[0]
        names = OTHER_OPTIONS.get(option, "")
        if names and all(name in self._option_string_actions for name in names.split(" and ")):
            return f"no option {option}; did you mean {names}?"
        return f"no option {option}{suggest_nearest(option, self._option_string_actions)}"


class MainParser(Parser):
    """Of the whole command line: its help is the commands in groups."""

    commands: argparse._SubParsersAction[Parser]

    def format_help(self) -> str:
        """Text of the help: usage, the commands in groups, the exit codes."""
        hint = "`bayesnet-track COMMAND --help` lists the options of a command, --version the version."
        parts = (self.format_usage().rstrip(), self.description, describe_commands(self.commands), hint)
        return "\n\n".join([*(part or "" for part in parts), f"{self.epilog}\n"])


OTHER_WORDS = {
    "track": "run",
    "label": "annotate",
    "convert": "export",
    "show": "report",
    "view": "report",
    "evaluate": "score",
    "new": "init",
    "check": "validate or doctor",
}
"""Words that other programs use for commands -> the command here."""

OTHER_OPTIONS = {
    "--frames": "--start and --end",
    "--max-frames": "--start and --end",
    "--first": "--start",
    "--last": "--end",
    "--skip": "--stride",
    "--input": "--source",
    "--output": "--out",
    "--save-video": "--video",
    "--show": "--view",
    "--box": "--init",
    "--bbox": "--init",
    "--roi": "--init",
    "--gt": "--truth",
    "--dets": "--detections",
    "--config": "--set",
}
"""Options that other programs have -> those here, if the command has them."""


def suggest(message: str) -> str:
    """The message of `argparse`; of a wrong choice with the nearest one.

    >>> suggest("argument SHELL: invalid choice: 'bahs' (choose from 'bash', 'zsh')")
    "no SHELL 'bahs'; there are bash, zsh; did you mean bash?"
    """
    choice = _CHOICE.fullmatch(message)
    if choice is None:
        return message
    names = choice["names"].replace("'", "").split(", ")
    is_command = choice["what"] == "COMMAND"
    if is_command and choice["word"] in OTHER_WORDS:
        return f"no command {choice['word']!r}; did you mean {OTHER_WORDS[choice['word']]}?"
    listed = "" if is_command else f"; there are {', '.join(names)}"
    kind = "command" if is_command else choice["what"]
    return f"no {kind} {choice['word']!r}{listed}{suggest_nearest(choice['word'], names)}"


def suggest_nearest(word: str, names: Iterable[str]) -> str:
    """`; did you mean run?`, or nothing."""
    matches = get_close_matches(word, [*names], n=1, cutoff=0.55)
    return f"; did you mean {matches[0]}?" if matches else ""


EXIT_CODES = """\
exit codes:
  0    done
  1    an error in bayesnet-track itself; or `doctor` found something broken
  2    wrong arguments
  3    the graph file is wrong
  4    the source, or the run that a command reads, cannot be read or was changed
  5    the source was damaged or truncated; what was read is saved; or `verify` found an unfinished run;
       or an answer of `annotate` is not tracked
  6    an output cannot be written
  130  stopped by Ctrl-C; outputs are valid up to the last whole frame
  143  stopped by SIGTERM; likewise"""

Adding = Callable[[Any], None]
Action = Callable[[argparse.Namespace], int]

_MODULES = (
    annotate, batch, calibrate, compare, detect, diagnose, export,
    fit, graphs, learn, review, runs, tracking,
)  # fmt: skip

COMMANDS: Mapping[str, tuple[Adding, Action | None]] = {
    "doctor": (add_doctor, None),
    **{name: command for module in _MODULES for name, command in module.COMMANDS.items()},
}
"""Command -> what adds its parser, and what it does; `doctor` starts where the others cannot be imported."""


@cache
def make_parser() -> MainParser:
    """The parser of the whole command line; one for all calls of a process."""
    parser = MainParser(
        prog="bayesnet-track",
        usage="bayesnet-track COMMAND ...",
        description="Track targets with a Bayes net written in YAML; see why it reconfigured itself.",
        epilog=EXIT_CODES,
    )
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", prog="bayesnet-track", parser_class=Parser
    )
    parser.commands = commands
    for add, _ in COMMANDS.values():
        add(commands)
    add_examples(commands)
    return parser
