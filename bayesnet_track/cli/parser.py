"""The parser of the whole command line."""

from __future__ import annotations

from functools import cache

from bayesnet_track.cli.commands.annotate import add_annotate
from bayesnet_track.cli.commands.batch import add_batch
from bayesnet_track.cli.commands.compare import add_compare
from bayesnet_track.cli.commands.completion import add_completion
from bayesnet_track.cli.commands.demo import add_demo
from bayesnet_track.cli.commands.detect import add_detect
from bayesnet_track.cli.commands.export import add_export
from bayesnet_track.cli.commands.init import add_init
from bayesnet_track.cli.commands.report import add_report
from bayesnet_track.cli.commands.resume import add_resume
from bayesnet_track.cli.commands.simulate import add_simulate
from bayesnet_track.cli.commands.smooth import add_smooth
from bayesnet_track.cli.commands.tracking import add_run
from bayesnet_track.cli.commands.verify import add_verify
from bayesnet_track.cli.commands.what_if import add_what_if
from bayesnet_track.cli.diagnose.command import add_diagnose
from bayesnet_track.cli.fitting.fit import add_fit
from bayesnet_track.cli.options.arguments import pixels, whole_number
from bayesnet_track.cli.options.doctor import add_doctor
from bayesnet_track.cli.options.learn import add_calibrate, add_learn_shape, add_learn_stereo
from bayesnet_track.cli.options.plugins import add_plugins
from bayesnet_track.cli.overview import add_examples
from bayesnet_track.cli.slips import MainParser, Parser

EXIT_CODES = """\
exit codes:
  0    done
  1    an error in bayesnet-track itself; or `doctor` found something broken
  2    wrong arguments
  3    the graph file is wrong
  4    the source, or the run that a command reads, cannot be read or was changed
  5    the source was damaged or truncated; what was read is saved; or `verify` found an unfinished run
  6    an output cannot be written
  130  stopped by Ctrl-C; outputs are valid up to the last whole frame
  143  stopped by SIGTERM; likewise"""


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

    add_annotate(commands)
    add_smooth(commands)
    add_simulate(commands)
    add_detect(commands)
    add_calibrate(commands)
    add_plugins(commands.add_parser("schema", help="print the JSON Schema of graph files, for editors"))
    add_plugins(commands.add_parser("list", help="list the installed graphs, cues, detectors and scenes"))

    log = commands.add_parser(
        "log", help="print every reconfiguration of a run as a sentence, with its reason"
    )
    log.add_argument("run", metavar="RUN", help="run directory")
    log.add_argument("--target", metavar="ID", help="only the history of one target")
    log.add_argument("--node", help="only this node")
    log.add_argument("--kind", help="only this kind of event: activated, deactivated, self_stopped, ...")
    log.add_argument("--frames", metavar="A:B", help="only frames A to B, B excluded")
    log.add_argument("--why", type=whole_number(0), metavar="N", help="what was active in frame N, and why")
    log.add_argument("--json", action="store_true", help="print the events as they are in the journal")

    score = commands.add_parser("score", help="score a run against ground truth")
    score.add_argument("run", metavar="RUN", help="run directory, or a file of tracks (MOT)")
    score.add_argument(
        "--truth",
        help="ground-truth file: one box per line, or MOT to score all targets together (default: the "
        "run's own truth.txt)",
    )
    score.add_argument(
        "--target", metavar="ID", help="which target, if the run has several and the ground truth one"
    )
    score.add_argument(
        "--cutoff",
        type=pixels,
        metavar="PX",
        help="several targets: the cut-off c of GOSPA, OSPA(2) and SIAP (default: 50)",
    )
    score.add_argument(
        "--trajectories",
        action="store_true",
        help="several targets: also trajectory GOSPA; slow if many cross",
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
    add_diagnose(commands)
    add_examples(commands)
    return parser
