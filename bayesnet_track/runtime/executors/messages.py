"""Questions to agents in other processes and their answers, and how they become bytes.

A message is the size of a pickle, and the pickle. Both ends run one version, and trust each other.
"""

from __future__ import annotations

import pickle
import socket
import struct
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from bayesnet_track.numerics.arrays import Array
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


class CueCall(NamedTuple):
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


class Employ(NamedTuple):
    """An agent, or a stream of frames, that a worker has from now on, and how it is made."""

    agent: str
    make: Any
    parameters: Any


class Dismiss(NamedTuple):
    """An agent that a worker has no more."""

    agent: str


@dataclass(frozen=True, eq=False)
class CallOutcome:
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

    def question(self, call: CueCall) -> CueCall:
        """The question, references in its arguments told."""
        # First: an array that this question contains or refers to must outlast it.
        forget = self._forgotten()
        encoded = tuple(self.encode(part) if isinstance(part, Mapping) else part for part in call.arguments)
        return CueCall(*call[:4], encoded, self.next_number, forget)

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


HEAD = struct.Struct("=Q")
"""How many bytes follow the head."""


def send(channel: socket.socket, message: Any) -> None:
    """Send a message; raises OSError."""
    body = pickle.dumps(message, protocol=5)
    channel.sendall(HEAD.pack(len(body)) + body)


def receive(channel: socket.socket) -> Any:
    """The next message, waited for.

    Raises:
        EOFError: the other end has closed.
        OSError: it is lost.
    """
    (size,) = HEAD.unpack(_received(channel, HEAD.size))
    return pickle.loads(_received(channel, size))


def _received(channel: socket.socket, size: int) -> bytearray:
    body = bytearray(size)
    received = 0
    while received < size:
        arrived = channel.recv_into(memoryview(body)[received:])
        if not arrived:
            raise EOFError
        received += arrived
    return body
