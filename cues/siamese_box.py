"""Cue: the one box that a Siamese network gives the target, measured instead of scored.

It chooses among the network's proposals as the tracker that the network comes from does (NanoTrack, OpenCV's
`TrackerNano`): a window prefers places near the prediction, and a penalty sizes near the last one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from bayesnet_track.cues.siamese import (
    NetworkParameters,
    files_of,
    learn_template,
    missing_files,
    open_network,
)
from bayesnet_track.observation.cue import (
    CueDeclaration,
    Floats,
    Hypotheses,
    Measurement,
    MeasuringCue,
    Reference,
)
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.planes.whole_frame import WholeFrame

if TYPE_CHECKING:
    from bayesnet_track.vision.siamese.memory import Memory

WINDOW_PX = 120.0
"""How far from the middle the window reaches, px of the network: to the last cells of its map."""


class SiameseBoxParameters(NetworkParameters):
    """Parameters of the box that a Siamese network gives."""

    window: float = Field(
        default=0.455, ge=0, lt=1, description="Weight of the window beside the network's probability."
    )
    size_penalty: float = Field(
        default=0.055, ge=0, description="How much a change of size and shape costs (in the exponent)."
    )
    min_probability: float = Field(
        default=0.1, ge=0, lt=1, description="Smallest probability of the chosen box; below, it is not seen."
    )
    sd_place: float = Field(
        default=0.02,
        gt=0,
        description="Error of the centre at a probability of 1 (share of the box's sides).",
    )
    sd_size: float = Field(default=0.1, gt=0, description="The same of the sides (share of the box's sides).")


@dataclass(frozen=True)
class SiameseBox:
    """The network at work.

    Reference: as of the cue `siamese`; `place` and `size` are those of the first box.
    """

    parameters: SiameseBoxParameters
    memory: Memory
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The picture itself."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The crop around the box (4,)."""
        return learn_template(planes[WholeFrame()], box)

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """The old template, which is never learnt anew."""
        return old if rate < 1.0 else new

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """The best proposal in a crop around the prediction; None when it is not probable enough.

        Its sds are divided by its probability times what its change of size leaves.
        """
        from bayesnet_track.vision.siamese.crops import search_crop

        p, expected = self.parameters, weights @ hypotheses.boxes
        crop = search_crop(float(expected[0]), float(expected[1]), expected[2:])
        proposals, logs = self.memory.proposals(
            planes[WholeFrame()], crop, reference["template"], expected[2:]
        )
        if not len(logs):
            return None
        probabilities = np.exp(logs)
        worth = probabilities * _kept_size(proposals, expected[2:], p.size_penalty)
        best = int(np.argmax((1.0 - p.window) * worth + p.window * _near(proposals, expected)))
        if probabilities[best] < p.min_probability:
            return None
        box = proposals[best]
        sds = np.tile(box[2:], 2) * np.repeat([p.sd_place, p.sd_size], 2) / max(worth[best], 0.1)
        return Measurement(("x", "y", "w", "h"), box, np.diag(sds**2), p.floor)


def _near(proposals: Floats, expected: Floats) -> Floats:
    """(M,) the window, a raised cosine of the distance in x times one of that in y."""
    from bayesnet_track.vision.siamese.crops import context_side
    from bayesnet_track.vision.siamese.networks import TEMPLATE

    reach = WINDOW_PX / TEMPLATE * context_side(expected[2:])
    away = np.minimum(np.abs(proposals[:, :2] - expected[:2]) / reach, 1.0)
    return np.asarray((0.5 + 0.5 * np.cos(np.pi * away)).prod(axis=1))


def _kept_size(proposals: Floats, size: Floats, penalty: float) -> Floats:
    """(M,) exp(-penalty (r s - 1)), r the change of shape and s of size, both as factors of at least 1."""

    def context(w: Floats, h: Floats) -> Floats:
        half = 0.5 * (w + h)
        return np.asarray(np.sqrt((w + half) * (h + half)))

    w, h = proposals[:, 2], proposals[:, 3]
    larger = context(w, h) / context(size[:1], size[1:])
    wider = (w / h) / (size[0] / size[1])
    change = np.maximum(larger, 1.0 / larger) * np.maximum(wider, 1.0 / wider)
    return np.asarray(np.exp(-penalty * (change - 1.0)))


def _make(parameters: SiameseBoxParameters) -> MeasuringCue:
    return SiameseBox(parameters, open_network(parameters))


CUE = CueDeclaration(
    name="siamese_box",
    summary="The box that a Siamese tracking network (ONNX) gives the target.",
    parameters=SiameseBoxParameters,
    make=_make,
    cost_ms=6.0,
    rate_max=0.0,
    measures=True,
    missing=missing_files,
    files=files_of,
)
