"""Questions to agents in other processes and their answers, and how they become bytes.

A message is a head, a description of plain values (`marshal`), and the arrays that it names, each at a
multiple of `ALIGNED` bytes. What else a cue may be asked or return is pickled. Both ends run one version.
"""

from __future__ import annotations

import marshal
import pickle
import socket
import struct
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import Region, read_only

LEARN_AND_BLEND = "learn and blend"
"""A question for a reference: what learns, the old one, the rate, and the arguments of what learns."""
LEAST_BYTES = 2048
"""Smaller arrays are sent whenever they are needed."""
MOST_BYTES = 256 << 20
"""Arrays of references that are kept on either side, at most."""


@dataclass(frozen=True, eq=False)
class EncodedReference:
    """A reference: name -> the array, or the number of one that the other side holds, or both: to be kept."""

    arrays: Mapping[str, tuple[int | None, Array | None]]


class Call(NamedTuple):
    """One call of a cue's method, as the engine makes it; with the last two, as a worker is told of it.

    Attributes:
        agent: whose cue.
        method: such as "log_likelihood".
        frames: where the current frame and the one before lie; None for a method that sees none.
        region: of the planes.
        arguments: those behind the planes; references are mappings of arrays, to a worker `EncodedReference`.
        next_number: of the first array of the answer that is kept.
        forget: numbers of arrays that are kept no longer.
    """

    agent: str
    method: str
    frames: tuple[Any, Any] | None
    region: Region | None
    arguments: tuple[Any, ...]
    next_number: int = 0
    forget: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Answer:
    """The outcome of a question.

    Attributes:
        value: what the method returned; a reference as `EncodedReference`.
        raised: (type, text) of what it raised.
        out_of_memory: whether it needed more memory than it may have.
        seconds: how long it took.
    """

    value: Any = None
    raised: tuple[str, str] | None = None
    out_of_memory: bool = False
    seconds: float = 0.0


@dataclass(frozen=True, eq=False)
class Foreign:
    """Stands for an object that is not what a cue may return; only its type's name is told."""

    type_name: str


class Sent:
    """The asking side's memory of which arrays a worker holds."""

    def __init__(self) -> None:
        self.next_number = 0
        self._by_id: OrderedDict[int, tuple[Array, int]] = OrderedDict()
        self._by_number: dict[int, Array] = {}
        self._bytes = 0

    def question(self, call: Call) -> Call:
        """The question, references in its arguments told."""
        # First: an array that this question contains or refers to must outlast it.
        forget = self._forgotten()
        encoded = tuple(self.encode(part) if isinstance(part, Mapping) else part for part in call.arguments)
        return Call(*call[:4], encoded, self.next_number, forget)

    def encode(self, reference: Mapping[str, Any]) -> EncodedReference:
        """The reference, without the arrays that the worker has."""
        arrays: dict[str, tuple[int | None, Array | None]] = {}
        for name, value in reference.items():
            place = self._by_id.get(id(value))
            if place is not None:
                self._by_id.move_to_end(id(value))
                arrays[name] = place[1], None
            elif isinstance(value, np.ndarray) and value.nbytes >= LEAST_BYTES:
                arrays[name] = self._keep(value), value
            else:
                arrays[name] = None, value
        return EncodedReference(arrays)

    def decode(self, encoded: EncodedReference) -> dict[str, Array]:
        """The reference that a worker made; what it keeps of it is noted."""
        reference: dict[str, Any] = {}
        for name, (number, encoded_value) in encoded.arrays.items():
            value = read_only(encoded_value)  # once: this very array is known to the worker by its number
            if value is None:
                assert number is not None
                reference[name] = self._by_number[number]
            else:
                reference[name] = value
                if number is not None:
                    own_number = self._keep(value)
                    assert own_number == number
        return reference

    def _forgotten(self) -> tuple[int, ...]:
        """Numbers of the arrays that the worker need not keep."""
        forget: list[int] = []
        while self._bytes > MOST_BYTES and len(self._by_id) > 1:
            _, (array, number) = self._by_id.popitem(last=False)
            del self._by_number[number]
            self._bytes -= array.nbytes
            forget.append(number)
        return tuple(forget)

    def _keep(self, array: Array) -> int:
        number = self.next_number
        self.next_number += 1
        self._by_id[id(array)] = array, number
        self._by_number[number] = array
        self._bytes += array.nbytes
        return number


@dataclass
class Received:
    """The answering side's arrays."""

    arrays: dict[int, Array] = field(default_factory=dict)

    def reference(self, encoded: EncodedReference) -> dict[str, Any]:
        """The reference that was told."""
        reference: dict[str, Any] = {}
        for name, (number, encoded_value) in encoded.arrays.items():
            value = read_only(encoded_value)
            if value is None and number is not None:
                reference[name] = self.arrays[number]
            else:
                reference[name] = value
                if number is not None and value is not None:
                    self.arrays[number] = value
        return reference

    def forget(self, numbers: tuple[int, ...]) -> None:
        """Drop arrays."""
        for number in numbers:
            self.arrays.pop(number, None)

    def encode(
        self, reference: Mapping[str, Any], questions: Sequence[EncodedReference], next_number: int
    ) -> EncodedReference:
        """A reference that was made here of those `questions`; their arrays are not sent back."""
        numbers = {
            id(self.arrays[number]): number
            for encoded in questions
            for number, _ in encoded.arrays.values()
            if number is not None
        }
        arrays: dict[str, tuple[int | None, Array | None]] = {}
        for name, value in reference.items():
            array = np.asarray(value)
            if id(array) in numbers:
                arrays[name] = numbers[id(array)], None
            elif array.nbytes >= LEAST_BYTES:
                # A view may look into a frame, which does not last.
                self.arrays[next_number] = read_only(array if array.base is None else array.copy())
                arrays[name] = next_number, array
                next_number += 1
            else:
                arrays[name] = None, array
        return EncodedReference(arrays)


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
    unsent = HEAD.size + size - channel.sendmsg(pieces)
    if unsent:
        channel.sendall(memoryview(b"".join(pieces))[-unsent:])


def receive(channel: socket.socket) -> tuple[Any, list[Any]]:
    """The plain part and the values of the next message, waited for; large arrays are views of it.

    Raises:
        EOFError: the other end has closed.
        OSError: it is lost.
    """
    head = channel.recv(HEAD.size)
    while len(head) < HEAD.size:
        chunk = channel.recv(HEAD.size - len(head)) if head else b""
        if not chunk:
            raise EOFError
        head += chunk
    arrays_at, size = HEAD.unpack(head)
    body = bytearray(size)
    received = channel.recv_into(body)
    while received < size:
        came = channel.recv_into(memoryview(body)[received:]) if received else 0
        if not came:
            raise EOFError
        received += came
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
            fields = [
                (self.flat(name), self.flat(values_of_field))
                for name, values_of_field in value.fields.items()
            ]
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
        fields = {_whole(name, body, arrays_at): _whole(values, body, arrays_at) for name, values in flat[2]}
        return Hypotheses(_whole(flat[1], body, arrays_at), fields)
    if kind == TOLD:
        return EncodedReference(
            {
                _whole(name, body, arrays_at): (number, _kept(_whole(array, body, arrays_at)))
                for name, number, array in flat[1]
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
    """The part that outlasts the message, without its other bytes."""
    return value.copy(order="K") if type(value) is np.ndarray and value.nbytes > SMALL else value
