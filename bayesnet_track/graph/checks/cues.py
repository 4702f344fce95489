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
from bayesnet_track.graph.text.explain import explain_errors
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions
from bayesnet_track.observation.cue import ENTRY_POINT_GROUP, CueDeclaration, NoParameters
from bayesnet_track.observation.plugins import why_absent

Parameters = TypeVar("Parameters", bound=BaseModel)


def cues_are_installed(plate: Plate) -> Iterator[GraphMessage]:
    """Every agent and verifier names an installed cue; one of another package must be allowed."""
    for name, path, choice in plate.spec.cue_choices():
        cue = choice.cue
        if cue not in plate.cues:
            key, absent = (*path, cue), why_absent(ENTRY_POINT_GROUP, cue)
            if absent is not None:
                yield plate.message(name, f"cue {absent[0]}", absent[1], key=key, on_key=True)
                continue
            remedy = list(plate.cues) or "no cue is installed"
            yield plate.message(name, f"unknown cue {cue!r}", remedy, key=key, word=cue, on_key=True)


def parameters_fit_the_cue(plate: Plate) -> Iterator[GraphMessage]:
    """Every parameter is one that the cue declares, of its type and within its range."""
    for name, subpath, choice in plate.spec.cue_choices():
        declaration = plate.cues.get(choice.cue)
        if declaration is None:
            continue
        try:
            cue_parameters(choice, declaration)
        except ValidationError as error:
            path = ("targets", plate.name, "nodes", name, *subpath, choice.cue)
            model = declaration.parameters
            for message in explain_errors(error, model, choice.parameters, plate.at, path):
                field = model.model_fields.get(str(message.path[-1]))
                meaning = field.description if field is not None else None
                yield (
                    replace(message, allowed=f"{message.allowed} ({meaning.rstrip('.')})")
                    if meaning
                    else message
                )


def cues_have_what_they_need(plate: Plate) -> Iterator[GraphMessage]:
    """Files and parts of other libraries that a cue's parameters need are there."""
    for name, path, choice in plate.spec.cue_choices():
        declaration = plate.cues.get(choice.cue)
        if declaration is None or declaration.missing is None:
            continue
        try:
            parameters = cue_parameters(choice, declaration)
        except ValidationError:
            continue
        absent = declaration.missing(parameters)
        if absent is not None:
            yield plate.message(name, absent, key=(*path, choice.cue))


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


def declares(
    plate: Plate, node: AgentNode, predicate: Callable[[CueDeclaration, NoParameters], bool]
) -> bool:
    """True if an agent's cue is such a one; what is wrong with its parameters is said elsewhere."""
    declaration = plate.cues.get(node.agent.cue)
    if declaration is None:
        return False
    try:
        return predicate(declaration, cue_parameters(node.agent, declaration))
    except ValidationError:
        return True


def plugin_parameters(choice: PluginChoice, model: type[Parameters]) -> Parameters:
    """The parameters of a plug-in as its own type.

    Numbers must be numbers, as everywhere in the language; a list stands for a tuple.

    Raises:
        pydantic.ValidationError: some parameter does not fit.
    """
    return model.model_validate_json(json.dumps(dict(choice.parameters)), strict=True)


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
        merged = reached[name]
        for child in plate.children[name]:
            pairs = [(evidence, agent) for evidence, agents in reached.pop(child).items() for agent in agents]
            for evidence, agent in pairs:
                agents = merged.setdefault(evidence, [])
                first = next(
                    (earlier for earlier in agents if _share_pixels(boxes[earlier], boxes[agent])), None
                )
                if first is None:
                    agents.append(agent)
                elif fuse is None or fuse.pool is None:
                    fault = f"the same evidence as {first!r}: {evidence[0]} counts twice in {name!r}"
                    advice = "both under one node with fuse: pool, or different parameters"
                    yield plate.message(agent, fault, advice, key=("agent",))


def _boxes(plate: Plate) -> dict[str | None, Box]:
    """Node -> the box that it is about, in the target's own."""
    boxes: dict[str | None, Box] = {None: WHOLE}
    for name in plate.order:
        x, y, w, h = boxes[plate.spec.nodes[name].parent]
        fuse = plate.inference[name].fuse if name in plate.inference else None
        if fuse is not None and fuse.latent is not None:
            offset, size = fuse.latent.given.offset_box, fuse.latent.given.size_box
            if fuse.latent.given.written:  # where it is, is not known here: it shares no pixels with another
                x += ELSEWHERE * len(boxes)
            x, y = (x, y) if offset is None else (x + offset.x * w, y + offset.y * h)
            w, h = (w, h) if size is None else (w * size.w, h * size.h)
        boxes[name] = (x, y, w, h)
    return boxes


def _share_pixels(first: Box, second: Box) -> bool:
    """At least the share `SHARED` of the smaller box lies in the other."""
    sides = [
        min(first[k] + first[k + 2] / 2, second[k] + second[k + 2] / 2)
        - max(first[k] - first[k + 2] / 2, second[k] - second[k + 2] / 2)
        for k in (0, 1)
    ]
    common = max(sides[0], 0.0) * max(sides[1], 0.0)
    return common >= SHARED * min(first[2] * first[3], second[2] * second[3])


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
        for category, settings in categories.items():
            path: KeyPath = ("category", category)
            if len(set(settings.values)) < len(settings.values):
                twice = next(value for value in settings.values if settings.values.count(value) > 1)
                yield plate.message(name, f"value {twice!r} twice", "each once", key=(*path, "values"))
            elif len(settings.values) == 1:
                fault = f"category {category!r} of one value, which says nothing"
                yield plate.message(name, fault, "at least two values", key=(*path, "values"))
            for value in settings.prior:
                if value not in settings.values:
                    key = (*path, "prior", value)
                    fault = f"no value {value!r} of {category}"
                    yield plate.message(name, fault, list(settings.values), key=key, word=value, on_key=True)
            missing = [value for value in settings.values if settings.prior and value not in settings.prior]
            if missing:
                fault = f"prior of {category} without {', '.join(missing)}"
                yield plate.message(name, fault, "a probability of each value", key=(*path, "prior"))
            elif settings.prior and not isclose(sum(settings.prior.values()), 1.0, abs_tol=1e-6):
                fault = f"prior of {category} that sums to {sum(settings.prior.values()):.6g}"
                yield plate.message(name, fault, "probabilities that sum to 1", key=(*path, "prior"))
        together = prod(len(settings.values) for settings in categories.values()) * len(node.modes or [""])
        if together > MOST_TOGETHER:
            fault = f"{together} combinations of modes and values of categories"
            yield plate.message(name, fault, f"at most {MOST_TOGETHER}", key=("category",), on_key=True)


def modes_and_categories_have_their_own_names(plate: Plate) -> Iterator[GraphMessage]:
    """Modes, categories and their values have names that expressions can tell apart."""
    for name, node in plate.inference.items():
        categories = node.category or {}
        meanings = dict.fromkeys((*WORDS, "mode", "t"), "a word of expressions")
        meanings |= dict.fromkeys(plate.frame_names, "an input") | dict.fromkeys(
            plate.constants, "a constant"
        )
        meanings |= dict.fromkeys(further_fields(node), "a field of the state")
        for mode in node.modes or {}:
            # Targets of a join have their names before a dot only.
            if mode in meanings and mode not in ("a", "b"):
                fault = f"mode {mode!r}, which is {meanings[mode]}"
                yield plate.message(name, fault, "another name", key=("modes", mode), on_key=True)
        meanings |= dict.fromkeys(node.modes or {}, "a mode")
        for category, settings in categories.items():
            for word, key in ((category, ()), *((value, ("values",)) for value in settings.values)):
                kind = "value" if key else "category"
                if word in meanings:
                    fault = f"{kind} {word!r}, which is {meanings[word]}"
                    path = ("category", category, *key)
                    yield plate.message(name, fault, "another name", key=path, on_key=not key)
            meanings |= {category: "a category"} | dict.fromkeys(settings.values, f"a value of {category}")


def confusions_name_categories(plate: Plate) -> Iterator[GraphMessage]:
    """Labels are evidence on a category of the root, with probabilities for each of its values."""
    root = plate.inference[plate.roots[0]] if plate.roots else None
    categories = {} if root is None or root.category is None else root.category
    for agent, category, rows in _confusions(plate):
        path: KeyPath = ("agent", plate.agents[agent].agent.cue, "confusion")
        if category not in categories:
            written = f"category: {{{category}: {{values: [{', '.join(rows)}]}}}} at the root"
            fault = f"confusion of {category!r}, and the root has no such category"
            remedy: Any = list(categories) or written
            yield plate.message(agent, fault, remedy, key=(*path, category), word=category, on_key=True)
            continue
        values = categories[category].values
        for value in rows:
            if value not in values:
                fault, key = f"no value {value!r} of {category}", (*path, category, value)
                yield plate.message(agent, fault, list(values), key=key, word=value, on_key=True)
        missing = [value for value in values if value not in rows]
        if missing:
            fault = f"confusion of {category} without {', '.join(missing)}"
            yield plate.message(agent, fault, "a row for each value", key=(*path, category), on_key=True)
        yield from _rows_are_whole(plate, agent, category, rows)


def _rows_are_whole(
    plate: Plate, agent: str, category: str, rows: Mapping[str, Any]
) -> Iterator[GraphMessage]:
    """Each row has a probability of each label, and sums to 1."""
    path: KeyPath = ("agent", plate.agents[agent].agent.cue, "confusion", category)
    written = {value: row for value, row in rows.items() if isinstance(row, Mapping)}
    labels = {label: value for value, row in written.items() for label in row}
    for value, row in written.items():
        lacking = [label for label in labels if label not in row]
        if lacking:
            fault = f"confusion of {value} without label {lacking[0]!r}, which {labels[lacking[0]]} has"
            yield plate.message(agent, fault, "a probability of it, as small as you like", key=(*path, value))
        numbers = [probability for probability in row.values() if isinstance(probability, int | float)]
        if len(numbers) == len(row) and not isclose(sum(numbers), 1.0, abs_tol=1e-6):
            fault = f"confusion of {value} that sums to {sum(numbers):.6g}"
            yield plate.message(agent, fault, "probabilities of labels that sum to 1", key=(*path, value))


def _confusions(plate: Plate) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Agent, category and rows of each confusion that is written."""
    for agent, node in plate.agents.items():
        written = node.agent.parameters.get("confusion")
        for category, rows in written.items() if isinstance(written, Mapping) else ():
            if isinstance(rows, Mapping):
                yield agent, str(category), rows


def categories_have_evidence(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """Something says of every category which value it has: labels, or an expression that reads it."""
    for kind, target in spec.targets.items():
        root = root_of(target)
        words = set(_words(join.factor for join in spec.joins if kind in (join.between or ())))
        for node in target.nodes.values():
            if not isinstance(node, InferenceNode):
                words |= set(_words(_texts(node.model_dump())))
        for category, settings in {} if root is None or root.category is None else root.category.items():
            if category in words:
                continue
            name = next(name for name, node in target.nodes.items() if node is root)
            fault = f"category {category!r}, of which nothing says anything"
            rows = ", ".join(f"{value}: {{..}}" for value in settings.values)
            remedy = (
                f"agent: {{detection: {{confusion: {{{category}: {{{rows}}}}}}}}}, or a factor, measures or "
                f"the factor of a join that reads {category}"
            )
            path = ("targets", kind, "nodes", name, "category", category)
            yield positions.message(path, fault, remedy, on_key=True)


def _texts(value: Any) -> Iterator[str]:
    """All keys and texts in plain data."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for key, element in value.items():
            yield str(key)
            yield from _texts(element)
    elif isinstance(value, list | tuple):
        for element in value:
            yield from _texts(element)


def _words(texts: Iterable[str | None]) -> Iterator[str]:
    for text in texts:
        yield from re.findall(r"[A-Za-z_][A-Za-z0-9_]*", text or "")


CATEGORY_CHECKS: tuple[Check, ...] = (
    categories_are_whole,
    modes_and_categories_have_their_own_names,
    confusions_name_categories,
)
