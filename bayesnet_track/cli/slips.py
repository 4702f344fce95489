"""What a wrong command line means: the nearest name, and how the usual slips are written."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

from bayesnet_track.cli.overview import describe_commands
from bayesnet_track.sources.network.address import hide_secrets

_CHOICE = re.compile(
    r"argument (?P<what>.*?): invalid choice: '?(?P<word>.*?)'?"
    r"(, maybe you meant .*?\?)? \(choose from .*\)",  # argparse suggests a name itself since Python 3.15
    re.DOTALL,
)
_NUMBER = re.compile(r"-?\d+(\.\d*)?,?")
BOXES = ("--init", "--learn")
"""Options that take a box in one word."""


class Parser(argparse.ArgumentParser):
    """Of a command: says what is wrong, the nearest option or command, and where all are listed."""

    given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As inherited; remembers what was given, and refuses a box in several words."""
        self.given = list(args or ())
        slip = None if isinstance(self, MainParser) else next(boxes_in_words(self.given), None)
        if slip is not None:
            self.error(slip)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line, a suggestion and where to look; exits with code 2."""
        said = suggest(self, hide_secrets(message))
        self.exit(2, f"{self.prog}: {said}\n`{self.prog} --help` lists what there is\n")

    def refuse(self, extras: Sequence[str]) -> NoReturn:
        """Refuse words that nothing takes."""
        options = [word for word in extras if word.startswith("-") and not _NUMBER.fullmatch(word)]
        if options:
            self.error("; ".join(_no_option(self, word) for word in options))
        self.error(f"nothing takes {' '.join(extras)!r}; a value with spaces is written in quotes")


class MainParser(Parser):
    """Of the whole command line: its help is the commands in groups."""

    commands: argparse._SubParsersAction[Parser]

    def format_help(self) -> str:
        """What it is, the commands in groups, the exit codes."""
        return "\n\n".join(
            [
                self.format_usage().rstrip(),
                self.description or "",
                describe_commands(self.commands),
                "`bayesnet-track COMMAND --help` lists the options of a command, --version the version.",
                f"{self.epilog}\n",
            ]
        )


def suggest(parser: argparse.ArgumentParser, message: str) -> str:
    """The message of `argparse` with the nearest name."""
    choice = _CHOICE.fullmatch(message)
    if choice:
        action = next((one for one in parser._actions if _name(one) == choice["what"]), None)
        names = [str(name) for name in (action.choices if action is not None and action.choices else ())]
        what = "command" if choice["what"] == "COMMAND" else f"{choice['what']}"
        near = nearest(choice["word"], names)
        listed = "" if what == "command" else f"; there are {', '.join(names)}"
        return f"no {what} {choice['word']!r}{listed}{near}"
    unknown = [_no_option(parser, word) for word in unknown_options(parser)]
    if unknown and "required" in message:
        return "; ".join([*unknown, message])
    if "required" in message and "--source" in message:
        media = next((word for word in loose_words(parser) if _may_be_media(word)), None)
        return message if media is None else f"{message}; write --source {media}"
    return message


def loose_words(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Words that stand behind no option that takes a value."""
    given = getattr(parser, "given", ())
    for before, word in zip(("", *given), given, strict=False):
        action = parser._option_string_actions.get(before)
        takes = before.startswith("-") and "=" not in before and (action is None or action.nargs != 0)
        if not word.startswith("-") and not takes:
            yield word


def _may_be_media(word: str) -> bool:
    """Whether it is there and no graph; a name that is too long is not there, and raises nothing."""
    return os.path.exists(word) and not word.endswith((".yaml", ".yml"))  # noqa: PTH110


def unknown_options(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Words that were given as options and begin no option of the parser."""
    for word in getattr(parser, "given", ()):
        option = word.partition("=")[0]
        known = any(name.startswith(option) for name in parser._option_string_actions)
        if option.startswith("--") and len(option) > 2 and not known:
            yield option


def nearest(word: str, names: Sequence[str]) -> str:
    """`; did you mean run?`, or nothing."""
    from difflib import get_close_matches

    close = get_close_matches(word, names, n=1, cutoff=0.55)
    return f"; did you mean {close[0]}?" if close else ""


def boxes_in_words(given: Sequence[str]) -> Iterator[str]:
    """For each box that is given in several words, how it is written."""
    for place, word in enumerate(given):
        if word not in BOXES:
            continue
        numbers: list[str] = []
        for part in given[place + 1 : place + 5]:
            if not _NUMBER.fullmatch(part):
                break
            numbers.append(part.rstrip(","))
        if len(numbers) > 1:
            yield f"{word} takes one word, without spaces: {word} {','.join(numbers)}"


def _no_option(parser: argparse.ArgumentParser, word: str) -> str:
    option = word.partition("=")[0]
    names = [name for name in parser._option_string_actions if name.startswith("--")]
    if option == "--truth":
        return "no option --truth; `score RUN --truth FILE` compares a run with ground truth"
    return f"no option {option}{nearest(option, names)}"


def _name(action: argparse.Action) -> str | None:
    if action.option_strings:
        return "/".join(action.option_strings)
    return action.metavar if isinstance(action.metavar, str) else action.dest


class Renamed(argparse.Action):
    """An option by its former name, which still works and says its new one."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,
    ) -> None:
        from bayesnet_track.cli.commands.answer import complain

        complain(f"{parser.prog}: {option} is called {self.metavar} now; the former name will go")
        setattr(namespace, self.dest, values)


def add_former_name(parser: argparse.ArgumentParser, former: str, now: str) -> None:
    """Let an option that takes one value have its former name, too."""
    parser.add_argument(
        former, action=Renamed, dest=now.lstrip("-").replace("-", "_"), metavar=now, help=argparse.SUPPRESS
    )
