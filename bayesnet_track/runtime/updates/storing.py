"""A tracker as bytes: sealed, of one version, read without running anything that they say."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np

from bayesnet_track.engine.step import Engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.write import graph_sha256
from bayesnet_track.journal.codec import event_classes, type_hints
from bayesnet_track.observation.depth import PointMap, RightEye, StereoGeometry
from bayesnet_track.observation.masks import Mask
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.checkpoints.given_files import file_sha256, model_files
from bayesnet_track.runtime.checkpoints.state_codec import CLASSES, StateError, decode, encode, state_format
from bayesnet_track.runtime.checkpoints.versions import versions
from bayesnet_track.runtime.frame_kind import FrameKind
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.updates.frame_clock import FrameClock
from bayesnet_track.runtime.updates.looking import image_users
from bayesnet_track.runtime.updates.standing import Standing

FORMAT = 2
"""Raised when older programs cannot read what is written; each program reads its own format only."""

MAGIC = b"bayesnet_track tracker"

MOST_BYTES = 1 << 30


class StoredError(ValueError):
    """A tracker that cannot be stored, or bytes from which none can be made here."""


@dataclass(frozen=True, eq=False)
class Stored:
    """What is stored of a tracker.

    Attributes:
        graph: the graph.
        options: what else the tracker was made with, by name.
        body: where it stands, encoded.
    """

    graph: CheckedGraph
    options: dict[str, Any]
    body: bytes

    def standing(self, engine: Engine) -> Standing | None:
        """Where it stands, to go on with `engine`; None before its first frame. Raises StoredError."""
        try:
            now = decode(self.body, stored_classes(), engine)
        except StateError as error:
            raise StoredError(f"the stored tracker is {error}") from error
        if not isinstance(now, Standing | None):
            raise StoredError("the stored tracker is damaged")
        return now


@cache
def stored_classes() -> tuple[type, ...]:
    """Every class of which a stored tracker is made."""
    own = (Standing, FrameClock, FrameKind, Resizing, Frame, RightEye, PointMap, StereoGeometry)
    found = dict.fromkeys((*CLASSES, *own))
    for kind in event_classes().values():
        found |= dict.fromkeys(_held(kind))
    return tuple(found)


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
    opaque = [name for one in engine.plates.values() for name in sorted(one.opaque)]
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


def pack(
    kind: str, graph: CheckedGraph, engine: Engine, options: Mapping[str, Any], now: Standing | None
) -> bytes:
    """The bytes of a tracker of a kind: pixels of the last frame only where the graph looks at any.

    Raises:
        StoredError: something of it cannot be stored.
    """
    if now is not None:
        state, previous = now.state, now.state.previous
        if previous is not None and not image_users(engine):
            blank = replace(previous, image=np.zeros_like(previous.image))
            state = replace(state, previous=blank)
        lines = tuple(replace(one, cloud=tuple(one.cloud)) for one in now.metrics)  # plain tuples
        now = replace(now, state=state, metrics=lines)
    try:
        body = encode(now, stored_classes())
        masks = encode({name: (str(one.path), one.sha256, one.gray) for name, one in graph.masks.items()}, ())
    except StateError as error:
        raise StoredError(f"this tracker cannot be stored: {error}") from error
    header = {
        "kind": kind,
        "graph": graph.text,
        "models": {path: file_sha256(path) for path in model_files(graph)},
        "options": dict(options),
        "masks": len(masks),
    }
    content = zlib.compress(json.dumps(header).encode("ascii") + b"\n" + masks + body, 1)
    seal = hashlib.sha256(content).hexdigest().encode("ascii")
    return b"\n".join((_first_line(), seal, content))


def unpack(data: bytes, kind: str, given: CheckedGraph | None = None) -> Stored:
    """What bytes say, to be made with the `given` graph, which is the stored one with None.

    Raises:
        StoredError: they are damaged, of another version, kind or graph, or a model file is not as it was.
    """
    first, _, rest = data.partition(b"\n")
    seal, _, content = rest.partition(b"\n")
    if not first.startswith(MAGIC):
        raise StoredError("these bytes are no stored tracker")
    if first != _first_line():
        writer, here = (
            line[len(MAGIC) :][:80].decode("ascii", "replace").strip() for line in (first, _first_line())
        )
        raise StoredError(
            f"the tracker was stored in {writer}, and this is {here}: a version reads its own format only; "
            "load it with that one, or start anew"
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
        found = decode(body[:size], ())
        masks = {name: Mask(Path(path), sha256, gray) for name, (path, sha256, gray) in found.items()}
    except StoredError:
        raise
    except (zlib.error, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise StoredError(f"the stored tracker is damaged: {error}") from error
    graph = check(*read_graph(text, "the stored graph"), masks=masks) if given is None else given
    _compare(graph, text, masks)
    for path, sha256 in models.items():
        if file_sha256(path) != sha256:
            raise StoredError(f"{path} is not what it was when the tracker was stored")
    return Stored(graph, options, body[size:])


def _first_line() -> bytes:
    version = versions()["bayesnet-track"]
    return f"{MAGIC.decode()} format {FORMAT}.{state_format(stored_classes())} of {version}".encode()


def _compare(graph: CheckedGraph, text: str, masks: Mapping[str, Mask]) -> None:
    if graph.text != text:
        stored, given = graph_sha256(text)[:12], graph_sha256(graph.text)[:12]
        raise StoredError(
            f"the tracker was stored with another graph: SHA-256 {stored}, and {graph.spec.name}, which is "
            f"given, has {given}; leave it out to go on with the stored one"
        )
    for name, mask in masks.items():
        if graph.masks[name].sha256 != mask.sha256:
            raise StoredError(f"the mask {name} is not what it was when the tracker was stored")
