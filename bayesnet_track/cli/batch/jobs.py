"""The jobs of a batch: one video with one seed each."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from bayesnet_track.evaluate.truth import TruthForm


class BatchError(ValueError):
    """A list or pattern from which no job can be made."""


@dataclass(frozen=True)
class Video:
    """One video of a batch.

    Attributes:
        source: file, folder or glob of images.
        name: of its rows and its folder.
        init: start box x, y, w, h as text, or None.
        init_from: ground-truth file whose first box starts it, or None.
        truth: ground-truth file to score with, or None.
    """

    source: str
    name: str
    init: str | None = None
    init_from: str | None = None
    truth: str | None = None


@dataclass(frozen=True)
class Job:
    """One run of a batch: a video with a seed.

    Attributes:
        graph: path or installed name of the graph.
        video: the video.
        seed: the seed.
        out: run directory.
        end: frame to stop before, or None.
        on_resize: what a change of size does.
        plugins: cues and detectors of other packages that may be loaded.
        cue_files: files with cues of one's own, from the root.
        max_side: longest side of the frames that are tracked in, px; None for those of the video.
        value_range: the values that become black and white; None for all that their type holds.
        truth_format: what lines of ground truth hold; None for what they look like.
    """

    graph: str
    video: Video
    seed: int
    out: str
    end: int | None = None
    on_resize: str = "stop"
    plugins: tuple[str, ...] = ()
    cue_files: tuple[str, ...] = ()
    max_side: int | None = None
    value_range: tuple[float, float] | None = None
    truth_format: TruthForm | None = None

    @property
    def label(self) -> str:
        """Its name in what is shown."""
        return f"{self.video.name} seed {self.seed}"

    def to_json(self) -> str:
        """It as one line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str) -> Job:
        """The inverse of `to_json`."""
        values: dict[str, Any] = json.loads(line)
        lists = {name: tuple(values[name]) for name in ("plugins", "cue_files")}
        if values["value_range"] is not None:
            lists["value_range"] = tuple(values["value_range"])
        return cls(**{**values, "video": Video(**values["video"]), **lists})


def allow(job: Job) -> None:
    """Let the code from elsewhere that the job names be loaded in this process.

    Raises:
        CueError: a cue file cannot be loaded.
    """
    from bayesnet_track.observation import plugins
    from bayesnet_track.observation.cue_files import use_cue_file

    plugins.allow(job.plugins)
    for file in job.cue_files:
        use_cue_file(file)
