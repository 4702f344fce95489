"""The checks of categories: values and priors that are whole, names of their own, and evidence."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from math import isclose, prod
from typing import Any

from bayesnet_track.graph.checks.plates import Check, Plate, further_fields, root_of
from bayesnet_track.graph.expressions.terms import WORDS
from bayesnet_track.graph.settings.net import Category
from bayesnet_track.graph.spec import GraphSpec, InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions

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
