"""Jobs of a batch: its videos, named, from patterns or from a list, each with one seed."""

from __future__ import annotations

import csv
import glob
import json
import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayesnet_track.evaluate.truth import TruthForm
from bayesnet_track.sources.mot_lines import read_text
from bayesnet_track.sources.paths import is_junk, shown_address


class BatchError(ValueError):
    """A list or pattern from which no job can be made."""


@dataclass(frozen=True)
class BatchVideo:
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
    video: BatchVideo
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
        return cls(**{**values, "video": BatchVideo(**values["video"]), **lists})


@dataclass(frozen=True)
class Part:
    """One of several equal parts of a batch, each for a computer of its own.

    The videos are dealt out in their order, so that a part needs to look at no file of another one.

    Attributes:
        number: which one, from 1.
        count: how many there are.
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Part:
        """A part as K/N; raises ValueError.

        >>> Part.parse("2/8")
        Part(number=2, count=8)
        """
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
        number, count = map(int, match.groups()) if match else (0, 0)
        if not 1 <= number <= count:
            raise ValueError(
                f"{text!r}: K/N is needed, part K of N: 1/{count or 8} to {count or 8}/{count or 8}"
            )
        return cls(number, count)

    @property
    def label(self) -> str:
        """It as part of a file's name."""
        return f"{self.number}-of-{self.count}"

    def select(self, videos: Sequence[BatchVideo]) -> list[BatchVideo]:
        """Its videos: every `count`-th."""
        return list(videos[self.number - 1 :: self.count])


def allow_job(job: Job) -> None:
    """Let the code from elsewhere that the job names be loaded in this process.

    Raises:
        CueError: a cue file cannot be loaded.
    """
    from bayesnet_track.observation import plugins
    from bayesnet_track.observation.cue_files import use_cue_file

    plugins.allow(job.plugins)
    for file in job.cue_files:
        use_cue_file(file)


COLUMNS = ("source", "name", "init", "init_from", "truth")
"""Columns of a list; only the source is needed."""

INNER = ("img", "img1")
"""Folders of images that are named after the folder around them."""

TABLE, LEDGER = "results.csv", ".batch"
"""The table of results and the folder of the ledger, beside the folders of the runs."""

RESERVED = re.compile(r"(results|overview)(\.\d+-of-\d+)?\.(csv|html)(\.part)?|\.batch")
"""Names of what the batch itself writes there."""

LONGEST_NAME = 200
"""Bytes of a name, which leave room for the seed."""


def videos_of(
    sources: Sequence[str], init_from: str | None = None, truth: str | None = None
) -> list[BatchVideo]:
    """The videos that patterns name, sorted; `init_from` and `truth` are patterns of a video's own file.

    In these, ``{name}`` is the video's name and ``{folder}`` the folder that it, or its images, are in.

    Raises:
        BatchError: a pattern matches nothing, or has other words in braces.
    """
    paths = []
    for pattern in sources:
        is_pattern = glob.has_magic(pattern)
        matching = glob.glob(pattern, recursive=True) if is_pattern else [pattern]  # noqa: PTH207
        names = sorted(name for name in matching if not (is_pattern and is_junk(Path(name))))
        if not names:
            raise BatchError(f"--source {shown_address(pattern)!r} matches nothing")
        paths += names
    named = _unique([_name(source) for source in paths])
    return [
        BatchVideo(source, name, None, _fill(init_from, source, name), _fill(truth, source, name))
        for source, name in zip(paths, named, strict=True)
    ]


def read_list(path: Path) -> list[BatchVideo]:
    """The videos of a list: CSV with a header (`COLUMNS`), or an object of JSON a line.

    Raises:
        OSError: it cannot be read.
        NotTextError: it is not text.
        BatchError: it is malformed; says file and line.
    """
    text = read_text(path)
    lines = list(_json_rows(path, text) if text.lstrip().startswith("{") else _csv_rows(path, text))
    if not lines:
        raise BatchError(f"{path}: no video in it")
    names = _listed_names(lines)
    return [
        BatchVideo(row["source"], name, *(row.get(key) or None for key in COLUMNS[2:]))
        for (_, row), name in zip(lines, names, strict=True)
    ]


def _csv_rows(path: Path, text: str) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Place and values of each row: a line, for a quote that is left open would swallow the others."""
    columns: list[str] | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        place = f"{path}:{number}"
        try:
            (values,) = csv.reader([line], strict=True)
        except csv.Error as error:
            fault = f"a quote is opened and not closed ({error})" if line.count('"') % 2 else str(error)
            raise BatchError(f"{place}: {fault}; a video is one line") from None
        if columns is None:
            columns = values
            continue
        if len(values) > len(columns):
            raise BatchError(
                f"{place}: {len(values)} values under {len(columns)} columns; quote a value with a comma"
            )
        yield place, _row(place, {key: value for key, value in zip(columns, values, strict=False) if value})


def _json_rows(path: Path, text: str) -> Iterator[tuple[str, Mapping[str, str]]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip():
            place = f"{path}:{number}"
            try:
                values = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise BatchError(f"{place}: not a line of JSON: {error}") from None
            yield place, _row(place, values)


def _row(place: str, values: Any) -> Mapping[str, str]:
    if not isinstance(values, dict) or not all(isinstance(value, str) for value in values.values()):
        raise BatchError(f"{place}: texts by the names {', '.join(COLUMNS)} are needed")
    unknown = [str(key) for key in values if key not in COLUMNS]
    if unknown or not values.get("source"):
        fault = f"unknown column {unknown[0]!r}" if unknown else "no source"
        raise BatchError(f"{place}: {fault}; columns are {', '.join(COLUMNS)}")
    return values


def _name(source: str) -> str:
    path = Path(shown_address(source))
    if path.name in INNER:
        path = path.parent
    if path.name in ("", ".."):
        path = path.resolve()
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


def _listed_names(lines: Sequence[tuple[str, Mapping[str, str]]]) -> list[str]:
    """The names of a list: given ones as they are, each once; raises BatchError with the line."""
    places: dict[str, str] = {}
    for place, row in lines:
        name = row.get("name")
        if name is None:
            continue
        fault = _fault(name)
        if fault:
            raise BatchError(f"{place}: the name {name!r} {fault}; it names a folder below --out")
        earlier = places.setdefault(_same(_folder_name(name)), place)
        if earlier != place:
            raise BatchError(
                f"{place}: the name {name!r} is that of {earlier}, or differs from it in upper and lower "
                "case alone; names are needed that differ"
            )
    generated = iter(_unique([_name(row["source"]) for _, row in lines if row.get("name") is None], places))
    return [_folder_name(row["name"]) if "name" in row else next(generated) for _, row in lines]


def _fault(name: str) -> str | None:
    """The reason that keeps a name from being that of a folder, in words."""
    if not name.strip(". "):
        return "is empty" if not name.strip() else "leads out of its folder or is hidden by it"
    if any(letter in "/\\" for letter in name):
        return "leads to another folder"
    if not name.isprintable():
        return "has a character that cannot be seen"
    if name != name.strip() or name.endswith("."):
        return "begins or ends with a blank, or ends with a dot"
    if RESERVED.fullmatch(_same(name)):
        return "is one of the batch's own (results.csv, overview.html, .batch)"
    if len(name.encode("utf-8", "surrogateescape")) > LONGEST_NAME:
        return f"is longer than {LONGEST_NAME} bytes"
    return None


def _same(name: str) -> str:
    """A key that is equal for names which some file systems take for one."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFKD", name).casefold())


def _folder_name(name: str) -> str:
    composed = unicodedata.normalize("NFC", name)
    return "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in composed)


def _unique(names: list[str], reserved: Mapping[str, str] | None = None) -> list[str]:
    """Each name once, and none that is taken: the second "a" is "a-2"."""
    keys, unique = set(reserved or ()), []
    for name in names:
        plain = _folder_name(name)
        plain = plain[: LONGEST_NAME // 4] if plain.strip(".") else "video"
        candidate, number = plain, 1
        while _same(candidate) in keys or RESERVED.fullmatch(_same(candidate)):
            number += 1
            candidate = f"{plain}-{number}"
        keys.add(_same(candidate))
        unique.append(candidate)
    return unique
