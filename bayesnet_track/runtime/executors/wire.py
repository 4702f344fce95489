"""How questions and answers become bytes: plain values, and arrays as they lie in memory.

A message is a head, a description of plain values (`marshal`), and the arrays that it names, each at a
multiple of `ALIGNED` bytes. What else a cue may be asked or return is pickled. Both ends run one version.
"""

from __future__ import annotations

import marshal
import pickle
import socket
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.cue import Hypotheses, Measurement
from bayesnet_track.planes import Region
from bayesnet_track.runtime.executors.questions import Told

Array = NDArray[Any]
Bytes = NDArray[np.uint8]

HEAD = struct.Struct("=QQ")
"""Bytes of the description, and of all that follows the head."""
ALIGNED = 64
MOST_PIECES = 256
"""Pieces of memory that are handed to the kernel at once; it takes 1024."""
VERSION = 2
"""Of marshal: the last one that does not look for values that occur twice."""
PLAIN = frozenset({type(None), bool, int, float, str, bytes})

ARRAY, TUPLE, FLOAT64, HYPOTHESES, REGION, MEASUREMENT, TOLD, OTHER = range(8)


def pieces_of(message: tuple[Any, ...]) -> list[Any]:
    """The memory that makes up a message, in order; arrays are not copied."""
    packing = _Packing()
    description = marshal.dumps([packing.flat(part) for part in message], VERSION)
    gap = -len(description) % ALIGNED
    head = HEAD.pack(len(description), len(description) + gap + packing.size)
    pieces: list[Any] = [head, description, bytes(gap), *packing.pieces]
    return pieces if len(pieces) <= MOST_PIECES else [b"".join(pieces)]


def message_of(body: Bytes, described: int) -> list[Any]:
    """The parts of a message, given its bytes behind the head; arrays are views of them."""
    flat = marshal.loads(body[:described].data)
    arrays = body[described + -described % ALIGNED :]
    return [_whole(part, arrays) for part in flat]


def send(channel: socket.socket, message: tuple[Any, ...]) -> None:
    """Send a message; raises OSError."""
    pieces = pieces_of(message)
    left = sum(len(piece) for piece in pieces) - channel.sendmsg(pieces)
    if left:
        channel.sendall(memoryview(b"".join(pieces))[-left:])


def receive(channel: socket.socket) -> list[Any]:
    """The next message, waited for; raises EOFError when the other end has closed, and OSError."""
    described, size = HEAD.unpack(_received(channel, HEAD.size).data)
    return message_of(_received(channel, size), described)


def _received(channel: socket.socket, size: int) -> Bytes:
    body = np.empty(size, np.uint8)
    at = 0
    while at < size:
        came = channel.recv_into(body[at:].data)
        if not came:
            raise EOFError
        at += came
    return body


class _Packing:
    """The arrays of a message, one behind the other."""

    def __init__(self) -> None:
        self.pieces: list[Any] = []
        self.size = 0

    def flat(self, value: Any) -> Any:
        """The value without classes and arrays."""
        kind = type(value)
        if kind in PLAIN:
            return value
        if kind is np.ndarray and not (value.dtype.hasobject or value.dtype.names or value.dtype.subdtype):
            return self._array(value)
        if kind is tuple:
            return TUPLE, [self.flat(part) for part in value]
        if kind is np.float64:
            return FLOAT64, float(value)
        if kind is Hypotheses and type(value.fields) is dict:
            fields = [(self.flat(name), self.flat(own)) for name, own in value.fields.items()]
            return HYPOTHESES, self.flat(value.boxes), fields
        if kind is Region:
            return REGION, value.x0, value.y0, value.x1, value.y1
        if kind is Measurement:
            parts = (value.fields, value.mean, value.covariance, value.floor)
            return MEASUREMENT, [self.flat(part) for part in parts]
        if kind is Told:
            return TOLD, [
                (self.flat(name), number, self.flat(array)) for name, (number, array) in value.arrays.items()
            ]
        return OTHER, pickle.dumps(value, protocol=5)

    def _array(self, array: Array) -> tuple[Any, ...]:
        is_turned = array.flags.f_contiguous and not array.flags.c_contiguous
        rows = array.T if is_turned else np.ascontiguousarray(array)
        self.pieces.append(rows.reshape(-1).view(np.uint8))
        gap = -rows.nbytes % ALIGNED
        if gap:
            self.pieces.append(bytes(gap))
        described = ARRAY, array.dtype.str, array.shape, self.size, is_turned
        self.size += rows.nbytes + gap
        return described


def _whole(flat: Any, arrays: Bytes) -> Any:
    """The value that `_Packing.flat` was given."""
    if type(flat) is not tuple:
        return flat
    kind = flat[0]
    if kind == ARRAY:
        return _array(arrays, *flat[1:])
    if kind == TUPLE:
        return tuple([_whole(part, arrays) for part in flat[1]])
    if kind == FLOAT64:
        return np.float64(flat[1])
    if kind == HYPOTHESES:
        own = {_whole(name, arrays): _whole(values, arrays) for name, values in flat[2]}
        return Hypotheses(_whole(flat[1], arrays), own)
    if kind == REGION:
        return Region(*flat[1:])
    if kind == MEASUREMENT:
        return Measurement(*[_whole(part, arrays) for part in flat[1]])
    if kind == TOLD:
        return Told({_whole(name, arrays): (n, _kept(_whole(one, arrays))) for name, n, one in flat[1]})
    return pickle.loads(flat[1])


def _array(arrays: Bytes, dtype: str, shape: tuple[int, ...], at: int, is_turned: bool) -> Array:
    kind = np.dtype(dtype)
    count = 1
    for length in shape:
        count *= length
    values = arrays[at : at + count * kind.itemsize].view(kind)
    return values.reshape(shape[::-1]).T if is_turned else values.reshape(shape)


def _kept(value: Any) -> Any:
    """What outlasts the message, without its other bytes."""
    return np.array(value) if type(value) is np.ndarray else value
