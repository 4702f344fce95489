"""Measurements of many frames as columns, and those of each target over a run, read in one pass.

A line per target and frame is a row of each column; a `Block` holds the rows of some successive frames.
Memory is that of one block, however long the run.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.encoder import JournalError
from bayesnet_track.journal.frame_columns import ABSENT, REGIONS, all_columns, is_absent, region_of
from bayesnet_track.journal.frame_file import FrameFile, RecordPlace, structured
from bayesnet_track.journal.metrics import NOT_SHOWN, FrameMetrics
from bayesnet_track.journal.reader import MOST, Measurements
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.cameras import UNSEEN

ROWS = 40_000
"""Rows of a block, about."""


class Texts:
    """Codes of texts, by which a column of them is one of integers."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._codes: dict[bytes, int] = {}
        self._columns: dict[tuple[str, bytes], NDArray[np.int32]] = {}

    def codes(self, column: NDArray[Any]) -> NDArray[np.int32]:
        """(N,) the codes of (N,) texts; raises UnicodeDecodeError, a ValueError, of what is no UTF-8."""
        key = column.dtype.str, column.tobytes()
        codes = self._columns.get(key)
        if codes is None:
            codes = np.array([self.code(text) for text in column.tolist()], dtype=np.int32)
            if len(self._columns) > 10_000:
                self._columns.clear()
            self._columns[key] = codes
        return codes

    def code(self, text: bytes) -> int:
        """The code of a text."""
        code = self._codes.get(text)
        if code is None:
            self.texts.append(text.decode("utf-8"))
            code = self._codes[text] = len(self.texts) - 1
        return code

    def renumbered(self, column: NDArray[np.int32], start: int) -> NDArray[np.int32]:
        """A column of codes, after those from `start` on were given anew in the order of the column."""
        if len(self.texts) < start + 2:
            return column
        present, rows = np.unique(column, return_index=True)
        order = present[np.argsort(rows)]
        order = order[order >= start]
        if (order[:-1] < order[1:]).all():
            return column
        unused = np.setdiff1d(np.arange(start, len(self.texts)), order)
        codes = np.concatenate([np.arange(start), order, unused])
        keys = [*self._codes]
        self.texts = [self.texts[code] for code in codes]
        self._codes = {keys[code]: number for number, code in enumerate(codes)}
        self._columns.clear()
        return np.argsort(codes).astype(np.int32)[column]


@dataclass(frozen=True)
class Block:
    """Rows of successive frames: one for each target in a frame, in order.

    Attributes:
        frame: (N,) of which frame.
        columns: name -> (N,) numbers, or (4, N) of boxes; of texts their codes, see `Blocks.texts`. Those of
            `CLOUD` are more than N.
    """

    frame: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.frame)

    def of_rows(self, rows: NDArray[Any]) -> Block:
        """Some of the rows, in this order, given as indices."""
        columns = {name: column[..., rows] for name, column in self.columns.items() if name != CLOUD}
        if CLOUD in self.columns:
            counts = self.columns["cloud_count"].astype(np.int64)
            starts = np.cumsum(counts) - counts
            counts_of_rows = counts[rows]
            shifts = starts[rows] - (np.cumsum(counts_of_rows) - counts_of_rows)
            hypotheses = np.arange(counts_of_rows.sum()) + np.repeat(shifts, counts_of_rows)
            columns[CLOUD] = self.columns[CLOUD][:, hypotheses]
        return Block(self.frame[rows], columns)

    def numbers(self, name: str) -> Floats:
        """(N,) or (4, N) in double precision; `ABSENT` where a target does not have it."""
        column = self.columns.get(name)
        if column is None:
            return np.full(len(self), ABSENT)
        return np.asarray(column, dtype=np.float64)

    def codes(self, name: str) -> NDArray[np.int32]:
        """(N,) codes of a column of texts."""
        return np.asarray(self.columns[name], dtype=np.int32) if len(self) else np.zeros(0, dtype=np.int32)


class Blocks:
    """The measurements of a run by columns.

    Args:
        metrics: the run's, in the order of frames; `Measurements` are read from their file.
        names: the columns to read, as `frame_columns` calls them, besides ``target``. One that ends with
            ``/`` stands for those of each node.

    Attributes:
        texts: name of a column of texts -> them and their codes.
        all_frames: frame of each record, in order.
        rows: rows of all blocks.
        step: frames of a block.
        last: last frame; -1 where there is none.

    Raises:
        JournalError: a record is damaged, when it is read.
    """

    def __init__(self, metrics: Sequence[FrameMetrics], names: Iterable[str]) -> None:
        self.texts: defaultdict[str, Texts] = defaultdict(Texts)
        self._names = frozenset({"target", *names})
        if self._names & {*REGIONS}:
            self._names |= {"map", "sd"}
        self._lines = metrics
        if isinstance(metrics, Measurements):
            places = metrics.file.places
            self.all_frames = np.array([place.frame for place in places], dtype=np.int64)
            counts = np.array([place.targets for place in places], dtype=np.int64)
        else:
            self.all_frames = np.array([line.frame for line in metrics], dtype=np.int64)
            counts = np.unique(self.all_frames, return_counts=True)[1]
        self.rows = int(counts.sum())
        self.step = max(1, ROWS // int(counts.max(initial=1)))
        self.last = int(self.all_frames[-1]) if len(self.all_frames) else -1

    def frames(self) -> NDArray[np.int64]:
        """(F,) frames that hold a target, in order."""
        return np.unique(self.all_frames)

    def __iter__(self) -> Iterator[Block]:
        return (self.read(*span) for span in spans([self], self.last + 1))

    def read(self, start: int, end: int) -> Block:
        """The rows of the frames from `start` to before `end`."""
        first, stop = np.searchsorted(self.all_frames, [start, end]).tolist()
        if not isinstance(self._lines, Measurements):
            return self._of_lines(self._lines[first:stop])
        file, count = self._lines.file, len(self.texts["target"].texts)
        block = self._of_places(file, file.places[first:stop])
        self._lines.check_targets(self.texts["target"].texts[count:])
        return block

    def joined(self, blocks: Sequence[Block]) -> Block:
        """Blocks of this run, one below the other."""
        names = dict.fromkeys(name for block in blocks for name in block.columns)
        pieces = [(len(block), block.columns) for block in blocks]
        frame = np.concatenate([np.zeros(0, dtype=np.int64), *(block.frame for block in blocks)])
        return Block(frame, {name: self._joined(name, pieces) for name in names})

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Columns of all frames: ``frame`` (N,) int64, ``target`` (N,) texts, and each that is read.

        Texts are (N,) objects; numbers (N,) float64, NaN where a target has none; boxes (N, 4), px.

        Raises:
            ValueError: no frame has such a column.
        """
        block = self.joined([*self])
        unread = sorted(self._names - {*block.columns, "frame"})
        if unread and self.rows:
            lines = self._lines
            written = next(lines.file.columns()) if isinstance(lines, Measurements) else all_columns(lines)
            raise ValueError(f"no frame has a column {unread[0]!r}; the first one has: {', '.join(written)}")
        arrays: dict[str, NDArray[Any]] = {"frame": block.frame}
        for name in ("target", *sorted(self._names - {"frame", "target"})):
            if is_text(name):
                arrays[name] = np.array(self.texts[name].texts, dtype=object)[block.codes(name)]
            else:
                arrays[name] = block.numbers(name).T
        return arrays

    def _of_lines(self, lines: Sequence[FrameMetrics]) -> Block:
        columns = {} if not lines else all_columns(lines, CLOUD in self._names)
        selected = {
            name: self.texts[name].codes(column) if is_text(name) else column
            for name, column in columns.items()
            if name in self._names or f"{name.partition('/')[0]}/" in self._names
        }
        if "time_s" in selected:
            selected["time_s"] = np.array([line.time_s for line in lines], dtype=np.float64)
        return Block(np.array([line.frame for line in lines], dtype=np.int64), selected)

    def _of_places(self, file: FrameFile, places: Sequence[RecordPlace]) -> Block:
        """Records with the same header stand below each other in one array, and are taken apart together."""
        frames = np.array([place.frame for place in places], dtype=np.int64)
        if len(frames) and not 0 <= frames.min() <= frames.max() <= MOST:
            raise JournalError(f"{file.path}: frame {frames.max()} is not an integer from 0 to {MOST}")
        records_of_header: defaultdict[tuple[bytes, int], list[tuple[int, bytes]]] = defaultdict(list)
        for number, (place, header, content) in enumerate(file.contents(places)):
            records_of_header[header, place.targets].append((number, content))
        counts = {name: len(column.texts) for name, column in self.texts.items()}
        pieces: list[tuple[int, dict[str, NDArray[Any]]]] = []
        record_of_row = [np.zeros(0, np.int64)]
        for (header, targets), records in records_of_header.items():
            numbers, contents = zip(*records, strict=True)
            try:
                piece = self._piece(structured(contents, header, self._names), targets)
            except (KeyError, ValueError, TypeError, IndexError) as error:
                raise file.damaged(places[numbers[0]], error) from error
            pieces.append((targets * len(records), piece))
            record_of_row.append(np.repeat(numbers, targets))
        names = dict.fromkeys(name for _, piece in pieces for name in piece)
        if pieces:
            names |= dict.fromkeys(name for name in TEXTS if name in self._names)
        rows = np.concatenate(record_of_row)
        block = Block(frames[rows], {name: self._joined(name, pieces) for name in names})
        if len(pieces) < 2:
            return block
        block = block.of_rows(np.argsort(rows, kind="stable"))
        renumbered = {
            name: self.texts[name].renumbered(column, counts.get(name, 0))
            for name, column in block.columns.items()
            if is_text(name)
        }
        return Block(block.frame, {**block.columns, **renumbered})

    def _piece(self, records: NDArray[Any], targets: int) -> dict[str, NDArray[Any]]:
        piece: dict[str, NDArray[Any]] = {}
        for name in records.dtype.names or ():
            if name == "time_s":
                piece[name] = np.repeat(records[name], targets)
                continue
            column, shape = records[name], (4, targets) if is_box(name) else (targets,)
            if column.shape[1:] != shape and (name != CLOUD or column.shape[1:2] != (4,)):
                raise ValueError(f"{name} of shape {column.shape[1:]}, not {shape}")
            if is_text(name):
                codes = [self.texts[name].codes(row) for row in column]
                piece[name] = codes[0] if len(codes) == 1 else np.concatenate(codes)
            elif is_box(name):
                piece[name] = column.transpose(1, 0, 2).reshape(4, -1)
            else:
                piece[name] = column.reshape(-1)
        if CLOUD in piece and piece["cloud_count"].sum() != piece[CLOUD].shape[1]:
            raise ValueError("hypotheses that are of no target")
        return piece | {
            name: region_of(piece, name) for name in REGIONS if name in self._names and name not in piece
        }

    def _joined(self, name: str, pieces: Sequence[tuple[int, Mapping[str, NDArray[Any]]]]) -> NDArray[Any]:
        columns = []
        for rows, piece in pieces:
            if name in piece:
                columns.append(piece[name])
            elif is_text(name):
                columns.append(np.full(rows, self.texts[name].code(b""), dtype=np.int32))
            elif name in (CLOUD, "cloud_count"):
                columns.append(np.zeros((4, 0) if name == CLOUD else rows, dtype="<i2"))
            else:
                columns.append(np.full((4, rows) if is_box(name) else rows, ABSENT, dtype="<f4"))
        return columns[0] if len(columns) == 1 else np.concatenate(columns, axis=-1)


def spans(runs: Sequence[Blocks], end: int) -> Iterator[tuple[int, int]]:
    """First frame and end of blocks, the same for all `runs`, that cover their frames below `end`."""
    step, start = min(run.step for run in runs), 0
    while True:
        starts = [run.all_frames[run.all_frames >= start][:1] for run in runs]
        start = int(min((frames[0] for frames in starts if len(frames)), default=end))
        if start >= end:
            return
        yield start, min(start + step, end)
        start += step


@dataclass(frozen=True, eq=False)
class NumberedBoxes:
    """Boxes of successive frames.

    Attributes:
        frames: (N,) frame of each.
        ids: (N,) number of its target, from 1 in the order in which targets appear.
        corners: (N, 4) left, top, width, height, px.
        scores: (N,) 0..1.
    """

    frames: NDArray[np.int64]
    ids: NDArray[np.int32]
    corners: Floats
    scores: Floats


def boxes_of(metrics: Sequence[FrameMetrics], lost: bool) -> Iterator[NumberedBoxes]:
    """All boxes that are measured, some frames at a time; without `lost` those of shown targets."""
    blocks = Blocks(metrics, ("status", "box", "score"))
    for block in blocks:
        corners = np.array(block.numbers("box").T)
        corners[:, :2] -= (corners[:, 2:] - 1.0) / 2.0
        scores, ids = block.numbers("score"), block.codes("target") + np.int32(1)
        gone = [code for code, text in enumerate(blocks.texts["status"].texts) if text in NOT_SHOWN]
        is_shown = corners[:, 0] > UNSEEN[0]
        if not lost and gone:
            is_shown &= ~np.isin(block.codes("status"), gone)
        if not is_shown.all():
            yield NumberedBoxes(block.frame[is_shown], ids[is_shown], corners[is_shown], scores[is_shown])
        else:
            yield NumberedBoxes(block.frame, ids, corners, scores)


TEXTS = ("target", "status", "active", "silent", "identities")
"""Columns of texts that can be read; `active` and `silent` hold names with blanks between them."""
BOXES = ("box", "map", "sd", "region50", "region90")
CLOUD = "cloud"
"""(4, M) hypotheses of all targets below each other; ``cloud_count`` (N,) how many are each target's."""


def is_text(name: str) -> bool:
    """True if a column holds texts."""
    return name in TEXTS or (name.startswith("parts/") and name.endswith("/status"))


def is_box(name: str) -> bool:
    """True if a column has four numbers for each target."""
    return name in (*BOXES, CLOUD) or (name.startswith("parts/") and name.endswith(("/box", "/sd")))


@dataclass(frozen=True, eq=False)
class Course:
    """One target's frames, in order.

    Attributes:
        target: whom it is about.
        block: its rows, with the columns that were asked for.
        texts: of each column of texts the texts that its codes stand for.
    """

    target: str
    block: Block
    texts: Mapping[str, Sequence[str]]

    def __len__(self) -> int:
        return len(self.block)

    def part(self, start: int, end: int) -> Course:
        """The rows from `start` to before `end`."""
        columns = {name: column[..., start:end] for name, column in self.block.columns.items()}
        return Course(self.target, Block(self.block.frame[start:end], columns), self.texts)

    @property
    def frame(self) -> NDArray[np.int64]:
        """(N,) numbers of the frames."""
        return self.block.frame

    def numbers(self, name: str) -> Floats:
        """(N,) a column in double precision; see `Block.numbers`."""
        return self.block.numbers(name)

    def is_text(self, name: str, texts: Iterable[str]) -> NDArray[np.bool_]:
        """(N,) whether a column holds one of some texts."""
        matching = np.array([text in texts for text in self.texts.get(name, ())], dtype=bool)
        return matching[self.block.codes(name)] if len(self) else np.zeros(0, dtype=bool)

    @cached_property
    def is_gone(self) -> NDArray[np.bool_]:
        """(N,) whether the box does not show the target: it is lost, or hidden."""
        return self.is_text("status", NOT_SHOWN)

    def by_name(self, field: str) -> dict[str, tuple[NDArray[np.bool_], Floats]]:
        """Name -> in which rows (N,) it has a number, and the numbers; by the first row, then by name."""
        numbers = {
            name.partition("/")[2]: self.numbers(name)
            for name in sorted(self.block.columns)
            if name.startswith(f"{field}/")
        }
        present = {name: (~is_absent(column), column) for name, column in numbers.items()}
        some = [name for name, (is_there, _) in present.items() if is_there.any()]
        return {name: present[name] for name in sorted(some, key=lambda name: present[name][0].argmax())}


def courses(
    metrics: Sequence[FrameMetrics], names: Iterable[str], targets: Iterable[str] | None = None
) -> dict[str, Course]:
    """The courses of all targets, or of some, in the order in which they appear.

    Args:
        metrics: the run's, in the order of frames.
        names: the columns to read; see `Blocks`.
        targets: the ones that are wanted; of those without measurements an empty course.

    Raises:
        JournalError: a record is damaged.
    """
    selected = frozenset(names)
    blocks = Blocks(metrics, selected)
    parts: dict[str, list[Block]] = {} if targets is None else {target: [] for target in targets}
    for block in blocks:
        codes = block.codes("target")
        order = np.argsort(codes, kind="stable")
        present, starts = np.unique(codes[order], return_index=True)
        for code, rows in zip(present.tolist(), np.split(order, starts[1:]), strict=True):
            target = blocks.texts["target"].texts[code]
            if targets is not None and target not in parts:
                continue
            columns = {
                name: column[..., rows]
                for name, column in block.columns.items()
                if name in selected or f"{name.partition('/')[0]}/" in selected
            }
            parts.setdefault(target, []).append(Block(block.frame[rows].astype(np.int32), columns))
    texts = {name: column.texts for name, column in blocks.texts.items()}
    return {target: Course(target, blocks.joined(some), texts) for target, some in parts.items()}
