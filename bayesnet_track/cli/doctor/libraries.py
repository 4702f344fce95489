"""Checks of the libraries at work: each is imported and asked for what is needed, in a process of its own."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.cli.doctor.finding import Finding, Trial, judge, try_code
from bayesnet_track.cli.doctor.packages import WHEEL

NEEDED_OF_OPENCV = (
    "Canny",
    "DISOpticalFlow.create",
    "FileStorage",
    "StereoSGBM.create",
    "VideoCapture",
    "calibrateCamera",
    "connectedComponentsWithStats",
    "dft",
    "distanceTransform",
    "dnn.readNetFromONNX",
    "findChessboardCorners",
    "imdecode",
    "imencode",
    "integral",
    "pyrDown",
    "remap",
    "sepFilter2D",
    "warpAffine",
)
"""Parts of OpenCV that are used; a build of one's own may lack some."""

NEEDED_DECODERS = ("h264", "mpeg4", "mjpeg")
OFTEN_WANTED = ("hevc", "vp9", "av1")

_CV2 = """
import sys, cv2
missing = []
for name in sys.argv[1].split():
    part = cv2
    for word in name.split("."):
        part = getattr(part, word, None)
    missing += [name] if part is None else []
print(cv2.__version__)
print(" ".join(missing))
if not missing:
    import numpy
    picture = numpy.zeros((8, 8, 3), numpy.uint8)
    ok, coded = cv2.imencode(".png", picture)
    assert ok and (cv2.imdecode(coded, 1) == picture).all(), "a PNG picture is not read as it was written"
"""
_NUMBA = """
import numba, sys
print(numba.__version__)
@numba.njit(cache=False)
def total(n):
    s = 0.0
    for i in range(n):
        s += i
    return s
assert total(10) == 45.0, "a compiled sum is wrong"
"""
_AV = """
import av, sys
print(av.__version__)
print(" ".join(n for n in sys.argv[1].split() if n not in av.codecs_available))
print("libx264" in av.codecs_available, "mpeg4" in av.codecs_available)
"""


def check_numpy() -> Iterator[Finding]:
    """Numpy can be imported, and computes."""
    trial = try_code(
        "import numpy; print(numpy.__version__); assert (numpy.eye(2) @ numpy.ones(2)).sum() == 2"
    )
    yield judge("numpy", trial, f"{trial.out} computes", "python -m pip install --force-reinstall numpy")


def check_opencv() -> Iterator[Finding]:
    """OpenCV can be imported, and has the parts that are used."""
    trial = try_code(_CV2, " ".join(NEEDED_OF_OPENCV))
    if trial.error:
        yield Finding("opencv", "broken", trial.error, _cure_of_opencv(trial))
        return
    version, _, missing = trial.out.partition("\n")
    if missing.strip():
        text = f"{version} lacks {missing.strip().replace(' ', ', ')}"
        yield Finding("opencv", "broken", text, f'python -m pip install --force-reinstall "{WHEEL}>=4.9,<6"')
    else:
        yield Finding("opencv", "ok", f"{version} has all parts that are used")


def _cure_of_opencv(trial: Trial) -> str:
    reinstall = f'python -m pip install --force-reinstall "{WHEEL}>=4.9,<6"'
    if ".so" in trial.error and "cannot open shared object" in trial.error:
        return (
            "this wheel of OpenCV has windows, and the machine lacks their libraries; take the one without: "
            f"python -m pip uninstall -y opencv-python opencv-contrib-python && {reinstall}"
            "   (or: apt-get install libgl1 libglib2.0-0)"
        )
    if "_ARRAY_API" in trial.text or "multiarray" in trial.text:
        return f"OpenCV was built for another version of NumPy: {reinstall} numpy"
    return f"python -m pip uninstall -y opencv-python opencv-contrib-python {WHEEL} && {reinstall}"


def check_numba() -> Iterator[Finding]:
    """Numba can be imported, and compiles."""
    trial = try_code(_NUMBA)
    cure = "python -m pip install --upgrade --force-reinstall numba numpy"
    if "Numba needs NumPy" in trial.error:
        cure = f"{trial.error.removeprefix('ImportError: ')}: python -m pip install --upgrade numba numpy"
    yield judge("numba", trial, f"{trial.out} compiles", cure)


def check_av() -> Iterator[Finding]:
    """PyAV can be imported, and knows the usual codecs."""
    trial = try_code(_AV, " ".join((*NEEDED_DECODERS, *OFTEN_WANTED)))
    reinstall = "python -m pip install --force-reinstall --only-binary :all: av"
    if trial.error:
        yield Finding("video", "broken", f"PyAV: {trial.error}", reinstall)
        return
    version, missing, writers = (trial.out.splitlines() + ["", "", ""])[:3]
    lacking = [name for name in missing.split() if name in NEEDED_DECODERS]
    x264, mpeg4 = (writers + " ").split(" ")[:2]
    if lacking:
        yield Finding("video", "broken", f"PyAV {version} cannot read {', '.join(lacking)}", reinstall)
    elif "True" not in (x264, mpeg4):
        yield Finding("video", "broken", f"PyAV {version} can write neither H.264 nor MPEG-4", reinstall)
    elif missing.strip() or x264 != "True":
        also = [f"no {name}" for name in missing.split()] + ([] if x264 == "True" else ["no H.264 encoder"])
        yield Finding("video", "note", f"PyAV {version} has {', '.join(also)}", f"if needed: {reinstall}")
    else:
        yield Finding("video", "ok", f"PyAV {version} reads and writes the usual codecs")
