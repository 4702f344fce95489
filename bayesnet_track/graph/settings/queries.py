"""The settings of queries: questions that a graph asks of its beliefs in every frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, create_model, model_validator

from bayesnet_track.graph.expressions.terms import MAX_CHARACTERS
from bayesnet_track.graph.settings.base import Model, Name, NotNegative, Number

Text = Annotated[str, Field(min_length=1, max_length=MAX_CHARACTERS)]
Level = Annotated[Number, Field(gt=0, lt=1)]
Point = tuple[Number, Number]
ENDS = ("", "_sd", "_low", "_high")
"""Ends of the names of a number's mean, sd and bounds (as in `journal.metrics.Answers`)."""
MOST_CORNERS = 1000
MOST_QUERIES = 32


class Counted(Model):
    """Targets that are counted: those inside a polygon, or those for which a condition holds.

    Example::

        queries:
          inside: {of: person, count: {polygon: zone.csv, point: foot}}
          fast: {of: car, count: {condition: "hypot(vx, vy) > 8"}}
    """

    polygon: (
        Annotated[str, Field(min_length=1, max_length=1000)]
        | Annotated[tuple[Point, ...], Field(max_length=MOST_CORNERS)]
        | None
    ) = Field(
        default=None,
        description="corners [x, y] in px, or a CSV file of them, a path from where the graph file is",
    )
    condition: Text | None = Field(
        default=None, description="instead of `polygon`: condition, an [expression](expressions.md)"
    )
    point: Literal["center", "foot"] = Field(
        default="center", description="point of the box: its centre, or the middle of its lower edge"
    )

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.polygon is None) == (self.condition is None):
            raise ValueError("exactly one of polygon, condition")
        if self.condition is not None and "point" in self.model_fields_set:
            raise ValueError("a polygon beside point")
        return self


HYSTERESIS_M = 0.1


class CrossingLine(Model):
    """Crossings of a line, each counted once when the target is surely on the other side.

    Example::

        queries:
          crossed: {of: person, crosses: {line: [[100, 240], [540, 240]], from: left}}
    """

    line: tuple[Point, Point] = Field(description="its two ends [x, y], px")
    hysteresis_px: NotNegative = Field(
        default=2.0, description="distance from the line from which on a side is sure"
    )
    hysteresis: NotNegative | None = Field(
        default=None, description="the same of targets [on the ground](metres.md), m; default 0.1"
    )
    point: Literal["center", "foot"] = Field(
        default="center", description="point of the box: its centre, or the middle of its lower edge"
    )

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if self.line[0] == self.line[1]:
            raise ValueError("a line of some length")
        return self

    @property
    def side(self) -> str:
        """The key `from`, which is no name of Python: left, right or either."""
        return str(getattr(self, "from"))


if TYPE_CHECKING:

    class Crossing(CrossingLine):
        """Crossings of a line."""
else:
    _FROM = Field(
        default="either",
        description="side from which a crossing counts, seen from the line's first end towards its second",
    )
    Crossing = create_model(
        "Crossing",
        __base__=CrossingLine,
        __doc__=CrossingLine.__doc__,
        __module__=__name__,
        **{"from": (Literal["left", "right", "either"], _FROM)},
    )


class Query(Model):
    """A question that is answered in every frame from the beliefs: one of probability, value, count, crosses.

    Example::

        queries:
          in_goal: {of: ball, probability: "x > goal_x and abs(y - 240) < 60", event_above: 0.9}
          speed: {of: car, value: "hypot(vx, vy) * m_per_px / frame_s", unit: m/s}
          near: {of: [hand, face], probability: "hypot(a.x - b.x, a.y - b.y) < 40"}
    """

    of: Name | Annotated[tuple[Name, ...], Field(max_length=8)] = Field(
        description="kind of target, each of which is asked; or two kinds: every pair, the first `a`, the "
        "second `b`"
    )
    probability: Text | None = Field(
        default=None, description="condition, an [expression](expressions.md) of the state"
    )
    value: Text | None = Field(
        default=None, description="number, an [expression](expressions.md) of the state: mean, sd, interval"
    )
    count: Counted | None = Field(default=None, description="number of targets in a polygon")
    crosses: Crossing | None = Field(default=None, description="number of crossings of a line")
    unit: Annotated[str, Field(min_length=1, max_length=32)] | None = Field(
        default=None, description="of a `value`; for readers only"
    )
    interval: Level = Field(
        default=0.9, description="share of the belief in the central interval of a number"
    )
    event_above: Level | None = Field(
        default=None,
        description="of a `probability` or `crosses`: level at which an event is written; default none",
    )

    @model_validator(mode="after")
    def _asks_one_thing(self) -> Self:
        questions = [name for name in KINDS if getattr(self, name) is not None]
        if len(questions) != 1:
            raise ValueError(f"exactly one of {', '.join(KINDS)}")
        return self

    @property
    def kind(self) -> str:
        """probability, value, count or crosses."""
        return next(name for name in KINDS if getattr(self, name) is not None)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The one kind of target, or the two of a pair."""
        return (self.of,) if isinstance(self.of, str) else self.of

    @property
    def is_pair(self) -> bool:
        """True of a query over pairs of targets."""
        return len(self.kinds) == 2

    def on_ground(self) -> Query:
        """The query in the unit of a state on the ground."""
        if self.crosses is None:
            return self
        hysteresis = HYSTERESIS_M if self.crosses.hysteresis is None else self.crosses.hysteresis
        return self.model_copy(
            update={"crosses": self.crosses.model_copy(update={"hysteresis_px": hysteresis})}
        )

    def columns(self, name: str) -> tuple[str, ...]:
        """Columns of its numbers of one target, of a query of this name; none of a pair."""
        if self.is_pair:
            return ()
        return tuple(name + end for end in ENDS[: 4 if self.kind == "value" else 1])

    def further_names(self, name: str) -> tuple[str, ...]:
        """Names of its numbers besides that of the query, of one target and of all together."""
        counts = self.kind in ("count", "crosses")
        return (*self.columns(name)[1:], *(f"{name}_count{end}" for end in ENDS if counts))

    @property
    def texts(self) -> Iterator[tuple[tuple[str, ...], str]]:
        """Keys of its expression, and the expression; none of a polygon or a line."""
        for key in ("probability", "value"):
            text = getattr(self, key)
            if text is not None:
                yield (key,), text
        if self.count is not None and self.count.condition is not None:
            yield ("count", "condition"), self.count.condition


KINDS = ("probability", "value", "count", "crosses")


def query_columns(queries: Mapping[str, Query]) -> tuple[str, ...]:
    """Columns that the queries of a graph add to a table with a row for each target and frame."""
    return tuple(column for name, query in queries.items() for column in query.columns(name))
