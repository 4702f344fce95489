"""What came from outside for frames that will be tracked again, kept while a run goes on after a checkpoint.

``inputs.jsonl`` is cut off at the checkpoint. Until the run has come past them again, the lines behind it are
in a file of their own: else they would be gone when it is broken off a second time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayesnet_track.journal.atomic import write_atomically
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.inputs import Input
from bayesnet_track.journal.reader import read_inputs
from bayesnet_track.runtime.recording.rundir import RunDirectory


def told_before(directory: RunDirectory) -> Mapping[int, Sequence[Input]]:
    """What came from outside, by frame.

    Raises:
        OSError: a file cannot be read.
        JournalError: it is damaged; says file and line.
    """
    found: dict[int, list[Input]] = {}
    for path in (directory.ahead, directory.inputs):
        by_frame: dict[int, list[Input]] = {}
        for one in read_inputs(path) if path.exists() else ():
            by_frame.setdefault(one.frame, []).append(one)
        found |= by_frame  # of a frame that was tracked again, what it was given then
    return found


def keep_ahead(directory: RunDirectory, before: Mapping[int, Sequence[Input]], frame: int) -> None:
    """Write down what came for the frames after `frame`.

    Raises:
        OutputError: it cannot be written.
    """
    later = [one for index, given in sorted(before.items()) if index > frame for one in given]
    if later or directory.ahead.exists():
        write_atomically(directory.ahead, "".join(f"{to_json(one)}\n" for one in later).encode("utf-8"))
