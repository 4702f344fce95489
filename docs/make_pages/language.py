"""The language reference in Markdown, a page per block, made from specification, checks and installed cues.

python docs/make_pages/language.py
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from inspect import cleandoc
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from bayesnet_track.graph.checks.cameras import CAMERA_GRAPH_CHECKS
from bayesnet_track.graph.checks.cues import CUE_CHECKS, evidence_counts_once
from bayesnet_track.graph.checks.factors import CONSTANT_CHECKS, FACTOR_CHECKS
from bayesnet_track.graph.checks.latent import TREE_CHECKS
from bayesnet_track.graph.checks.lifecycle import EXISTENCE_CHECKS, JOIN_CHECKS, LIFE_CHECKS
from bayesnet_track.graph.checks.motion import FORMULA_JOIN_CHECKS, gaussians_are_looked_for
from bayesnet_track.graph.checks.queries import QUERY_CHECKS
from bayesnet_track.graph.checks.run import RULE_CHECKS, VALUE_CHECKS
from bayesnet_track.graph.expressions.terms import (
    FRAME_NAMES,
    FUNCTIONS,
    MAX_CHARACTERS,
    MAX_NESTING,
    MAX_TERMS,
    PARENT,
    STATE_NAMES,
)
from bayesnet_track.graph.settings.base import Choice, Model, PluginChoice
from bayesnet_track.graph.spec import LANGUAGE_VERSION, GraphSpec
from bayesnet_track.graph.text.document import MAX_BYTES, MAX_DEPTH, MAX_NODES, MAX_SCALAR
from bayesnet_track.graph.text.hints import expects, shape_of
from bayesnet_track.graph.text.write import as_plain, flow_text
from bayesnet_track.observation.cue import CueDeclaration, installed_cues

FOLDER = Path(__file__).parents[1] / "language"


@dataclass(frozen=True)
class Page:
    """A page of the reference.

    Attributes:
        title: its heading.
        about: the line that the table of pages has of it.
        roots: titles of the models with which it begins; what is first used below one is on its page.
    """

    title: str
    about: str
    roots: tuple[str, ...] = ()


PAGES: Mapping[str, Page] = {
    "graph": Page("The graph", "the file as a whole", ("graph",)),
    "targets": Page("Targets", "births, ends, existence, identities", ("target",)),
    "nodes": Page(
        "Inference nodes", "nodes, estimates, fusion, nodes drawn around others", ("inference node",)
    ),
    "cameras": Page(
        "Cameras and the ground", "states in metres, seen by cameras", ("camera source", "world state")
    ),
    "beliefs": Page("Beliefs", "particles, Gaussian, grid", ("belief",)),
    "motion": Page("Motion", "how a target moves, and its modes", ("motion", "mode")),
    "adaptation": Page(
        "Adaptation", "which agents run when, and what they learn", ("adapt", "learn", "self check")
    ),
    "status": Page(
        "Status and score",
        "lost, score, distractors, guarantees",
        ("lost", "score", "localization", "distractors", "guarantee"),
    ),
    "agents": Page("Agents", "the nodes that see", ("agent", "agent node")),
    "factors": Page("Factors and joins", "what targets have to do with each other", ("factor node", "join")),
    "queries": Page("Queries", "what the beliefs are asked in every frame", ("query",)),
    "expressions": Page("Expressions", "functions and names in formulas"),
    "cues": Page("Cues", "every installed cue and its parameters"),
    "checks": Page("Checks", "what must hold for a graph to be accepted"),
}

_OPENING = f"""# The language, version {LANGUAGE_VERSION}

{{mark}}

A graph is one YAML file. Names begin with a letter, followed by letters, digits and `_`. Units are part of
the keys (`_px`, `_px2`, `_box`: relative to the box). A *choice* is written as one key with its settings,
`fuse: {{{{pool: {{{{a: 1, b: 2}}}}}}}}`, or, if every setting has a default, as a bare word, `fuse: product`.

The file is UTF-8, at most {MAX_BYTES // 1024} KiB, {MAX_DEPTH} levels, {MAX_NODES:,} values, and
{MAX_SCALAR:,} characters a value. Scalars are those of YAML 1.2: `on`, `off`, `yes` and `no` are words.
Unknown keys, keys given twice, empty values, tags, anchors, aliases and merge keys are refused.

Every error names `file:line:column: node: what was found; what is allowed; nearest name`.

| page | about | blocks |
|---|---|---|
"""

_MARK = "<!-- Made by python docs/make_pages/language.py; do not edit. -->"


def language_reference(cues: Mapping[str, CueDeclaration] | None = None) -> dict[str, str]:
    """The text of each page by file name; `cues` are the installed ones unless given."""
    cues = installed_cues() if cues is None else cues
    places = _page_of_each_model()
    texts: dict[str, list[str]] = {name: [f"# {page.title}\n\n{_MARK}\n"] for name, page in PAGES.items()}
    for model, name in places.items():
        texts[name].append(_section(model, places))
    texts["expressions"].append(_expressions())
    texts["cues"] += _cues(cues)
    texts["checks"].append(_checks())
    index = [_OPENING.format(mark=_MARK)]
    for name, page in PAGES.items():
        blocks = [_link(model, places, "index") for model, place in places.items() if place == name]
        index.append(f"| [{page.title}]({name}.md) | {page.about} | {', '.join(blocks)} |\n")
    tree = "\n".join(PAGES)
    index.append(f"\n```{{toctree}}\n:maxdepth: 1\n:hidden:\n\n{tree}\n```\n")
    return {"index.md": "".join(index)} | {f"{name}.md": "\n".join(parts) for name, parts in texts.items()}


def _page_of_each_model() -> dict[type[Model], str]:
    """The specification's models, each after the one that first uses it, with the page that describes it."""
    roots = {title: name for name, page in PAGES.items() for title in page.roots}
    pages: dict[type[Model], str] = {}
    waiting: list[tuple[Any, str]] = [(GraphSpec, "graph")]
    while waiting:
        kind, page = waiting.pop(0)
        if isinstance(kind, type) and issubclass(kind, Model):
            if kind not in pages and (kind.model_fields or issubclass(kind, PluginChoice)):
                pages[kind] = roots.get(_title(kind), page)
                waiting = [(field.annotation, pages[kind]) for field in kind.model_fields.values()] + waiting
        elif get_origin(kind) is not None:
            waiting = [*((part, page) for part in get_args(kind)), *waiting]
    return pages


def _section(model: type[Model], places: Mapping[type[Model], str]) -> str:
    parts = [f"## {_title(model)}\n", _prose(model.__doc__ or "")]
    if not issubclass(model, PluginChoice):
        parts.append(_table(model, places, places[model]))
    return "\n".join(parts)


def _title(model: type[BaseModel]) -> str:
    """The name of a model's section: its words in lower case.

    >>> _title(GraphSpec)
    'graph'
    """
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", model.__name__).lower()
    return {"graph spec": "graph", "agent choice": "agent", "detector choice": "detector"}.get(words, words)


def _prose(docstring: str) -> str:
    """A docstring as Markdown: literal blocks become YAML."""
    text = _from_below(cleandoc(docstring).replace("``", "`"))
    head, mark, example = text.partition("Example::\n")
    if not mark:
        return text + "\n"
    return f"{head}```yaml\n{cleandoc(example)}\n```\n"


def _from_below(text: str) -> str:
    """A text whose links to pages of the documentation start in the folder of the reference.

    >>> _from_below("an [expression](expressions.md#motion)")
    'an [expression](../expressions.md#motion)'
    """
    return re.sub(r"\]\((\w+\.md)", r"](../\1", text)


def _table(model: type[BaseModel], places: Mapping[type[Model], str], here: str) -> str:
    first = "one of" if issubclass(model, Choice) else "key"
    lines = [f"| {first} | value | default | meaning |", "|---|---|---|---|"]
    for name, field in model.model_fields.items():
        value = _linked(field, places, here) or expects(field.annotation, field.metadata) or "see its type"
        default = "" if issubclass(model, Choice) else _default(field)
        cells = (f"`{name}`", value, default, _from_below(field.description or ""))
        lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _linked(field: FieldInfo, places: Mapping[type[Model], str], here: str) -> str:
    """Links to the sections of the models in a field's value, or empty when it has none."""
    links = []
    for kind in shape_of(field.annotation).kinds:
        bare = shape_of(kind).only
        if get_origin(bare) is dict:
            inner = [_link(part, places, here) for part in shape_of(get_args(bare)[1]).kinds]
            if not any(inner):
                return ""
            links.append(f"name: {' or '.join(inner)}, for each")
        elif (link := _link(bare, places, here)) and bare is not None:
            links.append(link)
        elif len(shape_of(field.annotation).kinds) > 1:
            links.append(expects(kind))
    return " or ".join(links)


def _link(kind: Any, places: Mapping[type[Model], str], here: str) -> str:
    """A link from the page `here` to the section of a model, or empty for what is none."""
    bare = shape_of(kind).only
    if not (isinstance(bare, type) and issubclass(bare, Model)):
        return ""
    if not bare.model_fields:
        return "no settings"
    title = _title(bare)
    page = "" if places[bare] == here else f"{places[bare]}.md"
    return f"[{title}]({page}#{title.replace(' ', '-')})"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=False)
    if value is None or value is PydanticUndefined or value == "":
        return ""
    return f"`{flow_text(as_plain(value))}`"


def _expressions() -> str:
    lines = [
        "Numbers, names, `+ - * / **`, `< <= > >= == !=`, `and or not` and functions; at most "
        f"{MAX_CHARACTERS:,} characters, {MAX_TERMS} numbers, names and operations, "
        f"and {MAX_NESTING} levels of nesting. [More about expressions](../expressions.md).\n",
        "| function | gives |",
        "|---|---|",
        *(f"| `{name}{one.form}` | {one.meaning} |" for name, one in FUNCTIONS.items()),
        "",
        "| name | stands for |",
        "|---|---|",
        *(f"| `{name}` | {meaning} |" for name, meaning in (STATE_NAMES | FRAME_NAMES).items()),
        f"| `{PARENT}x` ... `{PARENT}h` | the same of the state that a latent node is drawn around |",
        f"| `{PARENT}vx` ... | a further field of the root's state, at a latent node below it |",
    ]
    return "\n".join(lines) + "\n"


def _cues(cues: Mapping[str, CueDeclaration]) -> Iterator[str]:
    yield "The installed cues. Every cue's likelihood is at most 1 and at least its `floor`.\n"
    for name, cue in cues.items():
        facts = [f"{cue.summary[:1].upper()}{cue.summary[1:].rstrip('.')}."]
        facts += ["Off on a gray source."] if cue.needs_color else []
        facts += [f"Declared cost {cue.cost_ms:g} ms for 1000 hypotheses."]
        facts += [f"Learns at up to {cue.rate_max:g} per frame."] if cue.rate_max is not None else []
        facts += ["Opaque: its state cannot be stored."] if cue.opaque else []
        yield f"## {name}\n\n{' '.join(facts)}\n\n{_table(cue.parameters, {}, 'cues')}"


def _checks() -> str:
    checks = (
        *TREE_CHECKS,
        *CUE_CHECKS,
        *LIFE_CHECKS,
        *VALUE_CHECKS,
        *RULE_CHECKS,
        *EXISTENCE_CHECKS,
        evidence_counts_once,
        gaussians_are_looked_for,
        *FACTOR_CHECKS,
        *CONSTANT_CHECKS,
        *JOIN_CHECKS,
        *FORMULA_JOIN_CHECKS,
        *QUERY_CHECKS,
        *CAMERA_GRAPH_CHECKS,
    )
    lines = ["A graph is accepted when all of these hold:\n"]
    for check in checks:
        first = cleandoc(check.__doc__ or "").split("\n\n")[0].replace("\n", " ")
        lines.append(f"- {first}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for file, page_text in language_reference().items():
        (FOLDER / file).write_text(page_text, encoding="utf-8")
