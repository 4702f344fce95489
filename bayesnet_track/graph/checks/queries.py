"""Checks of queries and of inputs: kinds, expressions, names, polygons, files that can be read."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from bayesnet_track.graph.checks.factors import explain_name
from bayesnet_track.graph.checks.lifecycle import GraphCheck
from bayesnet_track.graph.checks.plates import (
    discrete_fields,
    moving_fields,
    names_of_inputs,
    numbers_of_kinds,
    root_of,
    upright_fields,
)
from bayesnet_track.graph.expressions.evaluate import CONDITIONS
from bayesnet_track.graph.expressions.parse import parse_value
from bayesnet_track.graph.expressions.terms import (
    FRAME_NAMES,
    FRAME_S,
    WORDS,
    Call,
    ExpressionError,
    Term,
    names_in,
)
from bayesnet_track.graph.settings.queries import MOST_CORNERS, Query
from bayesnet_track.graph.spec import GraphSpec, Target
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions
from bayesnet_track.observation.planes import BEFORE
from bayesnet_track.observation.protocols import BOX
from bayesnet_track.observation.timed_columns import ColumnsError, TimedInput, read_timed_columns

COLUMNS = (
    *("frame", "time_s", "target", "kind", "x", "y", "w", "h", "angle", "status", "score", "ud_px2"),
    *("quiet_px2", "sd_x", "sd_y", "sd_w", "sd_h", "log_evidence", "surprise", "ess", "particles"),
    *("learn_rate", "active"),
)
"""Columns of the tables of a run, which no query may have the name of."""
MOST_BYTES = 1 << 18


def queries_ask_kinds(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """A query is about kinds of targets of the graph, and asks of them what can be asked."""
    for name, query in spec.queries.items():
        path: KeyPath = ("queries", name)
        for kind in query.kinds:
            if kind not in spec.targets:
                yield positions.message(
                    (*path, "of"), f"unknown target {kind!r}", list(spec.targets), word=kind
                )
        if not 1 <= len(query.kinds) <= 2:
            problem = f"{len(query.kinds)} kinds of targets"
            yield positions.message((*path, "of"), problem, "one kind, or two for pairs: [hand, face]")
        if query.is_pair and query.kind in ("count", "crosses"):
            problem = f"{query.kind} of a pair of targets"
            yield positions.message((*path, "of"), problem, f"one kind, such as of: {query.kinds[0]}")
        if query.unit is not None and query.kind != "value":
            problem = f"unit beside {query.kind}, which has none"
            yield positions.message((*path, "unit"), problem, "value beside it, or no unit", on_key=True)
        if query.event_above is not None and query.kind not in ("probability", "crosses"):
            problem = f"event_above beside {query.kind}, which is no probability"
            advice = "probability or crosses beside it, or no event_above"
            yield positions.message((*path, "event_above"), problem, advice, on_key=True)
        if "interval" in query.model_fields_set and query.kind == "probability":
            problem = "interval beside probability, which has none"
            yield positions.message((*path, "interval"), problem, "value, count or crosses", on_key=True)


def queries_can_be_read(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """Their expressions are of names that exist, conditions for probabilities and numbers for values."""
    for name, query in spec.queries.items():
        if len(query.kinds) not in (1, 2) or any(kind not in spec.targets for kind in query.kinds):
            continue
        for keys, text in query.texts:
            path: KeyPath = ("queries", name, *keys)
            try:
                term = parse_value(text, names_in_query(spec, query))
            except ExpressionError as error:
                message = positions.message(path, error.found, error.allowed)
                yield positions.inside(_explain(message, error, query), error.at)
                continue
            names_read = names_in(term)
            if query.kind == "value" and _is_condition(term):
                yield positions.message(path, "a condition, which is true or false", f'probability: "{text}"')
            if query.kind != "value" and not _is_condition(term):
                problem = "a number, which has no probability"
                yield positions.message(
                    path, problem, f'a condition such as "{text[:60]} > 0", or value: for the number'
                )
            if query.is_pair and not {"a", "b"} <= {
                node.partition(".")[0] for node in names_read if "." in node
            }:
                problem = "a pair of which only one target is read"
                advice = f"a.x and b.x in the expression, or of: {query.kinds[0]} with x"
                yield positions.message(path, problem, advice)


def _is_condition(term: Term) -> bool:
    """True of a comparison, or of conditions joined by and, or, not.

    >>> from bayesnet_track.graph.expressions.parse import parse, parse_value
    >>> _is_condition(parse("x > 3 and not y < 2")), _is_condition(parse("where(x > 3, 1, 0)"))
    (True, False)
    """
    return isinstance(term, Call) and term.function in CONDITIONS


def names_in_query(spec: GraphSpec, query: Query) -> tuple[str, ...]:
    """The names of a query's expression."""
    fields = [fields_of(spec.targets[kind]) for kind in query.kinds]
    if query.is_pair:
        first, second = fields
        fields_read = (*(f"a.{name}" for name in first), *(f"b.{name}" for name in second))
    else:
        fields_read = fields[0]
    numbers = numbers_of_kinds(spec, query.kinds)
    return (*fields_read, *FRAME_NAMES, FRAME_S, *names_of_inputs(spec.inputs), *numbers)


def fields_of(target: Target) -> tuple[str, ...]:
    """The fields of the state of a kind of target, and what it is: its mode, its categories."""
    root = root_of(target)
    if root is None:
        return BOX
    names = (*BOX, *moving_fields(root), *upright_fields(target), *discrete_fields(root))
    return tuple(dict.fromkeys(names))


def _explain(message: GraphMessage, error: ExpressionError, query: Query) -> GraphMessage:
    if query.is_pair and error.word in BOX:
        problem = f"name {error.word!r}, and there are two targets"
        return replace(message, found=problem, allowed=f"a.{error.word} or b.{error.word}")
    return explain_name(message, error.word, error.near)


def queries_have_their_own_names(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """No query has the name of a column of the run's tables, or of another query's numbers."""
    fields = {name for target in spec.targets.values() for name in fields_of(target)}
    reserved = {*COLUMNS, *fields, *(f"{name}_sd" for name in fields)}
    numbers = {end: name for name, query in spec.queries.items() for end in query.further_names(name)}
    for name in spec.queries:
        path = ("queries", name)
        if name in reserved:
            problem = f"query {name!r}, which is a column of the run's tables"
            yield positions.message(path, problem, f"another name, such as {name}_asked", on_key=True)
        elif name in numbers:
            problem = f"query {name!r}, which is a column of query {numbers[name]!r}"
            yield positions.message(path, problem, "another name", on_key=True)


QUERY_CHECKS: tuple[GraphCheck, ...] = (
    queries_ask_kinds,
    queries_can_be_read,
    queries_have_their_own_names,
)


# ------------------------------------------------------------------------------------ polygons


def with_polygons(
    spec: GraphSpec, folder: Path, positions: Positions
) -> tuple[GraphSpec, list[GraphMessage]]:
    """The graph with the corners of polygons in place of their files, and what is wrong with them."""
    errors: list[GraphMessage] = []
    queries = dict[str, Query]()
    for name, query in spec.queries.items():
        polygon = None if query.count is None else query.count.polygon
        queries[name] = query
        if query.count is None or polygon is None:
            continue
        path: KeyPath = ("queries", name, "count", "polygon")
        corners = _read_polygon(folder / polygon) if isinstance(polygon, str) else polygon
        if isinstance(corners, str):
            problem, _, advice = corners.partition("; allowed: ")
            advice = advice or "a CSV file of corners x,y, its path from where the graph file is"
            errors.append(positions.message(path, f"polygon {polygon}: {problem}", advice))
        elif len(corners) < 3:
            errors.append(positions.message(path, f"{len(corners)} corners", f"3 to {MOST_CORNERS}"))
        elif area_of(corners) == 0.0:
            advice = "three corners or more that lie on no line"
            errors.append(positions.message(path, "a polygon without an area", advice))
        else:
            counted = query.count.model_copy(update={"polygon": corners})
            queries[name] = query.model_copy(update={"count": counted})
    return (spec.model_copy(update={"queries": queries}) if spec.queries else spec), errors


def area_of(corners: tuple[tuple[float, float], ...]) -> float:
    """The area of a polygon, px^2.

    >>> area_of(((0.0, 0.0), (4.0, 0.0), (4.0, 3.0)))
    6.0
    """
    following = (*corners[1:], corners[0])
    return abs(sum(x * v - u * y for (x, y), (u, v) in zip(corners, following, strict=True))) / 2.0


def _read_polygon(path: Path) -> tuple[tuple[float, float], ...] | str:
    """The corners in a CSV file, or what is wrong with it; a first line of names is left out."""
    try:
        if not path.is_file():
            return "no such file" if not path.exists() else "no plain file"
        if path.stat().st_size > MOST_BYTES:
            return f"{path.stat().st_size} bytes; allowed: at most {MOST_BYTES}"
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        return getattr(error, "strerror", None) or "not a text in UTF-8"
    corners: list[tuple[float, float]] = []
    for number, row in enumerate(csv.reader(text.splitlines()), 1):
        cells = [cell.strip() for cell in row]
        if not any(cells) or cells[0].startswith("#"):
            continue
        corner = _corner(cells)
        if corner is not None:
            corners.append(corner)
        elif number > 1 or [cell.lower() for cell in cells] != ["x", "y"]:
            return f"line {number} is {', '.join(cells)[:60]!r}; allowed: two numbers x,y in px"
    if len(corners) > 3 and corners[0] == corners[-1]:
        corners.pop()  # closed, as geometries are written
    if not 3 <= len(corners) <= MOST_CORNERS:
        return f"{len(corners)} corners; allowed: 3 to {MOST_CORNERS}"
    return tuple(corners)


def _corner(cells: list[str]) -> tuple[float, float] | None:
    try:
        x, y = map(float, cells)
    except ValueError:
        return None
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


def inputs_have_their_own_names(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """No input has the name of a word, a constant, or of the value before of another input."""
    for name in spec.inputs:
        fault = ""
        if name in WORDS or name == "t":
            fault = f"input {name!r}, which is a word of expressions"
        elif name in spec.constants:
            fault = f"input {name!r}, which is a constant"
        elif name.endswith(BEFORE) and name.removesuffix(BEFORE) in spec.inputs:
            fault = f"input {name!r}, which is the value before of {name.removesuffix(BEFORE)!r}"
        if fault:
            yield positions.message(("inputs", name), fault, "another name", on_key=True)


def inputs_can_be_read(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """Every file is there and has the columns."""
    for name, source in spec.inputs.items():
        try:
            read_timed_columns(source.file, (source.column_of(name),))
        except ColumnsError as error:
            fault, _, remedy = str(error).partition("; allowed: ")
            key = "file" if source.column is None or "no column" not in fault else "column"
            yield positions.message(("inputs", name, key), fault, remedy)


def input_columns(spec: GraphSpec) -> Mapping[str, TimedInput]:
    """Input -> its column, of a graph that passed the checks.

    Raises:
        ColumnsError: a file is not there any more, or has changed so that it cannot be read.
    """
    return {
        name: TimedInput(
            read_timed_columns(source.file, (source.column_of(name),)), source.column_of(name), source.between
        )
        for name, source in spec.inputs.items()
    }


INPUT_CHECKS: tuple[GraphCheck, ...] = (inputs_have_their_own_names, inputs_can_be_read)
