"""Trackers that can be stored, pickled and copied: what `Tracker` and `DetectionsTracker` share."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self

from bayesnet_track.engine.step import Engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.writer import write_atomically
from bayesnet_track.observation import plugins
from bayesnet_track.runtime.updates.standing import Standing
from bayesnet_track.runtime.updates.storing import StoredError, check_storable, pack, unpack
from bayesnet_track.runtime.updates.turns import Turns
from bayesnet_track.sources.entrances.levels import Levels


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
        """What it was made with, besides the graph."""
        raise NotImplementedError

    def _make_again(self, graph: CheckedGraph, options: Mapping[str, Any]) -> None:
        """Become a new one, as its constructor makes it."""
        raise NotImplementedError

    def _renew_engine(self) -> None:
        """Make what of the engine is not shared with a copy, or depends on where it stands."""

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
        return pack(self._kind, self._graph, self._engine, options, self._now)

    @classmethod
    def _of_bytes(cls, data: bytes, graph: CheckedGraph | None = None) -> Self:
        stored = unpack(data, cls._kind, graph)
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
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__dict__, _turns=Turns(self._kind), _levels=copy.copy(self._levels))
        other._renew_engine()
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """As `copy.copy`: no tracker changes what copies share."""
        return copy.copy(self)

    def __reduce__(self) -> tuple[Any, ...]:
        """As `save`, and the attributes of subclasses; raises TypeError for what cannot be stored."""
        try:
            with self._turns.take("pickling"):
                data = self._bytes()
        except StoredError as error:
            raise TypeError(f"a {self._kind} that cannot be pickled: {error}") from error
        added = {name: value for name, value in vars(self).items() if name not in self._own}
        return _unpickled, (type(self), data, tuple(sorted(plugins.allowed()))), added or None


def _unpickled(kind: type[Storable], data: bytes, allowed: tuple[str, ...]) -> Storable:
    plugins.allow(allowed)
    return kind._of_bytes(data)
