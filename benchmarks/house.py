"""Measure the structure of the package: rooms, floors, arrows, circles, and what its lines are.

    python benchmarks/house.py [--at CLONE]

A room is a folder of the package (`cues` and `graphs` included), an arrow a room that imports another one.
`code` is what is left without docstrings, comments, imports and blank lines. Functions are counted without
docstrings. `tests/test_architecture.py` holds the rules that the figures keep to. Nothing is imported or run.
"""

from __future__ import annotations

import argparse
import ast
import statistics
from collections import Counter
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

PACKAGE, MAPPED = "bayesnet_track", ("cues", "graphs")
KINDS = ("code", "docs", "imports", "blank")
STEP = ("engine", "inference", "adapt", "belief")
MOST_LINES, MOST_PARAMETERS = 60, 6


def files_of(root: Path) -> dict[str, Path]:
    """Module -> file, of everything that is installed."""
    found = {}
    for top in (PACKAGE, *MAPPED):
        for path in sorted((root / top).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            parts = parts if top == PACKAGE else (PACKAGE, *parts)
            found[".".join(parts).removesuffix(".__init__")] = path
    return found


def imported(tree: ast.AST, files: dict[str, Path]) -> Iterator[str]:
    """The modules of the package that a module imports, at its top or in a function."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == PACKAGE:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in files else str(node.module)


def docstrings(tree: ast.AST) -> Iterator[ast.Expr]:
    """Texts that stand alone: docstrings, and those of attributes."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield node


def kinds(text: str, tree: ast.AST) -> Counter[str]:
    """How many lines of a module are of which of `KINDS`."""
    lines = [line.strip() for line in text.splitlines()]
    kind = ["docs" if line.startswith("#") else "code" if line else "blank" for line in lines]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            kind[node.lineno - 1 : node.end_lineno] = ["imports"] * ((node.end_lineno or 0) - node.lineno + 1)
    for node in docstrings(tree):
        kind[node.lineno - 1 : node.end_lineno] = ["docs"] * ((node.end_lineno or 0) - node.lineno + 1)
    return Counter(kind)


def is_long(node: ast.AST) -> bool:
    """Whether it is a function of more lines or parameters than the step's may have."""
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return False
    text = node.body[0] if ast.get_docstring(node) is not None else None
    lines = (node.end_lineno or 0) - node.lineno + 1
    lines -= 0 if text is None else (text.end_lineno or 0) - text.lineno + 1
    own = node.args
    names = [one for one in (*own.posonlyargs, *own.args, *own.kwonlyargs, own.vararg, own.kwarg) if one]
    return (
        lines > MOST_LINES or len([one for one in names if one.arg not in ("self", "cls")]) > MOST_PARAMETERS
    )


def room(module: str) -> str:
    """The room that a module is in; the package's own two files are rooms by themselves."""
    return module.split(".")[1] if "." in module else "__init__"


def main() -> None:
    """Print the figures, then a table by room."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--at", type=Path, default=Path(__file__).parents[1], metavar="CLONE")
    files = files_of(parser.parse_args().at)
    texts = {module: path.read_text("utf-8") for module, path in files.items()}
    trees = {module: ast.parse(text) for module, text in texts.items()}
    imports = {module: {*imported(tree, files)} - {module} for module, tree in trees.items()}
    rooms: dict[str, set[str]] = {room(module): set() for module in files}
    for module, others in imports.items():
        rooms[room(module)] |= {room(other) for other in others} - {room(module)}
    floor: dict[str, int] = {}
    try:
        for name in TopologicalSorter(rooms).static_order():
            floor[name] = 1 + max((floor[below] for below in rooms[name]), default=0)
        list(TopologicalSorter(imports).static_order())
        circles = "none"
    except CycleError as error:
        circles = " -> ".join(error.args[1])
    inside = {module for module in files if room(module) not in MAPPED}
    sizes = sorted(
        len(texts[module].splitlines()) for module in inside if files[module].name != "__init__.py"
    )
    count = sum(not name.startswith("__") for name in rooms)
    print(f"rooms {count}, floors {max(floor.values(), default=0)}, circles {circles}")
    print(f"arrows {sum(map(len, rooms.values()))}")
    print(f"modules {len(sizes)}, median {statistics.median(sizes):g} lines, largest {sizes[-1]}")
    for names, where in ((STEP, f"of {', '.join(STEP)}"), (tuple(rooms), "of all rooms")):
        long = [
            one
            for module, tree in trees.items()
            if room(module) in names
            for one in ast.walk(tree)
            if is_long(one)
        ]
        print(f"functions {where} over {MOST_LINES} lines or {MOST_PARAMETERS} parameters: {len(long)}")
    table: dict[str, Counter[str]] = {}
    for module, text in texts.items():
        of_room = table.setdefault(room(module), Counter())
        of_room.update(kinds(text, trees[module]))
        of_room["modules"] += files[module].name != "__init__.py"
    table["in all, without cues and graphs"] = sum(
        (table[name] for name in rooms if name not in MAPPED), Counter()
    )
    print(f"\n{'':32}" + "".join(f"{name:>9}" for name in ("modules", "lines", *KINDS)))
    for name, counts in sorted(table.items(), key=lambda row: -sum(row[1][kind] for kind in KINDS)):
        shown = (counts["modules"], sum(counts[kind] for kind in KINDS), *(counts[kind] for kind in KINDS))
        print(f"{name:32}" + "".join(f"{count:9,}" for count in shown))


if __name__ == "__main__":
    main()
