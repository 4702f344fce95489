"""What a detector reports of a crowd: misses, false boxes, noise, and people that it takes for one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.detector import Detections
from bayesnet_track.sources.detection_files import format_mot
from simulated.walkers import HEIGHTS_PX, WIDTH_SHARE, Crowd

Merging = Literal["none", "front", "hull"]


@dataclass(frozen=True)
class DetectorSettings:
    """How a detector errs.

    Attributes:
        missed: probability that a box is missing, independently.
        clutter: mean number of false boxes per frame, Poisson distributed, uniform over the image and as
            large as people.
        place_px: sd of a centre coordinate in px.
        size: sd of log width and log height.
        merging: what it makes of people who overlap, directly or through others: `none`, a box of each;
            `front`, the box of the one nearest to the camera alone; `hull`, one box around all of them.
        merge_iou: overlap (IoU) of two true boxes from which on it merges them.
    """

    missed: float = 0.1
    clutter: float = 5.0
    place_px: float = 3.0
    size: float = 0.05
    merging: Merging = "none"
    merge_iou: float = 0.3

    def __post_init__(self) -> None:
        if not 0 <= self.missed <= 1:
            raise ValueError(f"missed {self.missed:g}; expected a probability from 0 to 1")
        for name in ("clutter", "place_px", "size"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} {getattr(self, name):g}; expected a number from 0 on")
        if self.merging not in get_args(Merging):
            raise ValueError(f"merging {self.merging!r}; expected {', '.join(get_args(Merging))}")
        if not 0 < self.merge_iou <= 1:
            raise ValueError(f"merge_iou {self.merge_iou:g}; expected an overlap above 0, at most 1")


@dataclass(frozen=True, eq=False)
class Reported:
    """What is reported of a frame.

    Attributes:
        detections: the boxes in random order, all of score 1.
        people: of each, the numbers of those whom it is of; none for a false box.
    """

    detections: Detections
    people: tuple[tuple[int, ...], ...]


def detect_crowd(crowd: Crowd, settings: DetectorSettings, seed: int = 0) -> tuple[Reported, ...]:
    """What a detector reports of every frame; a frame's draws depend on the seed and its number alone."""
    streams = Streams(seed)
    return tuple(
        _detect(boxes, crowd, settings, streams.of("crowd", "detector", frame, "detect"))
        for frame, boxes in enumerate(crowd.boxes)
    )


def detections_text(reported: tuple[Reported, ...]) -> str:
    """The detections as a MOT file."""
    lines = (line for frame, one in enumerate(reported) for line in format_mot(frame, one.detections))
    return "".join(line + "\n" for line in lines)


def _detect(boxes: Floats, crowd: Crowd, settings: DetectorSettings, rng: np.random.Generator) -> Reported:
    people = _groups(boxes, settings)
    seen = rng.random(len(people)) >= settings.missed
    true = np.array([_merge(boxes[list(group)], settings) for group in people]).reshape(-1, 4)
    true[:, :2] += settings.place_px * rng.standard_normal((len(true), 2))
    true[:, 2:] *= np.exp(settings.size * rng.standard_normal((len(true), 2)))
    false = _clutter(crowd, rng.poisson(settings.clutter), rng)
    found = np.concatenate([true[seen], false])
    whose = [group for group, is_seen in zip(people, seen, strict=True) if is_seen] + [()] * len(false)
    order = rng.permutation(len(found))
    detections = Detections(found[order], np.ones(len(found)), ("",) * len(found))
    return Reported(detections, tuple(whose[one] for one in order))


def _groups(boxes: Floats, settings: DetectorSettings) -> list[tuple[int, ...]]:
    """Those present, the merged ones together, in the order of their first."""
    present = np.flatnonzero(np.isfinite(boxes[:, 0]))
    if settings.merging == "none":
        return [(one,) for one in present.tolist()]
    near = overlap(boxes[present][:, None], boxes[present][None, :]) >= settings.merge_iou
    labels = np.arange(len(present))
    for one, other in np.argwhere(np.triu(near, 1)):
        labels[labels == labels[other]] = labels[one]
    return [tuple(present[labels == label].tolist()) for label in dict.fromkeys(labels.tolist())]


def _merge(boxes: Floats, settings: DetectorSettings) -> Floats:
    """The one box of a group (n, 4), the last nearest to the camera."""
    if settings.merging == "hull":
        low = (boxes[:, :2] - boxes[:, 2:] / 2).min(axis=0)
        high = (boxes[:, :2] + boxes[:, 2:] / 2).max(axis=0)
        return np.concatenate([(low + high) / 2, high - low])
    return np.asarray(boxes[-1], dtype=np.float64)


def _clutter(crowd: Crowd, count: int, rng: np.random.Generator) -> Floats:
    heights = rng.uniform(*HEIGHTS_PX, count)
    image = np.array([crowd.settings.width, crowd.settings.height])
    places = rng.uniform(-0.5, image - 0.5, (count, 2))
    return np.column_stack([places, WIDTH_SHARE * heights, heights])
