"""An executor by its name, and an engine ready to be run by it, with one thread inside each agent."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from bayesnet_track.engine.step import Engine
from bayesnet_track.observation.cue import CueDeclaration
from bayesnet_track.runtime.executors.placing import Place, agent_specs, places_of, with_proxies
from bayesnet_track.runtime.executors.processes import PlacingError, Processes
from bayesnet_track.runtime.executors.workers import Limits, NoWorkerError
from bayesnet_track.runtime.stop import has_workers, no_workers

NAMES = ("scipy_openblas_{}64_", "scipy_openblas_{}", "openblas_{}64_", "openblas_{}")


@contextmanager
def one_thread_inside(opencv: bool) -> Iterator[None]:
    """While entered, NumPy's matrix products use one thread each, and so do, with `opencv`, its functions.

    The last bits of a matrix product depend on the number of its threads. Workers have one, and so the engine
    must, for the same bytes; none of OpenCV's functions that are used here depends on it.
    """
    import cv2

    blas = _blas()
    before = cv2.getNumThreads(), [get() for get, _ in blas]
    if opencv:
        cv2.setNumThreads(1)
    for _, set_threads in blas:
        set_threads(1)
    try:
        yield
    finally:
        if opencv:
            cv2.setNumThreads(before[0])
        for (_, set_threads), threads in zip(blas, before[1], strict=True):
            set_threads(threads)


@cache
def _blas() -> list[tuple[Any, Any]]:
    """Functions that get and set the number of threads of each OpenBLAS in the wheels of NumPy and SciPy."""
    site = Path(np.__file__).parent.parent
    found = []
    for package in ("numpy", "scipy"):
        if package not in sys.modules:
            continue
        for file in sorted((site / f"{package}.libs").glob("*openblas*")):
            try:
                library = ctypes.CDLL(str(file))
            except OSError:
                continue
            for name in NAMES:
                get = getattr(library, name.format("get_num_threads"), None)
                set_threads = getattr(library, name.format("set_num_threads"), None)
                if get is not None and set_threads is not None:
                    found.append((get, set_threads))
                    break
    return found


NO_PLACES: Mapping[str, Place] = MappingProxyType({})
RETRIES = 2
"""How often an agent whose worker was lost is asked again, where frames wait for it."""


class Executing:
    """An executor for a run: entered it is ready, left it has nothing running any more.

    Attributes:
        kind: its name.
        workers: processes at work at a time.
        processes: the worker processes, when the engine has agents in some.
    """

    def __init__(
        self,
        kind: str,
        workers: int,
        default: Place,
        places: Mapping[str, Place],
        limits: Limits,
        retries: int | None,
        cues: Mapping[str, CueDeclaration] | None,
    ) -> None:
        self.kind, self.workers = kind, workers
        self.processes: Processes | None = None
        self._default, self._places, self._limits = default, places, limits
        self._retries, self._cues = retries, cues
        self._open = ExitStack()

    def __enter__(self) -> Self:
        self._open.enter_context(one_thread_inside(opencv=not self._is_serial))
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        """Raises PlacingError where no worker could be started while it was entered."""
        self._open.close()
        if isinstance(error, NoWorkerError):
            raise PlacingError(str(error)) from error

    @property
    def _is_serial(self) -> bool:
        return self.kind == "serial"

    def engine(self, engine: Engine, retries: int = RETRIES) -> Engine:
        """`engine` with its agents placed, to be run while this is entered; once.

        `retries` holds where the executor was made without a number of its own.

        Raises:
            PlacingError: an agent cannot be where it was put.
        """
        places = places_of(engine, self._default, self._places, self._cues)
        specs = agent_specs(engine, places, self._cues)
        if specs:
            if not has_workers():
                raise PlacingError(no_workers())
            again = retries if self._retries is None else self._retries
            transport = self.processes = Processes(specs, self.workers, self._limits, again)
            self._open.callback(transport.close)
            engine = with_proxies(engine, places, transport)
        return engine


EXECUTORS: Mapping[str, Place] = MappingProxyType({"serial": "engine", "processes": "process"})
"""Name of an executor -> where agents work that are put nowhere."""


def make_executor(
    kind: str = "serial",
    *,
    workers: int | None = None,
    places: Mapping[str, Place] = NO_PLACES,
    limits: Limits = Limits(),  # noqa: B008  (immutable)
    retries: int | None = None,
    cues: Mapping[str, CueDeclaration] | None = None,
) -> Executing:
    """An executor by name, a context manager::

        with make_executor("processes", workers=2) as executor:
            engine = executor.engine(make_engine(graph))

    Args:
        kind: serial or processes.
        workers: processes at work at a time; as many as the machine has processors when None.
        places: AGENT or PLATE.AGENT -> "engine" or "process", before what the graph says with `on`.
        limits: what a worker process may take.
        retries: how often an agent whose worker was lost is asked again. None for 2, or 0 where frames do
            not wait for it: those of a camera, or with a budget.
        cues: declarations by name, where not the installed ones.

    Raises:
        ValueError: there is no such executor, or `workers` is less than 1.
    """
    if kind not in EXECUTORS:
        raise ValueError(f"executor {kind!r}; there are {', '.join(EXECUTORS)}")
    number = os.cpu_count() or 1 if workers is None else workers
    if number < 1:
        raise ValueError(f"{number} workers: at least 1 is needed")
    return Executing(kind, number, EXECUTORS[kind], places, limits, retries, cues)
