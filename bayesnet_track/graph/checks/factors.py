"""Checks of expressions at nodes: factors, measurement functions, distributions of latent nodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path

from pydantic import ValidationError

from bayesnet_track.graph.checked import Conditional, Factor, MeasuredAs
from bayesnet_track.graph.checks.cues import cue_parameters, noises_of, plugin_parameters
from bayesnet_track.graph.checks.lifecycle import GraphCheck
from bayesnet_track.graph.checks.plates import (
    Check,
    Plate,
    discrete_fields,
    fields_of_motion,
    further_fields,
    is_seen,
    mode_numbers,
    moving_fields,
)
from bayesnet_track.graph.expressions.parse import parse, parse_value
from bayesnet_track.graph.expressions.terms import (
    COMPUTED,
    DRAWN,
    FRAME_NAMES,
    MASK,
    PARENT,
    STATE_NAMES,
    TIMES,
    WORDS,
    Call,
    ExpressionError,
    Term,
    Variable,
    names_in,
    walk,
)
from bayesnet_track.graph.spec import AgentNode, FactorNode, Given, GraphSpec, InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions, nearest
from bayesnet_track.graphs import graph_folder
from bayesnet_track.observation.image_files import Mask, PictureError, read_mask
from bayesnet_track.observation.protocols import BOX


def constants_have_their_own_names(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """No constant has the name of a function or of a field of the state."""
    for name in spec.constants:
        if name in WORDS:
            fault = f"constant {name!r}, which is a word of expressions"
            yield positions.message(("constants", name), fault, "another name", on_key=True)


def factors_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """Every factor is an expression of names that exist at its node."""
    for name, node in plate.factors.items():
        try:
            parse(node.expression, names_at(plate, str(node.parent)), mask=node.mask is not None)
        except ExpressionError as error:
            message = plate.message(name, error.found, error.allowed, key=("factor",))
            yield plate.at.inside(explain_name(message, error.word, error.near), error.at)


def masks_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """The image of a factor is there, can be read, and is asked."""
    for name, node in plate.factors.items():
        if node.mask is None:
            continue
        wrong = plate.masks.get(node.mask)
        if isinstance(wrong, str):
            fault, _, remedy = wrong.partition("; allowed: ")
            remedy = remedy or "an image file of the frames' size, its path from where the graph file is"
            yield plate.message(name, fault, remedy, key=("mask",))
        elif not _asks_its_mask(node.expression):
            fault, remedy = "a mask that the factor does not ask", "mask(x, y) in the factor, or no factor"
            yield plate.message(name, fault, remedy, key=("mask",), on_key=True)


def _asks_its_mask(text: str) -> bool:
    try:
        return any(isinstance(term, Call) and term.function == MASK for term in walk(parse(text, mask=True)))
    except ExpressionError:
        return True  # said where expressions are checked


def masks_of(
    spec: GraphSpec, folder: Path, overrides: Mapping[str, Mask] | None = None
) -> dict[str, Mask | str]:
    """Path as written -> the mask, or what is wrong with it; of `overrides` as it is given there.

    Others are looked for in `folder`, then among the installed graphs.
    """
    masks: dict[str, Mask | str] = {}
    for target in spec.targets.values():
        for node in target.nodes.values():
            name = node.mask if isinstance(node, FactorNode) else None
            if name is None or name in masks:
                continue
            masks[name] = (
                overrides[name] if overrides is not None and name in overrides else _read_mask(name, folder)
            )
    return masks


def _read_mask(name: str, folder: Path) -> Mask | str:
    local = folder / name
    installed = Path(graph_folder()) / name
    try:
        return read_mask(local if local.exists() or not installed.is_file() else installed)
    except (PictureError, ValueError) as error:
        return f"mask {str(error)[:300]}"


def names_at(plate: Plate, node: str) -> tuple[str, ...]:
    """The names of an expression about the state of an inference node.

    A latent node has a box of its own, beside that of its parent where each of its hypotheses has one. A grid
    takes evidence once for all velocities at a place, so it knows no velocity.
    """
    latent = latent_above(plate, node)
    if latent is not None:
        fuse, belief = plate.inference[latent].fuse, plate.inference[latent].belief
        assert fuse is not None and fuse.latent is not None
        draws = belief is None or belief.particles is not None or latent == plate.roots[0]
        has_parent = draws and fuse.latent.draw != "kernel"
        state = (*BOX, *(plate.parent_names(latent) if has_parent else ()))
    elif is_seen(plate.spec, node):
        state = BOX
    else:
        root = plate.inference[plate.roots[0]]
        fields = BOX[:2] if plate.spec.state == "point" else BOX
        state = (*fields, *further_fields(root), *discrete_fields(root), *_modes(plate))
    return (*state, *FRAME_NAMES, *plate.frame_names, *plate.constants)


def agents_find_what_they_read(plate: Plate) -> Iterator[GraphMessage]:
    """The state has the fields that agents ask for, as `against: velocity` asks for `vx`, `vy`."""
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is None or declaration.reads is None:
            continue
        try:
            fields = declaration.reads(plugin_parameters(node.agent, declaration.parameters))
        except ValidationError:
            continue  # said where parameters are checked
        state = names_at(plate, str(node.parent))
        missing = [field for field in fields if field not in state]
        if missing:
            fault = f"{node.agent.cue} reads {', '.join(missing)}, which the state of this node does not have"
            remedy = "a motion with a velocity, at no latent node and on no grid"
            yield plate.message(name, fault, remedy, key=("agent", node.agent.cue))


def latent_above(plate: Plate, node: str | None) -> str | None:
    """The nearest latent node at or above `node`, whose hypotheses are seen there; None for the root's."""
    while node is not None:
        fuse = plate.inference[node].fuse
        if fuse is not None and fuse.latent is not None:
            return node
        node = plate.inference[node].parent
    return None


def _constants(plate: Plate) -> dict[str, float]:
    """Numbers that expressions of the state use by name: constants, and the modes by their numbers."""
    return {**_modes(plate), **plate.constants}


def _modes(plate: Plate) -> dict[str, float]:
    """The names of modes and of values of categories, with their numbers."""
    return mode_numbers(plate.inference[plate.roots[0]])


def read_factors(plate: Plate) -> dict[str, Factor]:
    """The factors of a plate that passed the checks."""
    factors = {}
    for name, node in plate.factors.items():
        term = parse(node.expression, mask=True)
        constants = _constants(plate)
        read = {word: constants[word] for word in names_in(term) if word in constants}
        mask = plate.masks.get(node.mask or "")
        factors[name] = Factor(str(node.parent), term, read, mask if isinstance(mask, Mask) else None)
    return factors


def explain_name(message: GraphMessage, word: str, candidates: tuple[str, ...]) -> GraphMessage:
    """The message of an unknown name with what is special about it, or the nearest name."""
    if word.startswith(PARENT):
        reason = "known only at a latent node that draws one state for each hypothesis"
        return replace(message, found=f"name {word!r}, {reason}")
    if word in STATE_NAMES:
        return replace(message, found=f"name {word!r}, which the state of this node does not have")
    return with_nearest(message, word, candidates)


def with_nearest(message: GraphMessage, word: str, candidates: tuple[str, ...]) -> GraphMessage:
    """The message of an unknown name with the nearest one; without any, what it may be."""
    if not word:
        return message
    if word in TIMES:
        hint = "t is the time in frame intervals, the frame's number at a constant rate"
        return replace(message, hint=hint)
    is_name = message.found.startswith("unknown name")
    owner, dot, name = word.rpartition(".")
    fields, form = COMPUTED.get(name, ((), ""))
    fields = tuple(owner + dot + field for field in fields)
    is_computed = is_name and fields and {*fields} <= {*candidates}
    suggestion = "" if is_computed else nearest(word, candidates)
    hints = [f"{word} is written {form.format(*fields)}"] if is_computed else []
    if is_name and not dot and not suggestion and word not in STATE_NAMES:
        hints.append(f"a column of a CSV file is an input: inputs: {{{word}: {{file: FILE.csv}}}}")
    return replace(message, nearest=suggestion, hint="; ".join(hints))


FACTOR_CHECKS: tuple[Check, ...] = (factors_can_be_read, masks_can_be_read, agents_find_what_they_read)
CONSTANT_CHECKS: tuple[GraphCheck, ...] = (constants_have_their_own_names,)


def measures_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """Measurement functions are expressions of the state."""
    for name, node in plate.agents.items():
        for quantity, text in node.measures.items():
            try:
                parse_value(text, names_of_measures(plate, node))
            except ExpressionError as error:
                key = ("measures", quantity)
                message = plate.message(name, error.found, error.allowed, key=key)
                yield plate.at.inside(with_nearest(message, error.word, error.near), error.at)


def measures_are_measured(plate: Plate) -> Iterator[GraphMessage]:
    """They are of quantities that the agent measures; each has one, or is a field of the state."""
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is None:
            continue
        if node.measures and not declaration.measures:
            fault = f"measures of {node.agent.cue}, which scores hypotheses"
            yield plate.message(name, fault, "an agent such as readings", key=("measures",), on_key=True)
            continue
        if declaration.gives is None:
            continue
        try:
            quantities = declaration.gives(cue_parameters(node.agent, declaration))
        except ValidationError:
            continue  # said where parameters are checked
        if node.measures and declaration.reads_detection and not quantities:
            fault = f"measures of {node.agent.cue}, which is assigned detections by its box"
            remedy = f"sd: {{{next(iter(node.measures))}: .., ...}} in the agent, or no measures"
            yield plate.message(name, fault, remedy, key=("measures",), on_key=True)
            continue
        state = names_of_measures(plate, node)
        for quantity in quantities:
            if quantity not in node.measures and quantity not in state:
                fault = f"{quantity!r} is measured, and nothing says what it would be of a state"
                remedy = f"measures: {{{quantity}: an expression of {', '.join(state[:4])}, ...}}"
                yield plate.message(name, fault, remedy, key=("agent",), on_key=True)
        for quantity in node.measures:
            if quantity not in quantities:
                fault = f"measures of {quantity!r}, which the agent does not measure"
                key = ("measures", quantity)
                yield plate.message(name, fault, quantities, key=key, word=quantity, on_key=True)


def measures_fit_the_belief(plate: Plate) -> Iterator[GraphMessage]:
    """They are not linear, as the root's filter may have to have them."""
    belief = plate.inference[plate.roots[0]].belief
    if belief is None or belief.gaussian is None or belief.gaussian.filter != "kalman":
        return
    for name, node in plate.agents.items():
        if node.measures and latent_above(plate, node.parent) is None:
            fault = "measures beside filter: kalman, which is of linear measurements"
            yield plate.message(name, fault, "filter: extended or unscented", key=("measures",), on_key=True)


def names_of_measures(plate: Plate, node: AgentNode) -> tuple[str, ...]:
    """The names of the agent's expressions: of the state whose hypotheses it is asked about."""
    return tuple(name for name in names_at(plate, node.parent) if not name.startswith(PARENT))


def read_measures(plate: Plate) -> dict[str, MeasuredAs]:
    """The measurement functions of a plate that passed the checks."""
    functions = {}
    for name, node in plate.agents.items():
        if node.measures or noises_of(plate, node) or delay_of(node):
            functions[name] = _read_measures(plate, node)
    return functions


def _read_measures(plate: Plate, node: AgentNode) -> MeasuredAs:
    terms = {quantity: parse(text) for quantity, text in node.measures.items()}
    errors = {quantity: parse(text, error=True) for quantity, text in noises_of(plate, node).items()}
    words = {word for term in (*terms.values(), *errors.values()) for word in names_in(term)}
    constants = {name: value for name, value in _constants(plate).items() if name in words}
    discrete = _discrete_numbers(plate.inference[plate.roots[0]])
    late = _late_fields(plate, node) if delay_of(node) else ()
    return MeasuredAs(terms, constants, errors, discrete, delay_of(node), late)


def _discrete_numbers(root: InferenceNode) -> dict[str, tuple[int, ...]]:
    """The number of the mode, and of each category's value, in each of their combinations, in order."""
    sizes = {"mode": len(root.modes or [""])}
    sizes |= {name: len(category.values) for name, category in (root.category or {}).items()}
    combinations = zip(*product(*map(range, sizes.values())), strict=True)
    return dict(zip(sizes, combinations, strict=True)) if discrete_fields(root) else {}


def delay_of(node: AgentNode) -> float:
    """Delay of what an agent measures, in frame intervals."""
    written = node.agent.parameters.get("delay", 0.0)
    return float(written) if isinstance(written, int | float) else 0.0


def _late_fields(plate: Plate, node: AgentNode) -> tuple[str, ...]:
    """The fields of the root's state that a delayed agent measures, or functions of them."""
    texts = (*node.measures.values(), *noises_of(plate, node).values())
    read = {name for text in texts for name in names_in(parse(text, error=True))}
    quantities = node.agent.parameters.get("sd", {})
    read |= {name for name in quantities if name not in node.measures}
    return tuple(name for name in (*BOX, *moving_fields(plate.inference[plate.roots[0]])) if name in read)


def delays_can_be_kept(plate: Plate) -> Iterator[GraphMessage]:
    """The belief can hold the past that a delayed agent measures."""
    root = plate.inference[plate.roots[0]]
    for name, node in plate.agents.items():
        if not delay_of(node):
            continue
        belief, key = root.belief, ("agent", node.agent.cue, "delay")
        latent = latent_above(plate, node.parent)
        if latent is not None and latent != plate.roots[0]:
            fault = f"delay at {latent}, of whose past nothing is kept"
            yield plate.message(name, fault, f"parent: {plate.roots[0]}", key=key, on_key=True)
        if belief is not None and belief.grid is not None:
            fault = "delay beside a grid, which keeps no past"
            yield plate.message(name, fault, "particles or gaussian", key=key, on_key=True)
        if belief is not None and belief.gaussian is not None and belief.gaussian.filter == "kalman":
            fault = "delay beside filter: kalman, whose state has no past"
            yield plate.message(name, fault, "filter: extended or unscented", key=key, on_key=True)
        proposal = None if belief is None or belief.particles is None else belief.particles.proposal.kind
        if proposal not in (None, "bootstrap"):
            fault = f"delay beside proposal: {proposal}, which draws hypotheses without a past"
            yield plate.message(name, fault, "proposal: bootstrap", key=key, on_key=True)
        try:
            late = _late_fields(plate, node)
        except ExpressionError:
            continue  # said where expressions are checked
        for mode, settings in (root.modes or {}).items():
            motion = settings.motion or root.motion
            fields = (*BOX, *(() if motion is None else fields_of_motion(motion)))
            lacking = [field for field in late if field not in fields]
            if lacking:
                fault = f"delay of {lacking[0]}, which mode {mode!r} does not have"
                yield plate.message(name, fault, "fields that every mode has", key=key, on_key=True)


MEASURE_CHECKS: tuple[Check, ...] = (
    measures_can_be_read,
    measures_are_measured,
    measures_fit_the_belief,
    delays_can_be_kept,
)


GIVEN_KEY: KeyPath = ("fuse", "latent", "given")
OTHERS = ("sd_px", "sd_box", "sd_log", "heavy_tail", "offset_box", "size_box")


def givens_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """Distributions are expressions of the parent's box, of own fields before, and of constants."""
    for node, conditional in _givens(plate):
        terms: list[Term] = []
        for name, text in conditional.written.items():
            earlier = BOX[: BOX.index(name)]
            names = (*plate.parent_names(node), *earlier, "pi", *plate.constants)
            try:
                terms.append(parse(text, names, draws=True))
            except ExpressionError as error:
                message = plate.message(node, error.found, error.allowed, key=(*GIVEN_KEY, name))
                yield plate.at.inside(_explain(message, error, name, plate), error.at)
        if len(terms) == len(conditional.written) and not any(map(is_drawn, terms)):
            fault = "given without a distribution: the node would have no state of its own"
            yield plate.message(node, fault, "at least one field such as normal(parent.x, 5)", key=GIVEN_KEY)


def givens_stand_alone(plate: Plate) -> Iterator[GraphMessage]:
    """Expressions say all of the distribution, and are held by draws, or by a Gaussian."""
    for node, conditional in _givens(plate):
        for key in (name for name in OTHERS if name in conditional.model_fields_set):
            fault = f"{key} beside {', '.join(conditional.written)}, which say the whole distribution"
            yield plate.message(node, fault, "either of them", key=(*GIVEN_KEY, key), on_key=True)
        belief = plate.inference[node].belief
        if belief is not None and belief.kind == "grid":
            fault = "grid beside a given by expressions"
            yield plate.message(node, fault, "belief: particles, or gaussian", key=("belief",))


def gaussian_givens_are_normal(plate: Plate) -> Iterator[GraphMessage]:
    """A Gaussian belief about a latent node's state is of normal distributions."""
    for node, conditional in _givens(plate):
        belief = plate.inference[node].belief
        if belief is None or belief.kind != "gaussian":
            continue
        for name, text in conditional.written.items():
            try:
                term = parse(text, draws=True)
            except ExpressionError:
                continue  # `givens_can_be_read` says so
            if is_drawn(term) and isinstance(term, Call) and term.function != "normal":
                fault = f"belief: gaussian, and {name} is drawn from {term.function}"
                yield plate.message(node, fault, "normal, or belief: particles", key=(*GIVEN_KEY, name))


def is_drawn(term: Term) -> bool:
    """True if it is a distribution, not a value."""
    return isinstance(term, Call) and term.arguments[:1] == (Variable(DRAWN),)


def read_givens(plate: Plate) -> dict[str, Conditional]:
    """The distributions by expressions of a plate that passed the checks."""
    conditionals = {}
    for node, conditional in _givens(plate):
        terms = {name: parse(text, draws=True) for name, text in conditional.written.items()}
        words = {word for term in terms.values() for word in names_in(term)}
        constants = {name: value for name, value in plate.constants.items() if name in words}
        conditionals[node] = Conditional(terms, constants)
    return conditionals


def _explain(message: GraphMessage, error: ExpressionError, field: str, plate: Plate) -> GraphMessage:
    if error.word in BOX:
        fault = f"{error.word!r} in the distribution of {field!r}, which is drawn before it"
        return replace(message, found=fault if error.word != field else f"{field!r} in its own distribution")
    if error.word in STATE_NAMES or error.word in plate.frame_names:
        fault = f"name {error.word!r}, which a latent node's distribution does not know"
        return replace(message, found=fault)
    return replace(message, nearest=nearest(error.word, error.near)) if error.word else message


def _givens(plate: Plate) -> Iterator[tuple[str, Given]]:
    for name, node in plate.inference.items():
        latent = None if node.fuse is None else node.fuse.latent
        if node.parent is not None and latent is not None and latent.given.written:
            yield name, latent.given


GIVEN_CHECKS: tuple[Check, ...] = (givens_can_be_read, givens_stand_alone, gaussian_givens_are_normal)
