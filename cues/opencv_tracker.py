"""Cue: any tracker of the installed OpenCV, as an agent that measures.

The tracker is an object of OpenCV's that cannot be stored: the agent is opaque. What can be stored is the
picture and the box that it last started from, or could start from anew; a reference without its tracker
starts one there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.arrays import Image
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
from bayesnet_track.observation.planes import Plane, Planes, Region, region_of_boxes
from bayesnet_track.vision.model_files import ModelFile
from bayesnet_track.vision.planes import WholeFrame
from bayesnet_track.vision.points import GRAY, correlations, cut_region, mix_channels
from bayesnet_track.vision.siamese_networks import check_apart, reason_of

FILES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"Nano": ("backbone", "neckhead"), "Vit": ("net",), "DaSiamRPN": ("model", "kernel_cls1", "kernel_r1")}
)
"""Tracker -> the network files that it needs, by the names that OpenCV gives them."""

PAD = 64
"""Pixels of view beyond all that a tracker may sample: some never return when their samples meet a border."""
SIDES = 8.0
"""The view is so many sides of the box wide, as far as the frame is."""
LEAST_SIDE = 12.0
"""A smaller box is grown to this, px: some trackers never return on fewer pixels."""
THUMB = 8
"""Side of the pictures that are compared, px."""


def present_trackers() -> tuple[str, ...]:
    """The trackers of the installed OpenCV, by name."""
    import cv2

    homes = (cv2, getattr(cv2, "legacy", None))
    names = {
        n
        for home in homes
        for n in dir(home)
        if n.startswith("Tracker") and hasattr(getattr(home, n), "create")
    }
    return tuple(sorted(name.removeprefix("Tracker") for name in names))


def missing_tracker(name: str, models: Mapping[str, str]) -> str | None:
    """Obstacle to making a tracker here, in words; None if there is none."""
    present = present_trackers()
    if name not in present:
        return (
            f"the installed OpenCV has no tracker {name}; it has {', '.join(present)}; "
            "the wheel opencv-contrib-python-headless has more (in place of opencv-python-headless)"
        )
    needed = FILES.get(name, ())
    if set(models) != set(needed):
        return (
            f"{name} takes the models {', '.join(needed) or '(none)'}; given: {', '.join(models) or 'none'}"
        )
    odd = [ascii(path) for path in models.values() if not _is_text(path)]
    if odd:  # OpenCV crashes on it
        return f"OpenCV reads no file whose name is not valid text: {', '.join(odd)}; rename it or its folder"
    absent = [path for path in models.values() if not Path(path).is_file()]
    return f"no such model file: {', '.join(absent)}" if absent else None


def _is_text(path: str) -> bool:
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


def _made(name: str, models: Mapping[str, str]) -> Any:
    import cv2

    kind = getattr(cv2, f"Tracker{name}", None) or getattr(getattr(cv2, "legacy", None), f"Tracker{name}")
    if name not in FILES:
        return kind.create()
    settings = getattr(cv2, f"Tracker{name}_Params")()
    for file in FILES[name]:
        setattr(settings, file, models[file])
    return kind.create(settings)


class ModelError(ValueError):
    """Files of a tracker's network that end the process that loads or runs them."""


def _check_models(name: str, models: Mapping[str, str]) -> None:
    """Try a tracker with network files in a process of its own; raises ModelError where that crashes."""
    if name in FILES:
        check_apart(try_models, [*models.values()], ModelError, name=name, models=dict(models))


def try_models(name: str, models: Mapping[str, str]) -> None:
    """Start the tracker on a gray image and look for the target in another."""
    image, session = np.full((160, 160, 3), 114, np.uint8), TrackerSession(name, models)
    session.start(image, np.array([80.0, 80.0, 40.0, 40.0]), 0)
    try:
        session.update(image, 1, np.array([80.0, 80.0]))
    except Exception as error:  # OpenCV's, of a file that is no network: the agent fails with it
        raise ModelError(reason_of(error)) from error


def _seed(number: int) -> None:
    """OpenCV's generator, and the C library's, which MIL draws from too, where it can be reached."""
    import ctypes

    import cv2

    cv2.setRNGSeed(number)
    try:
        ctypes.CDLL(None).srand(number)
    except (AttributeError, OSError, TypeError):  # Windows has no such handle: there MIL does not repeat
        return


class TrackerSession:
    """One tracker on one target. It changes with every frame.

    The tracker sees a view that moves with the prediction, so that it looks where the belief expects the
    target.

    Attributes:
        image: the last picture that it saw.
        index: its number.
        box: (4,) centre box of the target in it, px; None when the tracker does not find it.
        score: the tracker's own, 0..1; None for one that has none.
        refused: what it found was not the target.
    """

    def __init__(self, name: str, models: Mapping[str, str]) -> None:
        self._name, self._models = name, models
        self.score: float | None = None

    def start(self, image: Image, box: Floats, index: int) -> None:
        """Start in a centre box (4,). The tracker is made when the first picture after it comes."""
        self.image, self.index, self._first = image, index, np.array(box, dtype=np.float64)
        self.box: Floats | None = self._first
        self._look = _thumb(image, self._first)
        self.score, self.refused = None, False
        self._tracker: Any = None
        self._given: tuple[int, int, int, int] = (0, 0, 0, 0)
        self._view: tuple[int, int] = (0, 0)

    def refuse(self) -> None:
        """Take what it found for something else."""
        self.box, self.refused = None, True

    def update(self, image: Image, index: int, expected: Floats) -> None:
        """Look for the target in the next picture around `expected`, x and y."""
        if self._tracker is None:
            self._begin()
        height, width = self._view
        x, y, w, h = self._given
        corner = np.rint(expected - [x + w / 2, y + h / 2]).astype(int)
        view = cut_region(image, Region(corner[0], corner[1], corner[0] + width, corner[1] + height))
        self.image, self.index, self.box = image, index, None
        if view.size == 0 or self._tracker is None:
            return
        _seed(index)
        is_found, given_box = self._tracker.update(view)
        if not is_found or min(given_box[2:]) <= 0:
            return
        self._given = given_box
        size = self._first[2:] * np.array(given_box[2:]) / self._started
        centre = corner + np.array(given_box[:2]) + (np.array(given_box[2:]) - 1) / 2
        self.box = np.concatenate([centre + self._off, size])
        if self._name in FILES:  # the others have the method, but nothing to say
            self.score = float(self._tracker.getTrackingScore())

    def _begin(self) -> None:
        rows, columns = self.image.shape[:2]
        low, high = self._first[:2] - self._first[2:] / 2, self._first[:2] + self._first[2:] / 2
        low, high = np.maximum(low, -0.5), np.minimum(high, [columns - 0.5, rows - 0.5])
        if (high <= low).any():
            return
        centre, size = (low + high) / 2, np.rint(np.maximum(high - low, LEAST_SIDE)).astype(int)
        width, height = (np.minimum(SIDES * size, [columns, rows]) + 2 * PAD + size).astype(int)
        corner = np.rint(centre - np.array([width, height]) / 2).astype(int)
        place = np.rint(centre - (size - 1) / 2).astype(int) - corner
        self._given = (int(place[0]), int(place[1]), int(size[0]), int(size[1]))
        self._view, self._started = (int(height), int(width)), size
        self._off = self._first[:2] - (corner + place + (size - 1) / 2)
        _seed(self.index)
        self._tracker = _made(self._name, self._models)
        view = cut_region(self.image, Region(corner[0], corner[1], corner[0] + width, corner[1] + height))
        self._tracker.init(view, self._given)

    def learn(self) -> None:
        """Take what it found for the target: what it finds next is compared with that."""
        if self.box is not None:
            self._look = _thumb(self.image, self.box)

    @property
    def likeness(self) -> float:
        """Correlation of what it found with what was last learnt, 8 x 8 px each; 0 where one is flat."""
        return 0.0 if self.box is None else float(correlations(_thumb(self.image, self.box), self._look)[0])


def _thumb(image: Image, box: Floats) -> Floats:
    import cv2

    part = cut_region(image, region_of_boxes(box[None]))
    if part.size == 0:
        return np.zeros((1, THUMB, THUMB))
    small = cv2.resize(part, (THUMB, THUMB), interpolation=cv2.INTER_AREA)
    return mix_channels(np.asarray(small, np.uint8), GRAY)[None].astype(np.float64)


TrackerName = Literal[
    "MIL", "CSRT", "KCF", "MOSSE", "MedianFlow", "TLD", "Boosting", "Nano", "Vit", "DaSiamRPN"
]


class OpencvTrackerParameters(CueParameters):
    """Parameters of an OpenCV tracker."""

    tracker: TrackerName = Field(
        default="MIL", description="OpenCV's name of the tracker; the wheel decides which are available."
    )
    models: dict[str, ModelFile] = Field(
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

    def __init__(self, arrays: Mapping[str, NDArray[Any]], session: TrackerSession) -> None:
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
        """Reference at which a tracker can start; it does when it is first asked."""
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

    def _session(self, arrays: Reference) -> TrackerSession:
        p = self.parameters
        session = TrackerSession(p.tracker, p.models)
        session.start(arrays["image"], arrays["box"], int(arrays["index"]))
        return session


def _missing(parameters: OpencvTrackerParameters) -> str | None:
    absent = missing_tracker(parameters.tracker, parameters.models)
    if absent is not None:
        return absent
    try:
        _check_models(parameters.tracker, parameters.models)
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
