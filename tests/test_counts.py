"""Counts of the house that may only fall, room by room: files, names, docstrings, lonely functions, imports.

`tests/ceilings.json` holds their limits. `python tests/test_counts.py [ROOM ...]` lowers those whose counts
have fallen, and raises none.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
CEILINGS = Path(__file__).with_name("ceilings.json")
PACKAGE = "bayesnet_track"
VAGUE = frozenset(
    re.findall(
        r"\w+",
        """
        one own found said now left known given seen kept chosen inside above last other others
        away what held most least allowed moved old new best before after whole rest here there
        then out down across below where near of at shown drawn asked wanted close done around
        started until which by both again taken since used more on off apart every usual further
        ahead about alone several made changed told heard alike worth far within outside
        """,
    )
)
SIDES = {"right", "top", "bottom"}
RELATIVE = {"What", "Whether", "Those", "Where", "Which", "How", "As", "Why", "Who", "Whose", "That", "When"}
EVERYWHERE = "all rooms"
"""Row of the names that two modules define, whichever rooms they are of."""


class Place(NamedTuple):
    room: str
    file: str
    line: int
    text: str


class Module(NamedTuple):
    name: str
    file: str
    room: str
    tree: ast.Module
    nodes: tuple[ast.AST, ...]
    """Every node of the tree, found once for all measures."""


@cache
def modules() -> dict[str, Module]:
    """Dotted name -> module, of everything that is installed."""
    found = {}
    for path in (*(ROOT / PACKAGE).rglob("*.py"), *(ROOT / "cues").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        parts = parts if parts[0] == PACKAGE else (PACKAGE, *parts)
        name = ".".join(parts).removesuffix(".__init__")
        room = parts[1] if len(parts) > 2 or (ROOT / PACKAGE / parts[1]).is_dir() else PACKAGE
        tree = ast.parse(path.read_text("utf-8"))
        found[name] = Module(name, str(path.relative_to(ROOT)), room, tree, tuple(ast.walk(tree)))
    return found


def files() -> Iterator[Place]:
    """Every file."""
    for module in modules().values():
        yield Place(module.room, module.file, 1, "")


def bound_names(module: Module) -> Iterator[tuple[str, int]]:
    """Names that a module gives to variables, parameters, functions and classes, with their lines."""
    for node in module.nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name, node.lineno


@cache
def models() -> frozenset[str]:
    """Names of the classes that inherit from pydantic's `BaseModel`, directly or not."""
    bases = {
        node.name: {base.id for base in node.bases if isinstance(base, ast.Name)}
        for module in modules().values()
        for node in module.nodes
        if isinstance(node, ast.ClassDef)
    }
    known = {"BaseModel"}
    while grown := {name for name, of in bases.items() if of & known} - known:
        known |= grown
    return frozenset(known)


def keys_of_the_language(module: Module) -> set[tuple[str, int]]:
    """Fields of pydantic models with their lines: a graph file names them so."""
    return {
        (line.target.id, line.lineno)
        for node in module.nodes
        if isinstance(node, ast.ClassDef) and node.name in models()
        for line in node.body
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
    }


def vague_names() -> Iterator[Place]:
    """Bound names that say nothing of what they hold, but for keys of the language.

    `left` is a side in a module that has other sides.
    """
    for module in modules().values():
        keys = keys_of_the_language(module)
        names = [bound for bound in bound_names(module) if bound not in keys]
        has_sides = any(name in SIDES for name, _ in names)
        for name, line in names:
            if name.strip("_") in VAGUE and not (name == "left" and has_sides):
                yield Place(module.room, module.file, line, name)


def relative_docstrings() -> Iterator[Place]:
    """Docstrings of functions and classes that open with a relative word, neither with a noun nor a verb."""
    for module in modules().values():
        for node in module.nodes:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                text = (ast.get_docstring(node) or " ").split(maxsplit=1)
                if text and text[0].rstrip(",:;") in RELATIVE:
                    yield Place(module.room, module.file, node.lineno, f'{node.name}: "{text[0]} …"')


def public_functions(module: Module) -> dict[str, int]:
    return {
        node.name: node.lineno
        for node in module.tree.body
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_")
    }


def used_elsewhere(module: Module) -> set[tuple[str, str]]:
    """(module, name) of what a module uses of others, at its top or in a function."""
    used, whole = set(), {}
    for node in module.nodes:
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                if inner in modules():
                    whole[alias.asname or alias.name] = inner
                else:
                    used.add((node.module, alias.name))
    for node in module.nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in whole:
            used.add((whole[node.value.id], node.attr))
    return used


def functions_of_one_caller() -> Iterator[Place]:
    """Public functions that only one other module uses, and their own not at all."""
    callers: dict[tuple[str, str], set[str]] = defaultdict(set)
    for module in modules().values():
        for name in used_elsewhere(module):
            callers[name].add(module.name)
    for module in modules().values():
        within = {
            node.id for node in module.nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)
        }
        for name, line in public_functions(module).items():
            others = callers[module.name, name]
            if len(others) == 1 and name not in within:
                yield Place(module.room, module.file, line, f"{name}, used by {min(others)}")


def names_defined_twice() -> Iterator[Place]:
    """Public classes and functions at the top of a module whose name another module defines as well."""
    places: dict[str, list[Place]] = defaultdict(list)
    for module in modules().values():
        for node in module.tree.body:
            if (
                isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
                and node.name[0] != "_"
            ):
                places[node.name].append(Place(EVERYWHERE, module.file, node.lineno, node.name))
    for name, found in sorted(places.items()):
        if len(found) > 1:
            where = ", ".join(f"{place.file}:{place.line}" for place in found[1:])
            yield found[0]._replace(text=f"{name}, also {where}")


def modules_that_tests_import() -> Iterator[Place]:
    """Modules that tests import directly, but for the package: tests go through the front door.

    Who imports a module from its folder does not use the folder's own file.
    """
    met = set()
    for path in sorted((ROOT / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                names = {f"{node.module}.{alias.name}" for alias in node.names}
                met |= names if names <= modules().keys() else names | {node.module}
            elif isinstance(node, ast.Import):
                met |= {alias.name for alias in node.names}
    for name in sorted(met & modules().keys() - {PACKAGE}):
        module = modules()[name]
        yield Place(module.room, module.file, 1, "")


MEASURES = {
    "files": files,
    "vague names": vague_names,
    "docstrings that open with a relative word": relative_docstrings,
    "public functions with one caller, in another module": functions_of_one_caller,
    "public names defined twice": names_defined_twice,
    "modules that tests import directly": modules_that_tests_import,
}


def counts(measure: str) -> dict[str, int]:
    """Room -> how many places a measure finds."""
    return dict(sorted(Counter(place.room for place in MEASURES[measure]()).items()))


def describe(places: list[Place]) -> str:
    """Where they are, the files that changed last first."""
    in_file: dict[str, list[str]] = defaultdict(list)
    for place in places:
        in_file[place.file].append(f"{place.line} {place.text}".strip())
    newest = sorted(in_file, key=lambda file: -(ROOT / file).stat().st_mtime)[:12]
    return "\n".join(f"  {file}:" + "; ".join(in_file[file]) for file in newest)


@pytest.mark.parametrize("measure", MEASURES)
def test_the_counts_of_the_house_only_fall(measure: str) -> None:
    ceilings = json.loads(CEILINGS.read_text("utf-8"))[measure]
    places = list(MEASURES[measure]())
    more = [
        f"{room}: {count} {measure}, {ceilings.get(room, 0)} are allowed ({CEILINGS.name}). "
        f"The files that changed last:\n{describe([place for place in places if place.room == room])}"
        for room, count in counts(measure).items()
        if count > ceilings.get(room, 0)
    ]
    assert not more, "\n".join(more)


def lower_the_ceilings(rooms: list[str]) -> None:
    """Write the counts that have fallen, of all rooms where none is named."""
    ceilings = json.loads(CEILINGS.read_text("utf-8"))
    for measure, ceiling in ceilings.items():
        count = counts(measure)
        for room in rooms or ceiling:
            if room in ceiling:
                ceiling[room] = min(ceiling[room], count.get(room, 0))
    CEILINGS.write_text(json.dumps(ceilings, indent=2) + "\n", "utf-8")


if __name__ == "__main__":
    lower_the_ceilings(sys.argv[1:])
