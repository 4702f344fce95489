"""What a detector reports of a crowd: misses, false boxes, noise, and people that it takes for one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

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
        blind: share of time in which a person cannot be detected, in runs of `blind_frames` on average.
        blind_frames: mean length of such a run, geometrically distributed.
        doubles: mean number of runs of second boxes that begin on a person in a frame; such a box has a place
            and a size of its own, relative to the person's box, in every frame of its run.
        spots: mean number of runs of false boxes that begin at a place of the background in a frame.
        false_frames: mean length of both kinds of runs, geometrically distributed.
    """

    missed: float = 0.1
    clutter: float = 5.0
    place_px: float = 3.0
    size: float = 0.05
    merging: Merging = "none"
    merge_iou: float = 0.3
    blind: float = 0.0
    blind_frames: float = 6.0
    doubles: float = 0.0
    spots: float = 0.0
    false_frames: float = 5.0

    def __post_init__(self) -> None:
        if not 0 <= self.missed <= 1:
            raise ValueError(f"missed {self.missed:g}; expected a probability from 0 to 1")
        for name in ("blind_frames", "false_frames"):
            if not 1 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} {getattr(self, name):g}; expected a number from 1 on")
        if not 0 <= self.blind < 1:
            raise ValueError(f"blind {self.blind:g}; expected a share of at least 0, below 1")
        for name in ("clutter", "place_px", "size", "doubles", "spots"):
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
    """What a detector reports of every frame; a frame's draws depend on the seed and its number alone.

    Which people cannot be detected, and runs of false boxes, are drawn for all frames at once.
    """
    streams = Streams(seed)
    blind = _blind(crowd, settings, streams.of("crowd", "detector", 0, "blind"))
    false = _runs(crowd, settings, streams.of("crowd", "detector", 0, "false runs"))
    return tuple(
        _detect(
            boxes,
            crowd,
            settings,
            (blind[frame], false[frame]),
            streams.of("crowd", "detector", frame, "detect"),
        )
        for frame, boxes in enumerate(crowd.boxes)
    )


def _blind(crowd: Crowd, settings: DetectorSettings, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(frames, n) whether each person cannot be detected, a Markov chain from its long-run share on."""
    frames, people = crowd.boxes.shape[:2]
    leave = 1.0 / settings.blind_frames
    enter = leave * settings.blind / (1.0 - settings.blind)
    draws = rng.random((frames, people))
    blind = np.zeros((frames, people), np.bool_)
    blind[0] = draws[0] < settings.blind
    for frame in range(1, frames):
        blind[frame] = draws[frame] < np.where(blind[frame - 1], 1.0 - leave, enter)
    return blind


def _runs(crowd: Crowd, settings: DetectorSettings, rng: np.random.Generator) -> list[list[Floats]]:
    """For each frame the boxes (4,) of false detections that come in runs."""
    frames = len(crowd.boxes)
    false: list[list[Floats]] = [[] for _ in range(frames)]
    for frame in range(frames):
        for person in np.flatnonzero(np.isfinite(crowd.boxes[frame, :, 0])).tolist():
            for _ in range(rng.poisson(settings.doubles)):
                shift, size = rng.uniform(-0.35, 0.35, 2), np.exp(rng.uniform(np.log(0.5), np.log(1.4), 2))
                for later in range(frame, min(frame + rng.geometric(1.0 / settings.false_frames), frames)):
                    x, y, w, h = crowd.boxes[later, person]
                    if np.isfinite(x):
                        own = (x + shift[0] * w, y + shift[1] * h, size[0] * w, size[1] * h)
                        false[later].append(np.array(own))
        for box in _clutter(crowd, rng.poisson(settings.spots), rng):
            for later in range(frame, min(frame + rng.geometric(1.0 / settings.false_frames), frames)):
                false[later].append(box.copy())
    return false


def detections_text(reported: tuple[Reported, ...]) -> str:
    """The detections as a MOT file."""
    lines = (line for frame, one in enumerate(reported) for line in format_mot(frame, one.detections))
    return "".join(line + "\n" for line in lines)


def _detect(
    boxes: Floats,
    crowd: Crowd,
    settings: DetectorSettings,
    runs: tuple[NDArray[np.bool_], list[Floats]],
    rng: np.random.Generator,
) -> Reported:
    people = _groups(boxes, settings)
    blind, lasting = runs
    seen = rng.random(len(people)) >= settings.missed
    seen &= ~np.array([blind[list(group)].all() for group in people], dtype=np.bool_)
    true = np.array([_merge(boxes[list(group)], settings) for group in people]).reshape(-1, 4)
    true[:, :2] += settings.place_px * rng.standard_normal((len(true), 2))
    true[:, 2:] *= np.exp(settings.size * rng.standard_normal((len(true), 2)))
    false = _clutter(crowd, rng.poisson(settings.clutter), rng)
    if lasting:
        more = np.array(lasting)
        more[:, :2] += settings.place_px * rng.standard_normal((len(more), 2))
        more[:, 2:] *= np.exp(settings.size * rng.standard_normal((len(more), 2)))
        false = np.concatenate([false, more])
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
