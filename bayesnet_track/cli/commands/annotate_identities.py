"""`annotate --identities`: who is who in a finished run, asking where that is least certain."""

from __future__ import annotations

import argparse
import hashlib
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.arguments import (
    OK,
    UsageError,
    complain,
    say,
    users_file,
    users_output,
    whole_number,
    words,
)

if TYPE_CHECKING:
    from bayesnet_track.journal.writer import LineFile
    from bayesnet_track.runtime.annotation.identity_queue import IdentityQuestion, IdentityQueue
    from bayesnet_track.runtime.recording.run_reader import Run

MOST = 10
KEYS = {"k": "keep", "s": "swap", "n": "new", "x": "skip", "u": "undo"}
OF_VIDEOS = (
    "video",
    "graph",
    "threshold",
    "patience",
    "max_side",
    "value_range",
    "seed",
    "format",
    "imports",
)
"""What has no meaning beside `--identities`."""


def annotate_identities(options: argparse.Namespace) -> int:
    """Ask about the identities of a run, in the browser, the terminal or by a file; write what follows."""
    from bayesnet_track.journal.codec import JournalError
    from bayesnet_track.runtime.annotation.identity_desk import (
        NAME,
        IdentityFileError,
        open_answers,
        write_tracks,
    )
    from bayesnet_track.runtime.annotation.identity_queue import IdentityQueue, Tracklets
    from bayesnet_track.runtime.recording.manifest import is_locked, lock_run
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError

    misplaced = [name for name in OF_VIDEOS if getattr(options, name) not in (None, [])]
    if misplaced:
        raise UsageError(f"{_option(misplaced[0])}: of a video to label; --identities looks at a run")
    try:
        run = open_run(options.identities)
        if is_locked(run.directory):
            raise UsageError(f"--identities {options.identities}: it is still being written")
        mot = run.directory.mot.read_text(encoding="ascii")
        digest = hashlib.sha256(run.directory.journal.read_bytes() + mot.encode()).hexdigest()
    except FileNotFoundError as error:
        raise UsageError(f"--identities {options.identities}: it has no tracks.txt") from error
    except (RunDirectoryError, JournalError) as error:
        raise UsageError(f"--identities {options.identities}: {error}") from error
    folder = Path(options.out or Path(options.identities) / "identities")
    with users_output(folder):
        folder.mkdir(parents=True, exist_ok=True)
    queue = IdentityQueue(Tracklets.of_run(run))
    try:
        with lock_run(RunDirectory(folder)), closing(open_answers(folder / NAME, digest, queue)) as file:
            _answer(options, run, queue, file)
            left_out = write_tracks(queue, mot, folder)
    except IdentityFileError as error:
        raise UsageError(str(error)) from error
    except RunDirectoryError as error:
        raise UsageError(f"--out {folder}: {error}") from error
    say(describe_queue(folder, queue, options.most, left_out))
    if options.stop.between_frames():
        options.stop.signal = None  # every answer is kept
    return OK


def _answer(options: argparse.Namespace, run: Run, queue: IdentityQueue, file: LineFile) -> None:
    """Take answers from a file, from the page, or without a page from the terminal, if there is a person."""
    from bayesnet_track.runtime.annotation.identity_desk import give_lines, keep_answer

    if options.answers is not None:
        name, text = options.answers, ""
        with users_file("--answers", "a text file with one answer per line, or - for the standard input"):
            text = sys.stdin.read() if name == "-" else Path(name).read_text(encoding="utf-8")
        # All or none: a file with a fault in its last line changes nothing.
        for answer in give_lines(queue, text.splitlines(), f"--answers {name}"):
            keep_answer(file, answer)
    elif not options.no_view:
        _show(options, run, queue, file)
    elif sys.stdin.isatty():
        with suppress(EOFError, KeyboardInterrupt):
            _converse(options, queue, file)


def _show(options: argparse.Namespace, run: Run, queue: IdentityQueue, file: LineFile) -> None:
    """Open the page until the person leaves."""
    from bayesnet_track.cli.following import announce
    from bayesnet_track.runtime.annotation.identity_desk import IdentityServer, JpegFrames
    from bayesnet_track.runtime.recording.run_reader import pictures_of

    frames = max((int(path.frame[-1]) for path in queue.tracklets.paths), default=0) + 1
    header = {
        "name": run.name,
        "width": run.started.width,
        "height": run.started.height,
        "frames": frames,
        "out": options.out or f"{options.identities}/identities",
    }
    with pictures_of(run.directory, run.started, 0, frames - 1) as (images, why):
        if images is None:
            complain(f"the page shows boxes alone: {why}")
        pictures = JpegFrames(() if images is None else images.images)
    address = (options.view_host, options.port)
    try:
        desk = IdentityServer(queue, file, header, options.most, pictures, address)
    except OSError as error:
        raise UsageError(f"--port: {options.view_host}: {words(error)}; choose another, or none") from error
    with desk:
        announce(options, desk.address)
        complain("Ctrl-C or `Finish` on the page writes the tracks; every answer is kept at once")
        options.stop.is_patient = True
        desk.wait(lambda: options.stop.signal is not None)


def _converse(options: argparse.Namespace, queue: IdentityQueue, file: LineFile) -> None:
    """Ask in the terminal until there is no doubt, or the person leaves."""
    from bayesnet_track.runtime.annotation.identity_desk import keep_answer
    from bayesnet_track.runtime.annotation.identity_queue import IdentityAnswerError

    complain("k keep, s swap, n new, x skip, u undo, a target's name: the same as it; q or Ctrl-D leaves")
    while questions := queue.questions(1):
        question = questions[0]
        key = input(f"{question.describe()}\n[{_keys(question)}] ").strip()
        if key == "q":
            return
        message = {"frame": question.frame, "target": question.target, "answer": KEYS.get(key, "same")}
        if key not in KEYS:
            message["other"] = key
        try:
            keep_answer(file, queue.give(message))
        except IdentityAnswerError as error:
            complain(str(error))
    complain("nothing is left to ask")


def _keys(question: IdentityQuestion) -> str:
    keep = "" if question.shown == "new" and not question.swap else "k keep, "
    swap = f"s swap with {question.swap}, " if question.swap else ""
    return f"{keep}{swap}n new, name, x skip, u undo, q"


def describe_queue(folder: Path, queue: IdentityQueue, limit: int, left_out: int) -> str:
    """The number of answers and of changes by them, and the least certain decisions, a line each."""
    from bayesnet_track.journal.text.wording import plural

    questions = queue.questions()
    text = (
        f"{folder}: {plural(len(queue.in_force), 'answer')}; {plural(queue.changed, 'time')} a target "
        f"goes on as another one; {plural(len(questions), 'doubtful decision')} left"
    )
    if left_out:
        text += f"; {plural(left_out, 'line')} of tracks.txt left out: two had one identity there"
    return "\n".join([text, *(question.describe() for question in questions[:limit])])


def _option(name: str) -> str:
    return {"video": "VIDEO", "imports": "--import", "value_range": "--range"}.get(
        name, f"--{name.replace('_', '-')}"
    )


def add_identity_options(annotate: argparse.ArgumentParser) -> None:
    """`--identities`, `--answers`, `--most`."""
    group = annotate.add_argument_group("identities of a run")
    group.add_argument(
        "--identities",
        metavar="RUN",
        help="instead of a video: ask who is who in a run, the least certain decisions first, and write its "
        "tracks under the identities that follow, into --out (default RUN/identities)",
    )
    group.add_argument(
        "--answers",
        metavar="FILE",
        help="answers about identities, a line of JSON each, instead of asking; - for standard input",
    )
    group.add_argument(
        "--most",
        type=whole_number(1),
        default=MOST,
        metavar="K",
        help=f"doubtful decisions to show (default {MOST})",
    )
