"""The bricks of the specification: immutable models, choices, and the scalar types of the language."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, Strict, field_validator, model_validator

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
        """Settings that a bare `word` stands for: settings that are all defaults."""
        return {}

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if len(self.chosen()) != 1:
            raise ValueError(f"choose exactly one of {', '.join(type(self).model_fields)}")
        return self

    def chosen(self) -> list[str]:
        """Names of the fields that are set."""
        return [name for name in type(self).model_fields if getattr(self, name) is not None]

    @cached_property
    def kind(self) -> str:
        """Name of the field that is set."""
        return self.chosen()[0]

    @cached_property
    def settings(self) -> Any:
        """Value of the field that is set."""
        return getattr(self, self.kind)


class PluginChoice(Model):
    """Name of a plug-in and its parameters, not yet checked against the plug-in.

    Written as the bare name or as one key with the parameters. The field `WORD` of a kind of plug-in holds
    the name.
    """

    WORD: ClassVar[str] = ""

    parameters: Mapping[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _from_mapping(cls, value: Any) -> Any:
        word = cls.WORD
        if isinstance(value, str):
            return {word: value}
        if isinstance(value, Mapping) and not (word in value and set(value) <= {word, "parameters"}):
            if len(value) != 1:
                raise ValueError(f"exactly one {word}")
            ((name, parameters),) = value.items()
            return {word: name, "parameters": {} if parameters is None else parameters}
        return value

    @field_validator("parameters")
    @classmethod
    def _plain(cls, parameters: Mapping[str, Any]) -> dict[str, Any]:
        return {name: _plain_data(value) for name, value in parameters.items()}

    @property
    def plugin(self) -> str:
        """The plug-in's name."""
        return str(getattr(self, self.WORD))


class AgentChoice(PluginChoice):
    """The cue of an agent: a registered name and its parameters, not yet checked against the cue.

    Written ``agent: motion`` or ``agent: {motion: {sd_px: 2}}``.
    """

    WORD = "cue"

    cue: str = Field(max_length=64)


def _plain_data(value: Any, depth: int = 0) -> Any:
    """`value` as YAML would carry it: words, numbers, lists and mappings."""
    if depth > 16:
        raise ValueError("parameters are nested too deep")
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, int) and abs(value) < 10**18:
        return int(value)
    if isinstance(value, float) and math.isfinite(value):
        return float(value)
    if isinstance(value, (list, tuple)):
        return [_plain_data(item, depth + 1) for item in value]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: _plain_data(item, depth + 1) for key, item in value.items()}
    raise ValueError("parameters are words, finite numbers, lists and mappings")


class Empty(Model):
    """A choice without settings."""


def word_or_mapping(value: Any) -> str:
    """Form in which a setting is written: a bare word or a mapping (also as a model)."""
    return "mapping" if isinstance(value, (Mapping, Model)) else "word"
