"""Start boxes as they are given on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import UsageError, users_file

if TYPE_CHECKING:
    from bayesnet_track.evaluate.truth import TruthForm
    from bayesnet_track.runtime.run import Start


TRUTH_LINES = "a text file with one box x,y,w,h per line"
"""What a ground-truth file of one target holds, for messages."""

VIDEOS = {".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v"}


def run_folder(text: str) -> Path:
    """The run directory that `--out` names.

    Raises:
        UsageError: it looks like the name of a video.
    """
    out = Path(text)
    if out.suffix.lower() in VIDEOS:
        folder, kind = out.with_suffix(""), "mp4" if out.suffix.lower() == ".mp4" else "mkv"
        raise UsageError(
            f"--out {text}: this is the folder of the run; --out {folder} --video {kind} writes "
            f"{folder}/video.{kind}"
        )
    return out


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

    Raises:
        UsageError: it is something else.
    """
    from bayesnet_track.runtime.run import Start

    plate, _, numbers = text.rpartition(":")
    try:
        x, y, w, h = (float(part) for part in numbers.split(","))
    except ValueError:
        raise UsageError(f"--init {text!r}: four numbers X,Y,W,H are needed (top-left corner, px)") from None
    return Start((x, y, w, h), plate or None)
