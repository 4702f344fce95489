"""The command `annotate`: boxes for a whole video, asking only where the tracker is unsure."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    INCOMPLETE,
    OK,
    UsageError,
    complain,
    port,
    run_silently,
    say,
    share,
    users_mistake,
    users_output,
    whole_number,
    words,
)
from bayesnet_track.cli.commands.annotate_identities import add_identity_options, annotate_identities
from bayesnet_track.cli.options import add_range_option, add_size_option

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.annotation.answers import Header
    from bayesnet_track.runtime.annotation.asking import TrackerRuns
    from bayesnet_track.runtime.annotation.frame_store import FrameStore
    from bayesnet_track.runtime.annotation.session import Session
    from bayesnet_track.runtime.stop import StopRequest

FORMATS = ("coco", "mot", "cvat", "label-studio", "yolo")
COUNTED = ("given", "tracked", "interpolated", "gone")


def _annotate(options: argparse.Namespace) -> int:
    """Open or go on with a session, in the browser or without; write the annotations at its end."""
    if options.identities is not None:
        return annotate_identities(options)
    if options.video is None or options.out is None:
        raise UsageError("annotate needs a VIDEO and --out, or --identities RUN")
    if options.answers is not None:
        raise UsageError("--answers: of --identities RUN; boxes come by --import")
    from bayesnet_track.runtime.annotation.answers import AnswersFileError
    from bayesnet_track.runtime.recording.manifest import lock_run
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    stop: StopRequest = options.stop
    folder = Path(options.out)
    with users_output(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with lock_run(RunDirectory(folder)):
            session, is_complete = _work(options, folder)
    except AnswersFileError as error:
        raise UsageError(str(error)) from error
    say(_describe(folder, session))
    if stop.between_frames():
        stop.signal = None  # what was closed is the view; every answer is kept
    return OK if is_complete else INCOMPLETE


def _work(options: argparse.Namespace, folder: Path) -> tuple[Session, bool]:
    """The session, and whether the whole video was read and every answer is tracked."""
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.runtime.annotation.answers import NAME, read_answers
    from bayesnet_track.runtime.annotation.asking import TrackerRuns
    from bayesnet_track.runtime.annotation.desk import read_annotations, write_formats
    from bayesnet_track.runtime.annotation.frame_store import FrameStore
    from bayesnet_track.runtime.annotation.session import open_session
    from bayesnet_track.sources.paths import image_names
    from bayesnet_track.sources.sources import open_source

    stored = None
    if (folder / NAME).is_file() and (folder / NAME).stat().st_size:
        stored = read_answers(folder / NAME).header
    graph = load_graph(options.graph or (stored.graph_name if stored else "general"))
    _warn_of_score(graph)
    value_range = options.value_range or (stored.value_range if stored else None)
    with open_source(options.video, value_range=value_range) as source:
        store = FrameStore.of(source, options.video, source.frame_interval_s, _progress)
    run_silently(lambda: sys.stderr.write("\n"))
    is_whole = source.end_reason == "end_of_source"
    if not is_whole:
        complain(f"{options.video}: {source.end_reason.replace('_', ' ')} after {len(store)} frames")
    with store:
        header = make_header(options, graph, store, stored)
        images = image_names(options.video, len(store))
        session, difference = open_session(folder, header)
        if difference:
            complain(f"{folder}: {difference}; boxes between answers may differ from before")
        with closing(session):
            for file in options.imports:
                with users_mistake():
                    answers = read_annotations(Path(file), header.video, images)
                session.give_new(answers, file)
            runs = TrackerRuns(graph, store, session.header.seed, session.header.max_side)
            is_tracked = session.update(runs) if options.no_view else _show(options, session, store, runs)
            options.stop.is_patient = True
            document = replace(session.document, images=images)
            write_formats(folder, tuple(dict.fromkeys(options.format or ["coco"])), document)
    return session, is_whole and is_tracked and not session.annotations.failures


def make_header(
    options: argparse.Namespace, graph: CheckedGraph, store: FrameStore, stored: Header | None
) -> Header:
    """The header of the session: as stored, unless an option says otherwise."""
    from importlib.metadata import version

    from bayesnet_track.graph.text.write import graph_sha256, write_graph
    from bayesnet_track.runtime.annotation.answers import Header
    from bayesnet_track.runtime.annotation.asking import PATIENCE, THRESHOLD

    def value_of(name: str, default: Any) -> Any:
        value = getattr(options, name)
        return value if value is not None else default if stored is None else getattr(stored, name)

    return Header(
        store.about(),
        options.graph or (stored.graph_name if stored else "general"),
        graph_sha256(write_graph(graph.spec)),
        value_of("seed", 0),
        value_of("threshold", THRESHOLD),
        value_of("patience", PATIENCE),
        version("bayesnet-track"),
        value_of("max_side", None),
        value_of("value_range", None),
    )


def _describe(folder: Path, session: Session) -> str:
    """Progress of the annotations, in a line each of frames and of questions."""
    from bayesnet_track.journal.text.wording import plural

    marks = session.annotations.marks
    counts = dict.fromkeys(COUNTED, 0)
    for target_marks in marks.values():
        for mark in target_marks.values():
            counts[mark.how] += 1
    missing = len(marks) * session.frames - sum(counts.values())
    counted = ", ".join(f"{count} {how}" for how, count in counts.items() if count)
    text = f"{folder}: {plural(len(marks), 'target')}, {plural(session.frames, 'frame')}: "
    text += counted or "no box yet"
    text += f", {missing} not known yet" if missing else ""
    for question in session.annotations.questions:
        text += f"\nopen: {question.target}, frame {question.frame}: {question.reason}"
    return text if session.annotations.questions or missing or not counted else f"{text}; nothing to ask"


def _show(options: argparse.Namespace, session: Session, store: FrameStore, runs: TrackerRuns) -> bool:
    """Open the page until the person leaves; whether every answer is tracked then."""
    from bayesnet_track.cli.following import announce
    from bayesnet_track.runtime.annotation.desk import AnnotationServer

    stop: StopRequest = options.stop
    try:
        desk = AnnotationServer(session, store, runs, options.out, options.view_host, options.port)
    except OSError as error:
        raise UsageError(f"--port: {options.view_host}: {words(error)}; choose another, or none") from error
    with desk:
        announce(options, desk.address)
        complain("Ctrl-C or `Finish` on the page writes the annotations; every answer is kept at once")
        stop.is_patient = True
        desk.wait(lambda: stop.signal is not None)
        if desk.is_behind:
            complain("the last answers are not tracked yet; the same command goes on from them")
        return desk.is_tracked


def _progress(count: int) -> None:
    if count % 25 == 0 and sys.stderr.isatty():
        run_silently(lambda: sys.stderr.write(f"\rreading frames: {count}"))


def _warn_of_score(graph: CheckedGraph) -> None:
    plate = next(iter(graph.spec.targets.values()))
    if all(getattr(node, "score", None) is None for node in plate.nodes.values()):
        complain(
            f"{graph.spec.name}: its score is no probability, so that --threshold compares with an index; "
            "`fit` gives it one, and `general` has one"
        )


def _add_annotate(commands: argparse._SubParsersAction[Any]) -> None:
    annotate = commands.add_parser(
        "annotate",
        help="label every frame of a video; it tracks, and asks only where it is unsure",
        description="Open a page in the browser: draw a box; the tracker runs ahead until the probability "
        "of being on target falls. There it asks for a box, `gone` or `correct`, and tracks again from the "
        "answer, forward and backward. Every answer is saved at once; the same command resumes.",
    )
    annotate.add_argument("video", nargs="?", metavar="VIDEO", help="video file, or folder of images")
    annotate.add_argument("-o", "--out", metavar="ANNOTATIONS", help="folder of answers and annotations")
    annotate.add_argument("--graph", metavar="GRAPH", help="graph that tracks (default general)")
    annotate.add_argument(
        "--threshold",
        type=share,
        metavar="P",
        help="ask below this probability (default 0.8)",
    )
    annotate.add_argument(
        "--patience",
        type=whole_number(1),
        metavar="N",
        help="frames in a row that may be below (default 20)",
    )
    add_size_option(annotate)
    add_range_option(annotate)
    annotate.add_argument("--seed", type=whole_number(0), metavar="N", help="seed of all randomness (0)")
    annotate.add_argument(
        "--format", action="append", choices=FORMATS, help="format to write (default coco); may be repeated"
    )
    annotate.add_argument(
        "--import",
        dest="imports",
        action="append",
        default=[],
        metavar="FILE",
        help="boxes from another tool, taken as answers: COCO, MOT, CVAT, Label Studio, a YOLO folder, or a "
        "zip of one of them",
    )
    annotate.add_argument(
        "--no-view", action="store_true", help="open no page: track, write, and print what it would ask"
    )
    add_identity_options(annotate)
    page = annotate.add_argument_group("page")
    page.add_argument("--port", type=port, metavar="PORT", help="port of the page (default a free one)")
    page.add_argument(
        "--view-host",
        default="127.0.0.1",
        metavar="HOST",
        help="address that the page listens at (default 127.0.0.1: only this machine)",
    )
    page.add_argument("--open", action="store_true", help="open the page in this machine's browser")


COMMANDS = {"annotate": (_add_annotate, _annotate)}
