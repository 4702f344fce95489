"""Versions of what touches numbers: equal ones are needed for equal bytes."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version
from platform import python_version

_installed = cache(version)  # it searches and parses files: 8 ms for all of them, at each start of a run


def versions() -> dict[str, str]:
    """Library -> its version here."""
    import cv2

    names = ("bayesnet-track", "numpy", "numba", "scipy", "av")
    return {
        "python": python_version(),
        **{name: _installed(name) for name in names},
        "opencv": cv2.__version__,
        **_if_installed("onnxruntime"),
    }


@cache
def _if_installed(name: str) -> dict[str, str]:
    try:
        return {name: version(name)}
    except PackageNotFoundError:
        return {}
