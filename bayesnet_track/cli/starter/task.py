"""What is known of a task: the answers from which a first graph is written, and which go together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

FOLLOW: Mapping[str, str] = {
    "box": "one target, whose box I draw in the first frame",
    "appearing": "whatever appears, until it leaves; a detector finds it",
}
APART: Mapping[str, str] = {
    "color": "its colours are not those around it",
    "edges": "its pattern, texture or outline",
    "motion": "it moves differently from its surroundings",
    "depth": "its distance (needs two cameras or a depth sensor)",
    "shape": "its silhouette, such as that of a standing person",
    "detections": "boxes of a detector, in a file",
}
HARD: Mapping[str, str] = {
    "alike": "others look like it",
    "occlusion": "it is hidden for a while",
    "light": "the light changes",
    "camera": "the camera moves",
    "size": "it comes nearer or goes away",
    "rotation": "it rotates in the image",
}
SPEED: Mapping[str, str] = {
    "slow": "less than a tenth of its size from one frame to the next",
    "usual": "up to a third of its size",
    "fast": "up to its whole size",
}
BELIEF: Mapping[str, str] = {
    "particles": "hypotheses; for any kind of target (choose this if unsure)",
    "gaussian": "one mean and covariance, the Kalman family; cheap, never two places at once",
    "grid": "cells of the image; exact, for small targets of a constant size",
}
BUDGET: Mapping[str, str] = {
    "little": "a slow machine, or many targets",
    "usual": "a few milliseconds a frame",
    "much": "quality matters more than time",
}


class TaskError(ValueError):
    """Answers that do not go together; says why, and what to answer instead."""


@dataclass(frozen=True)
class Task:
    """The answers.

    Attributes:
        name: name of the graph.
        follow: a key of `FOLLOW`.
        apart: keys of `APART`, at least one, in that order.
        hard: keys of `HARD`.
        speed: a key of `SPEED`.
        belief: a key of `BELIEF`.
        budget: a key of `BUDGET`.
    """

    name: str = "mine"
    follow: str = "box"
    apart: tuple[str, ...] = ("color", "edges")
    hard: frozenset[str] = frozenset()
    speed: str = "usual"
    belief: str = "particles"
    budget: str = "usual"

    def __post_init__(self) -> None:
        if not self.apart:
            raise TaskError("something has to set the target apart")
        if self.belief == "gaussian" and "alike" in self.hard and "detections" not in self.apart:
            raise TaskError("a gaussian cannot be in two places: where others look alike, take particles")
        if self.belief == "grid" and self.hard & {"camera", "rotation"}:
            raise TaskError("a grid follows no camera and no rotation: take particles")
        if self.belief == "grid" and "depth" in self.apart:
            raise TaskError(
                "depth goes with a size that changes, for which a grid is too expensive: take particles"
            )
        if self.detected and self.belief == "grid":
            raise TaskError("a grid is no match for a detector's boxes: take gaussian, or particles")

    @property
    def detected(self) -> bool:
        """Whether a file of detections says where targets are."""
        return "detections" in self.apart
