"""The engine's state as bytes and back, bit for bit, without running anything that the bytes say.

A line of JSON holds the structure, the arrays follow it. Only the classes of `CLASSES` are ever made. What is
the same object twice is the same object again afterwards: the engine asks it of beliefs. Compiled plans are
left out and compiled again; the last frame is left out and read again from the source.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np

from bayesnet_track.adapt.cameras import CameraErrors, ClockReading, Offsets, Watch
from bayesnet_track.adapt.existence import DetectionModel, UnconfirmedTracks
from bayesnet_track.adapt.identities import Entangled, PlateIdentities
from bayesnet_track.adapt.joins import CarriedHypotheses, JoinMemory, Level, PairMemory
from bayesnet_track.adapt.lifecycle import (
    AppearanceMemory,
    CameraMemory,
    Candidate,
    TrackHistory,
    TrackRecord,
)
from bayesnet_track.adapt.meetings import Meeting, SensorRates
from bayesnet_track.adapt.memory import Baseline, InformationRate, Layout, RuleMemory
from bayesnet_track.adapt.presence import Known, Presence
from bayesnet_track.adapt.shedding import Load
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.grid.cells import GridBelief, Lattice
from bayesnet_track.belief.motion.composed import Influences
from bayesnet_track.belief.motion.delayed import CameraShift
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.belief.particles.sample_size import SampleSize, SizeMemory
from bayesnet_track.engine.predicting import MotionContext
from bayesnet_track.engine.scoring.score import Agreement, Encounter, Place, ScoreState
from bayesnet_track.engine.step import Engine, State, TargetState
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.crossings import Trail
from bayesnet_track.inference.learn import SlowReferences
from bayesnet_track.inference.queries import QueryMemory
from bayesnet_track.journal.events.joins import Joined, Refusal
from bayesnet_track.journal.net import Net
from bayesnet_track.journal.target_net import Fault, TargetNet, Turn
from bayesnet_track.numerics.arrays import Array
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.planes import Scene

CLASSES: tuple[type, ...] = (
    State,
    TargetState,
    Net,
    TargetNet,
    Fault,
    Turn,
    Load,
    Joined,
    ParticleSet,
    LogWeights,
    SizeMemory,
    SampleSize,
    GaussianPosterior,
    ModalPosterior,
    GridBelief,
    Lattice,
    RuleMemory,
    Layout,
    Baseline,
    InformationRate,
    SlowReferences,
    MotionContext,
    Influences,
    CameraShift,
    ScoreState,
    Encounter,
    Place,
    Agreement,
    TrackHistory,
    Refusal,
    Candidate,
    AppearanceMemory,
    TrackRecord,
    DetectionModel,
    UnconfirmedTracks,
    Known,
    Presence,
    JoinMemory,
    PairMemory,
    Level,
    CarriedHypotheses,
    Scene,
    QueryMemory,
    Trail,
    PlateIdentities,
    Meeting,
    Entangled,
    SensorRates,
    CameraErrors,
    ClockReading,
    Watch,
    Offsets,
    CameraMemory,
)
"""Every class of which the state between frames is made."""

PLAIN = frozenset((bool, int, float, str, type(None)))
DTYPES = "biufc"
MOST_BYTES = 1 << 28
"""What an array with gaps between its values may take."""


class StateError(ValueError):
    """A state that cannot be stored, or bytes that are no state."""


@cache
def _by_name(classes: tuple[type, ...]) -> Mapping[str, type]:
    return {kind.__name__: kind for kind in classes}


@cache
def _names(kind: Any) -> tuple[str, ...]:
    return tuple(item.name for item in fields(kind))


@cache
def state_format(classes: tuple[type, ...] = CLASSES) -> str:
    """A hash of the classes and their fields: bytes of another format are of another version."""
    text = json.dumps([[kind.__name__, *_names(kind)] for kind in classes])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def encode_state(state: State) -> bytes:
    """The state as bytes, but for its last frame.

    Raises:
        StateError: it holds something of a class that is not known here.
    """
    return encode_value(state, CLASSES, state.previous)


def encode_value(value: Any, classes: tuple[type, ...], outer_frame: Frame | None = None) -> bytes:
    """A value made of `classes`, plain values, tuples, mappings and arrays as bytes; without `outer_frame`.

    Raises:
        StateError: it holds something else.
    """
    encoder = _Encoder(outer_frame, _by_name(classes))
    structure = json.dumps(encoder.node(value), separators=(",", ":")).encode("ascii")
    line = json.dumps([len(structure), encoder.places], separators=(",", ":")).encode("ascii")
    return b"".join((line, b"\n", structure, *encoder.blobs))


def decode_state(data: bytes, engine: Engine, frame: Frame | None) -> State:
    """The state of these bytes, to go on with `engine`; `frame` is the last frame that it saw.

    Raises:
        StateError: they are no state of this version, or none of this engine's graph.
    """
    state = decode_value(data, CLASSES, engine, None if frame is None else engine.on_clock(frame))
    if not isinstance(state, State):
        raise StateError(f"damaged: a {type(state).__name__} in place of the state")
    return state


def decode_value(
    data: bytes, classes: tuple[type, ...], engine: Engine | None = None, outer_frame: Frame | None = None
) -> Any:
    """The inverse of `encode_value`; plans are compiled with `engine`.

    Raises:
        StateError: the bytes hold something else.
    """
    try:
        line, content = data.split(b"\n", 1)
        length, places = json.loads(line)
        arrays = _arrays(places, memoryview(content)[length:])
        return _Decoder(engine, outer_frame, arrays, _by_name(classes)).value(json.loads(content[:length]))
    except StateError:
        raise
    except Exception as error:  # whatever a class says of values that are not its own
        raise StateError(f"damaged: {type(error).__name__}: {error}") from error


class _Encoder:
    """Values as JSON: plain ones as they are, others as a list that begins with a letter."""

    def __init__(self, outer_frame: Frame | None, classes: Mapping[str, type]) -> None:
        self.blobs: list[bytes] = []
        self.places: list[list[Any]] = []
        self._outside, self._known = outer_frame, classes
        self._seen: dict[int, int] = {}

    def node(self, value: Any) -> Any:
        if type(value) in PLAIN:
            return value
        if type(value) is tuple:
            is_plain = PLAIN.issuperset(map(type, value))  # the usual case: many numbers
            return ["t", *(value if is_plain else map(self.node, value))]
        if type(value) is frozenset:
            return ["f", *[self.node(item) for item in sorted(value)]]
        number = self._seen.get(id(value))
        if number is not None:
            return ["=", number]
        node = self._made(value)
        self._seen[id(value)] = len(self._seen)
        return node

    def _made(self, value: Any) -> Any:
        if is_dataclass(value) and self._known.get(type(value).__name__) is type(value):
            kind: Any = type(value)
            return ["o", kind.__name__, *[self.node(getattr(value, name)) for name in _names(kind)]]
        if isinstance(value, Mapping):
            return ["m", *[[self.node(key), self.node(item)] for key, item in value.items()]]
        if isinstance(value, np.ndarray | np.generic):
            return ["a", self._array(value)]
        if value is self._outside:
            return ["p"]
        if isinstance(value, Plan):
            return ["c", value.target, sorted(value.active)]
        raise StateError(f"a {type(value).__module__}.{type(value).__qualname__} cannot be stored")

    def _array(self, value: Array | np.generic) -> int:
        array = np.asarray(value)
        if array.dtype.kind not in DTYPES or type(array) is not np.ndarray:
            raise StateError(f"an array of {array.dtype} cannot be stored")
        # Sums go along memory: another order of it gives other last bits.
        order = "C" if array.flags.c_contiguous else list(array.strides)
        self.places.append(
            [array.dtype.str, array.shape, order, array.flags.writeable, isinstance(value, np.generic)]
        )
        self.blobs.append(array.tobytes())
        return len(self.places) - 1


def _arrays(places: list[list[Any]], data: memoryview) -> list[Any]:
    arrays, offset = [], 0
    for name, shape, order, is_writeable, is_scalar in places:
        kind = np.dtype(name)
        if kind.kind not in DTYPES:
            raise StateError(f"damaged: an array of {name}")
        if any(type(size) is not int or size < 0 for size in shape):
            raise StateError(f"damaged: an array of shape {shape}")
        count = math.prod(shape)
        array: Array = np.frombuffer(data, kind, count, offset).reshape(shape)
        offset += count * kind.itemsize
        array = array.copy() if order == "C" else _lay_out(array, order)
        array.setflags(write=is_writeable)
        arrays.append(array[()] if is_scalar else array)
    if offset != len(data):
        raise StateError(f"damaged: {len(data) - offset} bytes too many")
    return arrays


def _lay_out(values: Array, strides: list[int]) -> Array:
    """The values in memory as they were: with the same strides."""
    steps = [(size - 1) * stride for size, stride in zip(values.shape, strides, strict=True)]
    first = -sum(step for step in steps if step < 0)
    size = first + sum(step for step in steps if step > 0) + values.itemsize
    if size > MOST_BYTES:
        raise StateError(f"damaged: an array laid out over {size} bytes")
    room = np.zeros(size, dtype=np.uint8)
    array: Array = np.ndarray(values.shape, values.dtype, room, first, strides)
    array[...] = values
    return array


class _Decoder:
    """The inverse of `_Encoder`."""

    def __init__(
        self, engine: Engine | None, outer_frame: Frame | None, arrays: list[Any], classes: Mapping[str, type]
    ) -> None:
        self._engine, self._outside, self._arrays, self._known = engine, outer_frame, arrays, classes
        self._made: list[Any] = []

    def value(self, node: Any) -> Any:
        if not isinstance(node, list):
            return node
        letter = node[0]
        if letter == "t":
            return tuple(self.value(item) for item in node[1:])
        if letter == "f":
            return frozenset(self.value(item) for item in node[1:])
        if letter == "=":
            return self._made[node[1]]
        instance = self._new(letter, node)
        self._made.append(instance)
        return instance

    def _new(self, letter: str, node: list[Any]) -> Any:
        if letter == "m":
            return {self.value(key): self.value(item) for key, item in node[1:]}
        if letter == "a":
            return self._arrays[node[1]]
        if letter == "p":
            return self._outside
        if letter == "c":
            if self._engine is None:
                raise StateError("damaged: a plan without an engine")
            compiled = self._engine.plates[node[1]]
            return compile_plan(compiled.plate, node[2], compiled.cues)
        if letter == "o":
            kind = self._known[node[1]]
            names = _names(kind)
            if len(node) != len(names) + 2:
                raise StateError(f"damaged: {node[1]} has {len(names)} fields, not {len(node) - 2}")
            return kind(**dict(zip(names, map(self.value, node[2:]), strict=True)))
        raise StateError(f"damaged: {letter!r}")
