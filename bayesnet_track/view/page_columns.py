"""Columns of numbers and a header as one small block of bytes, which the run page reads as typed arrays."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

KEPT_BITS = 14
ALIGNMENT = 8
TYPES = ("<f4", "<f8", "<i4", "<i2", "|u1")


def pack(header: Mapping[str, Any], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Header and columns, compressed with gzip; the same input gives the same bytes.

    Layout before compression: length of the header (uint32), the header as JSON, blanks up to a multiple of
    8 bytes, then the columns, each from a multiple of 8 bytes on. The header gets a key `columns`: name ->
    [type, values per row, number of values, offset behind the header]. All little-endian.

    Args:
        header: what JSON can hold.
        columns: arrays (n,) or (n, k) of float32, float64, int32, int16 or uint8.

    Raises:
        ValueError: an array is of another type or shape.
    """
    index: dict[str, list[Any]] = {}
    blocks: list[bytes] = []
    offset = 0
    for name, column in columns.items():
        kind = column.dtype.newbyteorder("<").str
        if kind not in TYPES or column.ndim not in (1, 2):
            raise ValueError(f"column {name!r} is {column.dtype} {column.shape}; one of {', '.join(TYPES)}")
        data = np.ascontiguousarray(column, dtype=kind).tobytes()
        width = column.shape[1] if column.ndim == 2 else 1
        index[name] = [kind[1:], width, column.size, offset]
        blocks.append(data + bytes(-len(data) % ALIGNMENT))
        offset += len(blocks[-1])
    text = json.dumps({**header, "columns": index}, allow_nan=False, separators=(",", ":")).encode()
    head = struct.pack("<I", len(text)) + text
    head += b" " * (-len(head) % ALIGNMENT)
    return gzip.compress(head + b"".join(blocks), compresslevel=6, mtime=0)


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and columns of `pack`."""
    raw = gzip.decompress(data)
    (length,) = struct.unpack("<I", raw[:4])
    header = json.loads(raw[4 : 4 + length])
    start = 4 + length + (-(4 + length) % ALIGNMENT)
    columns = {}
    for name, (kind, width, count, offset) in header.pop("columns").items():
        flat = np.frombuffer(raw, dtype=f"<{kind}", count=count, offset=start + offset)
        columns[name] = flat.reshape(-1, width) if width > 1 else flat
    return header, columns


def short_floats(values: Any) -> NDArray[np.float32]:
    """As float32 with 14 bits of mantissa, rounded: relative error below 2^-15, and half as long when packed.

    >>> float(short_floats([1234.56])[0])
    1234.5625
    """
    with np.errstate(over="ignore"):
        exact = np.asarray(values, dtype=np.float32)
    drop = 23 - KEPT_BITS
    with np.errstate(over="ignore"):
        bits = (exact.view(np.uint32) + np.uint32(1 << (drop - 1))) & np.uint32(
            0xFFFFFFFF << drop & 0xFFFFFFFF
        )
    rounded = bits.view(np.float32)
    return np.where(np.isfinite(exact) & np.isfinite(rounded), rounded, exact)
