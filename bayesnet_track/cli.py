"""The command line: parse, call, print. What each command does lives in `bayesnet_track.commands`."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from types import FrameType

EXIT_CODES = """\
exit codes:
  0    done
  1    an error in bayesnet-track itself
  2    wrong arguments
  3    the graph file is wrong
  4    the source cannot be read
  5    the source was damaged or truncated; what was read is saved
  6    an output cannot be written
  130  stopped by Ctrl-C; outputs are valid up to the last whole frame
  143  stopped by SIGTERM; the same"""


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived: wind up as for Ctrl-C, with another exit code."""


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

    demo = commands.add_parser("demo", help="track in a built-in synthetic scene; nothing to download")
    demo.add_argument(
        "scene", nargs="?", default="two_squares", help="two_squares (default), orange_and_gray, ..."
    )
    demo.add_argument("--graph", help="graph to use instead of the scene's own")
    demo.add_argument("--out", help="run directory (default runs/SCENE)")
    _add_run_options(demo)

    run = commands.add_parser("run", help="track in a video with a graph")
    run.add_argument("graph", help="path of a YAML file, or name of an installed graph")
    run.add_argument(
        "--source", required=True, help="video file, folder of images, glob, camera index, or URL"
    )
    run.add_argument("--out", required=True, help="run directory to write")
    start = run.add_mutually_exclusive_group(required=True)
    start.add_argument(
        "--init",
        action="append",
        metavar="X,Y,W,H",
        help="start box in the first frame, top-left corner, px; PLATE:X,Y,W,H names the plate",
    )
    start.add_argument(
        "--init-from", metavar="FILE", help="ground-truth file whose first box is the start box"
    )
    run.add_argument("--start", type=int, metavar="N", help="first frame (default 0)")
    run.add_argument("--end", type=int, metavar="N", help="frame to stop before")
    run.add_argument("--video", action="store_true", help="write the annotated video too (video.mkv)")
    run.add_argument(
        "--on-resize", choices=["stop", "rescale"], default="stop", help="when pictures change size"
    )
    run.add_argument("--allow-network", action="store_true", help="let the source be a URL")
    _add_run_options(run)

    validate = commands.add_parser("validate", help="check graph files; every error with line and column")
    validate.add_argument("graphs", nargs="+", metavar="GRAPH")

    graph = commands.add_parser("graph", help="show what a graph compiles to")
    graph.add_argument("graph")
    graph.add_argument("--target", metavar="NAME", help="the plate to show (default: the first)")
    graph.add_argument("--formula", action="store_true", help="print the density that the net stands for")
    graph.add_argument("--latex", action="store_true", help="print it as LaTeX")
    graph.add_argument("--svg", metavar="FILE", help="draw the net")
    graph.add_argument("--png", metavar="FILE", help="draw the net")

    commands.add_parser("schema", help="print the JSON Schema of graph files, for editors")
    commands.add_parser("list", help="list the installed graphs, cues and scenes")

    log = commands.add_parser("log", help="tell a run's reconfigurations as sentences")
    log.add_argument("run", help="run directory")
    log.add_argument("--node", help="only this node")
    log.add_argument("--kind", help="only this kind of event: activated, deactivated, self_stopped, ...")
    log.add_argument("--frames", metavar="A:B", help="only frames A to B, B excluded")
    log.add_argument("--why", type=int, metavar="N", help="what was active in frame N, and why")
    log.add_argument("--json", action="store_true", help="print the events as they stand in the journal")

    score = commands.add_parser("score", help="score a run against ground truth")
    score.add_argument("run", help="run directory")
    score.add_argument("--truth", help="ground-truth file (default: the run's own truth.txt)")
    score.add_argument("--json", action="store_true")
    return parser


def _add_run_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=int, default=0, help="seed of all randomness (default 0)")
    parser.add_argument(
        "--overwrite", action="store_true", help="replace an earlier run in the same directory"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress line")
    parser.add_argument("--log-json", action="store_true", help="progress as JSON lines")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code."""
    parser = make_parser()
    options = parser.parse_args(arguments)
    if options.version:
        from importlib.metadata import version

        sys.stdout.write(f"bayesnet-track {version('bayesnet-track')}\n")
        return 0
    if options.command is None:
        parser.print_help()
        return 2

    from bayesnet_track import commands

    previous = signal.signal(signal.SIGTERM, _terminate)
    try:
        return commands.call(options)
    except Terminated:
        return 143
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader of a pipe went away, as `head` does
        sys.stderr.close()
        return 0
    finally:
        signal.signal(signal.SIGTERM, previous)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated
