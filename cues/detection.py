"""Cue: the detection that the target was given in this frame, as a measurement of its box.

Detections are shared out before any target is weighed: all targets of a plate at once, each detection to one
target at most, by where each target is expected and, if wanted, by looks
(`bayesnet_track.engine.lifecycle.association`). A target that gets none hears nothing from this agent,
so that its belief predicts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from bayesnet_track.observation.cue import (
    OBSERVED,
    OWN_DETECTION,
    OWN_LABEL,
    AssociationRule,
    CueDeclaration,
    CueParameters,
    Floats,
    Hypotheses,
    Label,
    Measurement,
    Reference,
)
from bayesnet_track.observation.planes import Plane, Planes

FIELDS = ("x", "y", "w", "h")

CONTINUE_BOX = 1.25
"""Default of `continue_box` beside `density`."""

MIN_OVERLAP = 0.2
"""Overlap below which a detection is not the target's, unless the graph says it, beside `iou`."""


class DetectionParameters(CueParameters):
    """Parameters of the detection agent."""

    sd_place: float = Field(
        default=0.06, ge=0, description="Sd of a detection's centre (share of its width and height)."
    )
    sd_size: float = Field(default=0.06, ge=0, description="Sd of a detection's sides (share of them).")
    sd_place_px: float = Field(default=0.0, ge=0, description="Further sd of a detection's centre (px).")
    sd_size_px: float = Field(default=0.0, ge=0, description="Further sd of a detection's sides (px).")
    sd_place_slow: float = Field(
        default=0.0,
        ge=0,
        description="Sd of a further error of a target's centres, which changes slowly (share of the "
        "detection's width and height). For targets on the ground.",
    )
    sd_size_slow: float = Field(
        default=0.0, ge=0, description="The same of its sides (share of them). For targets on the ground."
    )
    slow_over_s: float = Field(
        default=2.0, gt=0, description="Time in which the correlation of slow errors falls to 1 / e (s)."
    )
    similarity: Literal["density", "iou"] = Field(
        default="density",
        description="What the best assignment has most of: `density`, the log density of the detections "
        "where the targets are expected, or `iou`, the sum of intersections over union, without a gate.",
    )
    gate: float = Field(
        default=0.999,
        gt=0,
        le=1,
        description="A detection farther from the prediction than this share of correct ones is not the "
        "target's (0..1).",
    )
    min_overlap: float | None = Field(
        default=None,
        ge=0,
        le=1,
        description="A detection that overlaps the predicted box by less is not the target's (intersection "
        "over union). Default: 0 beside `density`, whose gate says how far a target may move; 0.2 beside "
        "`iou`.",
    )
    continue_box: float | None = Field(
        default=None,
        ge=0,
        le=10,
        description="Detections that would start a target go on with a live one instead, if its own stopped "
        "when they began, within this many box sides a frame of it (0: never). Default: 1.25 beside "
        "`density`, 0 beside `iou`.",
    )
    first_score: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Detections of a lower score wait for a second pass, in which they are given to targets "
        "that got none (0: one pass).",
    )
    direction: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Weight of the direction consistency beside `iou`: how well the way to a detection goes "
        "on from a target's former ones.",
    )
    direction_frames: int = Field(
        default=3, ge=1, le=30, description="Frames over which the direction is measured."
    )
    recover: bool = Field(
        default=False,
        description="Whether targets left without a detection are compared by their last one, in a further "
        "pass with the detections left.",
    )
    re_update: bool = Field(
        default=False,
        description="Whether a target that has a detection after a gap is filtered anew over the gap, along "
        "the line between both detections.",
    )
    appearance: float = Field(
        default=0.0,
        ge=0,
        le=10,
        description="Weight of the agents of appearance in the assignment (exponent of their likelihood; 0: "
        "place alone).",
    )

    points: bool = Field(
        default=False,
        description="True where detections are points, such as labels: their centres count, with errors of "
        "`sd_place_px`, and their sides say nothing. Of targets on the ground or in space, below a view.",
    )
    sd: dict[str, Annotated[float, Field(gt=0)]] = Field(
        default={},
        max_length=8,
        description="Sd of each quantity's error, in its unit, where detections are no boxes: range and "
        "bearing, places; angles in radians.",
    )
    within: dict[str, tuple[float, float]] = Field(
        default={},
        description="Least and largest value of each quantity of `sd` that the sensor gives; false ones are "
        "uniform between them.",
    )

    confusion: dict[str, dict[str, dict[str, Annotated[float, Field(gt=0, le=1)]]]] = Field(
        default={},
        max_length=1,
        description="A category, each of its values, and the probability of each label that a detection of "
        "such a target has, as `{team: {red: {red: 0.9, blue: 0.1}, ...}}`. A label that is not named says "
        "nothing. Default: labels are no evidence.",
    )

    @model_validator(mode="after")
    def _of_quantities(self) -> Self:
        if not self.sd:
            if self.within:
                raise ValueError("within is of quantities; name them in sd: {range: 2, ...}")
            return self
        boxes = sorted(self.model_fields_set & OF_BOXES)
        if boxes:
            raise ValueError(
                f"{boxes[0]} is of boxes, and sd says that detections are quantities; leave it out"
            )
        for name in self.within:
            if name not in self.sd:
                raise ValueError(f"within.{name}: no such quantity; sd has {', '.join(self.sd)}")
        for name in self.sd:
            if self.within and name not in self.within:
                raise ValueError(
                    f"within has no {name}; give the least and the largest value of each quantity"
                )
        for name, (low, high) in self.within.items():
            if not low < high:
                raise ValueError(f"within.{name}: {low:g} is not below {high:g}")
        return self

    @model_validator(mode="after")
    def _of_points(self) -> Self:
        if not self.points:
            return self
        of_sides = sorted(self.model_fields_set & (OF_BOXES - {"sd_place_px"}))
        if self.sd or of_sides:
            raise ValueError(f"points beside {of_sides[0] if of_sides else 'sd'}, which is not of points")
        if self.sd_place_px == 0:
            raise ValueError("points without sd_place_px, the sd of their errors in px; set it above 0")
        return self

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        for share, px in (("sd_place", "sd_place_px"), ("sd_size", "sd_size_px")):
            if getattr(self, share) == getattr(self, px) == 0:
                raise ValueError(f"{share} and {px} are both 0; a detection has an error: set one above 0")
        if self.similarity == "iou" and self.appearance > 0:
            raise ValueError("appearance has no effect beside similarity: iou; take similarity: density")
        if self.similarity == "density" and (self.direction > 0 or self.recover):
            word = "direction" if self.direction > 0 else "recover"
            raise ValueError(f"{word} compares overlaps; take similarity: iou beside it")
        return self


OF_BOXES = frozenset(
    {"sd_place", "sd_size", "sd_place_px", "sd_size_px", "similarity", "min_overlap", "first_score"}
    | {"sd_place_slow", "sd_size_slow", "slow_over_s"}
    | {"direction", "direction_frames", "recover", "re_update", "appearance", "continue_box"}
)
"""Parameters that are of boxes."""


@dataclass(frozen=True)
class Detection:
    """The detection agent at work. It has no reference of its own but what it is given."""

    parameters: DetectionParameters
    needs: ClassVar[tuple[Plane, ...]] = ()
    context: ClassVar[float] = 0.0

    @property
    def _min_overlap(self) -> float:
        p = self.parameters
        if p.min_overlap is not None:
            return p.min_overlap
        return MIN_OVERLAP if p.similarity == "iou" else 0.0

    @property
    def _continue_box(self) -> float:
        p = self.parameters
        if p.continue_box is not None:
            return p.continue_box
        return 0.0 if p.similarity == "iou" else CONTINUE_BOX

    @cached_property
    def rule(self) -> AssociationRule:
        """Rule by which a detection is the target's."""
        p = self.parameters
        return AssociationRule(
            0.0 if p.points else p.sd_place,
            np.inf if p.points else p.sd_size,
            p.gate,
            self._min_overlap,
            p.appearance,
            None if p.sd or p.points else p.floor,
            sd_place_px=p.sd_place_px,
            sd_size_px=p.sd_size_px,
            similarity=p.similarity,
            first_score=p.first_score,
            direction=p.direction,
            direction_frames=p.direction_frames,
            recover=p.recover,
            re_update=p.re_update,
            continue_box=self._continue_box,
        )

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """Nothing: a detection is this frame's."""
        return {}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Nothing to blend; what is remembered of former detections stays."""
        memory = {OBSERVED: old[OBSERVED]} if OBSERVED in old else {}
        return {**new, **memory} if rate > 0 else old

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """x, y, w, h, or what else is measured, of the detection given, errors independent; None without one.

        Where several may be the target's, each is a choice with its probability.
        """
        detections = reference.get(OWN_DETECTION)
        if detections is None or len(detections) == 0:
            return None
        width = len(self.parameters.sd) or len(FIELDS)
        values = detections[:, : len(self._fields) if self.parameters.points else width]
        if detections.shape[1] == width + 1:
            return self._labelled(self._measured(values[:1])[0], reference, 0)
        weights = detections[:, width + 1]
        middle, *measured = self._measured(np.concatenate([(weights @ values / weights.sum())[None], values]))
        choices = (self._labelled(choice, reference, row) for row, choice in enumerate(measured))
        return replace(middle, choices=tuple(zip(weights.tolist(), choices, strict=True)))

    def _labelled(self, measured: Measurement, reference: Reference, row: int) -> Measurement:
        """The measurement with what the detection's label says of the target."""
        log = reference.get(OWN_LABEL)
        if log is None:
            return measured
        label = Label(next(iter(self.parameters.confusion)), log[row, :-1], float(log[row, -1]))
        return replace(measured, label=label)

    @property
    def _fields(self) -> tuple[str, ...]:
        """Names of the values that are measured."""
        return FIELDS[:2] if self.parameters.points else tuple(self.parameters.sd) or FIELDS

    def _measured(self, values: Floats) -> list[Measurement]:
        """Measurements of values (N, K)."""
        means, sd, floor = np.array(values, dtype=np.float64), self.parameters.sd, self.parameters.floor
        fields = self._fields
        if sd or self.parameters.points:
            variances = np.array([*sd.values()] or [self.parameters.sd_place_px] * len(fields)) ** 2
        else:
            variances = self.rule.variances(means)[:, :, None]
        covariances = np.broadcast_to(variances * np.eye(len(fields)), (len(means), len(fields), len(fields)))
        return [Measurement(fields, *row, floor) for row in zip(means, covariances, strict=True)]


def _quantities(parameters: Any) -> tuple[str, ...]:
    return tuple(parameters.sd)


CUE = CueDeclaration(
    name="detection",
    summary="The detection assigned to the target, by expected place and appearance: measures place "
    "and size.",
    parameters=DetectionParameters,
    make=Detection,
    cost_ms=0.05,
    is_appearance=False,
    gives=_quantities,
    reads_detection=True,
    measures=True,
)
