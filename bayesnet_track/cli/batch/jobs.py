"""The jobs of a batch: one video with one seed each, named, from patterns or from a list."""

from __future__ import annotations

import csv
import glob
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayesnet_track.evaluate.truth import TruthForm
from bayesnet_track.sources.mot_lines import read_text
from bayesnet_track.sources.paths import is_junk

COLUMNS = ("source", "name", "init", "init_from", "truth")
"""Columns of a list; only the source is needed."""

INNER = ("img", "img1")
"""Folders of images that are named after the folder around them."""


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


def videos_of(sources: Sequence[str], init_from: str | None = None, truth: str | None = None) -> list[Video]:
    """The videos that patterns name, sorted; `init_from` and `truth` are patterns of a video's own file.

    In these, ``{name}`` is the video's name and ``{folder}`` the folder that it, or its images, are in.

    Raises:
        BatchError: a pattern matches nothing, or has other words in braces.
    """
    found = []
    for pattern in sources:
        is_pattern = glob.has_magic(pattern)
        matching = glob.glob(pattern, recursive=True) if is_pattern else [pattern]  # noqa: PTH207
        names = sorted(name for name in matching if not (is_pattern and is_junk(Path(name))))
        if not names:
            raise BatchError(f"--source {pattern!r} matches nothing")
        found += names
    named = _unique([_name(source) for source in found])
    return [
        Video(source, name, None, _fill(init_from, source, name), _fill(truth, source, name))
        for source, name in zip(found, named, strict=True)
    ]


def read_list(path: Path) -> list[Video]:
    """The videos of a list: CSV with a header (`COLUMNS`), or an object of JSON a line.

    Raises:
        OSError: it cannot be read.
        NotTextError: it is not text.
        BatchError: it is malformed; says file and line.
    """
    text = read_text(path)
    rows = list(_json_rows(path, text) if text.lstrip().startswith("{") else _csv_rows(path, text))
    if not rows:
        raise BatchError(f"{path}: no video in it")
    names = _unique([row.get("name") or _name(row["source"]) for row in rows])
    return [
        Video(row["source"], name, *(row.get(key) or None for key in COLUMNS[2:]))
        for row, name in zip(rows, names, strict=True)
    ]


def _csv_rows(path: Path, text: str) -> Iterator[Mapping[str, str]]:
    reader = csv.DictReader(io.StringIO(text), strict=True)
    for row in reader:
        yield _row(f"{path}:{reader.line_num}", {key: value for key, value in row.items() if value})


def _json_rows(path: Path, text: str) -> Iterator[Mapping[str, str]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip():
            try:
                values = json.loads(line)
            except ValueError as error:
                raise BatchError(f"{path}:{number}: not a line of JSON: {error}") from None
            yield _row(f"{path}:{number}", values)


def _row(place: str, values: Any) -> Mapping[str, str]:
    if not isinstance(values, dict) or not all(isinstance(value, str) for value in values.values()):
        raise BatchError(f"{place}: texts by the names {', '.join(COLUMNS)} are needed")
    unknown = [str(key) for key in values if key not in COLUMNS]
    if unknown or not values.get("source"):
        what = f"unknown column {unknown[0]!r}" if unknown else "no source"
        raise BatchError(f"{place}: {what}; columns are {', '.join(COLUMNS)}")
    return values


def _name(source: str) -> str:
    path = Path(source)
    if path.name in INNER:
        path = path.parent
    return (path.stem if path.suffix and not path.is_dir() else path.name).replace("*", "") or "video"


def _folder(source: str) -> Path:
    path = Path(source)
    return path.parent if path.name in INNER or not path.is_dir() else path


def _fill(pattern: str | None, source: str, name: str) -> str | None:
    if pattern is None:
        return None
    try:
        return pattern.format(name=name, folder=_folder(source))
    except (KeyError, IndexError, ValueError):
        raise BatchError(f"{pattern!r}: only {{name}} and {{folder}} may stand in braces") from None


def _unique(names: list[str]) -> list[str]:
    """Each name once: the second "a" is "a-2"."""
    given: list[str] = []
    for name in names:
        plain = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in name)
        chosen, number = plain, 1
        while chosen in given:
            number += 1
            chosen = f"{plain}-{number}"
        given.append(chosen)
    return given
