"""One half of a Siamese network as a function of its inputs, run by OpenCV or by ONNX Runtime."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, Protocol

import numpy as np

from bayesnet_track.numerics.arrays import Singles
from bayesnet_track.vision.opencv_errors import reason_of

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
            found: Any = network.forward(outputs) if outputs else [network.forward()]
        except cv2.error as error:
            raise HalfError(reason_of(error)) from error
        return [np.array(one, np.float32) for one in found]

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
            return list(session.run(outputs or None, {name or first: own for name, own in inputs.items()}))
        except Exception as error:
            raise HalfError(_reason_of(error)) from error

    return run


def _reason_of(error: Exception) -> str:
    return " ".join(str(error).split(" : ", 3)[-1].split())[:200]


RUNTIMES: Mapping[Runtime, Callable[[bytes], Half]] = MappingProxyType(
    {"opencv": run_by_opencv, "onnxruntime": run_by_onnxruntime}
)
