"""What came from outside for frames that will be tracked again, kept while a run goes on after a checkpoint.

``inputs.jsonl`` is cut off at the checkpoint. Until the run has come past them again, the lines behind it are
in a file of their own: else they would be gone when it is broken off a second time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.reader import read_inputs
from bayesnet_track.journal.writer import write_atomically
from bayesnet_track.runtime.recording.rundir import RunDirectory


def inputs_before(directory: RunDirectory) -> Mapping[int, Sequence[Input]]:
    """What came from outside, by frame.

    Raises:
        OSError: a file cannot be read.
        JournalError: it is damaged; says file and line.
    """
    found = _by_frame(directory.ahead)
    for frame, given in _by_frame(directory.inputs).items():
        # A frame that was tracked again has what it was given then, unless that is only the first part of
        # what it had before: then the run was broken off while it was written again.
        if found.get(frame, [])[: len(given)] != given:
            found[frame] = given
    return found


def _by_frame(path: Path) -> dict[int, list[Input]]:
    found: dict[int, list[Input]] = {}
    for one in read_inputs(path) if path.exists() else ():
        found.setdefault(one.frame, []).append(one)
    return found


def keep_pending(directory: RunDirectory, before: Mapping[int, Sequence[Input]], frame: int) -> None:
    """Write down what came for the frames after `frame`.

    Raises:
        OutputError: it cannot be written.
    """
    later = [one for index, given in sorted(before.items()) if index > frame for one in given]
    if later or directory.ahead.exists():
        write_atomically(directory.ahead, "".join(f"{to_json(one)}\n" for one in later).encode("utf-8"))
