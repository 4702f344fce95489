"""Origins of numbers besides graph, source and seed: libraries, machine, files from outside."""

from __future__ import annotations

import hashlib
import os
import platform
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from errno import EINVAL
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from os import PathLike
from pathlib import Path
from platform import python_version
from types import MappingProxyType

import numpy as np

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.cues import cue_parameters, plugin_parameters
from bayesnet_track.journal.writer import read_position
from bayesnet_track.observation.detector import detectors_of_graphs
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.origin import changed_since, stamps
from bayesnet_track.sources.paths import SourceError

_installed = cache(version)  # it searches and parses files: 8 ms for all of them, at each start of a run


def versions() -> dict[str, str]:
    """Library -> its version here."""
    import cv2

    names = ("bayesnet-track", "numpy", "numba", "scipy", "av")
    return {
        "python": python_version(),
        **{name: _installed(name) for name in names},
        "opencv": cv2.__version__,
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
        **_if_installed("onnxruntime"),
    }


@cache
def _if_installed(name: str) -> dict[str, str]:
    try:
        return {name: version(name)}
    except PackageNotFoundError:
        return {}


SETTINGS = ("GLIBC_TUNABLES", "OPENBLAS_CORETYPE")
"""Environment variables that choose other code for the same function, beyond those the libraries report."""


@cache
def describe_machine() -> Mapping[str, str]:
    """Libraries and instruction sets of this process, by name; equal ones give equal bytes.

    The instruction sets are those in use, after `NPY_DISABLE_CPU_FEATURES`, `NUMBA_CPU_NAME`,
    `OPENCV_CPU_DISABLE` and the like. The number of processors is left out: no result depends on it.
    """
    entries = {
        **versions(),
        "machine": f"{platform.system()} {platform.machine()}",
        "C library": " ".join(platform.libc_ver()).strip() or "unknown",
        **_numpy(),
        **_numba(),
        **_opencv(),
        **_decoder(),
        **{name: os.environ[name] for name in SETTINGS if os.environ.get(name)},
    }
    return MappingProxyType(entries)


def _numpy() -> dict[str, str]:
    # NumPy shows them in `numpy.show_runtime()` only, which prints.
    core = "numpy.core" if np.__version__.startswith("1.") else "numpy._core"
    umath = import_module(f"{core}._multiarray_umath")
    features: Mapping[str, bool] = umath.__cpu_features__
    names = [*umath.__cpu_baseline__, *umath.__cpu_dispatch__]
    return {"NumPy CPU": " ".join(name for name in names if features.get(name)) or "baseline"}


def _numba() -> dict[str, str]:
    from numba.core import config
    from numba.core.registry import cpu_target

    if config.DISABLE_JIT:
        return {"Numba": "not compiled"}
    # The key under which Numba stores compiled kernels.
    triple, name, features = cpu_target.target_context.codegen().magic_tuple()
    features_on = sorted(part[1:] for part in features.split(",") if part.startswith("+"))
    return {
        "llvmlite": version("llvmlite"),
        "Numba target": f"{triple} {name}",
        "Numba CPU": " ".join(features_on) or "baseline",
    }


def _opencv() -> dict[str, str]:
    import cv2

    build = hashlib.sha256(cv2.getBuildInformation().encode()).hexdigest()[:12]
    # A star marks what is chosen at run time, a question mark what is not there or switched off.
    features = [word.lstrip("*") for word in cv2.getCPUFeaturesLine().split() if not word.endswith("?")]
    ipp = getattr(cv2, "ipp", None)
    return {
        "OpenCV build": build,
        "OpenCV CPU": " ".join(features) if cv2.useOptimized() else "baseline",
        "OpenCV IPP": ipp.getIppVersion() if ipp is not None and ipp.useIPP() else "none",
    }


def _decoder() -> dict[str, str]:
    import av

    names = ("libavcodec", "libavformat", "libswscale")
    return {"FFmpeg": " ".join(f"{n} {'.'.join(map(str, av.library_versions[n]))}" for n in names)}


def name_differences(earlier: Mapping[str, str], current: Mapping[str, str]) -> tuple[str, ...]:
    """Differences between two descriptions, in words.

    >>> name_differences({"NumPy CPU": "SSE2 AVX2"}, {"NumPy CPU": "SSE2"})
    ('NumPy CPU: without AVX2',)
    >>> name_differences({"zlib": "1.2"}, {"zlib": "1.3"}), name_differences({}, {"zlib": "1.3"})
    (('zlib 1.2, now 1.3',), ())
    """
    names = dict.fromkeys((*earlier, *current))
    if "zlib" not in earlier:
        names.pop("zlib", None)  # earlier runs did not record it
    return tuple(
        _difference(name, earlier.get(name), current.get(name))
        for name in names
        if earlier.get(name) != current.get(name)
    )


def _difference(name: str, earlier: str | None, current: str | None) -> str:
    old_words, new_words = (earlier or "").split(), (current or "").split()
    if not name.endswith("CPU") or not (old_words and new_words):
        return f"{name} {earlier or 'none'}, now {current or 'none'}"
    without = [word for word in old_words if word not in new_words]
    added = [word for word in new_words if word not in old_words]
    parts = [f"{word} {' '.join(words)}" for word, words in (("without", without), ("with", added)) if words]
    return f"{name}: {', '.join(parts)}"


AGAIN = "start again once nothing writes it"


@dataclass(frozen=True)
class GivenFile:
    """A file from outside: its path as given and from the root, and its content."""

    path: str
    absolute: str
    sha256: str

    @property
    def place(self) -> Path:
        """The present place: where it was, or as given if that is gone."""
        return Path(self.absolute) if Path(self.absolute).exists() else Path(self.path)

    def changes(self) -> tuple[str, ...]:
        """Changes of the file since then, in words; raises OSError when it cannot be read."""
        if not self.place.is_file():  # a device or a pipe might never end
            raise OSError(EINVAL, "not a plain file", str(self.place))
        sha256 = file_sha256(self.place)
        return () if sha256 == self.sha256 else (f"{self.path}: {self.sha256[:12]}, now {sha256[:12]}",)


def model_files(graph: CheckedGraph) -> list[str]:
    """Files that the agents and detectors of a graph read, by their paths as it has them."""
    paths: set[str] = set()
    cues = graph.declarations
    for plate in graph.targets.values():
        for _, _, choice in plate.spec.cue_choices():
            files = cues[choice.cue].files
            paths |= set(() if files is None else files(cue_parameters(choice, cues[choice.cue])))
        birth = plate.spec.birth
        if birth is not None:
            declaration = detectors_of_graphs([birth.detector.detector])[birth.detector.detector]
            if declaration.files is not None:
                paths |= set(declaration.files(plugin_parameters(birth.detector, declaration.parameters)))
    return sorted(paths | {source.file for source in graph.spec.inputs.values()})


@contextmanager
def steady(paths: Iterable[str | PathLike[str] | None]) -> Iterator[Callable[[], None]]:
    """Files that are read whole before the first frame; gives what to call once that is done.

    Raises:
        SourceError: when that is called, if a file changed since: what was read may not be what it holds.
    """
    old_stamps = stamps(Path(path) for path in paths if path is not None)

    def check() -> None:
        changes = changed_since(old_stamps)
        if changes:
            raise SourceError(few(changes), "changed while it was read", "files that stay as they are", AGAIN)

    yield check
    changes = changed_since(old_stamps)
    if changes:
        notice(
            f"{few(changes)}: changed during the run, which used what it held at the start; run.json has the "
            "SHA-256 of that"
        )


def file_sha256(path: str | PathLike[str]) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal.

    Raises:
        OSError: it cannot be read.
    """
    return read_position(Path(path)).sha256
