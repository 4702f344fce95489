"""Cue: a network's description of what is inside a box, compared with that of the target.

Any network in an ONNX file will do that gives a vector for a crop: one for re-identification, or the trunk
of a classifier. It is too dear for each hypothesis: they share crops on a lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

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
from bayesnet_track.vision.planes.whole_frame import WholeFrame

if TYPE_CHECKING:
    from bayesnet_track.vision.embedding import Embed

STEP = 0.7
"""Factor of a local action on alpha."""


class EmbeddingParameters(SizedCueParameters):
    """Parameters of the embedding."""

    model: str = Field(
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
        from bayesnet_track.vision.embedding import representatives

        p, boxes, size = self.parameters, hypotheses.boxes, reference["size"]
        if not len(boxes) or not reference["vector"].any():
            return np.zeros(len(boxes))
        alpha = float(reference["alpha"]) * factor_of(reference)
        asked, which = representatives(boxes, size, p.step, p.max_crops)
        distances = self._distances(planes, asked, reference["vector"])[which]
        similarity = log_logistic(distances, alpha)
        penalty = log_size_penalty(boxes, size, p.sd_log_area, p.sd_log_aspect)
        return floored(similarity + penalty, p.floor)

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A sharper likelihood; None at once when the vector has no length."""
        return sharpen(reference, attempt, STEP) if reference["vector"].any() else None

    def _vectors(self, planes: Planes, boxes: Floats) -> Floats:
        from bayesnet_track.vision.embedding import crops_at

        p = self.parameters
        return self.embed(crops_at(planes[WholeFrame()], boxes, p.input_width, p.input_height))

    def _distances(self, planes: Planes, boxes: Floats, vector: Floats) -> Floats:
        """(N,) 1 - s cos, 0..1, s the share of the box inside the frame; 1 outside it."""
        share = share_inside(boxes, planes.frame)
        seen = share > 0.0
        distances = np.ones(len(boxes))
        if seen.any():
            found = self._vectors(planes, boxes[seen])
            lengths = np.sqrt((found**2).sum(axis=1) * float(vector @ vector))
            dots = (found * vector).sum(
                axis=1
            )  # not `@`, which adds up differently for other numbers of rows
            cosine = np.divide(dots, lengths, out=np.zeros_like(dots), where=lengths > 0)
            distances[seen] = np.clip(1.0 - share[seen] * cosine, 0.0, 1.0)
        return distances


def _make(parameters: EmbeddingParameters) -> Cue:
    import cv2  # noqa: F401  load before the first frame

    from bayesnet_track.vision.embedding import Input, network, plain

    p = parameters
    if not p.model:
        return Embedding(p, plain)
    wanted = Input(p.input_width, p.input_height, p.scale, p.mean, p.channels == "rgb")
    return Embedding(p, network(p.model, wanted))


def _missing(parameters: EmbeddingParameters) -> str | None:
    if not parameters.model:
        return None
    from bayesnet_track.vision.embedding import EmbeddingError

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
