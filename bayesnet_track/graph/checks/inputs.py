"""Checks of inputs: names of their own, files that can be read, and what they are used for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from bayesnet_track.graph.checks.lifecycle import GraphCheck
from bayesnet_track.graph.expressions.terms import WORDS
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.messages import GraphMessage, Positions
from bayesnet_track.observation.planes import BEFORE
from bayesnet_track.observation.timed_columns import ColumnsError, TimedInput, read_timed_columns


def inputs_have_their_own_names(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """No input has the name of a word, a constant, or of the value before of another input."""
    for name in spec.inputs:
        found = ""
        if name in WORDS or name == "t":
            found = f"input {name!r}, which is a word of expressions"
        elif name in spec.constants:
            found = f"input {name!r}, which is a constant"
        elif name.endswith(BEFORE) and name.removesuffix(BEFORE) in spec.inputs:
            found = f"input {name!r}, which is the value before of {name.removesuffix(BEFORE)!r}"
        if found:
            yield at.message(("inputs", name), found, "another name", on_key=True)


def inputs_can_be_read(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """Every file is there and has the columns."""
    for name, one in spec.inputs.items():
        try:
            read_timed_columns(one.file, (one.column_of(name),))
        except ColumnsError as error:
            found, _, allowed = str(error).partition("; allowed: ")
            key = "file" if one.column is None or "no column" not in found else "column"
            yield at.message(("inputs", name, key), found, allowed)


def read_inputs(spec: GraphSpec) -> Mapping[str, TimedInput]:
    """Input -> its column, of a graph that passed the checks.

    Raises:
        ColumnsError: a file is not there any more, or has changed so that it cannot be read.
    """
    return {
        name: TimedInput(
            read_timed_columns(one.file, (one.column_of(name),)), one.column_of(name), one.between
        )
        for name, one in spec.inputs.items()
    }


INPUT_CHECKS: tuple[GraphCheck, ...] = (inputs_have_their_own_names, inputs_can_be_read)
