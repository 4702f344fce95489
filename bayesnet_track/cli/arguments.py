"""Arguments that commands share, start boxes among them, and their answers: exit codes and complaints."""

from __future__ import annotations

import argparse
import itertools
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from bayesnet_track.sources.paths import hide_secrets

if TYPE_CHECKING:
    from bayesnet_track.evaluate.truth import TruthForm
    from bayesnet_track.graph.checked import Calibration, CheckedGraph
    from bayesnet_track.observation.image_files import Mask
    from bayesnet_track.runtime.run import Start


OK, FAILED, USAGE, BAD_GRAPH, BAD_SOURCE, INCOMPLETE, BAD_OUTPUT = range(7)


class UsageError(ValueError):
    """Arguments that make no sense, alone or together."""


@contextmanager
def users_mistake() -> Iterator[None]:
    """Raise `UsageError` for what fails inside because of an argument, or of a file that one names."""
    from bayesnet_track.journal.codec import JournalError

    try:
        yield
    except JournalError:
        raise
    except (OSError, ValueError) as error:
        raise UsageError(words(error)) from error


@contextmanager
def users_file(option: str, expected: str) -> Iterator[None]:
    """`users_mistake` for the file of an option; one that cannot be read is said with what it should hold."""
    from bayesnet_track.sources.mot_lines import NotTextError

    with users_mistake():
        try:
            yield
        except (OSError, NotTextError) as error:
            raise UsageError(f"{option} {words(error)}; expected {expected}") from error


def users_output(path: Path) -> AbstractContextManager[None]:
    """Raise `OutputError`, which names the output, for what the system refuses inside it."""
    from bayesnet_track.journal import writer

    return writer.writing(path)


def check_free(path: Path, overwrite: bool) -> None:
    """Refuse to write over another file unless that is asked for; raises OutputError."""
    from bayesnet_track.journal.disk import is_there
    from bayesnet_track.journal.writer import OutputError

    with users_output(path):
        if is_there(path) and not overwrite:
            raise OutputError(f"{path}: it is there already; --overwrite replaces it")


def words(error: Exception) -> str:
    """An error as a message; the system's own in the form "file: what is wrong"."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def say(text: str) -> None:
    """Print a result."""
    sys.stdout.write(text + "\n")


STATUS_INKS = {"tracking": 32, "found again": 32, "uncertain": 33, "lost": 31, "hidden": 35}
"""Status, as a sentence ends with it -> number of its colour in a terminal, as on the page of a run."""

_STATUS = re.compile(rf"\b({'|'.join(STATUS_INKS)})(?=[;:]|$)")


def by_status(line: str, stream: TextIO) -> str:
    """The line with the status that it ends with in colour; unchanged where the stream takes none.

    A stream takes colour if it is a terminal, its `TERM` is not `dumb`, and `NO_COLOR` is unset or empty
    (https://no-color.org).
    """
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or not stream.isatty():
        return line
    return _STATUS.sub(lambda status: f"\x1b[{STATUS_INKS[status[1]]}m{status[1]}\x1b[0m", line)


def complain(message: str) -> None:
    """Print what is wrong."""
    run_silently(lambda: sys.stderr.write(hide_secrets(message) + "\n"))


def run_silently(show: Callable[[], object]) -> None:
    """Write to stderr; that nobody reads it any more stops nothing."""
    try:
        show()
    except BrokenPipeError:
        mute(sys.stderr)


def mute(stream: TextIO) -> None:
    """Let what is written go nowhere: at its end the interpreter would complain of a reader that is gone."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def whole_number(minimum: int) -> Callable[[str], int]:
    """Parser of whole numbers from `minimum` on."""

    def parse(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 19 and int(text) >= minimum):
            raise argparse.ArgumentTypeError(f"{text!r}: a whole number from {minimum} on is needed")
        return int(text)

    return parse


def _number(needed: str, bound: float = math.inf, maximum: float = math.inf) -> Callable[[str], float]:
    """Parser of finite numbers above 0, less than `bound` and at most `maximum`; `needed` says so."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not (0.0 < value < bound and value <= maximum):
            raise argparse.ArgumentTypeError(f"{text!r}: {needed}")
        return value

    return parse


metres = _number("a length above 0 in metres, at most 1 is needed (25 mm are 0.025)", maximum=1.0)
pixels = _number("a distance above 0 in px is needed", bound=1e9)
milliseconds = _number("milliseconds above 0 are needed", bound=1e7)
seconds = _number("a number of seconds above 0 is needed", bound=1e6)
gradient = _number("a number above 0, at most 100 is needed", maximum=100.0)
share = _number("a number above 0, at most 1 is needed", maximum=1.0)


FORMS = ("mot", "boxes", "corners", "centers", "polygons")
"""Those of `evaluate.truth`, which is not imported before it is needed."""


def add_truth_format(parser: argparse.ArgumentParser) -> None:
    """`--truth-format`."""
    parser.add_argument(
        "--truth-format",
        choices=FORMS,
        help="what a line of the ground truth holds: MOT, x,y,w,h, left,top,right,bottom, the centre "
        "and w,h, or four corners (default: what the lines look like)",
    )


def add_plugins(parser: argparse.ArgumentParser) -> None:
    """Add ``--allow-plugins`` and ``--cue-file`` to a command that reads graphs or loads detectors."""
    parser.add_argument(
        "--allow-plugins",
        action="append",
        default=[],
        type=_names,
        metavar="NAME,...",
        help="cues and detectors of other packages that may be loaded; see `list`",
    )
    parser.add_argument(
        "--cue-file",
        action="append",
        default=[],
        metavar="FILE",
        help="Python file that defines a cue, as CUE = CueDeclaration(...), for graphs to use; its code is "
        "run; may be repeated",
    )


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]


def add_set_option(parser: argparse.ArgumentParser) -> None:
    """`--set`, which may be repeated."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="change a value of the graph: keys joined by dots (targets, the plate and nodes may be "
        "left out), and YAML, as in square.adapt.activate.above.ud_px2=200; may be repeated",
    )


def set_values(
    text: str,
    changes: Sequence[str],
    adaptation: bool = True,
    masks: Mapping[str, Mask] | None = None,
    calibrations: Mapping[str, Calibration] | None = None,
) -> CheckedGraph:
    """The graph of a canonical text with other values; `adaptation` is False for all agents always on.

    Raises:
        UsageError: a path or a value that is none; says which names there are, and the nearest.
        GraphError: what comes out fails a check.
    """
    from bayesnet_track.graph.text.change import ChangeError, change_graph

    try:
        return change_graph(text, changes, adaptation, masks, calibrations)
    except ChangeError as error:
        raise UsageError(f"--set {error}") from error


def add_view_options(parser: argparse.ArgumentParser) -> None:
    """`--view`, `--view-host`, `--view-now`, `--open`."""
    group = parser.add_argument_group("live view")
    group.add_argument(
        "--view",
        nargs="?",
        const=0,
        type=port,
        metavar="PORT",
        help="show the run live in a browser; it begins when its page is opened, and a missing start "
        "box can be drawn there (default port: a free one)",
    )
    group.add_argument(
        "--view-host",
        default="127.0.0.1",
        metavar="HOST",
        help="address that the view listens at (default 127.0.0.1: only this machine)",
    )
    group.add_argument("--view-now", action="store_true", help="begin before the page is opened")
    group.add_argument("--open", action="store_true", help="open the page in this machine's browser")


def port(text: str) -> int:
    """A port from 1024 to 65535."""
    if not (text.isascii() and text.isdigit() and len(text) < 6 and 1024 <= int(text) < 65536):
        raise argparse.ArgumentTypeError(f"{text!r}: a port from 1024 to 65535 is needed")
    return int(text)


TRUTH_LINES = "a text file with one box x,y,w,h per line"
"""What a ground-truth file of one target holds, for messages."""

VIDEOS = {".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v"}


def run_folder(text: str) -> Path:
    """The run directory that `--out` names.

    Raises:
        UsageError: it looks like the name of a video.
    """
    folder_path = Path(text)
    if folder_path.suffix.lower() in VIDEOS:
        folder, kind = folder_path.with_suffix(""), "mp4" if folder_path.suffix.lower() == ".mp4" else "mkv"
        raise UsageError(
            f"--out {text}: this is the folder of the run; --out {folder} --video {kind} writes "
            f"{folder}/video.{kind}"
        )
    return folder_path


def free_folder(first: str, overwrite: bool = False) -> Path:
    """The first of NAME, NAME-2, NAME-3, ... that does not exist; NAME itself where it may be replaced."""
    names = itertools.chain([first], (f"{first}-{number}" for number in itertools.count(2)))
    return Path(next(name for name in names if overwrite or not os.path.lexists(name)))


def read_start(path: Path, frame: int, form: TruthForm | None = None) -> Start:
    """The start that a ground-truth file has for `frame`; `form` is that of `read_truth`.

    Raises:
        UsageError: the file cannot be read, or has no box for this frame.
    """
    from bayesnet_track.evaluate.truth import start_box
    from bayesnet_track.runtime.run import Start

    with users_file("--init-from", TRUTH_LINES):
        return Start(start_box(path, frame, form))


def parse_start(text: str) -> Start:
    """A start from ``x,y,w,h`` or ``plate:x,y,w,h`` (top-left corner, px).

    Or, of several cameras, from ``north=x,y south=x,y``, the points or boxes in which they show it.

    Raises:
        UsageError: it is something else.
    """
    from bayesnet_track.runtime.run import Start

    plate, _, numbers = text.rpartition(":")
    if "=" in numbers:
        return Start(plate=plate or None, points=_parse_points(text, numbers))
    try:
        x, y, w, h = (float(part) for part in numbers.split(","))
    except ValueError:
        raise UsageError(f"--init {text!r}: four numbers X,Y,W,H are needed (top-left corner, px)") from None
    return Start((x, y, w, h), plate or None)


def _parse_points(text: str, parts: str) -> dict[str, tuple[float, ...]]:
    points: dict[str, tuple[float, ...]] = {}
    for part in parts.split():
        camera, _, numbers = part.partition("=")
        try:
            points[camera] = tuple(float(number) for number in numbers.split(","))
        except ValueError:
            points[camera] = ()
        if len(points[camera]) not in (2, 4):
            raise UsageError(
                f"--init {text!r}: of camera {camera} {numbers!r}; allowed: CAMERA=X,Y, a point, or "
                "CAMERA=X,Y,W,H, a box (px), with spaces between cameras"
            )
    return points
