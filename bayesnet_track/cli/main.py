"""Command line: parse, call, print. What each command does lives in `bayesnet_track.cli.dispatch`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from io import TextIOWrapper

from bayesnet_track.cli.commands.compare import as_what_if
from bayesnet_track.cli.parser import Parser, make_parser
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
        from bayesnet_track.cli.arguments import mute

        mute(sys.stdout)
        return 0


def _main(arguments: Sequence[str] | None, stop: StopRequest) -> int:
    parser = make_parser()
    words_of_line = as_what_if(_join(sys.argv[1:] if arguments is None else arguments))
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
        from bayesnet_track.cli import dispatch as commands
        from bayesnet_track.cli.arguments import complain
        from bayesnet_track.sources.entrances.notices import heard

        with heard(complain), by_command_line():
            code = commands.call(options)
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
        out = sys.stdout
        if isinstance(out, TextIOWrapper) and out.errors == "strict":
            out.reconfigure(errors="replace")
            stack.callback(out.reconfigure, errors="strict")
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
