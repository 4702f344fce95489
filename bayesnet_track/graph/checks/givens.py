"""Checks of latent nodes whose distribution given the parent's state is written as expressions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from bayesnet_track.graph.checked import Conditional
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import DRAWN, Call, ExpressionError, Term, Variable, names_in
from bayesnet_track.graph.expressions.vocabulary import PARENT, STATE_NAMES
from bayesnet_track.graph.spec import Given
from bayesnet_track.graph.text.messages import GraphMessage, Path, nearest
from bayesnet_track.observation.protocols import BOX

KEY: Path = ("fuse", "latent", "given")
OTHERS = ("sd_px", "sd_box", "sd_log", "heavy_tail", "offset_box", "size_box")


def givens_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """Distributions are expressions of the parent's box, of own fields before, and of constants."""
    for node, given in _givens(plate):
        terms: list[Term] = []
        for name, text in given.written.items():
            own = BOX[: BOX.index(name)]
            names = (*(PARENT + field for field in BOX), *own, "pi", *plate.constants)
            try:
                terms.append(parse(text, names, draws=True))
            except ExpressionError as error:
                message = plate.message(node, error.found, error.allowed, key=(*KEY, name))
                yield plate.at.inside(_explain(message, error, name), error.at)
        if len(terms) == len(given.written) and not any(map(is_drawn, terms)):
            found = "given without a distribution: the node would have no state of its own"
            yield plate.message(node, found, "at least one field such as normal(parent.x, 5)", key=KEY)


def givens_stand_alone(plate: Plate) -> Iterator[GraphMessage]:
    """Expressions say all of the distribution, and are held by draws, or by a Gaussian."""
    for node, given in _givens(plate):
        for other in (name for name in OTHERS if name in given.model_fields_set):
            found = f"{other} beside {', '.join(given.written)}, which say the whole distribution"
            yield plate.message(node, found, "either of them", key=(*KEY, other), on_key=True)
        belief = plate.inference[node].belief
        if belief is not None and belief.kind == "grid":
            found = "grid beside a given by expressions"
            yield plate.message(node, found, "belief: particles, or gaussian", key=("belief",))


def gaussian_givens_are_normal(plate: Plate) -> Iterator[GraphMessage]:
    """A Gaussian belief about a latent node's state is of normal distributions."""
    for node, given in _givens(plate):
        belief = plate.inference[node].belief
        if belief is None or belief.kind != "gaussian":
            continue
        for name, text in given.written.items():
            try:
                term = parse(text, draws=True)
            except ExpressionError:
                continue  # `givens_can_be_read` says so
            if is_drawn(term) and isinstance(term, Call) and term.function != "normal":
                found = f"belief: gaussian, and {name} is drawn from {term.function}"
                yield plate.message(node, found, "normal, or belief: particles", key=(*KEY, name))


def is_drawn(term: Term) -> bool:
    """Whether it is a distribution, not a value."""
    return isinstance(term, Call) and term.arguments[:1] == (Variable(DRAWN),)


def read_givens(plate: Plate) -> dict[str, Conditional]:
    """The distributions by expressions of a plate that passed the checks."""
    found = {}
    for node, given in _givens(plate):
        terms = {name: parse(text, draws=True) for name, text in given.written.items()}
        used = {one for term in terms.values() for one in names_in(term)}
        constants = {name: value for name, value in plate.constants.items() if name in used}
        found[node] = Conditional(terms, constants)
    return found


def _explain(message: GraphMessage, error: ExpressionError, field: str) -> GraphMessage:
    if error.word in BOX:
        found = f"{error.word!r} in the distribution of {field!r}, which is drawn before it"
        return replace(message, found=found if error.word != field else f"{field!r} in its own distribution")
    if error.word in STATE_NAMES:
        found = f"name {error.word!r}, which a latent node's distribution does not know"
        return replace(message, found=found)
    return replace(message, nearest=nearest(error.word, error.near)) if error.word else message


def _givens(plate: Plate) -> Iterator[tuple[str, Given]]:
    for name, node in plate.inference.items():
        latent = None if node.fuse is None else node.fuse.latent
        if node.parent is not None and latent is not None and latent.given.written:
            yield name, latent.given


GIVEN_CHECKS: tuple[Check, ...] = (givens_can_be_read, givens_stand_alone, gaussian_givens_are_normal)
