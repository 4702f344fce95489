"""Cue: the one box that a Siamese network gives the target, measured instead of scored.

It chooses among the network's proposals as the tracker that the network comes from does (NanoTrack, OpenCV's
`TrackerNano`): a window prefers places near the prediction, and a penalty sizes near the last one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from bayesnet_track.cues.siamese import (
    NetworkParameters,
    learn_template,
    missing_files,
    network_files,
    open_network,
)
from bayesnet_track.numerics.arrays import Bytes
from bayesnet_track.observation.cue import (
    CueDeclaration,
    Floats,
    Hypotheses,
    Measurement,
    MeasuringCue,
    Reference,
)
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.planes import WholeFrame
from bayesnet_track.vision.siamese_crops import context_side, search_crop, wide_crop
from bayesnet_track.vision.siamese_networks import SEARCH, TEMPLATE

if TYPE_CHECKING:
    from bayesnet_track.vision.siamese_crops import Memory

WINDOW_PX = 120.0
"""How far from the middle the window reaches, px of the network: to the last cells of its map."""
DOUBTFUL_WINDOW = 0.1
"""Weight of the window, at most, in a second look: the prediction has shown nothing sure."""
LIKELY = 0.5
"""Smallest probability in a wide crop for a closer look."""


class SiameseBoxParameters(NetworkParameters):
    """Parameters of the box that a Siamese network gives."""

    window: float = Field(
        default=0.455, ge=0, lt=1, description="Weight of the window beside the network's probability."
    )
    size_penalty: float = Field(
        default=0.055, ge=0, description="How much a change of size and shape costs (in the exponent)."
    )
    crop_px: Literal[159, 191, 223, 255] = Field(
        default=SEARCH,
        description="Side of the search crop (px of the network); a smaller one takes less time.",
    )
    sure_probability: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Probability of the box below which the frame is looked at again, in the usual crop and "
        "hardly bound to the prediction; what is found then counts from this probability on, as does what is "
        "found by way of a wide crop (no unit).",
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
class ChosenProposal:
    """A proposal that was chosen.

    Attributes:
        box: (4,) centre box, px.
        probability: 0..1.
        worth: the same, less what its change of size and shape costs.
    """

    box: Floats
    probability: float
    worth: float


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

        If the hypotheses are too far apart for the usual crop, a wide one shows where the crop should be.

        Its sds are divided by its probability times what its change of size leaves.
        """
        p, expected = self.parameters, weights @ hypotheses.boxes
        image, template = planes[WholeFrame()], reference["template"]
        if _reach(hypotheses.boxes, weights) > SEARCH / TEMPLATE * context_side(expected[2:]):
            proposal = self._look_widely(image, expected, template)
        else:
            proposal = self._look_near(image, expected, template)
        if proposal is None or proposal.probability < p.min_probability:
            return None
        box, score, sure = proposal.box, max(proposal.worth, 0.1), proposal.probability
        sds = [side * sd / score for sd in (p.sd_place, p.sd_size) for side in box[2:].tolist()]
        covariance = np.diag([sd * sd for sd in sds])
        return Measurement(("x", "y", "w", "h"), box, covariance, p.floor, confidence=sure)

    def _look_near(self, image: Bytes, expected: Floats, template: Bytes) -> ChosenProposal | None:
        """The proposal near a centre box (4,), or a sure one in the usual crop around it."""
        p = self.parameters
        proposal = self._look(image, expected, p.crop_px, template, p.window)
        if _is_sure(proposal, p):
            return proposal
        doubtful_proposal = self._look(image, expected, SEARCH, template, min(p.window, DOUBTFUL_WINDOW))
        # What is far from the prediction counts only if it is sure.
        return doubtful_proposal if _is_sure(doubtful_proposal, p) else proposal

    def _look_widely(self, image: Bytes, expected: Floats, template: Bytes) -> ChosenProposal | None:
        """A sure proposal where a wide crop around a centre box (4,) shows the target best, if at all.

        The wide crop is coarse: it says where to look, and the crop around that place what is there.
        """
        p, crop = self.parameters, wide_crop(float(expected[0]), float(expected[1]), expected[2:])
        proposals, logs = self.memory.proposals(image, crop, template, expected[2:])
        if not len(logs) or logs[0] < math.log(LIKELY):
            return None
        wide_box = np.concatenate([proposals[0, :2], expected[2:]])
        proposal = self._look(image, wide_box, p.crop_px, template, p.window)
        return proposal if _is_sure(proposal, p) else None

    def _look(
        self, image: Bytes, expected: Floats, crop_px: int, template: Bytes, window: float
    ) -> ChosenProposal | None:
        """The proposal that is chosen in a crop around a centre box (4,)."""
        from bayesnet_track.vision.kernels.correlation_kernels import choose

        p = self.parameters
        crop = search_crop(float(expected[0]), float(expected[1]), expected[2:], crop_px)
        proposals, logs = self.memory.proposals(image, crop, template, expected[2:])
        if not len(logs):
            return None
        reach = WINDOW_PX / TEMPLATE * context_side(expected[2:])
        index, score = choose(proposals, logs, expected, window, reach, p.size_penalty)
        return ChosenProposal(proposals[index], float(np.exp(logs[index])), score)


def _reach(boxes: Floats, weights: Floats) -> float:
    """Side of the square that holds weighted centre boxes (N, 4), one sd to each side of their mean."""
    mean = weights @ boxes
    sds = np.sqrt(weights @ (boxes[:, :2] - mean[:2]) ** 2)
    return float((2.0 * sds + mean[2:]).max())


def _is_sure(proposal: ChosenProposal | None, parameters: SiameseBoxParameters) -> bool:
    return (0.0 if proposal is None else proposal.probability) >= parameters.sure_probability


def _sides(parameters: SiameseBoxParameters) -> tuple[int, ...]:
    """The sides of the search crops, in the order in which they are looked at."""
    return (parameters.crop_px, SEARCH)


def _missing(parameters: SiameseBoxParameters) -> str | None:
    return missing_files(parameters, _sides(parameters))


def _make(parameters: SiameseBoxParameters) -> MeasuringCue:
    return SiameseBox(parameters, open_network(parameters, _sides(parameters)))


CUE = CueDeclaration(
    name="siamese_box",
    summary="The box that a Siamese tracking network (ONNX) gives the target.",
    parameters=SiameseBoxParameters,
    make=_make,
    cost_ms=6.0,
    rate_max=0.0,
    measures=True,
    is_confident=lambda parameters: True,
    missing=_missing,
    files=network_files,
)
