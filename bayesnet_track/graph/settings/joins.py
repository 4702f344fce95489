"""The settings of joins: when nets of different targets depend on each other, and how."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from bayesnet_track.graph.expressions.terms import MAX_CHARACTERS
from bayesnet_track.graph.settings.base import (
    FrameCount,
    Model,
    Name,
    NotNegative,
    Number,
    Positive,
    Whole,
)


class Exclusion(Model):
    """Two targets cannot be explained by the same pixels.

    Where two boxes overlap, the pixels give evidence for the one in front only. Without `occlusion` either
    may be in front, independently in every frame.
    """

    nats: NotNegative = Field(
        default=0.0,
        description="further log-odds against one box lying wholly on the other; large for objects that never"
        " hide each other, such as people seen from above",
    )


class Occlusion(Model):
    """Which target is in front is a variable with two values that persists over frames.

    The box of the target behind gives evidence by its visible share only. The rest counts with its `level`,
    the evidence that the target had in frames in which it was visible: being hidden is better than matching
    badly, and worse than matching well.
    """

    stay: Annotated[Number, Field(ge=0.5, lt=1)] = Field(
        default=0.95, description="probability that the order is that of the last frame"
    )


class Attachment(Model):
    """A target of the second kind may be carried by one of the first: then it moves as that one does.

    Whether it is carried is a part of each of its hypotheses. `between` names the carrier's kind, then the
    carried one's.
    """

    start: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.05, description="probability per frame that it is picked up"
    )
    stay: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.97, description="probability per frame that it stays carried"
    )
    sd_px: Positive = Field(
        default=1.0, description="sd of its motion relative to the carrier's, px per frame"
    )


class Together(Model):
    """When two nets are joined, and when they part.

    The overlap of two beliefs is that of their reaches, as a share of the smaller one: a reach is the mean
    box, widened by one sd of the centre on each side.
    """

    overlap: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.05,
        description="smallest overlap at which they are joined; 0, of a `factor` alone: always",
    )
    apart_frames: FrameCount = Field(
        default=5, description="consecutive frames with a smaller overlap before they part"
    )


class Join(Model):
    """How targets of these kinds depend on each other while they are near.

    Example::

        joins:
          - between: [person, box]
            occlusion: {stay: 0.95}
            attachment: {start: 0.05, stay: 0.97}
            when: {overlap: 0.05, apart_frames: 5}
    """

    between: Annotated[tuple[Name, ...], Field(min_length=1, max_length=2)] | None = Field(
        default=None,
        description="one kind of target with itself, or two with each other; default every pair of kinds, a "
        "kind with itself included",
    )
    exclusion: Exclusion | None = Field(default=None, description="no pixel is evidence for two targets")
    occlusion: Occlusion | None = Field(default=None, description="as `exclusion`, and the order persists")
    attachment: Attachment | None = Field(default=None, description="one may carry the other")
    factor: Annotated[str, Field(max_length=MAX_CHARACTERS)] | None = Field(
        default=None,
        description="[expression](expressions.md) of the two states, `a.x` of the first kind and `b.x` of "
        "the second; a density up to a constant",
    )
    when: Together = Field(default=Together(), description="when they are joined")
    pairings: Annotated[Whole, Field(ge=1, le=64)] = Field(
        default=8, description="hypotheses of the other target that each hypothesis is paired with"
    )

    @model_validator(mode="after")
    def _joins_something(self) -> Self:
        if (self.exclusion, self.occlusion, self.attachment, self.factor) == (None,) * 4:
            raise ValueError("at least one of exclusion, occlusion, attachment, factor")
        return self

    @property
    def shares_pixels(self) -> bool:
        """True when pixels of both are accounted for."""
        return self.exclusion is not None or self.occlusion is not None

    @property
    def reweights(self) -> bool:
        """True when hypotheses of both are weighed together: by shared pixels, or by a factor."""
        return self.shares_pixels or self.factor is not None

    @property
    def stay(self) -> float:
        """Probability that the order persists; a half, no memory, without `occlusion`."""
        return 0.5 if self.occlusion is None else self.occlusion.stay

    @property
    def nats(self) -> float:
        """Log-odds against a box that lies wholly on the other."""
        return 0.0 if self.exclusion is None else self.exclusion.nats

    def holds_between(self, first: str, second: str) -> bool:
        """True when it is about targets of these two kinds."""
        if self.between is None:
            return True
        return {first, second} == set(self.between) and (first == second) == (len(set(self.between)) == 1)


def join_of(joins: tuple[Join, ...], first: str, second: str) -> int | None:
    """Index of the join between two kinds, of the first that fits; None when there is none."""
    return next((k for k, join in enumerate(joins) if join.holds_between(first, second)), None)
