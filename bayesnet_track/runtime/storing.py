"""Trackers as bytes: stored, pickled and copied, by one thread at a time."""

from __future__ import annotations

import copy
import hashlib
import json
import threading
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass, replace
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self, get_args

import numpy as np

from bayesnet_track.engine.step import Engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.cameras import read_file
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph, read_graph
from bayesnet_track.graph.text.write import graph_sha256
from bayesnet_track.journal.codec import event_classes, type_hints
from bayesnet_track.journal.metrics import Answers, QueryAnswer
from bayesnet_track.journal.writer import write_atomically
from bayesnet_track.observation import plugins
from bayesnet_track.observation.image_files import Mask
from bayesnet_track.observation.planes import Frame, PointMap, RightEye, StereoGeometry
from bayesnet_track.runtime.checkpoints.origins import file_sha256, model_files, versions
from bayesnet_track.runtime.checkpoints.state_codec import (
    CLASSES,
    StateError,
    decode_value,
    encode_value,
    state_format,
)
from bayesnet_track.runtime.frame_clock import FrameClock, Standing, image_users
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import FrameKind
from bayesnet_track.sources.entrances.levels import Levels


class Turns:
    """Lets one thread in at a time and refuses others.

    Waiting would give a result, too, but one that depends on which thread came first: the order of frames
    decides what a tracker finds.

    >>> turns = Turns("Tracker")
    >>> with turns.take("update"):
    ...     pass
    """

    def __init__(self, kind: str) -> None:
        self._kind, self._lock = kind, threading.Lock()
        self._at_work = ("", "")

    @contextmanager
    def take(self, call: str) -> Iterator[None]:
        """A turn for a call.

        Raises:
            RuntimeError: another thread, or an outer call of this one, has its turn; names both.
        """
        thread = threading.current_thread().name
        if not self._lock.acquire(blocking=False):
            holder, running = self._at_work
            raise RuntimeError(
                f"{call} in thread {thread!r} while thread {holder!r} is in {running} of the same "
                f"{self._kind}: its frames must come in order; call it from one thread, or hold a lock "
                f"around each call; a {self._kind} of its own for each video can run in each thread"
            )
        try:
            self._at_work = (thread, call)
            yield
        finally:
            self._lock.release()


FORMAT = 2
"""Raised when older programs cannot read what is written; each program reads its own format only."""

MAGIC = b"bayesnet_track tracker"

MOST_BYTES = 1 << 30


class StoredError(ValueError):
    """A tracker that cannot be stored, or bytes from which none can be made here."""


@dataclass(frozen=True, eq=False)
class Stored:
    """Contents of a stored tracker.

    Attributes:
        graph: the graph.
        options: what else the tracker was made with, by name.
        body: where it stands, encoded.
    """

    graph: CheckedGraph
    options: dict[str, Any]
    body: bytes

    def standing(self, engine: Engine) -> Standing | None:
        """The standing to go on from with `engine`; None before its first frame. Raises StoredError."""
        try:
            decoded = decode_value(self.body, stored_classes(), engine)
        except StateError as error:
            raise StoredError(f"the stored tracker is {error}") from error
        if not isinstance(decoded, Standing | None):
            raise StoredError("the stored tracker is damaged")
        return decoded


@cache
def stored_classes() -> tuple[type, ...]:
    """Every class of which a stored tracker is made."""
    of_trackers = (
        Standing,
        Answers,
        QueryAnswer,
        FrameClock,
        FrameKind,
        Resizing,
        Frame,
        RightEye,
        PointMap,
        StereoGeometry,
    )
    classes = dict.fromkeys((*CLASSES, *of_trackers))
    for kind in event_classes().values():
        classes |= dict.fromkeys(_held(kind))
    return tuple(classes)


def _held(hint: Any) -> Iterator[type]:
    """The dataclasses that a type is made of."""
    for inner in get_args(hint):
        yield from _held(inner)
    if isinstance(hint, type) and is_dataclass(hint):
        yield hint
        for member in type_hints(hint).values():
            yield from _held(member)


def check_storable(graph: CheckedGraph, engine: Engine, has_own_motion: bool) -> None:
    """Refuse what cannot be stored; raises StoredError, which names it."""
    opaque = [name for plate in engine.plates.values() for name in sorted(plate.opaque)]
    reasons = [
        *(["its motion is a model of one's own"] if has_own_motion else []),
        *([f"its cues {', '.join(graph.cues)} are one's own"] if graph.cues else []),
        *([f"its agents {', '.join(opaque)} keep what cannot be read"] if opaque else []),
    ]
    if reasons:
        raise StoredError(
            f"this tracker cannot be stored: {'; '.join(reasons)}; copy.copy(tracker) gives another one in "
            "this process"
        )


def _pack(
    kind: str, graph: CheckedGraph, engine: Engine, options: Mapping[str, Any], standing: Standing | None
) -> bytes:
    """The bytes of a tracker of a kind: pixels of the last frame only where the graph looks at any.

    Raises:
        StoredError: something of it cannot be stored.
    """
    if standing is not None:
        state, previous = standing.state, standing.state.previous
        if previous is not None and not image_users(engine):
            blank = replace(previous, image=np.zeros_like(previous.image))
            state = replace(state, previous=blank)
        lines = tuple(replace(line, cloud=tuple(line.cloud)) for line in standing.metrics)  # plain tuples
        standing = replace(standing, state=state, metrics=lines)
    try:
        body = encode_value(standing, stored_classes())
        masks = encode_value(
            {name: (str(line.path), line.sha256, line.gray) for name, line in graph.masks.items()}, ()
        )
    except StateError as error:
        raise StoredError(f"this tracker cannot be stored: {error}") from error
    header = {
        "kind": kind,
        "graph": graph.text,
        "models": {path: file_sha256(path) for path in model_files(graph)},
        "options": dict(options),
        "masks": len(masks),
        "calibrations": {
            key: [str(line.path.absolute()), line.sha256, line.name]
            for key, line in graph.calibrations.items()
        },
    }
    content = zlib.compress(json.dumps(header).encode("ascii") + b"\n" + masks + body, 1)
    seal = hashlib.sha256(content).hexdigest().encode("ascii")
    return b"\n".join((_first_line(), seal, content))


def _unpack(data: bytes, kind: str, own_graph: CheckedGraph | None = None) -> Stored:
    """Contents of the bytes, to be made with the `own_graph` graph, which is the stored one with None.

    Raises:
        StoredError: they are damaged, of another version, kind or graph, or a model file is not as it was.
    """
    first, _, remainder = data.partition(b"\n")
    seal, _, content = remainder.partition(b"\n")
    if not first.startswith(MAGIC):
        raise StoredError("these bytes are no stored tracker")
    if first != _first_line():
        writer, reader_line = (
            line[len(MAGIC) :][:80].decode("ascii", "replace").strip() for line in (first, _first_line())
        )
        raise StoredError(
            f"the tracker was stored in {writer}, and this is {reader_line}: "
            "a version reads its own format only; load it with that one, or start anew"
        )
    if hashlib.sha256(content).hexdigest().encode("ascii") != seal:
        raise StoredError("the stored tracker is damaged")
    try:
        reader = zlib.decompressobj()
        line, body = reader.decompress(content, MOST_BYTES).split(b"\n", 1)
        header = json.loads(line)
        if header["kind"] != kind:
            raise StoredError(f"a {header['kind']} was stored, and a {kind} is asked for")
        size, text, models, options = (header[name] for name in ("masks", "graph", "models", "options"))
        files = header["calibrations"]
        fields = decode_value(body[:size], ())
        masks = {name: Mask(Path(path), sha256, gray) for name, (path, sha256, gray) in fields.items()}
    except StoredError:
        raise
    except (zlib.error, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise StoredError(f"the stored tracker is damaged: {error}") from error
    if own_graph is None:
        for path, sha256, _ in files.values():
            _check_file("calibration", path, sha256)
        cameras = {key: read_file(Path(path), name) for key, (path, _, name) in files.items()}
        own_graph = check(*read_graph(text, "the stored graph"), masks=masks, calibrations=cameras)
    graph = own_graph
    _compare(graph, text, masks)
    for key, (path, sha256, _) in files.items():
        if graph.calibrations[key].sha256 != sha256:
            raise StoredError(f"the calibration {path} is not what it was when the tracker was stored")
    for path, sha256 in models.items():
        _check_file("model", path, sha256)
    return Stored(graph, options, body[size:])


def _check_file(noun: str, path: str, sha256: str) -> None:
    """Refuse a file that a stored tracker needs, and that is gone or another."""
    try:
        actual = file_sha256(path)
    except OSError as error:
        reason = error.strerror or str(error)
        advice = "" if noun == "model" else ", or load with a graph that has it (graph=..)"
        raise StoredError(
            f"the {noun} {path}, which the tracker was stored with, cannot be read: {reason}; "
            f"put it back{advice}"
        ) from error
    if actual != sha256:
        raise StoredError(f"the {noun} {path} is not what it was when the tracker was stored")


def _first_line() -> bytes:
    version = versions()["bayesnet-track"]
    return f"{MAGIC.decode()} format {FORMAT}.{state_format(stored_classes())} of {version}".encode()


def _compare(graph: CheckedGraph, text: str, masks: Mapping[str, Mask]) -> None:
    if graph.text != text:
        stored, offered = graph_sha256(text)[:12], graph_sha256(graph.text)[:12]
        raise StoredError(
            f"the tracker was stored with another graph: SHA-256 {stored}, and {graph.spec.name}, which is "
            f"given, has {offered}; leave it out to go on with the stored one"
        )
    for name, mask in masks.items():
        if graph.masks[name].sha256 != mask.sha256:
            raise StoredError(f"the mask {name} is not what it was when the tracker was stored")


class Storable:
    """A tracker whose graph, options and standing are all that there is of it."""

    _kind: ClassVar[str]
    _graph: CheckedGraph
    _engine: Engine
    _now: Standing | None
    _turns: Turns
    _own: frozenset[str]
    _levels: Levels
    _has_own_motion = False

    def _options(self) -> Mapping[str, Any]:
        """Options that it was made with, besides the graph."""
        raise NotImplementedError

    def _make_again(self, graph: CheckedGraph, options: Mapping[str, Any]) -> None:
        """Become a new one, as its constructor makes it."""
        raise NotImplementedError

    def _renew_engine(self) -> None:
        """Make what of the engine is not shared with a copy, or depends on where it stands."""

    @property
    def queries(self) -> Mapping[str, Answers]:
        """Query of the graph -> its answers after the last frame, by target or pair; empty before.

        Lengths are those of the frames that it tracks in::

            tracker.queries["in_goal"]["1"].probability, tracker.queries["inside"].total.mean
        """
        standing = self._now
        return {} if standing is None else {answers.query: answers for answers in standing.answers}

    def save(self, path: str | PathLike[str]) -> None:
        """Write the graph, the options and all that is known after the last frame into a file.

        The tracker that `load` makes of it goes on as this one does: with the same bytes on the same type of
        machine and with the same versions of the libraries.

        Raises:
            RuntimeError: another thread is at work with this tracker.
            StoredError: the motion or cues are one's own, or an agent keeps what cannot be stored.
            OutputError: the file cannot be written; an older one is as it was.
        """
        with self._turns.take("save"):
            write_atomically(Path(path), self._bytes())

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        graph: str | PathLike[str] | GraphSpec | CheckedGraph | None = None,
        allow_plugins: Iterable[str] = (),
    ) -> Self:
        """The tracker of a file that `save` wrote.

        Args:
            path: the file.
            graph: the graph that the tracker has to have; any with None.
            allow_plugins: cues and detectors of other packages that may be loaded, as of the constructor.

        Raises:
            OSError: the file, or a model that the graph names, cannot be read.
            StoredError: it is damaged, of another version of its format, of another graph or tracker, or a
                model is not what it was.
            GraphError: a cue of the graph is not here, or may not be loaded.
        """
        plugins.allow(allow_plugins)
        return cls._of_bytes(Path(path).read_bytes(), None if graph is None else load_graph(graph))

    def _bytes(self) -> bytes:
        check_storable(self._graph, self._engine, self._has_own_motion)
        options = {**self._options(), "dtype": self._levels.dtype}
        return _pack(self._kind, self._graph, self._engine, options, self._now)

    @classmethod
    def _of_bytes(cls, data: bytes, graph: CheckedGraph | None = None) -> Self:
        stored = _unpack(data, cls._kind, graph)
        tracker, dtype = cls.__new__(cls), stored.options.pop("dtype", None)
        tracker._make_again(stored.graph, stored.options)
        tracker._levels.go_on(dtype)
        tracker._now = stored.standing(tracker._engine)
        if stored.graph.masks and tracker._now is not None:
            tracker._renew_engine()
            tracker._now = stored.standing(tracker._engine)
        return tracker

    def __copy__(self) -> Self:
        """A tracker that goes on from here by itself; what never changes is shared."""
        twin = type(self).__new__(type(self))
        twin.__dict__.update(self.__dict__, _turns=Turns(self._kind), _levels=copy.copy(self._levels))
        twin._renew_engine()
        return twin

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Copy like `copy.copy`: no tracker changes what copies share."""
        return copy.copy(self)

    def __reduce__(self) -> tuple[Any, ...]:
        """Store like `save`, with attributes of subclasses; raises TypeError for what cannot be stored."""
        try:
            with self._turns.take("pickling"):
                data = self._bytes()
        except StoredError as error:
            raise TypeError(f"a {self._kind} that cannot be pickled: {error}") from error
        added = {name: value for name, value in vars(self).items() if name not in self._own}
        return _unpickled, (type(self), data, tuple(sorted(plugins.allowed()))), added or None


def _unpickled(kind: type[Storable], data: bytes, plugin_names: tuple[str, ...]) -> Storable:
    plugins.allow(plugin_names)
    return kind._of_bytes(data)
