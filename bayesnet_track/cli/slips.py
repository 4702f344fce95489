"""The parsers of the command line: a wrong one is refused with the nearest name."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Any, NoReturn

from bayesnet_track.cli.overview import describe_commands
from bayesnet_track.sources.paths import hide_secrets

_CHOICE = re.compile(
    r"argument (?P<what>.*?): invalid choice: '?(?P<word>.*?)'?"
    r"(, maybe you meant .*?\?)? \(choose from (?P<names>.*)\)",  # argparse suggests since Python 3.15
    re.DOTALL,
)


class Parser(argparse.ArgumentParser):
    """Of a command: says what is wrong, the nearest option or command, and where all are listed."""

    given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As inherited; remembers what was given."""
        self.given = list(args or ())
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line, a suggestion and where to look; exits with code 2."""
        unknown = [] if isinstance(self, MainParser) else [self.describe_option(w) for w in self.unknown()]
        said = hide_secrets(suggest(message))
        text = "; ".join([*unknown, said] if "required" in message else [said])
        self.exit(2, f"{self.prog}: {text}\n`{self.prog} --help` lists what there is\n")

    def refuse(self, extras: Sequence[str]) -> NoReturn:
        """Refuse words that nothing takes."""
        options = [self.describe_option(word) for word in extras if re.match(r"--?[A-Za-z]", word)]
        said = f"nothing takes {' '.join(extras)!r}; a value is one word, as 1,2,3,4 is, or in quotes"
        self.error("; ".join(options) or said)

    def unknown(self) -> Iterable[str]:
        """Words that were given as options and begin no option of the parser."""
        words = (word.partition("=")[0] for word in self.given if re.match(r"--[A-Za-z]", word))
        return (
            word for word in words if not any(name.startswith(word) for name in self._option_string_actions)
        )

    def describe_option(self, word: str) -> str:
        """The message that there is no such option."""
        option = word.partition("=")[0]
        return f"no option {option}{nearest(option, self._option_string_actions)}"


class MainParser(Parser):
    """Of the whole command line: its help is the commands in groups."""

    commands: argparse._SubParsersAction[Parser]

    def format_help(self) -> str:
        """What it is, the commands in groups, the exit codes."""
        more = "`bayesnet-track COMMAND --help` lists the options of a command, --version the version."
        parts = (self.format_usage().rstrip(), self.description, describe_commands(self.commands), more)
        return "\n\n".join([*(part or "" for part in parts), f"{self.epilog}\n"])


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
    listed = "" if is_command else f"; there are {', '.join(names)}"
    what = "command" if is_command else choice["what"]
    return f"no {what} {choice['word']!r}{listed}{nearest(choice['word'], names)}"


def nearest(word: str, names: Iterable[str]) -> str:
    """`; did you mean run?`, or nothing."""
    close = get_close_matches(word, [*names], n=1, cutoff=0.55)
    return f"; did you mean {close[0]}?" if close else ""
