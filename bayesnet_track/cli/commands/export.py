"""Commands that export a run: `report` as a page, `plot` as a picture, `export` for another tool."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    OK,
    TRUTH_LINES,
    UsageError,
    add_truth_format,
    check_free,
    complain,
    say,
    users_file,
    users_mistake,
    users_output,
    whole_number,
    words,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesnet_track.runtime.recording.run_reader import Data, Run, RunPictures
    from bayesnet_track.runtime.recording.rundir import RunDirectory


FOLDER, INDEX = "report", "index.html"
UNFINISHED = "<!doctype html><title>unfinished</title><p>This page is not finished: make it again.</p>\n"


def _report(options: argparse.Namespace) -> int:
    """Write the page of a run."""
    from bayesnet_track.journal.blocks import Blocks
    from bayesnet_track.journal.events.runs import RunStarted
    from bayesnet_track.journal.reader import Measurements, read_events
    from bayesnet_track.runtime.recording.run_reader import page_data, page_in_one, pictures_of
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    directory = RunDirectory.open(options.run)
    path = _place(options, directory)
    events = list(read_events(directory.journal, complain))
    metrics = Measurements(directory.frames, complain) if directory.frames.is_file() else ()
    if not events or not isinstance(events[0], RunStarted):
        raise UsageError(f"{directory.journal}: it does not begin with run_started; there is nothing to show")
    data = page_data(directory, events, metrics, _truth(directory, options), complain)
    frames = Blocks(metrics, ()).frames().tolist()
    if options.frames == "none" or not frames:
        missing = "left out by --frames none" if frames else "no frame was tracked"
        _write(path, page_in_one(data, None, missing, 0))
    else:
        with pictures_of(directory, events[0], min(frames), max(frames)) as (pictures, missing):
            if missing:
                complain(f"{directory.path}: the page has no pictures: {missing}")
            if pictures is not None and options.frames == "full":
                _write_folder(path, data, pictures)
            else:
                _write(path, page_in_one(data, pictures, missing, len(frames)))
    if path.resolve() == directory.report.resolve():
        _list(directory)
    say(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
    if not options.open:
        complain(
            "next: open it in a browser (--open does); "
            f"`bayesnet-track diagnose {options.run}` names keys to try"
        )
    else:
        from bayesnet_track.cli.following import open_page

        open_page(path.absolute().as_uri())
    return OK


def _list(directory: RunDirectory) -> None:
    """Let `verify` know the page, where the run has a manifest that can be trusted."""
    from bayesnet_track.runtime.recording.manifest import ManifestError, add_output

    try:
        add_output(directory, "report")
    except (OSError, ManifestError) as error:
        complain(f"{directory.report}: not listed in {directory.manifest.name}: {words(error)}")


def _place(options: argparse.Namespace, directory: RunDirectory) -> Path:
    """The HTML file to write; its folder is there."""
    with users_output(Path(options.out or directory.path)):
        place = _checked_place(options, directory)
        place.parent.mkdir(parents=True, exist_ok=True)
    return place


def _checked_place(options: argparse.Namespace, directory: RunDirectory) -> Path:
    from bayesnet_track.view.run_page import is_page

    if options.frames == "full":
        folder = Path(options.out) if options.out else directory.path / FOLDER
        if folder.is_dir() and any(folder.iterdir()) and not (folder / INDEX).is_file():
            raise UsageError(f"--out {folder}: the folder holds something else; give a new or an empty one")
        place = folder / INDEX
    else:
        place = Path(options.out) if options.out else directory.report
        if place.is_dir():
            raise UsageError(f"--out {place}: it is a folder; name a file, or ask for --frames full")
        with users_mistake():
            if options.out and place.exists() and not is_page(place):
                raise UsageError(
                    f"--out {place}: it is there already, and no page of a run; name another file"
                )
    return place


def _truth(directory: RunDirectory, options: argparse.Namespace) -> NDArray[Any] | None:
    from bayesnet_track.evaluate.runs import say_lengths
    from bayesnet_track.evaluate.truth import read_truth

    truth_path = options.truth
    place = directory.truth if truth_path is None else Path(truth_path)
    if truth_path is None and not place.is_file():
        return None
    with users_file("--truth", TRUTH_LINES):
        truth = read_truth(place, options.truth_format)
    if truth_path is not None:
        say_lengths(directory.path, place, len(truth))
    return truth


def _write_folder(path: Path, data: Data, pictures: RunPictures) -> None:
    from bayesnet_track.view.run_page import FRAMES_FOLDER, full_pictures, picture_name, with_folder

    frames: dict[str, list[int]] = {}
    if not path.exists():  # what is killed before the page is there leaves a folder that is known for its own
        _write(path, [UNFINISHED])
    with users_output(path.parent):
        (path.parent / FRAMES_FOLDER).mkdir(exist_ok=True)
        for frame, camera, picture in full_pictures(pictures.views):
            place = path.parent / picture_name(frame, camera)
            place.parent.mkdir(exist_ok=True)
            place.write_bytes(picture)
            frames.setdefault(camera, []).append(frame)
    _write(path, with_folder(*data, frames, pictures.annotated))


def _write(path: Path, pieces: Iterable[str]) -> None:
    from bayesnet_track.journal.writer import PART

    part = path.resolve().with_name(path.resolve().name + PART)
    with users_output(path):
        with part.open("w", encoding="utf-8", errors="replace", newline="\n") as file:
            for piece in pieces:
                file.write(piece)
        part.replace(path.resolve())


def _plot_run(options: argparse.Namespace) -> int:
    """Draw a run over time."""
    from bayesnet_track.journal.text.story import check_target
    from bayesnet_track.runtime.recording.run_reader import open_run

    run = open_run(options.run, complain)
    path = Path(options.out or f"{run.directory.path.resolve().name}.svg")
    check_free(path, options.overwrite)
    with users_mistake():
        if options.target is not None:
            check_target(run.events, options.target)
        picture = run.timeline(options.target)
    _write(path, [picture])
    say(f"wrote {path}")
    return OK


def _add_plot(commands: argparse._SubParsersAction[Any]) -> None:
    plot = commands.add_parser("plot", help="draw uncertainty and active agents over time, as SVG")
    plot.add_argument("run", metavar="RUN", help="run directory")
    plot.add_argument("-o", "--out", metavar="FILE", help="SVG file to write (default: name of the run)")
    plot.add_argument("--target", metavar="ID", help="which target (default: the first)")
    plot.add_argument("--overwrite", action="store_true", help="replace the file if it exists")


def _add_report(commands: argparse._SubParsersAction[Any]) -> None:
    report = commands.add_parser(
        "report",
        help="write a page of a run for the browser",
        description="Write one HTML file that shows a run: its frames, the belief, the net, its uncertainty, "
        "and every reconfiguration with its reason. The file needs no network.",
    )
    report.add_argument("run", metavar="RUN", help="run directory")
    report.add_argument("-o", "--out", metavar="FILE", help="file to write (default: report.html in RUN)")
    report.add_argument(
        "--frames",
        choices=["thumbnails", "full", "none"],
        default="thumbnails",
        help="thumbnails in the file (default); full: a folder with index.html and every frame; none",
    )
    report.add_argument(
        "--truth", metavar="FILE", help="ground-truth file to compare with (default: the run's own truth.txt)"
    )
    add_truth_format(report)
    report.add_argument("--open", action="store_true", help="open it in the browser")


WITH_LOST = ("csv", "jsonl", "frames")
"""Formats that say of a box that its target is lost."""


def _export(options: argparse.Namespace) -> int:
    """Write the file."""
    from bayesnet_track.runtime.recording.exports import FORMATS
    from bayesnet_track.runtime.recording.run_reader import open_run

    if options.format == "arviz":
        return _export_beliefs(options)
    if options.draws is not None:
        raise UsageError(f"--draws beside --format {options.format}; it is for --format arviz")
    run = open_run(options.run, complain)
    if options.afterwards:
        run = _judged(run)
    lost = options.lost or (options.format in WITH_LOST and not options.no_lost)
    text = FORMATS[options.format](run, lost)
    parts = [text] if isinstance(text, str) else text
    if options.out is None:
        sys.stdout.writelines(parts)
        return OK
    path = Path(options.out)
    check_free(path, options.overwrite)
    with users_output(path), path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(parts)
    complain(f"wrote {path}")
    return OK


def _judged(run: Run) -> Run:
    """The run judged as a whole; says what changed."""
    from bayesnet_track.journal.text.wording import plural
    from bayesnet_track.runtime.recording.exports import judge_afterwards

    run, judgements = judge_afterwards(run)
    if not judgements:
        raise UsageError(
            f"--afterwards: no target of {run.name} has a guarantee with levels for it; "
            "`bayesnet-track fit --guarantee` writes them"
        )
    for judgement in judgements:
        complain(
            f"target {judgement.target}: tracking in {judgement.afterwards} of "
            f"{plural(judgement.frames, 'frame')} instead of {judgement.live}, where the mean "
            f"score is above {judgement.level:.4g}"
        )
    return run


def _export_beliefs(options: argparse.Namespace) -> int:
    """Write draws of the kept beliefs for ArviZ."""
    from bayesnet_track.runtime.recording.exports import ArvizError, write_arviz
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.smoothing import KeptBeliefsError

    if options.lost or options.no_lost:
        raise UsageError("--lost and --no-lost are not for --format arviz, which writes every belief")
    if options.afterwards:
        raise UsageError("--afterwards judges statuses; --format arviz writes beliefs")
    if options.out is None:
        raise UsageError("--format arviz writes a binary file; give its name with --out")
    path = Path(options.out)
    check_free(path, options.overwrite)
    run = open_run(options.run, complain)
    try:
        with users_output(path):
            write_arviz(run, path, options.draws or DRAWS)
    except (KeptBeliefsError, ArvizError) as error:
        raise UsageError(str(error)) from error
    complain(f"wrote {path}")
    return OK


DRAWS = 500
FORMATS = ("mot", "coco", "csv", "jsonl", "frames", "world", "arviz")


def _add_export(commands: argparse._SubParsersAction[Any]) -> None:
    export = commands.add_parser("export", help="write a run in the format of another tool")
    export.add_argument("run", metavar="RUN", help="run directory")
    export.add_argument("--format", required=True, choices=FORMATS, help="format of the file")
    export.add_argument("-o", "--out", metavar="FILE", help="file to write (default: print)")
    export.add_argument(
        "--draws",
        type=whole_number(1),
        metavar="N",
        help=f"draws of each belief, for --format arviz (default {DRAWS})",
    )
    lost = export.add_mutually_exclusive_group()
    lost.add_argument(
        "--lost",
        action="store_true",
        help="include the boxes of lost targets (default for csv, jsonl, frames)",
    )
    lost.add_argument("--no-lost", action="store_true", help="leave them out (default for mot, coco, world)")
    export.add_argument(
        "--afterwards",
        action="store_true",
        help="statuses as the graph's guarantee allows now that the run is over",
    )
    export.add_argument("--overwrite", action="store_true", help="replace the file if it exists")


COMMANDS = {
    "report": (_add_report, _report),
    "export": (_add_export, _export),
    "plot": (_add_plot, _plot_run),
}
