"""The parser of the whole command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from bayesnet_track.cli.commands.annotate import add_annotate, annotate
from bayesnet_track.cli.commands.batch import add_batch, batch
from bayesnet_track.cli.commands.calibrate import add_calibrate, calibrate
from bayesnet_track.cli.commands.compare import add_compare, compare
from bayesnet_track.cli.commands.completion import add_completion, completion
from bayesnet_track.cli.commands.demo import add_demo, demo
from bayesnet_track.cli.commands.detect import add_detect, detect
from bayesnet_track.cli.commands.export import add_export, export
from bayesnet_track.cli.commands.graphs import (
    add_graph,
    add_list,
    add_schema,
    add_validate,
    graph,
    list_installed,
    schema,
    validate,
)
from bayesnet_track.cli.commands.init import add_init, init
from bayesnet_track.cli.commands.learn_shape import add_learn_shape, learn_shape
from bayesnet_track.cli.commands.learn_stereo import add_learn_stereo, learn_stereo
from bayesnet_track.cli.commands.report import add_report, report
from bayesnet_track.cli.commands.resume import add_resume, resume
from bayesnet_track.cli.commands.review import add_log, add_score, log, score
from bayesnet_track.cli.commands.simulate import add_simulate, simulate
from bayesnet_track.cli.commands.smooth import add_smooth, smooth
from bayesnet_track.cli.commands.tracking import add_run, run
from bayesnet_track.cli.commands.verify import add_verify, verify
from bayesnet_track.cli.commands.what_if import add_what_if, what_if
from bayesnet_track.cli.diagnose.command import add_diagnose, diagnose
from bayesnet_track.cli.doctor import add_doctor
from bayesnet_track.cli.fitting.fit import add_fit, fit
from bayesnet_track.cli.overview import add_examples
from bayesnet_track.cli.slips import MainParser, Parser

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

COMMANDS: Mapping[str, tuple[Adding, Action | None]] = {
    "demo": (add_demo, demo),
    "run": (add_run, run),
    "validate": (add_validate, validate),
    "graph": (add_graph, graph),
    "annotate": (add_annotate, annotate),
    "smooth": (add_smooth, smooth),
    "simulate": (add_simulate, simulate),
    "detect": (add_detect, detect),
    "calibrate": (add_calibrate, calibrate),
    "schema": (add_schema, schema),
    "list": (add_list, list_installed),
    "log": (add_log, log),
    "score": (add_score, score),
    "learn-shape": (add_learn_shape, learn_shape),
    "fit": (add_fit, fit),
    "learn-stereo": (add_learn_stereo, learn_stereo),
    "init": (add_init, init),
    "doctor": (add_doctor, None),
    "completion": (add_completion, completion),
    "resume": (add_resume, resume),
    "verify": (add_verify, verify),
    "batch": (add_batch, batch),
    "report": (add_report, report),
    "compare": (add_compare, compare),
    "what-if": (add_what_if, what_if),
    "export": (add_export, export),
    "diagnose": (add_diagnose, diagnose),
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
