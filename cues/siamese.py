"""Cue: what a Siamese network answers: how probable each place is, and which box the target has there.

The network runs once on a crop around the hypotheses. Each cell of its map proposes a box with a probability;
a hypothesis is as likely as the proposal that explains it best. Where the target is expected is left to the
belief: unlike in the tracker that the network comes from, no window and no penalty for change is applied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from bayesnet_track.numerics.arrays import Bytes
from bayesnet_track.observation.cue import (
    Cue,
    CueDeclaration,
    CueParameters,
    Floats,
    Hypotheses,
    Reference,
    floored,
)
from bayesnet_track.observation.geometry import share_inside
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.model_files import NANOTRACK, VARIABLE, ModelFile, find_nanotrack
from bayesnet_track.vision.planes import WholeFrame
from bayesnet_track.vision.siamese_networks import SEARCH, Runtime

if TYPE_CHECKING:
    from bayesnet_track.vision.siamese_crops import Memory


class NetworkParameters(CueParameters):
    """Files of the network."""

    backbone: ModelFile = Field(
        default="",
        description="ONNX file (path) of the half that describes a crop; empty, as `head`: plain pixels.",
    )
    head: ModelFile = Field(
        default="",
        description="ONNX file (path) of the half that compares template and search crop.",
    )
    runtime: Runtime = Field(
        default="opencv",
        description="What runs the files: OpenCV, or ONNX Runtime (extra `onnx`), in less time.",
    )
    without_files: Literal["plain", "refuse"] = Field(
        default="plain",
        description="Without model files: use plain pixels, to try out a graph, or refuse to start unless "
        "those of NanoTrack v2 are in a folder of models.",
    )


class SiameseParameters(NetworkParameters):
    """Parameters of the Siamese network."""

    sharpness: float = Field(
        default=6.0,
        gt=0,
        description="Exponent of the network's probabilities, which are close to 1 for nearly every target.",
    )
    sd_place: float = Field(
        default=0.1, gt=0, description="Error of the network's box: its centre (share of its sides)."
    )
    sd_size: float = Field(
        default=0.12, gt=0, description="Error of the network's box: its sides (in their logarithm)."
    )
    max_crops: int = Field(
        default=64,
        ge=1,
        le=256,
        description="Runs of the network per frame; hypotheses beyond the crops get the floor (count).",
    )
    floor: float = Field(
        default=1e-5,
        gt=0,
        lt=1,
        description="Likelihood of an outlier as a share of the best possible likelihood.",
    )


NEEDED = (
    "the network needs the two ONNX files of a Siamese tracker, which are not part of the package: put "
    f"{NANOTRACK[0]} and {NANOTRACK[1]} into the folder `models` here (or into one that the "
    f"variable {VARIABLE} names), or copy the graph and write `backbone: PATH, head: PATH` into the settings "
    "of the agent"
)


@dataclass(frozen=True)
class Siamese:
    """The network at work.

    Reference: `template` (127, 127, 3) uint8 the crop that shows the target; `place` (2,) and `size` (2,),
    px, where it was last learnt.
    """

    parameters: SiameseParameters
    memory: Memory
    context: ClassVar[float] = 0.0  # it reads the whole picture

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The picture itself."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The crop around the box."""
        return learn_template(planes[WholeFrame()], box)

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """The old template with the newest place and size: what the target looks like is not learnt anew."""
        if rate <= 0.0:
            return old
        return new if rate >= 1.0 else {**new, "template": old["template"]}

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """max over proposals c of sharpness log p_c - d_c^2 / 2, plus log s, over the floor.

        p_c is the network's probability, d_c the distance of the hypothesis from the proposed box, and s the
        share of the hypothesis' box inside the frame.
        """
        from bayesnet_track.vision.kernels.correlation_kernels import explained
        from bayesnet_track.vision.siamese_crops import crops_for

        p, boxes, image = self.parameters, hypotheses.boxes, planes[WholeFrame()]
        share = share_inside(boxes, planes.frame)
        log = np.full(len(boxes), -np.inf)
        for crop, indices in crops_for(
            boxes, share > 0.0, reference["place"], reference["size"], p.max_crops
        ):
            proposals, logs = self.memory.proposals(image, crop, reference["template"], reference["size"])
            log[indices] = explained(boxes[indices], proposals, p.sharpness * logs, p.sd_place, p.sd_size)
        with np.errstate(divide="ignore"):
            return floored(np.minimum(log + np.log(share), 0.0), p.floor)


def open_network(parameters: NetworkParameters, sides: Sequence[int] = (SEARCH,)) -> Memory:
    """The network of the files for search crops of these sides, or plain pixels; raises SiameseError."""
    import cv2  # noqa: F401  load before the first frame

    from bayesnet_track.vision.siamese_crops import Memory, plain_correlator
    from bayesnet_track.vision.siamese_networks import SiameseError, load_networks

    p = parameters
    if p.backbone or p.head:
        return Memory(load_networks(p.backbone, p.head, sides, p.runtime))
    if p.without_files == "refuse":
        if usual := find_nanotrack():
            return Memory(load_networks(*usual, sides, p.runtime))
        raise SiameseError(NEEDED)
    return Memory(plain_correlator())


def missing_files(parameters: NetworkParameters, sides: Sequence[int] = (SEARCH,)) -> str | None:
    """Fault of the files, in words; None if they can be used, or none are named."""
    if not network_files(parameters):
        return None
    from bayesnet_track.vision.siamese_networks import SiameseError

    try:
        open_network(parameters, sides)
    except SiameseError as error:
        return str(error)
    return None


def network_files(parameters: NetworkParameters) -> tuple[str, ...]:
    """The paths that are named, or those of NanoTrack that a graph without names insists on."""
    named = tuple(path for path in (parameters.backbone, parameters.head) if path)
    return named or (find_nanotrack() or () if parameters.without_files == "refuse" else ())


def learn_template(image: Bytes, box: Floats) -> Reference:
    """The crop around a centre box (4,): the network describes it when it is first compared."""
    from bayesnet_track.vision.siamese_crops import template_crop

    box = np.array(box, dtype=np.float64)
    return {"template": template_crop(box).cut(image), "place": box[:2], "size": box[2:]}


def _make(parameters: SiameseParameters) -> Cue:
    return Siamese(parameters, open_network(parameters))


CUE = CueDeclaration(
    name="siamese",
    summary="Box and probability that a Siamese tracking network (ONNX) gives each place.",
    parameters=SiameseParameters,
    make=_make,
    cost_ms=6.0,
    rate_max=0.05,
    missing=missing_files,
    files=network_files,
)
