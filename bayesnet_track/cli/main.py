"""Command line: parse, call, print; errors as exit codes."""

from __future__ import annotations

import argparse
import errno
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from io import TextIOWrapper

from bayesnet_track.cli.arguments import (
    BAD_GRAPH,
    BAD_OUTPUT,
    BAD_SOURCE,
    USAGE,
    UsageError,
    complain,
    mute,
    words,
)
from bayesnet_track.cli.parser import COMMANDS as DECLARED
from bayesnet_track.cli.parser import Parser, make_parser
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.numerics.compile_watch import WATCH
from bayesnet_track.runtime.stop import StopRequest, Terminated


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code."""
    stop = StopRequest()
    try:
        with stop:
            code = _in_streams(arguments, stop)
    except Terminated:
        code = 143
    except KeyboardInterrupt:
        code = 130
    return stop.exit_code or code


def _in_streams(arguments: Sequence[str] | None, stop: StopRequest) -> int:
    try:
        with _streams():
            return _main(arguments, stop)
    except BrokenPipeError:  # the reader of a pipe went away, as `head` does
        mute(sys.stdout)
        return 0


def _main(arguments: Sequence[str] | None, stop: StopRequest) -> int:
    parser = make_parser()
    words_of_line = _as_what_if(_join(sys.argv[1:] if arguments is None else arguments))
    options, extras = parser.parse_known_args(words_of_line)
    if extras:
        refusing = parser.commands.choices.get(options.command or "", parser)
        assert isinstance(refusing, Parser)
        refusing.refuse(extras)
    if options.version:
        from importlib.metadata import version

        sys.stdout.write(f"bayesnet-track {version('bayesnet-track')}\n")
        return 0
    if options.command is None:
        parser.print_help()
        return 2
    options.stop, options.parser, options.owns_process = stop, parser, arguments is None
    from bayesnet_track.observation.settings import by_command_line

    try:
        if options.command == "doctor":  # works where the others cannot even be imported
            from bayesnet_track.cli.doctor import doctor

            with by_command_line():
                return doctor(options)
        # Inside the guard: what is interrupted while it is imported ends the command, with no word of ours.
        from bayesnet_track.sources.entrances.notices import heard

        with heard(complain), by_command_line():
            code = call(options)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        raise
    except Exception:
        # An interruption comes out of C code as some other error (of an import, for one).
        if stop.signal is None:
            import traceback

            traceback.print_exc()
            sys.stderr.write(
                "bayesnet-track: this is an error in the program; please report the lines above\n"
            )
        return 1


@contextmanager
def _streams() -> Iterator[None]:
    """Inside it both streams are there, and characters that the terminal lacks are replaced, not fatal."""
    with ExitStack() as stack:
        # A process started without them (as a service may be) has None.
        for stream, redirect in ((sys.stdout, redirect_stdout), (sys.stderr, redirect_stderr)):
            if stream is None:
                from pathlib import Path

                nowhere = stack.enter_context(Path(os.devnull).open("w", encoding="utf-8"))
                stack.enter_context(redirect(nowhere))
        stdout = sys.stdout
        if isinstance(stdout, TextIOWrapper) and stdout.errors == "strict":
            stdout.reconfigure(errors="replace")
            stack.callback(stdout.reconfigure, errors="strict")
        yield


def _join(arguments: Sequence[str]) -> list[str]:
    """The arguments, with a box that starts with a minus tied to its --init: else it looks like an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] == "--init" and argument.startswith("-") and "," in argument:
            joined[-1] = f"--init={argument}"
        else:
            joined.append(argument)
    return joined


def _as_what_if(arguments: Sequence[str]) -> list[str]:
    """`run --what-if RUN ...` as `what-if RUN ...`; other arguments as they are.

    >>> _as_what_if(["run", "--what-if", "runs/mine", "--seed", "1"])
    ['what-if', 'runs/mine', '--seed', '1']
    """
    if list(arguments[:1]) != ["run"]:
        return list(arguments)
    for place, argument in enumerate(arguments):
        if argument == "--what-if":
            return ["what-if", *arguments[1:place], *arguments[place + 1 :]]
        if argument.startswith("--what-if="):
            run = argument.partition("=")[2]
            return ["what-if", *arguments[1:place], run, *arguments[place + 1 :]]
    return list(arguments)


COMPILING = "compiling kernels that no earlier command has needed: seconds, up to a minute"
TRACKING = ("demo", "run", "resume", "batch", "what-if")
RESUMED = ("demo", "run", "resume")
LOOKS_BACK = ("log", "score", "report", "plot", "compare", "diagnose", "export")
SILENT = ("quiet", "log_json", "json")
"""Options with which nothing is said of it: somebody reads by program, or does not want to know."""

COMMANDS = {name: action for name, (_, action) in DECLARED.items() if action is not None}
"""Command -> what it does."""


def call(options: argparse.Namespace) -> int:
    """Carry out a parsed command line; the exit code.

    Expected errors become one clear message; any other is an error in the program and passes through.
    """
    try:
        _allow(options)
        _say_what_is_missing(options)
        with WATCH.notifying(notice_compiling(options)):
            return COMMANDS[options.command](options)
    except GraphError as error:
        from bayesnet_track.graph.text.explain import describe_error

        complain(describe_error(error))
        return BAD_GRAPH
    except (OSError, ValueError) as error:
        code = _code_of(error, options.command)
        if code is None:
            raise
        complain(f"bayesnet-track {options.command}: {words(error)}{_mend_full_disk(error, options)}")
        return code


def _mend_full_disk(error: Exception, options: argparse.Namespace) -> str:
    """The next step where a disk is full; nothing after another error."""
    causes: list[BaseException] = [error]
    while (cause := causes[-1].__cause__) is not None and cause not in causes:  # one may be its own cause
        causes.append(cause)
    if all(getattr(cause, "errno", None) != errno.ENOSPC for cause in causes):
        return ""
    folder = getattr(options, "run", None) if options.command == "resume" else getattr(options, "out", None)
    goes_on = f", then `bayesnet-track resume {folder}`" if options.command in RESUMED and folder else ""
    return f"; free some space{goes_on}"


def notice_compiling(options: argparse.Namespace) -> Callable[[], None]:
    """Says once that kernels are compiled, where that is wanted: else the first run seems to hang."""
    waiting = [] if any(getattr(options, name, False) for name in SILENT) else [COMPILING]

    def notify() -> None:
        if waiting:
            complain(waiting.pop())

    return notify


def _say_what_is_missing(options: argparse.Namespace) -> None:
    """At the start of a run, on a system that is not tested."""
    from bayesnet_track.runtime import stop

    if options.command in TRACKING and not options.quiet and not getattr(options, "log_json", False):
        missing = stop.describe_missing()
        if missing:
            complain(missing)


def _allow(options: argparse.Namespace) -> None:
    """Let the plug-ins of other packages that the user names be loaded, and load cue files."""
    files = getattr(options, "cue_file", ())
    if files:
        from bayesnet_track.observation.cue_files import use_cue_file

        for file in files:
            use_cue_file(file)
    names = [name for group in getattr(options, "allow_plugins", ()) for name in group]
    if not names:
        return
    from bayesnet_track.observation import cue, detector, plugins

    available = {**plugins.others(cue.ENTRY_POINT_GROUP), **plugins.others(detector.ENTRY_POINT_GROUP)}
    for name in names:
        if name not in available:
            available_names = ", ".join(sorted(available)) or "none is installed"
            raise UsageError(f"--allow-plugins {name}: no other package has it; there are: {available_names}")
    plugins.allow(names)


def _code_of(error: Exception, command: str) -> int | None:
    from bayesnet_track.journal.codec import JournalError
    from bayesnet_track.journal.writer import OutputError
    from bayesnet_track.observation.cue import CueError
    from bayesnet_track.runtime.checkpoints.checkpoint import CheckpointError
    from bayesnet_track.runtime.checkpoints.recipe import RecipeError
    from bayesnet_track.runtime.checkpoints.resume import ResumeError
    from bayesnet_track.runtime.recording.beliefs import UnkeptBeliefError
    from bayesnet_track.runtime.recording.manifest import ManifestError
    from bayesnet_track.runtime.recording.rundir import RunDirectoryError
    from bayesnet_track.sources.paths import SourceError
    from bayesnet_track.vision.calibration import StereoCalibrationError

    if isinstance(error, UsageError | CueError | UnkeptBeliefError):
        return USAGE
    unreadable = RecipeError | CheckpointError | ResumeError | ManifestError
    if isinstance(error, SourceError | JournalError | StereoCalibrationError | unreadable):
        return BAD_SOURCE
    if isinstance(error, RunDirectoryError):
        return BAD_SOURCE if command in LOOKS_BACK else BAD_OUTPUT
    return BAD_OUTPUT if isinstance(error, OutputError) else None
