"""What numbers depend on besides graph, source and seed: libraries, their builds, instruction sets."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import version
from types import MappingProxyType

import numpy as np

from bayesnet_track.runtime.checkpoints.versions import versions

SETTINGS = ("GLIBC_TUNABLES", "OPENBLAS_CORETYPE")
"""Environment variables that choose other code for the same function, beyond those the libraries report."""


@cache
def describe_machine() -> Mapping[str, str]:
    """What is at work in this process, by name; equal ones give equal bytes.

    The instruction sets are those in use, after `NPY_DISABLE_CPU_FEATURES`, `NUMBA_CPU_NAME`,
    `OPENCV_CPU_DISABLE` and the like. The number of processors is left out: no result depends on it.
    """
    said = {
        **versions(),
        "machine": f"{platform.system()} {platform.machine()}",
        "C library": " ".join(platform.libc_ver()).strip() or "unknown",
        **_numpy(),
        **_numba(),
        **_opencv(),
        **_decoder(),
        **{name: os.environ[name] for name in SETTINGS if os.environ.get(name)},
    }
    return MappingProxyType(said)


def name_differences(then: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, ...]:
    """What differs between two descriptions, in words.

    >>> name_differences({"NumPy CPU": "SSE2 AVX2"}, {"NumPy CPU": "SSE2"})
    ('NumPy CPU: without AVX2',)
    """
    names = dict.fromkeys((*then, *now))
    return tuple(
        _difference(name, then.get(name), now.get(name)) for name in names if then.get(name) != now.get(name)
    )


def _difference(name: str, then: str | None, now: str | None) -> str:
    before, after = (then or "").split(), (now or "").split()
    if not name.endswith("CPU") or not (before and after):
        return f"{name} {then or 'none'}, now {now or 'none'}"
    without = [word for word in before if word not in after]
    more = [word for word in after if word not in before]
    parts = [f"{word} {' '.join(words)}" for word, words in (("without", without), ("with", more)) if words]
    return f"{name}: {', '.join(parts)}"


def _numpy() -> dict[str, str]:
    # NumPy shows them in `numpy.show_runtime()` only, which prints.
    core = "numpy.core" if np.__version__.startswith("1.") else "numpy._core"
    umath = import_module(f"{core}._multiarray_umath")
    found: Mapping[str, bool] = umath.__cpu_features__
    chosen = [*umath.__cpu_baseline__, *umath.__cpu_dispatch__]
    return {"NumPy CPU": " ".join(name for name in chosen if found.get(name)) or "baseline"}


def _numba() -> dict[str, str]:
    from numba.core import config
    from numba.core.registry import cpu_target

    if config.DISABLE_JIT:
        return {"Numba": "not compiled"}
    # The key under which Numba stores compiled kernels.
    triple, name, features = cpu_target.target_context.codegen().magic_tuple()
    used = sorted(part[1:] for part in features.split(",") if part.startswith("+"))
    return {
        "llvmlite": version("llvmlite"),
        "Numba target": f"{triple} {name}",
        "Numba CPU": " ".join(used) or "baseline",
    }


def _opencv() -> dict[str, str]:
    import cv2

    build = hashlib.sha256(cv2.getBuildInformation().encode()).hexdigest()[:12]
    # A star marks what is chosen at run time, a question mark what is not there or switched off.
    used = [word.lstrip("*") for word in cv2.getCPUFeaturesLine().split() if not word.endswith("?")]
    ipp = getattr(cv2, "ipp", None)
    return {
        "OpenCV build": build,
        "OpenCV CPU": " ".join(used) if cv2.useOptimized() else "baseline",
        "OpenCV IPP": ipp.getIppVersion() if ipp is not None and ipp.useIPP() else "none",
    }


def _decoder() -> dict[str, str]:
    import av

    names = ("libavcodec", "libavformat", "libswscale")
    return {"FFmpeg": " ".join(f"{n} {'.'.join(map(str, av.library_versions[n]))}" for n in names)}
