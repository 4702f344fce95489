"""``frames.npy.gz``: a record per frame, each a member of gzip that holds one array of NumPy's format.

Members stand below each other, as gzip allows: any tool decompresses the file, and `numpy.load` reads the
arrays one after the other::

    with gzip.open("run/frames.npy.gz") as file:
        frame = np.load(file)  # again for the next one
        frame["target"], frame["box"]  # texts (T,), centre boxes (4, T)

Each array has one element, whose fields are the columns of `frame_columns`. The header of a member says, as
in BGZF, how long it is, so that a reader steps from frame to frame without decompressing any; and which frame
and how many targets it holds. A killed process leaves whole records and at most a torn last one.
"""

from __future__ import annotations

import io
import os
import struct
import tokenize
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from io import FileIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.encoder import JournalError
from bayesnet_track.journal.frame_columns import Columns, columns_of, lines_of
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.writer import LineFile

Notice = Callable[[str], None]

_HEAD = struct.Struct("<4sIBBH2sHIIq")
"""Magic, time, flags, system, length of the extra field; its name and length; bytes, targets, frame."""
_TAIL = struct.Struct("<II")
_MAGIC, _NAME = b"\x1f\x8b\x08\x04", b"BT"
_LARGEST = 1 << 30
"""Bytes of a record, decompressed; a damaged file may ask for more."""
_LONGEST_HEADER = 1 << 20
_NO_FIELDS: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class RecordPlace:
    """Place of a frame's record in the file.

    Attributes:
        frame: number of the frame.
        targets: how many it holds.
        start: its first byte in the file.
        size: its bytes.
    """

    frame: int
    targets: int
    start: int
    size: int


class FrameWriter(LineFile):
    """A file of frames, new or continued; as `LineFile`, a record in place of a line."""

    def __init__(self, path: Path, after: int | None = None) -> None:
        super().__init__(path, after)
        self._records: list[bytes] = []

    def write(self, lines: Sequence[FrameMetrics], hypotheses: bool = True) -> None:
        """Add the lines of one frame to the next flush; of none, nothing."""
        if lines:
            self.write_columns(columns_of(lines, hypotheses))

    def write_columns(self, columns: Columns) -> None:
        """Add the columns of one frame to the next flush."""
        self._records.append(record(columns))

    def _pending(self) -> bytes:
        data = b"".join(self._records)
        self._records.clear()
        return data


def record(columns: Columns) -> bytes:
    """The record of a frame with these columns."""
    kind = tuple((name, column.dtype.str, column.shape) for name, column in columns.items())
    data = _header(kind) + b"".join([column.tobytes() for column in columns.values()])
    packer = zlib.compressobj(1, zlib.DEFLATED, -zlib.MAX_WBITS)
    packed = packer.compress(data) + packer.flush()
    size = _HEAD.size + len(packed) + _TAIL.size
    head = _HEAD.pack(_MAGIC, 0, 0, 255, 20, _NAME, 16, size, len(columns["target"]), int(columns["frame"]))
    return b"".join((head, packed, _TAIL.pack(zlib.crc32(data), len(data) & 0xFFFF_FFFF)))


class FrameFile:
    """The frames of a run, one at a time: `places` says which there are, `columns` reads one of them.

    Args:
        path: the file.
        notice: told of a torn last record, which a killed process leaves and which is left out.

    Raises:
        JournalError: a record is damaged; names its place.
        OSError: the file cannot be read.
    """

    def __init__(self, path: Path, notice: Notice | None = None) -> None:
        self.path = path
        with path.open("rb", buffering=0) as file:
            self.places = tuple(_places(file, path, notice))

    def __len__(self) -> int:
        return len(self.places)

    def columns(self, places: Sequence[RecordPlace] | None = None) -> Iterator[Columns]:
        """The columns of some frames, or of all, in order."""
        with self.path.open("rb") as file:
            for place in self.places if places is None else places:
                file.seek(place.start)
                try:
                    yield unpacked(file.read(place.size))
                except (ValueError, zlib.error) as error:
                    raise self.damaged(place, error) from error

    def contents(self, places: Sequence[RecordPlace]) -> Iterator[tuple[RecordPlace, bytes, bytes]]:
        """Place, header and numbers of some frames, in order, for `structured`."""
        with self.path.open("rb", buffering=1 << 18) as file:
            for place in places:
                file.seek(place.start)
                try:
                    content = _content(file.read(place.size))
                    start = _start_of_data(content)
                    yield place, content[:start], content[start:]
                except (ValueError, zlib.error) as error:
                    raise self.damaged(place, error) from error

    def lines(
        self, places: Sequence[RecordPlace] | None = None, target: str | None = None
    ) -> Iterator[FrameMetrics]:
        """The lines of some frames, or of all, in order; with `target` of that one alone."""
        wanted_places = self.places if places is None else places
        for place, columns in zip(wanted_places, self.columns(wanted_places), strict=True):
            try:
                target_columns = columns if target is None else _of_target(columns, target)
                lines = list(lines_of(target_columns)) if len(target_columns["target"]) else []
            except (KeyError, ValueError, TypeError, IndexError, AttributeError, RecursionError) as error:
                raise self.damaged(place, error) from error
            yield from lines

    def damaged(self, place: RecordPlace, error: Exception) -> JournalError:
        """The error that names the place of a damaged record."""
        return JournalError(f"{self.path}: frame {place.frame} (byte {place.start}) is damaged: {error}")


def unpacked(data: bytes) -> Columns:
    """The columns of a record.

    Raises:
        ValueError, zlib.error: it is damaged.
    """
    content = _content(data)
    start = _start_of_data(content)
    fields, length = _fields(content[:start])
    if len(content) != start + length:
        raise ValueError(f"{len(content) - start} bytes of columns, not {length}")
    return {
        name: np.frombuffer(content, kind, size, start + offset).reshape(shape)
        for name, kind, shape, size, offset in fields
    }


def structured(contents: Sequence[bytes], header: bytes, names: frozenset[str]) -> NDArray[Any]:
    """(N,) records of the same header, one below the other, with those of their columns that are in `names`.

    Raises:
        ValueError: they are damaged.
    """
    kind = _selected(header, names)
    if any(len(content) != kind.itemsize for content in contents):
        raise ValueError(f"not {kind.itemsize} bytes of columns")
    return np.frombuffer(contents[0] if len(contents) == 1 else b"".join(contents), kind, len(contents))


@lru_cache(maxsize=256)
def _selected(header: bytes, names: frozenset[str]) -> np.dtype[Any]:
    """Type of a record with this header, of which only the columns in `names` have one."""
    fields, length = _fields(header)
    selected = [field for field in fields if field[0] in names or f"{field[0].partition('/')[0]}/" in names]
    return np.dtype(
        {
            "names": [name for name, *_ in selected],
            "formats": [(kind, shape) for _, kind, shape, _, _ in selected],
            "offsets": [offset for *_, offset in selected],
            "itemsize": length,
        }
    )


def _content(data: bytes) -> bytes:
    """A record, decompressed; raises ValueError or zlib.error where it is damaged."""
    unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
    content = unpacker.decompress(data[_HEAD.size :], _LARGEST)
    if not unpacker.eof or len(unpacker.unused_data) != _TAIL.size:
        raise ValueError("it does not end where it should")
    if _TAIL.unpack(unpacker.unused_data) != (zlib.crc32(content), len(content) & 0xFFFF_FFFF):
        raise ValueError("its checksum is another")
    return content


def _places(file: FileIO, path: Path, notice: Notice | None) -> Iterator[RecordPlace]:
    start, end = 0, os.fstat(file.fileno()).st_size
    while start < end:
        file.seek(start)
        head = file.read(_HEAD.size)
        is_whole = len(head) == _HEAD.size
        size, targets, frame = _HEAD.unpack(head)[-3:] if is_whole else (end + 1, 0, 0)
        if is_whole and (head[:4] != _MAGIC or head[12:14] != _NAME or size <= _HEAD.size + _TAIL.size):
            if any(head) or any(file.read(1 << 20)):
                raise JournalError(f"{path}: byte {start}: no frame begins there")
            size = end + 1  # a file system that lost its power leaves zeros
        if start + size > end:
            if notice is not None:
                notice(f"{path}: the last frame is torn ({end - start} bytes) and was dropped")
            return
        yield RecordPlace(frame, targets, start, size)
        start += size


@lru_cache(maxsize=256)
def _header(kind: tuple[tuple[str, str, tuple[int, ...]], ...]) -> bytes:
    """Header of an array of one element with these fields."""
    array = np.zeros((), np.dtype([*kind]))
    text = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that older versions of NumPy do not read
        np.lib.format.write_array(text, array, allow_pickle=False)
    return text.getvalue()[: -array.nbytes]


def _start_of_data(content: bytes) -> int:
    if content[:6] != b"\x93NUMPY" or len(content) < 12:
        raise ValueError("no array in it")
    if content[6] == 1:
        return 10 + int.from_bytes(content[8:10], "little")
    return 12 + int.from_bytes(content[8:12], "little")


@lru_cache(maxsize=256)
def _fields(header: bytes) -> tuple[list[tuple[str, Any, tuple[int, ...], int, int]], int]:
    """Name, type, shape, count and place of each column; then the bytes of all.

    Raises:
        ValueError: it is no header, or one of something else.
    """
    try:
        kind = _kind_of(header)
        fields = []
        for name in kind.names or ():
            field, offset = (kind.fields or _NO_FIELDS)[name][:2]
            base, shape = field.subdtype or (field, ())
            if base.kind not in "fiS" or not base.itemsize:
                raise ValueError(f"column {name} of type {base}")
            fields.append((name, base, shape, int(np.prod(shape, dtype=np.int64)), offset))
    except (tokenize.TokenError, SyntaxError, TypeError, KeyError, RecursionError, MemoryError) as error:
        raise ValueError(f"not the header of an array: {error}") from error
    return fields, kind.itemsize


def _kind_of(header: bytes) -> np.dtype[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        text = io.BytesIO(header)
        if np.lib.format.read_magic(text) == (1, 0):
            shape, _, kind = np.lib.format.read_array_header_1_0(text, _LONGEST_HEADER)
        else:
            shape, _, kind = np.lib.format.read_array_header_2_0(text, _LONGEST_HEADER)
    if shape != ():
        raise ValueError(f"an array of shape {shape}")
    return kind


def _of_target(columns: Columns, target: str) -> Columns:
    """The columns of one target; of none, if the frame does not have it.

    Raises:
        KeyError, ValueError: the columns are not those of a frame.
    """
    names = columns["target"]
    rows = np.flatnonzero(names == target.encode("utf-8"))
    picked: dict[str, NDArray[Any]] = {}
    for name, column in columns.items():
        if name == "cloud":
            ends = np.cumsum(columns["cloud_count"])
            spans = [np.arange(ends[row] - columns["cloud_count"][row], ends[row]) for row in rows]
            column = column[:, np.concatenate([np.arange(0), *spans])]
        elif column.ndim and not name.startswith("cameras/"):
            if column.shape[-1] != len(names):
                raise ValueError(f"{name} of shape {column.shape}, not of {len(names)} targets")
            column = column[..., rows]
        picked[name] = column
    return picked
