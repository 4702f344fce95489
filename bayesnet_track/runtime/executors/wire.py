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

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import Region
from bayesnet_track.runtime.executors.questions import EncodedReference

HEAD = struct.Struct("=QQ")
"""Where the arrays begin, and how many bytes follow the head."""
ALIGNED = 64
SMALL = 512
"""Bytes of an array up to which it stands in the description."""
MOST_PIECES = 256
"""Pieces of memory that are handed to the kernel at once; it takes 1024."""
VERSION = 2
"""Of marshal: the last one that does not look for values that occur twice."""
PLAIN = frozenset({type(None), bool, int, float, str, bytes})
NUMBERS = frozenset("biufc")
"""Kinds of arrays whose memory any buffer can be made of."""

EMPLOY, DISMISS, ASK = range(3)
"""What a message to a worker is for, the first of its plain part."""

SMALL_ARRAY, ARRAY, TUPLE, FLOAT64, HYPOTHESES, REGION, MEASUREMENT, TOLD, OTHER = range(9)


def send(channel: socket.socket, plain: tuple[Any, ...], *values: Any) -> None:
    """Send a message: `plain` of what `marshal` takes, and any values; raises OSError."""
    packing = _Packing()
    flat = [packing.flat(value) for value in values]
    description = marshal.dumps((plain, flat), VERSION)
    arrays_at = -(-len(description) // ALIGNED) * ALIGNED
    size = arrays_at + packing.size
    pieces = [HEAD.pack(arrays_at, size) + description.ljust(arrays_at, b"\0"), *packing.pieces]
    if len(pieces) > MOST_PIECES:
        pieces = [b"".join(pieces)]
    left = HEAD.size + size - channel.sendmsg(pieces)
    if left:
        channel.sendall(memoryview(b"".join(pieces))[-left:])


def receive(channel: socket.socket) -> tuple[Any, list[Any]]:
    """The plain part and the values of the next message, waited for; large arrays are views of it.

    Raises:
        EOFError: the other end has closed.
        OSError: it is lost.
    """
    head = channel.recv(HEAD.size)
    while len(head) < HEAD.size:
        more = channel.recv(HEAD.size - len(head)) if head else b""
        if not more:
            raise EOFError
        head += more
    arrays_at, size = HEAD.unpack(head)
    body = bytearray(size)
    at = channel.recv_into(body)
    while at < size:
        came = channel.recv_into(memoryview(body)[at:]) if at else 0
        if not came:
            raise EOFError
        at += came
    plain, flat = marshal.loads(body)  # what is behind it is not looked at
    return plain, [part if type(part) is not tuple else _whole(part, body, arrays_at) for part in flat]


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
        if kind is np.ndarray:
            return self._array(value)
        if kind is Hypotheses and type(value.fields) is dict:
            fields = [(self.flat(name), self.flat(own)) for name, own in value.fields.items()]
            return HYPOTHESES, self.flat(value.boxes), fields
        if kind is EncodedReference:
            return TOLD, [
                (self.flat(name), number, None if array is None else self.flat(array))
                for name, (number, array) in value.arrays.items()
            ]
        if kind is np.float64:
            return FLOAT64, float(value)
        if kind is tuple:
            return TUPLE, [self.flat(part) for part in value]
        if kind is Region:
            return REGION, value.x0, value.y0, value.x1, value.y1
        if kind is Measurement:
            gaussian = (value.fields, value.mean, value.covariance, value.floor)
            return MEASUREMENT, [self.flat(part) for part in (*gaussian, value.choices, value.confidence)]
        return OTHER, pickle.dumps(value, protocol=5)

    def _array(self, array: Array) -> tuple[Any, ...]:
        dtype, flags = array.dtype, array.flags
        if dtype.kind not in NUMBERS or not (flags.c_contiguous or flags.f_contiguous):
            return OTHER, pickle.dumps(array, protocol=5)
        is_turned = not flags.c_contiguous
        rows = array.T if is_turned else array
        if rows.nbytes <= SMALL:
            return SMALL_ARRAY, dtype.str, array.shape, is_turned, rows.tobytes()
        self.pieces.append(rows)
        described = ARRAY, dtype.str, array.shape, is_turned, self.size, rows.size
        gap = -rows.nbytes % ALIGNED
        if gap:
            self.pieces.append(bytes(gap))
        self.size += rows.nbytes + gap
        return described


def _whole(flat: Any, body: bytearray, arrays_at: int) -> Any:
    """The value that `_Packing.flat` was given; large arrays are views of `body`, from `arrays_at` on."""
    if type(flat) is not tuple:
        return flat
    kind = flat[0]
    if kind == SMALL_ARRAY:
        return _shape(np.array(np.frombuffer(flat[4], flat[1])), flat[2], flat[3])
    if kind == ARRAY:
        return _shape(np.frombuffer(body, flat[1], flat[5], arrays_at + flat[4]), flat[2], flat[3])
    if kind == HYPOTHESES:
        own = {_whole(name, body, arrays_at): _whole(values, body, arrays_at) for name, values in flat[2]}
        return Hypotheses(_whole(flat[1], body, arrays_at), own)
    if kind == TOLD:
        return EncodedReference(
            {
                _whole(name, body, arrays_at): (number, _kept(_whole(one, body, arrays_at)))
                for name, number, one in flat[1]
            }
        )
    if kind == FLOAT64:
        return np.float64(flat[1])
    if kind == TUPLE:
        return tuple([_whole(part, body, arrays_at) for part in flat[1]])
    if kind == REGION:
        return Region(*flat[1:])
    if kind == MEASUREMENT:
        return Measurement(*[_whole(part, body, arrays_at) for part in flat[1]])
    return pickle.loads(flat[1])


def _shape(values: Array, shape: tuple[int, ...], is_turned: bool) -> Array:
    if len(shape) == 1:
        return values
    return values.reshape(shape[::-1]).T if is_turned else values.reshape(shape)


def _kept(value: Any) -> Any:
    """What outlasts the message, without its other bytes."""
    return value.copy(order="K") if type(value) is np.ndarray and value.nbytes > SMALL else value
