"""Versions of what touches numbers: equal ones are needed for equal bytes."""

from __future__ import annotations

from importlib.metadata import version
from platform import python_version


def versions() -> dict[str, str]:
    """Library -> its version here."""
    import cv2

    names = ("bayesnet-track", "numpy", "numba", "scipy", "av")
    return {"python": python_version(), **{name: version(name) for name in names}, "opencv": cv2.__version__}
