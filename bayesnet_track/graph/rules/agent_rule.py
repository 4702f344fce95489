"""Contract of a rule by which an agent switches itself off: settings, condition, checks, words.

A rule is a subclass of `AgentRule` in a file of its own, and a field of `AgentNode`, whose name is its key in
the language. All else follows from these two: the streak that counts its frames, the decision, the sentence
in the log, the rest of the agent, the documentation of the key, and what `--no-adaptation` takes away.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal, Protocol

from bayesnet_track.graph.settings.adapt import Level
from bayesnet_track.graph.settings.base import Model
from bayesnet_track.observation.cue import CueDeclaration, Floats

AgentMeasure = Literal["agent_ud_px2", "kl", "contribution", "strength"]
"""A number that is measured of every active agent in every frame; UD in px^2, the others in nats."""


class AgentMeasures(Protocol):
    """Measures of one agent for T targets in one frame."""

    def measured(self, quantity: AgentMeasure) -> Floats:
        """(T,) the quantity; NaN where the agent gave no evidence, is off, or was switched by hand."""
        ...


@dataclass(frozen=True)
class AgentPlace:
    """The place of an agent with a rule in its graph.

    Attributes:
        name: the agent.
        cue: what is known of its cue; None where no such cue is installed.
        siblings: the other agents of its plate.
    """

    name: str
    cue: CueDeclaration | None
    siblings: tuple[str, ...]


@dataclass(frozen=True)
class RuleFlaw:
    """A setting of a rule that cannot be meant.

    Attributes:
        key: the setting.
        problem: what is wrong with it.
        remedy: what would be right.
    """

    key: str
    problem: str
    remedy: str | Iterable[str] = ""


class AgentRule(Model):
    """An agent switches itself off when a quantity has lain beyond `level` for `frames` frames in a row.

    It may be switched on again only after `rest` frames; each further self-stop doubles its rest. The last
    active agent never stops itself, and none does while the target is lost.

    Attributes:
        quantity: the quantity in words, as it stands behind "its" in the log.
        unit: the unit of the level where that is a plain number, with the space before it.
        relation: whether the agent stops above or below the level.
        adapts_first: whether an agent that can (`LocallyAdaptable`) first tries to help itself, in every
            frame in which the condition holds.
        cause: how the journal holds the numbers: in `words`, as a `RuleCause`, which has the rule's own
            words; or as those of the agent's own `ud`, a `Cause`.
    """

    quantity: ClassVar[str]
    unit: ClassVar[str] = ""
    relation: ClassVar[Literal[">", "<"]]
    adapts_first: ClassVar[bool] = False
    cause: ClassVar[Literal["words", "ud"]] = "words"

    if TYPE_CHECKING:  # each rule has these as settings, described in its own words

        @property
        def frames(self) -> int:
            """Consecutive frames before the agent stops."""
            ...

        @property
        def rest(self) -> int:
            """Frames before it may be switched on again."""
            ...

    @property
    def level(self) -> Level | float:
        """The threshold: a level of UD, for values in px^2, or a plain number."""
        raise NotImplementedError

    def values(self, measures: AgentMeasures) -> Floats:
        """(T,) the quantity that is compared with the level; NaN where nothing can be said."""
        raise NotImplementedError

    def flaws(self, place: AgentPlace) -> Iterator[RuleFlaw]:
        """Settings that cannot be meant where the agent stands."""
        return iter(())
