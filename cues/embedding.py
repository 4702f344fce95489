"""Cue: a network's description of what is inside a box, compared with that of the target.

Any network in an ONNX file will do that gives a vector for a crop: one for re-identification, or the trunk
of a classifier. It is too dear for each hypothesis: they share crops on a lattice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.arrays import Bytes
from bayesnet_track.numerics.log_weights import SHARPER, factor_of, relax, sharpen
from bayesnet_track.observation.cue import (
    Cue,
    CueDeclaration,
    Floats,
    Hypotheses,
    Reference,
    SizedCueParameters,
    blend_arrays,
    blend_sizes,
    floored,
    log_logistic,
    log_size_penalty,
)
from bayesnet_track.observation.geometry import HALF_OVERLAP, share_inside
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.model_files import ModelFile
from bayesnet_track.vision.planes import WholeFrame
from bayesnet_track.vision.siamese_networks import check_apart, read_onnx, reason_of

Embed = Callable[[Bytes], Floats]
"""(n, height, width, 3) uint8 BGR crops -> (n, D) vectors."""


class EmbeddingError(ValueError):
    """A model that is not there, is no model, or does not run on the crops."""


@dataclass(frozen=True)
class Input:
    """Input of the network.

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
    """Reason why there is no such model, in words; None if there is, or none is needed."""
    if model and not Path(model).is_file():
        return f"{model}: no such model file; the path of an ONNX file is needed"
    return None


def _plain(crops: Bytes) -> Floats:
    """(n, D) the pixels themselves, around each channel's mean."""
    values = crops.astype(np.float64)
    values -= values.mean(axis=(1, 2), keepdims=True)
    return values.reshape(len(crops), -1)


def network(model: str, shape: Input) -> Embed:
    """The network of an ONNX file as a function of crops, tried once.

    Raises:
        EmbeddingError: no such file, no ONNX model, it does not run on an input of this size, or that
            crashes.
    """
    if absent := missing_model(model):
        raise EmbeddingError(absent)
    check_apart(_try_network, [model], EmbeddingError, model=model, shape=asdict(shape))
    return _network(model, shape)


def _try_network(model: str, shape: Mapping[str, Any]) -> None:
    """Load and run a network for an input of these attributes once."""
    _network(model, Input(**shape))


def _network(model: str, shape: Input) -> Embed:
    import cv2

    net = read_onnx(model, EmbeddingError)

    def embed(crops: Bytes) -> Floats:
        # One by one: many networks have a fixed batch of 1, and a vector must not depend on its company.
        return np.stack([embed_crop(crop) for crop in crops])

    def embed_crop(crop: Bytes) -> Floats:
        channels = crop[..., ::-1] if shape.rgb else crop
        values = (channels.astype(np.float32) - np.array(shape.mean, np.float32)) * np.float32(shape.scale)
        try:
            net.setInput(np.ascontiguousarray(values.transpose(2, 0, 1)[None]))
            vector = np.asarray(net.forward(), dtype=np.float64).reshape(-1)
        except cv2.error as error:
            size = f"{shape.width}x{shape.height}"
            raise EmbeddingError(
                f"{model}: does not run on a 3-channel input of {size} px: {reason_of(error)}"
            ) from error
        # OpenCV cuts what is infinite, or no number, to the largest float.
        if not vector.size or not (np.abs(vector) < np.finfo(np.float32).max).all():
            raise EmbeddingError(
                f"{model}: no finite vector comes from an input of {shape.width}x{shape.height} px"
            )
        return vector

    embed(np.zeros((1, shape.height, shape.width, 3), np.uint8))
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
            row_places = np.clip(np.arange(y0, y1), 0, rows - 1)
            part = image[np.ix_(row_places, np.clip(np.arange(x0, x1), 0, columns - 1))]
        smaller = part.shape[1] > width and part.shape[0] > height
        crops[k] = cv2.resize(
            np.ascontiguousarray(part),
            (width, height),
            interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR,
        )
    return crops


def representatives(
    boxes: Floats, size: Floats, step: float, max_count: int
) -> tuple[Floats, NDArray[np.intp]]:
    """Boxes that stand for others: (R, 4), R <= `max_count`, and for each of `boxes` which of them, (N,).

    They are knots of a lattice of `step` sizes in place and 2 `step` in the logs of the sides, whichever
    hypotheses there are: a box has the same representative in any company that needs no more than
    `max_count`. Else the lattice gets coarser, and the mean of those that share a knot stands for them.

    Args:
        boxes: (N, 4) centre boxes, px, N >= 1.
        size: (2,) w and h of the target, px: the lattice's unit.
        step: of the finest lattice.
        max_count: number of representatives, 1 at least.
    """
    logs, finest = np.log(boxes[:, 2:] / size), True
    while True:
        level = np.rint(logs / (2 * step))
        sides = size * np.exp(2 * step * level)
        keys = np.concatenate([np.rint(boxes[:, :2] / (step * sides)), level], axis=1)
        knots, indices = np.unique(keys, axis=0, return_inverse=True)
        indices = indices.reshape(-1)
        if len(knots) <= max_count:
            break
        step, finest = 1.25 * step, False
    if finest:
        sides = size * np.exp(2 * step * knots[:, 2:])
        return np.concatenate([knots[:, :2] * step * sides, sides], axis=1), indices
    sums = np.stack([np.bincount(indices, column) for column in boxes.T], axis=1)
    return sums / np.bincount(indices)[:, None], indices


STEP = 0.7
"""Factor of a local action on alpha."""


class EmbeddingParameters(SizedCueParameters):
    """Parameters of the embedding."""

    model: ModelFile = Field(
        default="",
        description="ONNX file (path) of a network that gives a vector for a crop; empty: the crop's pixels.",
    )
    input_width: int = Field(default=16, ge=2, le=1024, description="Width of the network's input (px).")
    input_height: int = Field(default=16, ge=2, le=1024, description="Height of the network's input (px).")
    scale: float = Field(
        default=1 / 255, gt=0, description="Gray levels are multiplied by this, after the mean is subtracted."
    )
    mean: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0),
        description="Subtracted from the channels, in the network's order (gray levels).",
    )
    channels: Literal["rgb", "bgr"] = Field(default="rgb", description="Order of the network's channels.")
    max_crops: int = Field(
        default=400,
        ge=1,
        le=10000,
        description="Largest number of crops per frame; hypotheses share them (count).",
    )
    step: float = Field(
        default=0.1,
        gt=0,
        le=1,
        description="Distance between crops if that needs no more than `max_crops` (sides of the box).",
    )
    alpha_min: float = Field(
        default=0.02, gt=0, le=1, description="Smallest distance at which the likelihood halves (0..1)."
    )


@dataclass(frozen=True)
class Embedding:
    """An embedding at work.

    A reference holds ``vector`` (D,), the target's; ``alpha`` (), the distance at which the likelihood
    halves; ``size`` (2,), w and h in px; ``sharper`` (), a factor on alpha.
    """

    parameters: EmbeddingParameters
    embed: Embed
    context: ClassVar[float] = 0.0  # it reads the whole picture

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The picture itself."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The vector of the box, and alpha: half the mean distance of the four boxes half a box away."""
        box = np.asarray(box, dtype=np.float64)
        vector = self._vectors(planes, box[None])[0]
        shifted = np.concatenate([box[:2] + HALF_OVERLAP * box[2:], np.tile(box[2:], (4, 1))], axis=1)
        alpha = 0.5 * float(self._distances(planes, shifted, vector).mean())
        return {
            "vector": vector,
            "alpha": np.array(max(alpha, self.parameters.alpha_min)),
            "size": np.array(box[2:]),
            SHARPER: np.array(1.0),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linear (eq. 2.15), the size in its logarithm."""
        return {**blend_arrays(old, new, rate), **relax(old, new, rate), "size": blend_sizes(old, new, rate)}

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """-log(1 + exp(4 (d - alpha) / alpha)), 0 at d = 0, plus the size penalty, over the floor.

        d is the cosine distance of the hypothesis' representative. All 0 when the reference is a vector
        without length, and when there are no hypotheses.
        """

        p, boxes, size = self.parameters, hypotheses.boxes, reference["size"]
        if not len(boxes) or not reference["vector"].any():
            return np.zeros(len(boxes))
        alpha = float(reference["alpha"]) * factor_of(reference)
        crop_boxes, indices = representatives(boxes, size, p.step, p.max_crops)
        distances = self._distances(planes, crop_boxes, reference["vector"])[indices]
        similarity = log_logistic(distances, alpha)
        penalty = log_size_penalty(boxes, size, p.sd_log_area, p.sd_log_aspect)
        return floored(similarity + penalty, p.floor)

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A sharper likelihood; None at once when the vector has no length."""
        return sharpen(reference, attempt, STEP) if reference["vector"].any() else None

    def _vectors(self, planes: Planes, boxes: Floats) -> Floats:

        p = self.parameters
        return self.embed(crops_at(planes[WholeFrame()], boxes, p.input_width, p.input_height))

    def _distances(self, planes: Planes, boxes: Floats, vector: Floats) -> Floats:
        """(N,) 1 - s cos, 0..1, s the share of the box inside the frame; 1 outside it."""
        share = share_inside(boxes, planes.frame)
        is_visible = share > 0.0
        distances = np.ones(len(boxes))
        if is_visible.any():
            vectors = self._vectors(planes, boxes[is_visible])
            lengths = np.sqrt((vectors**2).sum(axis=1) * float(vector @ vector))
            dots = (vectors * vector).sum(
                axis=1
            )  # not `@`, which adds up differently for other numbers of rows
            cosine = np.divide(dots, lengths, out=np.zeros_like(dots), where=lengths > 0)
            distances[is_visible] = np.clip(1.0 - share[is_visible] * cosine, 0.0, 1.0)
        return distances


def _make(parameters: EmbeddingParameters) -> Cue:
    import cv2  # noqa: F401  load before the first frame

    p = parameters
    if not p.model:
        return Embedding(p, _plain)
    shape = Input(p.input_width, p.input_height, p.scale, p.mean, p.channels == "rgb")
    return Embedding(p, network(p.model, shape))


def _missing(parameters: EmbeddingParameters) -> str | None:
    if not parameters.model:
        return None

    try:
        _make(parameters)
    except EmbeddingError as error:
        return str(error)
    return None


CUE = CueDeclaration(
    name="embedding",
    summary="Feature vector of a network (ONNX) for the content of the box.",
    parameters=EmbeddingParameters,
    make=_make,
    cost_ms=8.0,
    missing=_missing,
    files=lambda parameters: (parameters.model,) if parameters.model else (),
    adapts=True,
)
