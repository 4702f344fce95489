"""The command `doctor`: versions, and ten frames through the program's own path, each with its cure.

Nothing here imports a library that may be broken: each is tried in a process of its own.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from importlib.metadata import Distribution

OURS = "bayesnet-track"
WHEEL = "opencv-python-headless"
OPENCV_WHEELS = (WHEEL, "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python")
LIBRARIES = {"numpy": "numpy", "cv2": f'"{WHEEL}>=4.9,<6"', "numba": "numba numpy", "av": "av"}
"""Module -> what pip has to install again where it cannot be imported."""
EXTRAS = {
    "matplotlib": ("figures and plots", "figures"),
    "rerun-sdk": ("the viewer Rerun", "rerun"),
    "ray": ("batches on a cluster", "ray"),
    "h5netcdf": ("files for ArviZ", "arviz"),
    "onnxruntime": ("Siamese networks in less time", "onnx"),
}
MARKS = {"ok": "ok     ", "note": "note   ", "broken": "BROKEN "}
REPORT = "mend what is above; else please report this with the lines above"

_TRACK = """
import itertools, tempfile
from pathlib import Path
from bayesnet_track import Start, open_run, track
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.runtime.recording.videowriter import VideoWriter
from bayesnet_track.runtime.stop import has_workers
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.sources import open_source
def play(video, start, out, executor):
    with open_source(str(video)) as source:
        run = track("two_squares", source, [Start(start, plate="square")], seed=0, out=out, executor=executor)
        boxes = [result.targets[0].centre_box for result in run]
    assert len(open_run(out).metrics) == len(boxes) == 10, f"{len(boxes)} of 10 frames came back"
    return boxes
if __name__ == "__main__":
    scene = make_scene("two_squares", 0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with VideoWriter(folder / "short.mp4", 320, 240, 1 / 25) as video:
            for image in itertools.islice(scene.frames, 10):
                video.write(image)
        ways = ["serial", "processes" if has_workers() else "serial"]
        video, start = folder / "short.mp4", scene.start_box
        first, again = (play(video, start, folder / f"run{n}", way) for n, way in enumerate(ways))
    share = float(overlap([first[-1]], centre_from_corner(scene.truth[9:10]))[0])
    assert first == again, "the same seed gives other boxes with agents in a process of their own"
    assert share > 0.5, f"the target is lost: overlap {share:.2f}"
    print(f"written as MP4, read, tracked and recorded, the same in a worker process; overlap {share:.2f}")
"""
_LOAD = """
import sys
from importlib.metadata import entry_points
for group in sys.argv[1:]:
    for point in entry_points(group=group):
        if point.dist is not None and point.dist.name.lower().replace("_", "-") == "bayesnet-track":
            assert point.load().name, point.name
"""
_MODELS = """
import json
from pathlib import Path
from bayesnet_track.vision.model_files import NANOTRACK, VARIABLE, find_model, model_folders
folders = model_folders()
files = {str(f.resolve()): sorted(path.name for path in f.glob("*.onnx")) for f in folders if f.is_dir()}
missing = [name for name in NANOTRACK if not Path(find_model(name)).is_file()]
print(json.dumps({
    "folders": [str(folder.resolve()) for folder in folders], "files": {f: n for f, n in files.items() if n},
    "usual": NANOTRACK, "missing": missing, "variable": VARIABLE,
}))
"""
GROUPS = ("bayesnet_track.cues", "bayesnet_track.detectors")


@dataclass(frozen=True)
class CheckResult:
    """The result of a check.

    Attributes:
        check: the part of the installation.
        level: `ok`, `note` (works, but worth knowing) or `broken`.
        text: the facts.
        cure: a command or advice; empty if nothing needs to be done.
    """

    check: str
    level: Literal["ok", "note", "broken"]
    text: str
    cure: str = ""


def try_code(code: str, *arguments: str, timeout_s: float = 300.0) -> tuple[str, str]:
    """Output and error of `code` in a process of its own: a crash or a hang there leaves this one alone.

    The error is the last line that the process complained of; empty if it ended well.
    """
    import subprocess
    import tempfile

    path = os.pathsep.join(folder for folder in sys.path if folder)  # the same package is found there
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8", "PYTHONPATH": path}
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "trial.py"  # a file: worker processes may import it again
        script.write_text(code, encoding="utf-8")
        try:
            process = subprocess.run(
                [sys.executable, str(script), *arguments],
                capture_output=True,
                timeout=timeout_s,
                env=environment,
                stdin=subprocess.DEVNULL,
            )
        except subprocess.TimeoutExpired:
            return "", f"no answer within {timeout_s:.0f} s"
        except OSError as error:
            return "", str(error)
    complaint = (process.stderr.decode("utf-8", "replace").strip().splitlines() or [""])[-1]
    if process.returncode < 0:
        complaint = f"the process died of signal {-process.returncode} {complaint}".strip()
    output = process.stdout.decode("utf-8", "replace").strip()
    return output, "" if process.returncode == 0 else complaint or f"exit code {process.returncode}"


def _installed(name: str) -> Distribution | None:
    """The installed distribution of that name; a build in a checkout is none."""
    from importlib.metadata import distributions

    candidates = (
        distribution
        for distribution in distributions(name=name)
        if distribution.read_text("SOURCES.txt") is None
    )
    return next((distribution for distribution in candidates if "Version" in distribution.metadata), None)


def check_system() -> Iterator[CheckResult]:
    """The interpreter and the operating system."""
    import platform

    from bayesnet_track.runtime import stop

    text = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    if sys.maxsize < 2**32:
        yield CheckResult("python", "broken", f"{text}, 32 bits", "install a 64-bit Python")
    elif missing := stop.describe_missing():
        yield CheckResult("python", "note", f"{text}: {missing}", "please report what else does not work")
    else:
        yield CheckResult("python", "ok", text)


def check_package() -> Iterator[CheckResult]:
    """The code that runs is the code that is installed."""
    import json
    from urllib.parse import urlparse
    from urllib.request import url2pathname

    package = Path(__file__).resolve().parents[1]
    metadata = _installed(OURS)
    install = f"python -m pip install -e {package.parent}"
    if metadata is None:
        text = f"runs from {package}, and is not installed: cues, detectors and graphs are not found"
        yield CheckResult("package", "broken", text, f"{install}   (or run an installed one elsewhere)")
        return
    origin: dict[str, Any] = json.loads(metadata.read_text("direct_url.json") or "{}")
    home = Path(str(metadata.locate_file("bayesnet_track"))).resolve()
    if origin.get("dir_info", {}).get("editable"):
        home = (Path(url2pathname(urlparse(origin["url"]).path)) / "bayesnet_track").resolve()
    if home != package and (home / "__init__.py").exists():
        text = f"runs from {package}, which shadows the installed {metadata.version} in {home}"
        cure = f"start it in another folder, or install this one: {install}"
        yield CheckResult("package", "broken", text, cure)
    else:
        yield CheckResult("package", "ok", f"{OURS} {metadata.version} in {package}")


def check_versions() -> Iterator[CheckResult]:
    """Every package that is needed within its range, those that it needs, and a single wheel of OpenCV."""
    try:
        from packaging.requirements import Requirement
    except ImportError:
        yield CheckResult("versions", "broken", "packaging is missing", "python -m pip install packaging")
        return
    wrong: dict[str, str] = {}
    fine = []
    for needed in map(Requirement, _requires(_installed(OURS))):
        distribution = _of(needed.name)
        if distribution is None:
            wrong[f"{needed.name} is missing"] = str(needed)
            continue
        fine.append(f"{distribution.name} {distribution.version}")
        if not needed.specifier.contains(distribution.version, prereleases=True):
            wrong[f"{distribution.name} {distribution.version} is not {needed.specifier}"] = str(needed)
        for inner in map(Requirement, _requires(distribution)):
            dependency = _of(inner.name)
            if dependency is not None and not inner.specifier.contains(dependency.version, prereleases=True):
                need = f"{inner.name}{inner.specifier}"
                wrong[
                    f"{distribution.name} {distribution.version} needs {need}, not {dependency.version}"
                ] = need
    for text, requirement in wrong.items():
        yield CheckResult("versions", "broken", text, f'python -m pip install "{requirement}"')
    if not wrong:
        yield CheckResult("versions", "ok" if fine else "note", ", ".join(fine) or "unknown: no metadata")
    wheels = [distribution for distribution in map(_installed, OPENCV_WHEELS) if distribution is not None]
    if len(wheels) > 1:
        names = " ".join(distribution.name for distribution in wheels)
        wheel = "opencv-contrib-python-headless" if "contrib" in names else WHEEL
        text = " and ".join(f"{distribution.name} {distribution.version}" for distribution in wheels)
        text += ": each overwrites files of the other"
        cure = f'python -m pip uninstall -y {names} && python -m pip install "{wheel}>=4.9,<6"'
        yield CheckResult("opencv wheels", "broken", text, cure)


def _requires(distribution: Distribution | None) -> Iterator[str]:
    """The requirements of a distribution that hold here, without extras."""
    from packaging.requirements import InvalidRequirement, Requirement

    for text in (None if distribution is None else distribution.requires) or ():
        try:
            marker = Requirement(text).marker
        except InvalidRequirement:
            continue
        if marker is None or marker.evaluate({"extra": ""}):
            yield text


def _of(name: str) -> Distribution | None:
    """The distribution under the name; any wheel of OpenCV stands for the one that is required."""
    names = OPENCV_WHEELS if name == WHEEL else (name,)
    return next((distribution for distribution in map(_installed, names) if distribution is not None), None)


def check_libraries() -> Iterator[CheckResult]:
    """Each library can be imported."""
    for module, packages in LIBRARIES.items():
        version, error = try_code(f"import {module}; print({module}.__version__)")
        cure = f"python -m pip install --force-reinstall {packages}"
        if "cannot open shared object" in error and module == "cv2":
            cure = "python -m pip uninstall -y opencv-python opencv-contrib-python && " + cure
        yield CheckResult(module, "broken", error, cure) if error else CheckResult(module, "ok", version)


def check_plugins() -> Iterator[CheckResult]:
    """Every cue and detector of this package can be loaded; those of other packages are only looked for."""
    from importlib.metadata import entry_points
    from importlib.util import find_spec

    _, error = try_code(_LOAD, *GROUPS)
    points = [point for group in GROUPS for point in entry_points(group=group)]
    if error or not points:
        yield CheckResult("plug-ins", "broken", error or "no cues are declared", "mend what is above first")
    else:
        yield CheckResult("plug-ins", "ok", f"{len(points)} cues and detectors")
    for point in points:
        module = point.module.partition(".")[0]
        if find_spec(module) is None:  # finds the package without running it
            package = "a package" if point.dist is None else point.dist.name
            text = f"{package} declares {point.name!r}, and {module} is not there"
            yield CheckResult("plug-ins", "broken", text, f"reinstall or uninstall {package}")


def check_tracking() -> Iterator[CheckResult]:
    """Ten frames by the program's own path: written as MP4, read, tracked, recorded, also in a worker."""
    output, error = try_code(_TRACK)
    yield (
        CheckResult("ten frames", "broken", error, REPORT)
        if error
        else CheckResult("ten frames", "ok", output)
    )


def check_extras() -> Iterator[CheckResult]:
    """Optional packages, and their purpose."""
    for name, (purpose, extra) in EXTRAS.items():
        distribution = _installed(name)
        if distribution is None:
            cure = f'if wanted: python -m pip install "{OURS}[{extra}]"'
            yield CheckResult("extra", "note", f"{name} is not installed: {purpose}", cure)
        else:
            yield CheckResult("extra", "ok", f"{name} {distribution.version}: {purpose}")


def check_models() -> Iterator[CheckResult]:
    """Files of networks in the folders of models, and whether the graph `deep` finds its own."""
    import json

    output, error = try_code(_MODELS)
    if error:
        yield CheckResult("models", "broken", error, "mend what is above first")
        return
    report = json.loads(output)
    expected, folders = " and ".join(report["usual"]), " or ".join(report["folders"])
    if report["missing"]:
        cure = f"if wanted: put {expected} there, or name their folder in the variable {report['variable']}"
        yield CheckResult(
            "models", "note", f"the graph deep finds no {report['missing'][0]} in {folders}", cure
        )
    for folder, names in report["files"].items():
        yield CheckResult("models", "ok", f"{folder}: {', '.join(names)}")


CHECKS: tuple[Callable[[], Iterator[CheckResult]], ...] = (
    check_system,
    check_package,
    check_versions,
    check_libraries,
    check_plugins,
    check_extras,
    check_models,
    check_tracking,
)


def examine() -> Iterator[CheckResult]:
    """The findings of all checks; a check that fails itself is a finding, too."""
    for check in CHECKS:
        try:
            yield from check()
        except Exception as error:
            name = check.__name__.removeprefix("check_")
            yield CheckResult(name, "broken", f"cannot be checked: {type(error).__name__}: {error}", REPORT)


def doctor(options: argparse.Namespace) -> int:
    """Check the installation; exit code 1 when something is broken."""
    findings = []
    for finding in examine():
        findings.append(finding)
        if not options.json:
            cure = f"{'':21}→ {finding.cure}\n" if finding.cure else ""
            sys.stdout.write(f"{MARKS[finding.level]}{finding.check:13} {finding.text}\n{cure}")
            sys.stdout.flush()
    broken = sum(finding.level == "broken" for finding in findings)
    if options.json:
        import json

        text = json.dumps([asdict(finding) for finding in findings], indent=2, ensure_ascii=False)
    else:
        counted = "1 thing is broken" if broken == 1 else f"{broken} things are broken"
        text = f"{counted}: begin with the first one" if broken else "everything works"
    sys.stdout.write(text + "\n")
    return 1 if broken else 0


def add_doctor(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "doctor",
        help="check the installation, and print how to repair it",
        description="Check the installation: versions, OpenCV's wheels, plug-ins, and ten frames through the "
        "program's own path. The exit code is 1 when something is broken. If the command "
        "itself is missing: python -m bayesnet_track doctor",
    )
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
