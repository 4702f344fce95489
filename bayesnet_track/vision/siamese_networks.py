"""A Siamese tracking network as two ONNX files, tried in a process of their own, then run.

The files are those that OpenCV's `TrackerNano` takes (NanoTrack). The backbone describes a crop; the head
compares the descriptions of template and search crop, and gives for each cell of a square map how probable it
is that the target covers it, and how far the four sides of the target's box are from it.

OpenCV and ONNX Runtime read such files in C++, where a changed byte can end the process. What was loaded and
run once elsewhere without that is loaded here. It is tried once for the same bytes, settings and libraries:
that it went well is kept beside the compiled kernels, where a folder for that can be written.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Protocol

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Floats, Singles
from bayesnet_track.observation.child import cut, python, tie
from bayesnet_track.observation.cue import CueError

Runtime = Literal["opencv", "onnxruntime"]

DECLARED = 2 * bytes.fromhex("0a0308ff01")
"""How a model of ONNX declares the height and width of 255 px: two dimensions with a value ..."""
NAMED = 2 * bytes.fromhex("0a03120173")
"""... and two that have a name instead: any size then fits."""


class HalfError(Exception):
    """A half that cannot be read or run; the runtime's words."""


class Half(Protocol):
    """One half at work."""

    def __call__(self, inputs: Mapping[str, Singles], outputs: Sequence[str] = ()) -> list[Singles]:
        """The outputs of these names, float32; "" is the only input, and without names the only output.

        Raises:
            HalfError: it does not run on such inputs.
        """


def run_by_opencv(model: bytes) -> Half:
    """A half that OpenCV runs; raises HalfError."""
    import cv2

    try:
        network = cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8))
    except cv2.error as error:
        raise HalfError(f"OpenCV cannot read it as an ONNX model: {reason_of(error)}") from error

    def run(inputs: Mapping[str, Singles], outputs: Sequence[str] = ()) -> list[Singles]:
        try:
            for name, values in inputs.items():
                network.setInput(values, name)
            results: Any = network.forward(outputs) if outputs else [network.forward()]
        except cv2.error as error:
            raise HalfError(reason_of(error)) from error
        return [np.array(result, np.float32) for result in results]

    return run


def run_by_onnxruntime(model: bytes) -> Half:
    """A half that ONNX Runtime runs on one thread; raises HalfError."""
    try:
        import onnxruntime
    except ImportError as error:
        cure = 'python -m pip install "bayesnet-track[onnx]", or runtime: opencv'
        raise HalfError(f"ONNX Runtime is not installed: {cure}") from error

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what is wrong is raised, and sizes that were declared are no matter
    # Its exceptions have no other base in common.
    try:
        model = model.replace(DECLARED, NAMED)
        session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise HalfError(f"ONNX Runtime cannot read it as an ONNX model: {_reason_of(error)}") from error
    first = session.get_inputs()[0].name

    def run(inputs: Mapping[str, Singles], outputs: Sequence[str] = ()) -> list[Singles]:
        try:
            return list(
                session.run(outputs or None, {name or first: values for name, values in inputs.items()})
            )
        except Exception as error:
            raise HalfError(_reason_of(error)) from error

    return run


def _reason_of(error: Exception) -> str:
    return " ".join(str(error).split(" : ", 3)[-1].split())[:200]


RUNTIMES: Mapping[Runtime, Callable[[bytes], Half]] = MappingProxyType(
    {"opencv": run_by_opencv, "onnxruntime": run_by_onnxruntime}
)


TEMPLATE = 127
"""Side of the template's crop, px of the network."""
SEARCH = 255
"""Usual side of the search crop, px of the network: at the template's scale."""
STRIDE = 16
"""Between cells of the map, px of the network."""
FEATURES = 16
"""Cells a side that the backbone makes of the usual search crop."""


class SiameseError(CueError):
    """Model files that are missing, are no models, or are not the two halves of such a network."""


@dataclass(frozen=True, eq=False)
class Response:
    """Answer of the network to a search crop.

    Attributes:
        probabilities: (S, S) that the target covers the cell, 0..1.
        sides: (4, S, S) from the cell to the left, top, right and bottom side of its box, px of the network.
        stride: between cells, px of the network; cell S // 2 is in the crop's middle.
    """

    probabilities: Singles
    sides: Singles
    stride: int


@dataclass(frozen=True)
class Networks:
    """The two halves.

    Attributes:
        describe: (TEMPLATE, TEMPLATE, 3) uint8 BGR -> features of the template.
        compare: features of the template, (side, side, 3) uint8 BGR, (2,) w and h that the target is
            expected to have in it -> response.
    """

    describe: Callable[[Bytes], Singles]
    compare: Callable[[Singles, Bytes, Floats], Response]


def missing_file(key: str, path: str) -> str | None:
    """Reason why a model file cannot be used, in words; None if it can."""
    if not path:
        return f"{key}: no path; the path of an ONNX file is needed, as for the other half of the network"
    if not Path(path).is_file():
        return f"{key}: {path}: no such model file; the path of an ONNX file is needed"
    return None


def load_networks(
    backbone: str, head: str, sides: Sequence[int] = (SEARCH,), runtime: Runtime = "opencv"
) -> Networks:
    """The network of two ONNX files, tried once with search crops of each of the `sides`, px.

    Raises:
        SiameseError: a file is missing or no ONNX model, the two are not the halves of such a network, they
            take no crops of such a side, loading or running them crashes, or the runtime is not installed.
    """
    arguments = {"backbone": backbone, "head": head, "sides": [*sides], "runtime": runtime}
    check_apart(try_networks, [backbone, head], SiameseError, **arguments)
    return try_networks(backbone, head, sides, runtime)


def try_networks(backbone: str, head: str, sides: Sequence[int], runtime: Runtime) -> Networks:
    """Load networks as `load_networks` does, in this process whatever the files do to it."""
    import cv2

    body, default_head = _open("backbone", backbone, runtime), _open("head", head, runtime)

    @cache
    def neck(cells: int) -> Half:
        resized = None if cells == FEATURES else _of_cells(Path(head).read_bytes(), cells)
        return default_head if resized is None else RUNTIMES[runtime](resized)

    def describe(crop: Bytes) -> Singles:
        (features,) = body({"": cv2.dnn.blobFromImage(crop, swapRB=True)})
        return features

    def compare(template: Singles, crop: Bytes, size: Floats) -> Response:
        features = describe(crop)
        half = neck(features.shape[-1])
        scores, sides = half({"input1": template, "input2": features}, ["output1", "output2"])
        return _response(scores, sides)

    networks = Networks(describe, compare)
    usual_cells = _try_out(networks, backbone, head, SEARCH)
    for side in {*sides} - {SEARCH}:
        fault = f"head: {head}: takes search crops of {SEARCH} px only, not of {side} px"
        try:
            cells = _try_out(networks, backbone, head, side)
        except (SiameseError, HalfError) as error:
            raise SiameseError(fault) from error
        if cells - usual_cells != (side - SEARCH) // STRIDE:
            raise SiameseError(fault)
    return networks


def _of_cells(head: bytes, cells: int) -> bytes | None:
    """The head for other features than those of `FEATURES` cells a side; None where it needs no change.

    It is convolutional but for the shape of its correlation, which such files hold as a constant. One that
    does not hold it, or more than once, is taken as it is.
    """
    shape, resized_shape = (struct.pack("<4q", 1, -1, side, side) for side in (FEATURES, cells))
    if head.count(shape) != 1:
        return None
    # OpenCV 4 and ONNX Runtime try the constant on the shapes that the file declares: height and width, and
    # their product where a map is a row.
    declared, resized_map = (2 * _dimension(side, 1) for side in (FEATURES, cells))
    row, other_row = (_dimension(side**2, 2) for side in (FEATURES, cells))
    return head.replace(shape, resized_shape).replace(declared, resized_map).replace(row, other_row)


def _dimension(size: int, length: int) -> bytes:
    """Declaration of a dimension in a file: dim {dim_value: size}, the number in so many bytes of 7 bits."""
    groups = [size >> 7 * k & 0x7F for k in range(length)]
    return bytes([0x0A, 1 + length, 0x08, *(group | 0x80 for group in groups[:-1]), groups[-1]])


def _response(scores: Singles, sides: Singles) -> Response:
    cells = scores.shape[-1]
    if scores.shape != (1, 2, cells, cells) or sides.shape != (1, 4, cells, cells):
        raise SiameseError(
            f"gives outputs of {_shape(scores)} and {_shape(sides)}; allowed: 1x2xSxS and 1x4xSxS"
        )
    difference = (scores[0, 0] - scores[0, 1]).clip(-80.0, 80.0)
    return Response((1.0 / (1.0 + np.exp(difference))).astype(np.float32), sides[0], STRIDE)


def _shape(array: Singles) -> str:
    return "x".join(str(side) for side in array.shape)


def _open(key: str, path: str, runtime: Runtime) -> Half:
    if absent := missing_file(key, path):
        raise SiameseError(absent)
    working_on(path)
    try:
        return RUNTIMES[runtime](Path(path).read_bytes())
    except (HalfError, OSError) as error:
        raise SiameseError(f"{key}: {path}: {error}") from error


def _try_out(networks: Networks, backbone: str, head: str, side: int) -> int:
    """Run both once on gray crops, that of the search of `side` px; the cells of the map a side.

    Raises:
        SiameseError: they do not run.
    """
    swapped = "; are backbone and head interchanged?"
    working_on(backbone)
    try:
        template = networks.describe(np.full((TEMPLATE, TEMPLATE, 3), 114, np.uint8))
    except HalfError as error:
        size = f"a 3-channel input of {TEMPLATE}x{TEMPLATE} px"
        raise SiameseError(f"backbone: {backbone}: does not run on {size}{swapped} {error}") from error
    working_on(head)
    try:
        response = networks.compare(template, np.full((side, side, 3), 114, np.uint8), np.ones(2))
    except SiameseError as error:
        raise SiameseError(f"head: {head}: {error}") from error
    except HalfError as error:
        takes = f"features of {_shape(template)} as input1 and of the search crop as input2"
        raise SiameseError(f"head: {head}: does not run on {takes}{swapped} {error}") from error
    if not (np.isfinite(response.probabilities).all() and (np.abs(response.sides) < 1e6).all()):
        raise SiameseError(f"head: {head}: its outputs are not finite numbers")
    return len(response.probabilities)


SECONDS = 120.0
"""Of loading and running a network once; a damaged one may go on for ever."""
CODE = f"from {__name__} import serve; serve()"

_tried: set[str] = set()
_announce: list[Callable[[str], object]] = []


def check_apart(
    load: Callable[..., object], files: Sequence[str], fault: Callable[[str], Exception], **arguments: Any
) -> None:
    """Call `load` with `arguments`, values of JSON, in another process, and refuse what ends that.

    Args:
        load: a function of a module that loads and runs networks; what it raises itself is no crash.
        files: paths of the networks.
        fault: makes of a text the exception to raise.
        arguments: of `load`.

    Raises what `fault` makes: the process crashed, or took longer than `SECONDS`.
    """
    try:
        digests = {path: sha256(Path(path).read_bytes()).hexdigest() for path in files}
    except OSError:
        return  # `load` says so
    by_content = [
        digests.get(value, value) if isinstance(value, str) else value for value in arguments.values()
    ]
    request = [load.__module__, load.__qualname__, by_content, list(digests.values()), _versions()]
    key = sha256(json.dumps(request).encode()).hexdigest()
    marker = _folder() / f"{key[:40]}.tried"
    if key in _tried or marker.exists():
        return
    ended, file = _try(json.dumps([load.__module__, load.__qualname__, arguments]))
    if ended is not None:
        raise fault(
            f"{file or ', '.join(files)}: {ended} where the network was tried: the file is damaged, or this "
            "library cannot run it; fetch it again, or export it anew"
        )
    _tried.add(key)
    with suppress(OSError):
        marker.parent.mkdir(exist_ok=True)
        marker.touch()


def working_on(path: str) -> None:
    """Note, where networks are tried, which file comes next: it is named if that ends the process."""
    for announce in _announce:
        announce(path)


def serve() -> None:
    """In the other process: call the function that the last argument names."""
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    module, name, arguments = json.loads(sys.argv[-1])
    _announce.append(lambda path: _say(file=path))
    load = getattr(import_module(module), name)
    _say(begins=True)
    try:
        load(**arguments)
    except Exception as error:
        if not type(error).__module__.startswith("bayesnet_track"):
            _say(raised=f"{type(error).__name__}: {error}"[:200])
    os._exit(0)  # what a damaged network left behind may crash when it is taken down


def _say(**message: object) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def _try(request: str) -> tuple[str | None, str]:
    """End of the other process in words, None where it went well; the last file it named."""
    environment = {**os.environ, "MALLOC_PERTURB_": "165"}  # what is read after it was freed is seen
    descriptor, lifeline = tie()
    try:
        process = subprocess.run(
            python(CODE, request, descriptor=descriptor),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=() if descriptor < 0 else (descriptor,),
            env=environment,
            timeout=SECONDS,
        )
        code: int | None = process.returncode
        output = process.stdout
    except subprocess.TimeoutExpired as error:
        code, output = None, error.stdout or b""
    except OSError:  # no process can be started: then it is loaded as it is
        return None, ""
    finally:
        cut(descriptor, lifeline)
    report: dict[str, Any] = {}
    for line in output.decode("utf-8", "replace").splitlines():
        with suppress(ValueError):
            report |= json.loads(line)
    file = str(report.get("file", ""))
    if "raised" in report:
        return f"{report['raised']}, raised", file
    if code == 0 or "begins" not in report:  # it did not come to the network
        return None, file
    if code is None:
        return f"no end after {SECONDS:g} s", file
    return f"a crash ({signal.Signals(-code).name if code < 0 else f'exit code {code}'})", file


def _versions() -> list[str]:
    import cv2

    versions = [platform.machine(), platform.python_version(), np.__version__, cv2.__version__]
    for name in ("bayesnet-track", "onnxruntime"):
        with suppress(PackageNotFoundError):
            versions.append(f"{name} {version(name)}")
    return versions


def _folder() -> Path:
    """Folder of the compiled kernels, too."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    return Path(folder) if folder else Path(__file__).parent / "__pycache__"


def reason_of(error: Exception) -> str:
    """OpenCV's own words, without its file and line, in at most 200 characters.

    >>> reason_of(ValueError("OpenCV(4.12.0) net.cpp:3: error: (-215) no\\n such layer"))
    '(-215) no such layer'
    """
    return " ".join(str(error).split("error: ", 1)[-1].split())[:200]


def read_onnx(path: str, fault: Callable[[str], Exception]) -> Any:
    """OpenCV's network of an ONNX file; raises what `fault` makes of the text that says what is wrong."""
    import cv2

    try:
        model = np.fromfile(path, np.uint8)
    except OSError as error:
        raise fault(f"{path}: {error.strerror}") from error
    try:
        return cv2.dnn.readNetFromONNX(model)
    except cv2.error as error:
        raise fault(f"{path}: OpenCV cannot read it as an ONNX model: {reason_of(error)}") from error
