"""Checks of cues of agents and verifiers, of categories, and that evidence reaches a node by one path."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from math import isclose, prod
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from bayesnet_track.graph.checks.plates import Check, Plate, camera_above, further_fields, root_of
from bayesnet_track.graph.expressions.terms import WORDS
from bayesnet_track.graph.settings.base import PluginChoice
from bayesnet_track.graph.settings.net import Category
from bayesnet_track.graph.spec import AgentChoice, AgentNode, GraphSpec, InferenceNode
from bayesnet_track.graph.text.explain import explain
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions
from bayesnet_track.observation.cue import ENTRY_POINT_GROUP, CueDeclaration, NoParameters
from bayesnet_track.observation.plugins import why_absent

Parameters = TypeVar("Parameters", bound=BaseModel)


def cues_are_installed(plate: Plate) -> Iterator[GraphMessage]:
    """Every agent and verifier names an installed cue; one of another package must be allowed."""
    for name, where, chosen in plate.spec.cue_choices():
        cue = chosen.cue
        if cue not in plate.cues:
            key, absent = (*where, cue), why_absent(ENTRY_POINT_GROUP, cue)
            if absent is not None:
                yield plate.message(name, f"cue {absent[0]}", absent[1], key=key, on_key=True)
                continue
            allowed = list(plate.cues) or "no cue is installed"
            yield plate.message(name, f"unknown cue {cue!r}", allowed, key=key, word=cue, on_key=True)


def parameters_fit_the_cue(plate: Plate) -> Iterator[GraphMessage]:
    """Every parameter is one that the cue declares, of its type and within its range."""
    for name, where, chosen in plate.spec.cue_choices():
        declaration = plate.cues.get(chosen.cue)
        if declaration is None:
            continue
        try:
            cue_parameters(chosen, declaration)
        except ValidationError as error:
            path = ("targets", plate.name, "nodes", name, *where, chosen.cue)
            model = declaration.parameters
            for message in explain(error, model, chosen.parameters, plate.at, path):
                field = model.model_fields.get(str(message.path[-1]))
                meaning = field.description if field is not None else None
                yield (
                    replace(message, allowed=f"{message.allowed} ({meaning.rstrip('.')})")
                    if meaning
                    else message
                )


def cues_have_what_they_need(plate: Plate) -> Iterator[GraphMessage]:
    """Files and parts of other libraries that a cue's parameters need are there."""
    for name, where, chosen in plate.spec.cue_choices():
        declaration = plate.cues.get(chosen.cue)
        if declaration is None or declaration.missing is None:
            continue
        try:
            parameters = cue_parameters(chosen, declaration)
        except ValidationError:
            continue
        absent = declaration.missing(parameters)
        if absent is not None:
            yield plate.message(name, absent, key=(*where, chosen.cue))


def cue_parameters(agent: AgentChoice, declaration: CueDeclaration) -> NoParameters:
    """The agent's parameters as the cue's own type; raises as `plugin_parameters`."""
    return plugin_parameters(agent, declaration.parameters)


def noises_of(plate: Plate, node: AgentNode) -> Mapping[str, str]:
    """Quantity -> the distribution of its error as text, of an agent whose errors are written so."""
    declaration = plate.cues.get(node.agent.cue)
    if declaration is None or declaration.noises is None:
        return {}
    try:
        return declaration.noises(cue_parameters(node.agent, declaration))
    except ValidationError:
        return {}  # said where parameters are checked


def declares(plate: Plate, node: AgentNode, what: Callable[[CueDeclaration, NoParameters], bool]) -> bool:
    """True if an agent's cue is such a one; what is wrong with its parameters is said elsewhere."""
    declaration = plate.cues.get(node.agent.cue)
    if declaration is None:
        return False
    try:
        return what(declaration, cue_parameters(node.agent, declaration))
    except ValidationError:
        return True


def plugin_parameters(chosen: PluginChoice, model: type[Parameters]) -> Parameters:
    """The parameters of a plug-in as its own type.

    Numbers must be numbers, as everywhere in the language; a list stands for a tuple.

    Raises:
        pydantic.ValidationError: some parameter does not fit.
    """
    return model.model_validate_json(json.dumps(dict(chosen.parameters)), strict=True)


CUE_CHECKS: tuple[Check, ...] = (cues_are_installed, parameters_fit_the_cue, cues_have_what_they_need)


Evidence = tuple[str, str, str | None]
"""A cue and its parameters: what an agent reads of the pixels; and of which camera these are."""

Box = tuple[float, float, float, float]
ELSEWHERE = 1e6
WHOLE: Box = (0.0, 0.0, 1.0, 1.0)
"""The target's own box: centre, width and height in its own."""

SHARED = 0.5
"""Share of the smaller of two boxes from which on they hold the same pixels."""


def evidence_counts_once(plate: Plate) -> Iterator[GraphMessage]:
    """Two agents that compute the same are not multiplied, which would count it twice; a pool may hold them.

    For a sound tree. Thesis 2.6: colour is counted once by a node of its own. Agents that look at parts of
    the target compute the same where half of one part lies in the other.
    """
    boxes = _boxes(plate)
    reached: dict[str, dict[Evidence, list[str]]] = {name: {} for name in plate.order}
    for name in reversed(plate.order):
        if name in plate.agents:
            evidence = _evidence(plate, name)
            if evidence is not None:
                reached[name] = {evidence: [name]}
            continue
        fuse = plate.inference[name].fuse
        here = reached[name]
        for child in plate.children[name]:
            pairs = [(evidence, agent) for evidence, below in reached.pop(child).items() for agent in below]
            for evidence, agent in pairs:
                others = here.setdefault(evidence, [])
                first = next((one for one in others if _share_pixels(boxes[one], boxes[agent])), None)
                if first is None:
                    others.append(agent)
                elif fuse is None or fuse.pool is None:
                    found = f"the same evidence as {first!r}: {evidence[0]} counts twice in {name!r}"
                    advice = "both under one node with fuse: pool, or different parameters"
                    yield plate.message(agent, found, advice, key=("agent",))


def _boxes(plate: Plate) -> dict[str | None, Box]:
    """Node -> the box that it is about, in the target's own."""
    boxes: dict[str | None, Box] = {None: WHOLE}
    for name in plate.order:
        x, y, w, h = boxes[plate.spec.nodes[name].parent]
        fuse = plate.inference[name].fuse if name in plate.inference else None
        if fuse is not None and fuse.latent is not None:
            at, size = fuse.latent.given.offset_box, fuse.latent.given.size_box
            if fuse.latent.given.written:  # where it is, is not known here: it shares no pixels with another
                x += ELSEWHERE * len(boxes)
            x, y = (x, y) if at is None else (x + at.x * w, y + at.y * h)
            w, h = (w, h) if size is None else (w * size.w, h * size.h)
        boxes[name] = (x, y, w, h)
    return boxes


def _share_pixels(one: Box, other: Box) -> bool:
    """At least the share `SHARED` of the smaller box lies in the other."""
    sides = [
        min(one[k] + one[k + 2] / 2, other[k] + other[k + 2] / 2)
        - max(one[k] - one[k + 2] / 2, other[k] - other[k + 2] / 2)
        for k in (0, 1)
    ]
    common = max(sides[0], 0.0) * max(sides[1], 0.0)
    return common >= SHARED * min(one[2] * one[3], other[2] * other[3])


def _evidence(plate: Plate, agent: str) -> Evidence | None:
    choice = plate.agents[agent].agent
    if choice.cue not in plate.cues:
        return None
    try:
        parameters = cue_parameters(choice, plate.cues[choice.cue]).model_dump_json()
        return choice.cue, parameters, camera_above(plate.spec, agent)
    except ValidationError:
        return None


MOST_TOGETHER = 16
"""Combinations of modes and values of categories: each has a Gaussian of its own."""


def _with_categories(plate: Plate) -> Iterator[tuple[str, InferenceNode, Mapping[str, Category]]]:
    for name, node in plate.inference.items():
        if node.category is not None:
            yield name, node, node.category


def categories_are_whole(plate: Plate) -> Iterator[GraphMessage]:
    """Every category has two values or more, and a prior of all of them."""
    for name, node, categories in _with_categories(plate):
        for category, one in categories.items():
            here: KeyPath = ("category", category)
            if len(set(one.values)) < len(one.values):
                twice = next(value for value in one.values if one.values.count(value) > 1)
                yield plate.message(name, f"value {twice!r} twice", "each once", key=(*here, "values"))
            elif len(one.values) == 1:
                found = f"category {category!r} of one value, which says nothing"
                yield plate.message(name, found, "at least two values", key=(*here, "values"))
            for value in one.prior:
                if value not in one.values:
                    key = (*here, "prior", value)
                    found = f"no value {value!r} of {category}"
                    yield plate.message(name, found, list(one.values), key=key, word=value, on_key=True)
            missing = [value for value in one.values if one.prior and value not in one.prior]
            if missing:
                found = f"prior of {category} without {', '.join(missing)}"
                yield plate.message(name, found, "a probability of each value", key=(*here, "prior"))
            elif one.prior and not isclose(sum(one.prior.values()), 1.0, abs_tol=1e-6):
                found = f"prior of {category} that sums to {sum(one.prior.values()):.6g}"
                yield plate.message(name, found, "probabilities that sum to 1", key=(*here, "prior"))
        together = prod(len(one.values) for one in categories.values()) * len(node.modes or [""])
        if together > MOST_TOGETHER:
            found = f"{together} combinations of modes and values of categories"
            yield plate.message(name, found, f"at most {MOST_TOGETHER}", key=("category",), on_key=True)


def categories_have_their_own_names(plate: Plate) -> Iterator[GraphMessage]:
    """Categories and their values have names that expressions can tell apart."""
    for name, node, categories in _with_categories(plate):
        taken = dict.fromkeys((*WORDS, "mode", "t"), "a word of expressions")
        taken |= dict.fromkeys(plate.frame_names, "an input") | dict.fromkeys(plate.constants, "a constant")
        taken |= dict.fromkeys(further_fields(node), "a field of the state")
        taken |= dict.fromkeys(node.modes or {}, "a mode")
        for category, one in categories.items():
            for word, key in ((category, ()), *((value, ("values",)) for value in one.values)):
                what = "value" if key else "category"
                if word in taken:
                    found = f"{what} {word!r}, which is {taken[word]}"
                    path = ("category", category, *key)
                    yield plate.message(name, found, "another name", key=path, on_key=not key)
            taken |= {category: "a category"} | dict.fromkeys(one.values, f"a value of {category}")


def confusions_name_categories(plate: Plate) -> Iterator[GraphMessage]:
    """Labels are evidence on a category of the root, with probabilities for each of its values."""
    root = plate.inference[plate.roots[0]] if plate.roots else None
    known = {} if root is None or root.category is None else root.category
    for agent, category, rows in _confusions(plate):
        here: KeyPath = ("agent", plate.agents[agent].agent.cue, "confusion")
        if category not in known:
            written = f"category: {{{category}: {{values: [{', '.join(rows)}]}}}} at the root"
            found = f"confusion of {category!r}, and the root has no such category"
            allowed: Any = list(known) or written
            yield plate.message(agent, found, allowed, key=(*here, category), word=category, on_key=True)
            continue
        values = known[category].values
        for value in rows:
            if value not in values:
                found, key = f"no value {value!r} of {category}", (*here, category, value)
                yield plate.message(agent, found, list(values), key=key, word=value, on_key=True)
        missing = [value for value in values if value not in rows]
        if missing:
            found = f"confusion of {category} without {', '.join(missing)}"
            yield plate.message(agent, found, "a row for each value", key=(*here, category), on_key=True)
        yield from _rows_are_whole(plate, agent, category, rows)


def _rows_are_whole(
    plate: Plate, agent: str, category: str, rows: Mapping[str, Any]
) -> Iterator[GraphMessage]:
    """Each row has a probability of each label, and sums to 1."""
    here: KeyPath = ("agent", plate.agents[agent].agent.cue, "confusion", category)
    written = {value: row for value, row in rows.items() if isinstance(row, Mapping)}
    labels = {label: value for value, row in written.items() for label in row}
    for value, row in written.items():
        lacking = [label for label in labels if label not in row]
        if lacking:
            found = f"confusion of {value} without label {lacking[0]!r}, which {labels[lacking[0]]} has"
            yield plate.message(agent, found, "a probability of it, as small as you like", key=(*here, value))
        numbers = [one for one in row.values() if isinstance(one, int | float)]
        if len(numbers) == len(row) and not isclose(sum(numbers), 1.0, abs_tol=1e-6):
            found = f"confusion of {value} that sums to {sum(numbers):.6g}"
            yield plate.message(agent, found, "probabilities of labels that sum to 1", key=(*here, value))


def _confusions(plate: Plate) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Agent, category and rows of each confusion that is written."""
    for agent, node in plate.agents.items():
        written = node.agent.parameters.get("confusion")
        for category, rows in written.items() if isinstance(written, Mapping) else ():
            if isinstance(rows, Mapping):
                yield agent, str(category), rows


def categories_have_evidence(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """Something says of every category which value it has: labels, or an expression that reads it."""
    for kind, target in spec.targets.items():
        root = root_of(target)
        told = set(_words(join.factor for join in spec.joins if kind in (join.between or ())))
        for node in target.nodes.values():
            if not isinstance(node, InferenceNode):
                told |= set(_words(_texts(node.model_dump())))
        for category, one in {} if root is None or root.category is None else root.category.items():
            if category in told:
                continue
            name = next(name for name, node in target.nodes.items() if node is root)
            found = f"category {category!r}, of which nothing says anything"
            rows = ", ".join(f"{value}: {{..}}" for value in one.values)
            allowed = (
                f"agent: {{detection: {{confusion: {{{category}: {{{rows}}}}}}}}}, or a factor, measures or "
                f"the factor of a join that reads {category}"
            )
            path = ("targets", kind, "nodes", name, "category", category)
            yield at.message(path, found, allowed, on_key=True)


def _texts(value: Any) -> Iterator[str]:
    """All keys and texts in plain data."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for key, inside in value.items():
            yield str(key)
            yield from _texts(inside)
    elif isinstance(value, list | tuple):
        for inside in value:
            yield from _texts(inside)


def _words(texts: Iterable[str | None]) -> Iterator[str]:
    for text in texts:
        yield from re.findall(r"[A-Za-z_][A-Za-z0-9_]*", text or "")


CATEGORY_CHECKS: tuple[Check, ...] = (
    categories_are_whole,
    categories_have_their_own_names,
    confusions_name_categories,
)
