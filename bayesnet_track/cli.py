"""The command line: parse, call, print. What each command does lives in `bayesnet_track.commands`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from io import TextIOWrapper

from bayesnet_track.arguments import cells, gradient, metres, share, whole_number
from bayesnet_track.parsers.batch import add_batch
from bayesnet_track.parsers.compare import add_compare
from bayesnet_track.parsers.completion import add_completion
from bayesnet_track.parsers.doctor import add_doctor
from bayesnet_track.parsers.report import add_report
from bayesnet_track.parsers.rerun import add_rerun_option
from bayesnet_track.parsers.export import add_export
from bayesnet_track.parsers.executors import add_executor_options
from bayesnet_track.parsers.init import add_init
from bayesnet_track.parsers.outside import add_outside_options
from bayesnet_track.parsers.plugins import add_plugins
from bayesnet_track.parsers.resume import add_checkpoints, add_resume
from bayesnet_track.parsers.view import add_view_options
from bayesnet_track.parsers.what_if import add_what_if
from bayesnet_track.runtime.stop import StopRequest, Terminated

EXIT_CODES = """\
exit codes:
  0    done
  1    an error in bayesnet-track itself; or `doctor` found something broken
  2    wrong arguments
  3    the graph file is wrong
  4    the source, or the run to look back at, cannot be read
  5    the source was damaged or truncated; what was read is saved
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

    demo = commands.add_parser("demo", help="track in a built-in synthetic scene; nothing to download")
    demo.add_argument(
        "scene", nargs="?", default="two_squares", metavar="SCENE", help="default two_squares; see `list`"
    )
    demo.add_argument("--graph", help="graph to use instead of the scene's own")
    demo.add_argument(
        "--out", metavar="RUN", help="run directory (default runs/SCENE, replaced if it exists)"
    )
    demo.add_argument("--end", type=whole_number(1), metavar="N", help="frame to stop before")
    _add_run_options(demo)

    run = commands.add_parser("run", help="track in a video with a graph")
    run.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    run.add_argument(
        "--source", required=True, help="video file, folder of images, glob, camera index, or URL"
    )
    run.add_argument("--out", metavar="RUN", required=True, help="run directory to write")
    _add_depth_options(run)
    start = run.add_mutually_exclusive_group()
    start.add_argument(
        "--init",
        action="append",
        metavar="X,Y,W,H",
        help="start box in the first frame, top-left corner, px; PLATE:X,Y,W,H names the plate; "
        "give it again for a further target; needed unless the graph has `birth`",
    )
    start.add_argument(
        "--init-from", metavar="FILE", help="ground-truth file; its box of the first frame is the start box"
    )
    run.add_argument(
        "--detections", metavar="FILE", help="detections (MOT, JSON Lines) for a graph with births by them"
    )
    run.add_argument("--video", action="store_true", help="write the annotated video too (video.mkv)")
    add_outside_options(run)
    add_rerun_option(run)
    _add_window_options(run)
    _add_run_options(run)

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
    for one in (demo, run):
        add_view_options(one)
    for one in (demo, run, validate, graph):
        add_plugins(one)

    detect = commands.add_parser("detect", help="find targets in every frame with a detector")
    detect.add_argument("name", metavar="DETECTOR", help="see `list`")
    detect.add_argument(
        "--source", required=True, help="video file, folder of images, glob, camera index, or URL"
    )
    _add_depth_options(detect)
    detect.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of the detector, as YAML"
    )
    detect.add_argument(
        "--learn",
        metavar="X,Y,W,H",
        help="box of the target in the first frame, for one that can be shown it",
    )
    detect.add_argument(
        "--out",
        metavar="FILE",
        help="file to write: JSON Lines if it ends in .jsonl, else MOT (default: print)",
    )
    detect.add_argument("--video", metavar="FILE", help="write the video with the boxes too (.mkv or .mp4)")
    _add_window_options(detect)
    detect.add_argument("--overwrite", action="store_true", help="replace files that are there")
    add_plugins(detect)

    calibrate = commands.add_parser("calibrate", help="calibrate a pair of cameras from chessboard pictures")
    calibrate.add_argument("left", metavar="LEFT", help="pictures of the left eye: folder, glob or video")
    calibrate.add_argument("right", metavar="RIGHT", help="those of the right eye, in the same order")
    calibrate.add_argument("--board", required=True, metavar="CxR", help="inner corners across and down: 9x6")
    calibrate.add_argument(
        "--square", dest="square_m", required=True, type=metres, metavar="M", help="side of a square, m"
    )
    calibrate.add_argument("--out", required=True, metavar="FILE", help="calibration file to write")
    calibrate.add_argument("--overwrite", action="store_true", help="replace the file if it is there")

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

    shape = commands.add_parser("learn-shape", help="learn a shape model from masks, or boxes on a video")
    shape.add_argument("out", metavar="MODEL", help="model file to write (.npz)")
    examples = shape.add_mutually_exclusive_group(required=True)
    examples.add_argument("--masks", metavar="DIR", help="folder of mask images: the target is not black")
    examples.add_argument("--source", help="video file, folder of images, or glob")
    shape.add_argument("--boxes", metavar="FILE", help="ground-truth file of the boxes in --source")
    shape.add_argument("--every", type=whole_number(1), default=1, metavar="N", help="every Nth frame only")
    shape.add_argument("--grid", type=cells, default=16, metavar="G", help="cells per side (default 16)")
    shape.add_argument(
        "--keep",
        type=share,
        default=0.95,
        metavar="SHARE",
        help="variance that the modes keep (default .95)",
    )
    shape.add_argument(
        "--min-support",
        type=share,
        default=0.5,
        metavar="SHARE",
        help="leave out silhouettes with less of them on edges (default .5)",
    )
    shape.add_argument(
        "--edge-gray",
        type=gradient,
        default=8.0,
        metavar="G",
        help="gradient where an edge starts, gray levels per pixel (default 8)",
    )

    fit = commands.add_parser("fit", help="calibrate a graph's score and regions on videos with truth")
    fit.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    fit.add_argument(
        "--source", action="append", default=[], help="video, folder of images, or glob; may be repeated"
    )
    fit.add_argument(
        "--truth", action="append", default=[], metavar="FILE", help="ground-truth file of each --source"
    )
    fit.add_argument(
        "--folder", metavar="DATA", help="folder of NAME/img with NAME/groundtruth.txt: all of them"
    )
    fit.add_argument("--end", type=whole_number(2), metavar="N", help="frame of each video to stop before")
    fit.add_argument(
        "--seeds", type=whole_number(1), default=2, metavar="N", help="runs over each video (default 2)"
    )
    fit.add_argument(
        "--what",
        default="score,slack,lost",
        metavar="LIST",
        help="of score, slack, lost, ud, temperature (default score,slack,lost)",
    )
    fit.add_argument(
        "--features",
        default="log_ud_box,evidence",
        metavar="LIST",
        help="what the score goes by (default log_ud_box,evidence)",
    )
    fit.add_argument("--out", metavar="FILE", help="graph file to write (default: print it)")
    fit.add_argument("--overwrite", action="store_true", help="replace the file if it is there")
    fit.add_argument(
        "--leave-one-out",
        action="store_true",
        help="print how calibrated each video is by what is fitted to the others, and write nothing",
    )
    add_plugins(fit)

    stereo = commands.add_parser("learn-stereo", help="learn how much a target's depth features vary")
    stereo.add_argument("--source", required=True, help="video file, folder of images, or glob")
    _add_depth_options(stereo)
    stereo.add_argument(
        "--truth", required=True, metavar="FILE", help="ground-truth file of the boxes in the left eye"
    )
    stereo.add_argument("--every", type=whole_number(1), default=1, metavar="N", help="every Nth frame only")
    stereo.add_argument(
        "--within",
        type=whole_number(2),
        metavar="N",
        help="variation within N frames, as long as the reference takes to follow (default: the whole video)",
    )
    stereo.add_argument(
        "--prior",
        type=whole_number(0),
        default=10,
        metavar="N",
        help="examples that the default counts for (default 10)",
    )
    stereo.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of the cue, as YAML"
    )
    _add_window_options(stereo)
    add_init(commands)
    add_doctor(commands)
    add_completion(commands)
    add_resume(commands)
    add_batch(commands)
    add_report(commands)
    add_compare(commands)
    add_what_if(commands)
    add_export(commands)
    return parser


def _add_depth_options(parser: argparse.ArgumentParser) -> None:
    second = parser.add_mutually_exclusive_group()
    second.add_argument("--right", metavar="SOURCE", help="the right eye; --source is then the left one")
    second.add_argument(
        "--stereo", choices=["side_by_side"], help="both eyes are in one picture, the left one on the left"
    )
    second.add_argument(
        "--depth", metavar="FOLDER", help="depth of another sensor, a file per picture (16-bit images, .npy)"
    )
    parser.add_argument("--calibration", metavar="FILE", help="of the pair, OpenCV YAML; see `calibrate`")


def _add_window_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--start", type=whole_number(0), default=0, metavar="N", help="first frame (default 0)"
    )
    parser.add_argument("--end", type=whole_number(1), metavar="N", help="frame to stop before")
    parser.add_argument(
        "--on-resize", choices=["stop", "rescale"], default="stop", help="when pictures change size"
    )
    parser.add_argument("--allow-network", action="store_true", help="let the source be a URL")
    parser.add_argument(
        "--isolate-decoder", action="store_true", help="decode in a process of its own, held down by limits"
    )


def _add_run_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="N", help="seed of all randomness (default 0)"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace an earlier run in the same directory"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress line")
    parser.add_argument("--log-json", action="store_true", help="progress as JSON lines")
    add_checkpoints(parser)
    add_executor_options(parser)


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
        from bayesnet_track.commands.answer import mute

        mute(sys.stdout)
        return 0


def _main(arguments: Sequence[str] | None, stop: StopRequest) -> int:
    parser = make_parser()
    options = parser.parse_args(_joined(sys.argv[1:] if arguments is None else arguments))
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
            from bayesnet_track.doctor.examine import doctor

            return doctor(options)
        from bayesnet_track import commands

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
