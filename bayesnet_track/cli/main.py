"""The command line: parse, call, print. What each command does lives in `bayesnet_track.cli.dispatch`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from io import TextIOWrapper

from bayesnet_track.cli.commands.batch import add_batch
from bayesnet_track.cli.commands.compare import add_compare
from bayesnet_track.cli.commands.completion import add_completion
from bayesnet_track.cli.commands.detect import add_detect
from bayesnet_track.cli.commands.export import add_export
from bayesnet_track.cli.commands.fit import add_fit
from bayesnet_track.cli.commands.init import add_init
from bayesnet_track.cli.commands.report import add_report
from bayesnet_track.cli.commands.resume import add_resume
from bayesnet_track.cli.commands.tracking import add_demo, add_run
from bayesnet_track.cli.commands.verify import add_verify
from bayesnet_track.cli.commands.what_if import add_what_if, as_what_if
from bayesnet_track.cli.options.arguments import whole_number
from bayesnet_track.cli.options.doctor import add_doctor
from bayesnet_track.cli.options.learn import add_calibrate, add_learn_shape, add_learn_stereo
from bayesnet_track.cli.options.plugins import add_plugins
from bayesnet_track.runtime.stop import StopRequest, Terminated

EXIT_CODES = """\
exit codes:
  0    done
  1    an error in bayesnet-track itself; or `doctor` found something broken
  2    wrong arguments
  3    the graph file is wrong
  4    the source, or the run to look back at, cannot be read or was changed
  5    the source was damaged or truncated; what was read is saved; or `verify` found an unfinished run
  6    an output cannot be written
  130  stopped by Ctrl-C; outputs are valid up to the last whole frame
  143  stopped by SIGTERM; the same"""


def make_parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    parser = argparse.ArgumentParser(
        prog="bayesnet-track",
        description="Track by a Bayes net written in YAML; see why it reconfigured itself.",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")

    add_demo(commands)
    add_run(commands)
    validate = commands.add_parser("validate", help="check graph files; every error with line and column")
    validate.add_argument("graphs", nargs="+", metavar="GRAPH", help="path of a YAML file, or name")

    graph = commands.add_parser("graph", help="show what a graph compiles to")
    graph.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    graph.add_argument(
        "--target", metavar="NAME", help="the plate to show (default: all; of a drawing, the first)"
    )
    graph.add_argument("--formula", action="store_true", help="print the density that the net stands for")
    graph.add_argument("--latex", action="store_true", help="print it as LaTeX")
    graph.add_argument("--svg", metavar="FILE", help="draw the net")
    graph.add_argument("--png", metavar="FILE", help="draw the net")
    for one in (validate, graph):
        add_plugins(one)

    add_detect(commands)
    add_calibrate(commands)
    add_plugins(commands.add_parser("schema", help="print the JSON Schema of graph files, for editors"))
    add_plugins(commands.add_parser("list", help="list the installed graphs, cues, detectors and scenes"))

    log = commands.add_parser("log", help="tell a run's reconfigurations as sentences")
    log.add_argument("run", metavar="RUN", help="run directory")
    log.add_argument("--target", metavar="ID", help="tell the life of one target")
    log.add_argument("--node", help="only this node")
    log.add_argument("--kind", help="only this kind of event: activated, deactivated, self_stopped, ...")
    log.add_argument("--frames", metavar="A:B", help="only frames A to B, B excluded")
    log.add_argument("--why", type=whole_number(0), metavar="N", help="what was active in frame N, and why")
    log.add_argument("--json", action="store_true", help="print the events as they stand in the journal")

    score = commands.add_parser("score", help="score a run against ground truth")
    score.add_argument("run", metavar="RUN", help="run directory, or a file of tracks (MOT)")
    score.add_argument(
        "--truth",
        help="ground-truth file: a box a line, or MOT, then all targets are scored at once "
        "(default: the run's own truth.txt)",
    )
    score.add_argument(
        "--target", metavar="ID", help="which target, where the run has several and the truth one"
    )
    score.add_argument("--json", action="store_true", help="print the scores as JSON")

    add_learn_shape(commands)
    add_fit(commands)
    add_learn_stereo(commands)
    add_init(commands)
    add_doctor(commands)
    add_completion(commands)
    add_resume(commands)
    add_verify(commands)
    add_batch(commands)
    add_report(commands)
    add_compare(commands)
    add_what_if(commands)
    add_export(commands)
    return parser


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
        from bayesnet_track.cli.commands.answer import mute

        mute(sys.stdout)
        return 0


def _main(arguments: Sequence[str] | None, stop: StopRequest) -> int:
    parser = make_parser()
    options = parser.parse_args(as_what_if(_joined(sys.argv[1:] if arguments is None else arguments)))
    if options.version:
        from importlib.metadata import version

        sys.stdout.write(f"bayesnet-track {version('bayesnet-track')}\n")
        return 0
    if options.command is None:
        parser.print_help()
        return 2
    options.stop = stop
    try:
        if options.command == "doctor":  # works where the others cannot even be imported
            from bayesnet_track.cli.doctor.examine import doctor

            return doctor(options)
        from bayesnet_track.cli import dispatch as commands

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


def _joined(arguments: Sequence[str]) -> list[str]:
    """The arguments, with a box that starts with a minus tied to its --init: else it looks like an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] == "--init" and argument.startswith("-") and "," in argument:
            joined[-1] = f"--init={argument}"
        else:
            joined.append(argument)
    return joined
