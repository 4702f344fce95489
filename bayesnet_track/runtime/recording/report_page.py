"""The page of a run, made from its directory: for `report`, and for a notebook."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from bayesnet_track.journal.blocks import Blocks
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.reader import Notice
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.view.run_page import LARGEST

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.recording.pictures import Found

Data = tuple[dict[str, Any], dict[str, Any]]
"""What is embedded in a page: its header, and its columns."""


def page_data(
    directory: RunDirectory,
    events: Sequence[Event],
    metrics: Sequence[FrameMetrics],
    truth: NDArray[Any] | None,
    notice: Notice,
) -> Data:
    """What a page shows of a run, but for its pictures; `notice` is told of what cannot be shown.

    Raises:
        JournalError: a line of timings.jsonl is malformed.
    """
    from bayesnet_track.view.page_data import read_timings, run_data

    timings = read_timings(directory.timings)
    return run_data(events, metrics, timings, _graph(directory, notice), truth, directory.path.resolve().name)


def page_in_one(
    data: Data, found: Found | None, missing: str, expected: int, largest: int = LARGEST
) -> Iterator[str]:
    """The text of a page in one file, in pieces.

    Args:
        data: from `page_data`.
        found: its pictures, if there are any; read before the first piece is given.
        missing: why there are none.
        expected: how many there may be.
        largest: bytes of the page, unless what was measured alone takes more.
    """
    from bayesnet_track.view.run_page import Pictures, gather, one_file, room_for_pictures

    pictures = Pictures((), ())
    if found is not None:
        wanted = {row["frame"] for row in data[0]["events"] if row["sort"] != "note"}
        pictures = gather(found.images, expected, wanted, room_for_pictures(*data, largest), found.annotated)
    return one_file(*data, pictures, missing)


def page_html(
    directory: RunDirectory,
    events: Sequence[Event],
    metrics: Sequence[FrameMetrics],
    truth: NDArray[Any] | None,
    largest: int,
) -> str:
    """The page of a run as a text of at most `largest` bytes; see `page_in_one`.

    Raises:
        ValueError: it does not begin with `run_started`.
    """
    from bayesnet_track.runtime.recording.pictures import pictures_of

    if not events or not isinstance(events[0], RunStarted):
        raise ValueError(f"{directory.journal}: it does not begin with run_started; there is nothing to show")
    data = page_data(directory, events, metrics, truth, lambda text: None)
    frames = Blocks(metrics, ()).frames().tolist()
    if not frames:
        return "".join(page_in_one(data, None, "no frame was tracked", 0, largest))
    with pictures_of(directory, events[0], min(frames), max(frames)) as (found, missing):
        return "".join(page_in_one(data, found, missing, len(frames), largest))


def _graph(directory: RunDirectory, notice: Notice) -> CheckedGraph | None:
    """The run's graph, whose cues are not run; None, with a notice, where it cannot be read."""
    from bayesnet_track.graph.checks.cameras import AnyCalibration
    from bayesnet_track.graph.checks.run import check, cues_named
    from bayesnet_track.graph.text.load import read_graph
    from bayesnet_track.graph.text.messages import GraphError
    from bayesnet_track.observation.cue import stand_ins
    from bayesnet_track.observation.image_files import AnyMask

    try:
        spec, at = read_graph(directory.graph)
        return check(spec, at, stand_ins(cues_named(spec)), AnyMask(), AnyCalibration())
    except (GraphError, OSError) as error:
        notice(f"{directory.graph}: the page shows no net: {error}")
        return None
