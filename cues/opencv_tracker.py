"""Cue: any tracker of the installed OpenCV, as an agent that measures.

The tracker is an object of OpenCV's that cannot be stored: the agent is opaque. What can be stored is the
picture and the box that it last started from, or could start from anew; a reference without its tracker
starts one there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.observation.cue import (
    CueDeclaration,
    CueParameters,
    Floats,
    Hypotheses,
    Measurement,
    MeasuringCue,
    Reference,
)
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.opencv_trackers import (
    FILES,
    ModelError,
    Session,
    check_models,
    missing_tracker,
)
from bayesnet_track.vision.planes.whole_frame import WholeFrame

TrackerName = Literal[
    "MIL", "CSRT", "KCF", "MOSSE", "MedianFlow", "TLD", "Boosting", "Nano", "Vit", "DaSiamRPN"
]


class OpencvTrackerParameters(CueParameters):
    """Parameters of an OpenCV tracker."""

    tracker: TrackerName = Field(
        default="MIL", description="OpenCV's name of the tracker; the wheel decides which are available."
    )
    models: dict[str, str] = Field(
        default={},
        description="Paths of the network's files by OpenCV's names: Nano backbone, neckhead; Vit net; "
        "DaSiamRPN model, kernel_cls1, kernel_r1.",
    )
    sd_box: float = Field(
        default=0.06, gt=0, description="Error of the place at a score of 1 (share of the box's sides)."
    )
    min_correlation: float = Field(
        default=0.3,
        ge=-1,
        le=1,
        description="Smallest correlation of what it finds with what was last learnt; below, the target is "
        "not seen; -1: trust the tracker.",
    )
    patience: int = Field(
        default=10,
        ge=0,
        description="Number of frames without the target after which it starts again at the estimate "
        "(frames).",
    )
    restart_below: float = Field(
        default=0.2,
        ge=0,
        le=1,
        description="It starts again if its box overlaps the estimate by less (intersection over union).",
    )


class TrackedReference(dict[str, NDArray[Any]]):
    """A reference's arrays, and the tracker at work, which no file holds.

    Attributes:
        session: the tracker, from the box and picture that it started with.
    """

    def __init__(self, arrays: Mapping[str, NDArray[Any]], session: Session) -> None:
        super().__init__(arrays)
        self.session = session


@dataclass(frozen=True)
class OpencvTracker:
    """A tracker of OpenCV's at work.

    Reference: `image` (rows, columns, 3) uint8 the last picture that was learnt, whole; `box` (4,) the target
    in it, px; `index` () its number; and, unless it was read from a file, the tracker (`TrackedReference`).
    """

    parameters: OpencvTrackerParameters
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The whole picture."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """Where a tracker can start; it does when it is first asked."""
        image = planes[WholeFrame()]
        arrays = {
            "image": image,
            "box": np.array(box, dtype=np.float64),
            "index": np.array(planes.frame.index),
        }
        return TrackedReference(arrays, self._session(arrays))

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """The tracker at work with the newest picture; the new one where the old has left the estimate.

        While it does not find the target the old reference stays, for `patience` frames. Trackers learn by
        themselves: `rate` matters only when it is 0 (the old reference) or 1 (the new).
        """
        if rate <= 0.0:
            return old
        session = old.session if isinstance(old, TrackedReference) else None
        if rate >= 1.0 or session is None or session.image is not new["image"]:
            return new
        box = session.box
        if box is None and new["index"] - old["index"] < self.parameters.patience:
            return old
        if box is None or overlap(new["box"], box[None])[0] < self.parameters.restart_below:
            return new
        session.learn()
        return TrackedReference(new, session)

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """The tracker's box in this picture, sds its sides times `sd_box` over its score (or 1).

        None when the tracker does not find the target, or what it found does not look like it; having learnt
        from that, it starts anew then. A tracker sees
        each frame once and in order: asked again it answers the same, and after frames that it was not asked
        about it starts anew, in the last picture that was learnt.
        """
        p, image, index = self.parameters, planes[WholeFrame()], planes.frame.index
        session = reference.session if isinstance(reference, TrackedReference) else self._session(reference)
        if session.image is not image:
            if session.index != index - 1 or session.refused:
                session.start(reference["image"], reference["box"], int(reference["index"]))
            session.update(image, index, weights @ hypotheses.boxes[:, :2])
        if session.box is None:
            return None
        if session.likeness < p.min_correlation:
            session.refuse()
            return None
        score = None if session.score is None else min(max(session.score, 0.0), 1.0)
        sd = np.maximum(p.sd_box * session.box[2:] / (1.0 if score is None else max(score, 0.1)), 0.5)
        covariance = np.diag(np.tile(sd**2, 2))
        return Measurement(("x", "y", "w", "h"), session.box, covariance, p.floor, confidence=score)

    def _session(self, arrays: Reference) -> Session:
        p = self.parameters
        session = Session(p.tracker, p.models)
        session.start(arrays["image"], arrays["box"], int(arrays["index"]))
        return session


def _missing(parameters: OpencvTrackerParameters) -> str | None:
    absent = missing_tracker(parameters.tracker, parameters.models)
    if absent is not None:
        return absent
    try:
        check_models(parameters.tracker, parameters.models)
    except ModelError as error:
        return str(error)
    return None


def _is_confident(parameters: OpencvTrackerParameters) -> bool:
    return parameters.tracker in FILES  # the others have no score


def _make(parameters: OpencvTrackerParameters) -> MeasuringCue:
    absent = _missing(parameters)
    if absent is not None:
        raise ValueError(absent)
    return OpencvTracker(parameters)


CUE = CueDeclaration(
    name="opencv_tracker",
    summary="A tracker of OpenCV's (MIL, CSRT, KCF, Nano, ...): measures where it finds the target.",
    parameters=OpencvTrackerParameters,
    make=_make,
    cost_ms=55.0,
    rate_max=0.2,
    opaque=True,
    missing=_missing,
    files=lambda parameters: tuple(parameters.models.values()),
    measures=True,
    is_confident=_is_confident,
)
