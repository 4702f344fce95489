"""Checks of measurement functions: what an agent's quantities would be of a state, as expressions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from pydantic import ValidationError

from bayesnet_track.graph.checked import MeasuredAs
from bayesnet_track.graph.checks.cues import cue_parameters
from bayesnet_track.graph.checks.factors import latent_above, names_at
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import ExpressionError, names_in
from bayesnet_track.graph.expressions.vocabulary import PARENT
from bayesnet_track.graph.spec import AgentNode
from bayesnet_track.graph.text.messages import GraphMessage, nearest


def measures_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """Measurement functions are expressions of the state."""
    for name, node in plate.agents.items():
        for quantity, text in node.measures.items():
            try:
                parse(text, _names(plate, node))
            except ExpressionError as error:
                key = ("measures", quantity)
                message = plate.message(name, error.found, error.allowed, key=key)
                if error.word:
                    message = replace(message, nearest=nearest(error.word, error.near))
                yield plate.at.inside(message, error.at)


def measures_are_measured(plate: Plate) -> Iterator[GraphMessage]:
    """They are of quantities that the agent measures; each has one, or is a field of the state."""
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is None:
            continue
        if node.measures and (not declaration.measures or declaration.reads_detection):
            why = "is assigned detections by its box" if declaration.measures else "scores hypotheses"
            found = f"measures of {node.agent.cue}, which {why}"
            yield plate.message(name, found, "an agent such as readings", key=("measures",), on_key=True)
            continue
        if declaration.gives is None:
            continue
        try:
            given = declaration.gives(cue_parameters(node.agent, declaration))
        except ValidationError:
            continue  # said where parameters are checked
        state = _names(plate, node)
        for quantity in given:
            if quantity not in node.measures and quantity not in state:
                found = f"{quantity!r} is measured, and nothing says what it would be of a state"
                allowed = f"measures: {{{quantity}: an expression of {', '.join(state[:4])}, ...}}"
                yield plate.message(name, found, allowed, key=("agent",), on_key=True)
        for quantity in node.measures:
            if quantity not in given:
                found = f"measures of {quantity!r}, which the agent does not measure"
                key = ("measures", quantity)
                yield plate.message(name, found, given, key=key, word=quantity, on_key=True)


def measures_fit_the_belief(plate: Plate) -> Iterator[GraphMessage]:
    """They are not linear, as the root's filter may have to have them."""
    belief = plate.inference[plate.roots[0]].belief
    if belief is None or belief.gaussian is None or belief.gaussian.filter != "kalman":
        return
    for name, node in plate.agents.items():
        if node.measures and latent_above(plate, node.parent) is None:
            found = "measures beside filter: kalman, which is of linear measurements"
            yield plate.message(name, found, "filter: extended or unscented", key=("measures",), on_key=True)


def _names(plate: Plate, node: AgentNode) -> tuple[str, ...]:
    """The names of the agent's expressions: of the state whose hypotheses it is asked about."""
    return tuple(name for name in names_at(plate, node.parent) if not name.startswith(PARENT))


def read_measures(plate: Plate) -> dict[str, MeasuredAs]:
    """The measurement functions of a plate that passed the checks."""
    found = {}
    for name, node in plate.agents.items():
        if node.measures:
            found[name] = _read(plate, node)
    return found


def _read(plate: Plate, node: AgentNode) -> MeasuredAs:
    terms = {quantity: parse(text) for quantity, text in node.measures.items()}
    used = {one for term in terms.values() for one in names_in(term)}
    return MeasuredAs(terms, {name: value for name, value in plate.constants.items() if name in used})


MEASURE_CHECKS: tuple[Check, ...] = (measures_can_be_read, measures_are_measured, measures_fit_the_belief)
