"""What an agent in another process is asked and answers; references are told only when they change."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import Region
from bayesnet_track.observation.shared import read_only

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
    """What became of a question.

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
        # First: an array that this question tells or refers to must outlast it.
        forget = self._forgotten()
        encoded = tuple(self.encode(part) if isinstance(part, Mapping) else part for part in call.arguments)
        return Call(*call[:4], encoded, self.next_number, forget)

    def encode(self, reference: Mapping[str, Any]) -> EncodedReference:
        """The reference, without the arrays that the worker has."""
        arrays: dict[str, tuple[int | None, Array | None]] = {}
        for name, value in reference.items():
            known = self._by_id.get(id(value))
            if known is not None:
                self._by_id.move_to_end(id(value))
                arrays[name] = known[1], None
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
                    kept = self._keep(value)
                    assert kept == number
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
        self, reference: Mapping[str, Any], given: Sequence[EncodedReference], next_number: int
    ) -> EncodedReference:
        """A reference that was made here of those `given`; their arrays are not sent back."""
        known = {
            id(self.arrays[number]): number
            for encoded in given
            for number, _ in encoded.arrays.values()
            if number is not None
        }
        arrays: dict[str, tuple[int | None, Array | None]] = {}
        for name, value in reference.items():
            array = np.asarray(value)
            if id(array) in known:
                arrays[name] = known[id(array)], None
            elif array.nbytes >= LEAST_BYTES:
                # A view may look into a frame, which does not last.
                self.arrays[next_number] = read_only(array if array.base is None else array.copy())
                arrays[name] = next_number, array
                next_number += 1
            else:
                arrays[name] = None, array
        return EncodedReference(arrays)
