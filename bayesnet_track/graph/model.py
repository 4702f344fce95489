"""The bricks of the specification: immutable models, choices, and the scalar types of the language."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, Strict, model_validator

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")]
Number = Annotated[float, Strict()]
Whole = Annotated[int, Strict()]
Truth = Annotated[bool, Strict()]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Share = Annotated[Number, Field(gt=0, le=1)]
FrameCount = Annotated[Whole, Field(ge=1, le=1_000_000)]


class Model(BaseModel):
    """Base of every part of the specification: immutable, unknown keys refused, no NaN or infinity.

    Numbers are numbers: a quoted number or a truth value is not taken for one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Choice(Model):
    """Exactly one field is set; written as its name, or as its name with settings."""

    @model_validator(mode="before")
    @classmethod
    def _bare_word(cls, value: Any) -> Any:
        return {value: cls.bare(value)} if isinstance(value, str) else value

    @classmethod
    def bare(cls, word: str) -> Any:
        """What a bare `word` stands for: settings that are all defaults."""
        return {}

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if len(self.chosen()) != 1:
            raise ValueError(f"choose exactly one of {', '.join(type(self).model_fields)}")
        return self

    def chosen(self) -> list[str]:
        """Names of the fields that are set."""
        return [name for name in type(self).model_fields if getattr(self, name) is not None]

    @property
    def kind(self) -> str:
        """Name of the field that is set."""
        return self.chosen()[0]

    @property
    def settings(self) -> Any:
        """Value of the field that is set."""
        return getattr(self, self.kind)


class Empty(Model):
    """A choice without settings."""


def word_or_mapping(value: Any) -> str:
    """Which of the two forms of a setting is used: a bare word or a mapping (also as a model)."""
    return "mapping" if isinstance(value, (Mapping, Model)) else "word"
