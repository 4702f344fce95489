"""A Siamese tracking network as two ONNX files, run by OpenCV: where in a crop is what the template shows?

The files are those that OpenCV's `TrackerNano` takes (NanoTrack). The backbone describes a crop; the head
compares the descriptions of template and search crop, and gives for each cell of a square map how probable it
is that the target covers it, and how far the four sides of the target's box are from it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Floats, Singles
from bayesnet_track.observation.capabilities import CueError
from bayesnet_track.vision.opencv_errors import read_onnx, reason_of

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
    """What the network says of a search crop.

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
    """Why a model file cannot be there, in words; None when it is."""
    if not path:
        return f"{key}: no path; the path of an ONNX file is needed, as for the other half of the network"
    if not Path(path).is_file():
        return f"{key}: {path}: no such model file; the path of an ONNX file is needed"
    return None


def load_networks(backbone: str, head: str, sides: Sequence[int] = (SEARCH,)) -> Networks:
    """The network of two ONNX files, tried once with search crops of each of the `sides`, px.

    Raises:
        SiameseError: a file is missing or no ONNX model, the two are not the halves of such a network, or
            they take no crops of such a side.
    """
    import cv2

    body, usual = _read("backbone", backbone), _read("head", head)

    @cache
    def neck(cells: int) -> Any:
        return usual if cells == FEATURES else _of_cells(head, usual, cells)

    def describe(crop: Bytes) -> Singles:
        body.setInput(cv2.dnn.blobFromImage(crop, swapRB=True))
        return np.array(body.forward(), np.float32)

    def compare(template: Singles, crop: Bytes, size: Floats) -> Response:
        features = describe(crop)
        half = neck(features.shape[-1])
        half.setInput(template, "input1")
        half.setInput(features, "input2")
        scores, sides = half.forward(["output1", "output2"])
        return _response(np.asarray(scores, np.float32), np.asarray(sides, np.float32))

    networks = Networks(describe, compare)
    usual_cells = _try_out(networks, backbone, head, SEARCH)
    for side in {*sides} - {SEARCH}:
        fault = f"head: {head}: takes search crops of {SEARCH} px only, not of {side} px"
        try:
            cells = _try_out(networks, backbone, head, side)
        except SiameseError as error:
            raise SiameseError(fault) from error
        if cells - usual_cells != (side - SEARCH) // STRIDE:
            raise SiameseError(fault)
    return networks


def _of_cells(head: str, usual: Any, cells: int) -> Any:
    """The head for other features than those of `FEATURES` cells a side.

    It is convolutional but for the shape of its correlation, which such files hold as a constant. One that
    does not hold it, or more than once, is taken as it is.
    """
    import cv2

    model = Path(head).read_bytes()
    shape, wanted = (struct.pack("<4q", 1, -1, side, side) for side in (FEATURES, cells))
    if model.count(shape) != 1:
        return usual
    # OpenCV 4 tries the constant on the shapes that the file declares: two fields dim {dim_value: side}.
    declared, other = (2 * bytes([0x0A, 2, 0x08, side]) for side in (FEATURES, cells))
    changed = model.replace(shape, wanted).replace(declared, other)
    return cv2.dnn.readNetFromONNX(np.frombuffer(changed, np.uint8))


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


def _read(key: str, path: str) -> Any:
    if absent := missing_file(key, path):
        raise SiameseError(absent)
    return read_onnx(path, lambda text: SiameseError(f"{key}: {text}"))


def _try_out(networks: Networks, backbone: str, head: str, side: int) -> int:
    """Run both once on gray crops, that of the search of `side` px; the cells of the map a side.

    Raises:
        SiameseError: they do not run.
    """
    import cv2

    swapped = "; are backbone and head interchanged?"
    try:
        template = networks.describe(np.full((TEMPLATE, TEMPLATE, 3), 114, np.uint8))
    except cv2.error as error:
        size = f"a 3-channel input of {TEMPLATE}x{TEMPLATE} px"
        raise SiameseError(
            f"backbone: {backbone}: does not run on {size}{swapped} {reason_of(error)}"
        ) from error
    try:
        found = networks.compare(template, np.full((side, side, 3), 114, np.uint8), np.ones(2))
    except SiameseError as error:
        raise SiameseError(f"head: {head}: {error}") from error
    except cv2.error as error:
        takes = f"features of {_shape(template)} as input1 and of the search crop as input2"
        raise SiameseError(f"head: {head}: does not run on {takes}{swapped} {reason_of(error)}") from error
    if not (np.isfinite(found.probabilities).all() and (np.abs(found.sides) < 1e6).all()):
        raise SiameseError(f"head: {head}: its outputs are not finite numbers")
    return len(found.probabilities)
