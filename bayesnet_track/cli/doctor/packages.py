"""Checks of what is installed: this package, the versions of the others, and OpenCV's wheels."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any
from urllib.parse import urlparse
from urllib.request import url2pathname

from bayesnet_track.cli.doctor.finding import Finding

OURS = "bayesnet-track"
WHEEL = "opencv-python-headless"
OPENCV_WHEELS = (WHEEL, "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python")
EXTRAS = {
    "matplotlib": ("figures and plots", "figures"),
    "rerun-sdk": ("the viewer Rerun", "rerun"),
    "ray": ("batches on a cluster", "ray"),
    "h5netcdf": ("files for ArviZ", "arviz"),
    "onnxruntime": ("Siamese networks in less time", "onnx"),
}


def installed(name: str) -> Distribution | None:
    """The installed distribution of that name; what a build left in a checkout is none."""
    there = (found for found in distributions(name=name) if found.read_text("SOURCES.txt") is None)
    return next((found for found in there if "Version" in found.metadata), None)


def check_python() -> Iterator[Finding]:
    """The interpreter, and whether it is one of an environment of its own."""
    version = platform.python_version()
    where = "an environment of its own" if sys.prefix != sys.base_prefix else "the system's Python"
    text = f"{version} on {platform.system()} {platform.machine()}, {where}"
    if sys.maxsize < 2**32:
        yield Finding("python", "broken", f"{text}, 32 bits", "install a 64-bit Python")
    else:
        yield Finding("python", "ok", text)


def check_system() -> Iterator[Finding]:
    """Whether this system is the tested one, and what is missing on it."""
    from bayesnet_track.runtime import system

    missing = system.describe_missing()
    if missing:
        yield Finding("system", "note", missing, "please report what else does not work")
    else:
        yield Finding("system", "ok", f"{' '.join(system.TESTED)}, which is tested")


def check_this_package() -> Iterator[Finding]:
    """Whether the code that runs is the code that is installed."""
    here = Path(__file__).resolve().parents[2]
    metadata = installed(OURS)
    again = f"python -m pip install -e {here.parent}"
    if metadata is None:
        text = f"runs from {here}, and is not installed: cues, detectors and graphs are not found"
        yield Finding("package", "broken", text, f"{again}   (or run an installed one elsewhere)")
        return
    home = _home(metadata)
    if home is not None and home != here:
        text = f"runs from {here}, which shadows the installed {metadata.version} in {home}"
        cure = f"start it in another folder, or install what lies here: {again}"
        yield Finding("package", "broken", text, cure)
    else:
        yield Finding("package", "ok", f"{OURS} {metadata.version} in {here}")


def _home(metadata: Distribution) -> Path | None:
    """The folder of the installed package; None where it cannot be told."""
    text = metadata.read_text("direct_url.json")
    origin: dict[str, Any] = json.loads(text) if text else {}
    if origin.get("dir_info", {}).get("editable"):
        return (Path(url2pathname(urlparse(origin["url"]).path)) / "bayesnet_track").resolve()
    beside = Path(str(metadata.locate_file("bayesnet_track"))).resolve()
    return beside if (beside / "__init__.py").exists() else None


def check_versions() -> Iterator[Finding]:
    """Every package that is needed, and that those need, within its range."""
    try:
        from packaging.requirements import InvalidRequirement, Requirement
    except ImportError:
        yield Finding("versions", "broken", "packaging is missing", "python -m pip install packaging")
        return
    metadata = installed(OURS)
    needed = [Requirement(text) for text in (metadata.requires if metadata else None) or ()]
    needed = [one for one in needed if one.marker is None or one.marker.evaluate({"extra": ""})]
    wrong, fine = [], []
    for requirement in needed:
        found = _of_requirement(requirement.name)
        if found is None:
            wrong.append((f"{requirement.name} is missing", str(requirement)))
            continue
        fine.append(f"{found.name} {found.version}")
        if not requirement.specifier.contains(found.version, prereleases=True):
            cure = str(requirement)
            wrong.append((f"{found.name} {found.version} is not {requirement.specifier}", cure))
        for text in found.requires or ():
            try:
                inner = Requirement(text)
            except InvalidRequirement:
                continue
            if inner.marker is not None and not inner.marker.evaluate({"extra": ""}):
                continue
            other = _of_requirement(inner.name)
            if other is not None and not inner.specifier.contains(other.version, prereleases=True):
                summary = (
                    f"{found.name} {found.version} needs {inner.name}{inner.specifier}, not {other.version}"
                )
                wrong.append((summary, f"{inner.name}{inner.specifier}"))
    for text, requirement_text in dict(wrong).items():
        yield Finding("versions", "broken", text, f'python -m pip install "{requirement_text}"')
    if not wrong:
        yield Finding("versions", "ok" if fine else "note", ", ".join(fine) or "not told: no metadata")


def _of_requirement(name: str) -> Distribution | None:
    """What is installed under the name; any wheel of OpenCV stands for the one that is asked for."""
    names = OPENCV_WHEELS if name == WHEEL else (name,)
    return next((found for found in map(installed, names) if found is not None), None)


def check_wheels() -> Iterator[Finding]:
    """One wheel of OpenCV: several write the same files."""
    there = [found for found in map(installed, OPENCV_WHEELS) if found is not None]
    summary = " and ".join(f"{found.name} {found.version}" for found in there)
    names = " ".join(found.name for found in there)
    keep = "opencv-contrib-python-headless" if any("contrib" in found.name for found in there) else WHEEL
    if len(there) > 1:
        cure = f'python -m pip uninstall -y {names} && python -m pip install "{keep}>=4.9,<6"'
        yield Finding("opencv wheels", "broken", f"{summary}: each overwrites files of the other", cure)
    elif there and there[0].name == WHEEL:
        yield Finding("opencv wheels", "ok", summary)
    elif there:
        text = f"{summary} instead of {WHEEL}: fine alone, and `pip` will want to add the other"
        yield Finding("opencv wheels", "note", text)
    else:
        text = "no wheel of OpenCV is known to pip (fine if conda or the system brought it)"
        yield Finding("opencv wheels", "note", text, f"if cv2 is missing: python -m pip install {WHEEL}")


def check_extras() -> Iterator[Finding]:
    """What can be done without, and what it is for."""
    for name, (purpose, extra) in EXTRAS.items():
        found = installed(name)
        if found is None:
            cure = f'if wanted: python -m pip install "{OURS}[{extra}]"'
            yield Finding("extra", "note", f"{name} is not installed: {purpose}", cure)
        else:
            yield Finding("extra", "ok", f"{name} {found.version}: {purpose}")
