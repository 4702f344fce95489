"""Vectors that describe crops: by a network in an ONNX file, or by the plain pixels; and where to crop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats
from bayesnet_track.vision.apart import check_apart
from bayesnet_track.vision.opencv_errors import read_onnx, reason_of

Embed = Callable[[Bytes], Floats]
"""(n, height, width, 3) uint8 BGR crops -> (n, D) vectors."""


class EmbeddingError(ValueError):
    """A model that is not there, is no model, or does not run on the crops."""


@dataclass(frozen=True)
class Input:
    """What the network gets.

    Attributes:
        width: of its input, px; likewise `height`.
        scale: gray levels are multiplied by this, after `mean` is taken off.
        mean: in the order of the network's channels, gray levels.
        rgb: the order of the channels is red, green, blue.
    """

    width: int
    height: int
    scale: float = 1 / 255
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rgb: bool = True


def missing_model(model: str) -> str | None:
    """Why there is no such model, in words; None when there is, or none is wanted."""
    if model and not Path(model).is_file():
        return f"{model}: no such model file; the path of an ONNX file is needed"
    return None


def plain(crops: Bytes) -> Floats:
    """(n, D) the pixels themselves, around each channel's mean."""
    values = crops.astype(np.float64)
    values -= values.mean(axis=(1, 2), keepdims=True)
    return values.reshape(len(crops), -1)


def network(model: str, wanted: Input) -> Embed:
    """The network of an ONNX file as a function of crops, tried once.

    Raises:
        EmbeddingError: no such file, no ONNX model, it does not run on an input of this size, or that
            crashes.
    """
    if absent := missing_model(model):
        raise EmbeddingError(absent)
    check_apart(try_network, [model], EmbeddingError, model=model, wanted=asdict(wanted))
    return _network(model, wanted)


def try_network(model: str, wanted: Mapping[str, Any]) -> None:
    """Load and run a network for an input of these attributes once."""
    _network(model, Input(**wanted))


def _network(model: str, wanted: Input) -> Embed:
    import cv2

    net = read_onnx(model, EmbeddingError)

    def embed(crops: Bytes) -> Floats:
        # One by one: many networks have a fixed batch of 1, and a vector must not depend on its company.
        return np.stack([one(crop) for crop in crops])

    def one(crop: Bytes) -> Floats:
        channels = crop[..., ::-1] if wanted.rgb else crop
        values = (channels.astype(np.float32) - np.array(wanted.mean, np.float32)) * np.float32(wanted.scale)
        try:
            net.setInput(np.ascontiguousarray(values.transpose(2, 0, 1)[None]))
            vector = np.asarray(net.forward(), dtype=np.float64).reshape(-1)
        except cv2.error as error:
            size = f"{wanted.width}x{wanted.height}"
            raise EmbeddingError(
                f"{model}: does not run on a 3-channel input of {size} px: {reason_of(error)}"
            ) from error
        # OpenCV cuts what is infinite, or no number, to the largest float.
        if not vector.size or not (np.abs(vector) < np.finfo(np.float32).max).all():
            raise EmbeddingError(
                f"{model}: no finite vector comes from an input of {wanted.width}x{wanted.height} px"
            )
        return vector

    embed(np.zeros((1, wanted.height, wanted.width, 3), np.uint8))
    return embed


def crops_at(image: Bytes, boxes: Floats, width: int, height: int) -> Bytes:
    """(n, height, width, 3) boxes (n, 4) cut out and resized; beyond the picture its border is repeated."""
    import cv2

    crops = np.empty((len(boxes), height, width, 3), np.uint8)
    rows, columns = image.shape[:2]
    for k, (x, y, w, h) in enumerate(boxes):
        x0, y0 = int(np.floor(x - w / 2 + 0.5)), int(np.floor(y - h / 2 + 0.5))
        x1, y1 = max(int(np.ceil(x + w / 2 - 0.5)), x0) + 1, max(int(np.ceil(y + h / 2 - 0.5)), y0) + 1
        if x0 >= 0 and y0 >= 0 and x1 <= columns and y1 <= rows:
            part = image[y0:y1, x0:x1]
        else:
            down = np.clip(np.arange(y0, y1), 0, rows - 1)
            part = image[np.ix_(down, np.clip(np.arange(x0, x1), 0, columns - 1))]
        smaller = part.shape[1] > width and part.shape[0] > height
        crops[k] = cv2.resize(
            np.ascontiguousarray(part),
            (width, height),
            interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR,
        )
    return crops


def representatives(boxes: Floats, size: Floats, step: float, most: int) -> tuple[Floats, NDArray[np.intp]]:
    """Boxes that stand for others: (R, 4), R <= `most`, and (N,) which of them stands for each of `boxes`.

    They are knots of a lattice of `step` sizes in place and 2 `step` in the logs of the sides, whichever
    hypotheses there are: a box has the same representative in any company that needs no more than `most`.
    Else the lattice gets coarser, and the mean of those that share a knot stands for them.

    Args:
        boxes: (N, 4) centre boxes, px, N >= 1.
        size: (2,) w and h of the target, px: the lattice's unit.
        step: of the finest lattice.
        most: number of representatives, 1 at least.
    """
    logs, finest = np.log(boxes[:, 2:] / size), True
    while True:
        level = np.rint(logs / (2 * step))
        sides = size * np.exp(2 * step * level)
        keys = np.concatenate([np.rint(boxes[:, :2] / (step * sides)), level], axis=1)
        knots, which = np.unique(keys, axis=0, return_inverse=True)
        which = which.reshape(-1)
        if len(knots) <= most:
            break
        step, finest = 1.25 * step, False
    if finest:
        sides = size * np.exp(2 * step * knots[:, 2:])
        return np.concatenate([knots[:, :2] * step * sides, sides], axis=1), which
    sums = np.stack([np.bincount(which, column) for column in boxes.T], axis=1)
    return sums / np.bincount(which)[:, None], which
