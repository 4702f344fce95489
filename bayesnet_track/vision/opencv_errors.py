"""What OpenCV says of an error, such as one of a file that is no network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


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
