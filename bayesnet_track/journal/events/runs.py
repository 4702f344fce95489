"""A run that starts, goes on elsewhere, and ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesnet_track.journal.text.wording import plural

JOURNAL_VERSION = 2


@dataclass(frozen=True)
class RunStarted:
    """First line of every journal.

    Attributes:
        journal: version of the file format.
        graph: the graph's name.
        graph_sha256: hash of the graph's canonical text, which stands in graph.yaml.
        seed: seed of all random streams.
        source: the source as given.
        width: columns of the first frame.
        height: rows of the first frame.
        has_color: False for a gray source.
        declared_frames: number of frames that the source declares, or None.
        frame_interval_s: nominal seconds between frames (1 time unit).
        costs_ms: declared cost of each cue, which rules weigh with.
        versions: of Python and of the libraries that touch numbers.
        inputs: files from outside besides the source (of detections), each with its SHA-256; left out when
            there are none.
        smoothed: whether boxes and uncertainties are of beliefs given the whole sequence (`smooth`); left out
            when they are the filter's.
        tracked: width and height of the frames tracked in, where they were made smaller (`max_side`); boxes
            are in the source's pixels all the same, UD is not. Left out when they were not.
    """

    journal: int
    graph: str
    graph_sha256: str
    seed: int
    source: str
    width: int
    height: int
    has_color: bool
    declared_frames: int | None
    frame_interval_s: float
    costs_ms: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    smoothed: bool = field(default=False, metadata={"left_out_when_empty": True})
    tracked: tuple[int, ...] = field(default=(), metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        colour = "" if self.has_color else " gray"
        length = "" if self.declared_frames is None else f", {plural(self.declared_frames, 'frame')}"
        kind = "smoothed run" if self.smoothed else "run"
        resized = " tracked at {}x{}".format(*self.tracked) if self.tracked else ""
        rate = (
            f"{1 / self.frame_interval_s:.4g} frames per second" if self.frame_interval_s > 0 else "no rate"
        )
        return (
            f"{kind} of {self.graph} ({self.graph_sha256[:12]}) on {self.source}: "
            f"{self.width}x{self.height}{resized}{colour}{length}, {rate}; seed {self.seed}"
        )


@dataclass(frozen=True)
class RunEnded:
    """Last line of a journal that was closed properly.

    Attributes:
        frames: frames read.
        declared_frames: what the source declared, or None.
        complete: False when the source ended early, was damaged, or the run was stopped.
        reason: end_of_source, source_truncated, source_damaged, frame_size_changed, interrupted, error.
    """

    frames: int
    declared_frames: int | None
    complete: bool
    reason: str

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        declared = self.declared_frames
        whole = declared is None or declared == self.frames
        frames = plural(self.frames, "frame") if whole else f"{self.frames} of {declared} frames"
        how = "ended" if self.complete else "ended early"
        return f"run {how} after {frames}: {self.reason.replace('_', ' ')}"


@dataclass(frozen=True)
class MachineChanged:
    """The run was resumed on another machine or with other libraries, because that was explicitly allowed.

    From this frame on its numbers may differ in their last digits from those of an unbroken run on either.

    Attributes:
        frame: the first frame that is computed there.
        changes: what differs, each in words: name, before, now.
    """

    frame: int
    changes: tuple[str, ...]

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        where = "the run continues on another machine or with other libraries"
        return f"{where}: {'; '.join(self.changes)}"


Events = RunStarted | RunEnded | MachineChanged
