"""The rooms of the package: which may import which, and that no two modules import each other in a circle."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = "bayesnet_track"
MAPPED = ("cues", "graphs")  # top-level folders that are installed inside the package

BASE = {"journal", "numerics"}
MAY_IMPORT = {
    "journal": {"numerics"},
    "numerics": set(),
    "graphs": set(),
    "observation": {"numerics"},
    "vision": {"graphs", "numerics", "observation"},
    "graph": {"graphs", "numerics", "observation"},
    "adapt": BASE | {"graph", "observation"},
    "belief": BASE | {"graph", "observation"},
    "cues": {"numerics", "observation", "vision"},
    "sources": BASE | {"observation", "vision"},
    "view": BASE | {"graph", "observation"},
    "inference": BASE | {"adapt", "belief", "graph", "observation", "view"},
    "engine": BASE | {"adapt", "belief", "graph", "inference", "observation", "sources", "vision"},
    "evaluate": BASE | {"belief", "engine", "graph", "observation", "sources"},
    "runtime": BASE
    | {"adapt", "belief", "engine", "graph", "inference", "observation", "sources", "view", "vision"},
    "cli": BASE
    | {"engine", "evaluate", "graph", "graphs", "inference", "observation", "runtime", "sources", "view"}
    | {"vision"},
    "__init__": {"graph", "observation", "runtime", "vision"},
    "__main__": {"cli"},
}
FLOORS = 9
MOST_LINES = 450


def module_files() -> dict[str, Path]:
    """Dotted name -> file, of every module that is installed."""
    files = {}
    for path in (
        *(ROOT / PACKAGE).rglob("*.py"),
        *(file for top in MAPPED for file in (ROOT / top).glob("*.py")),
    ):
        parts = path.relative_to(ROOT).with_suffix("").parts
        parts = parts if parts[0] == PACKAGE else (PACKAGE, *parts)
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


FILES = module_files()


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """Every node of a module's syntax tree."""
    return tuple(ast.walk(ast.parse(path.read_text("utf-8"))))


def imported(path: Path) -> Iterator[str]:
    """The project's modules that a file imports, at its top or inside a function."""
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == PACKAGE:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in FILES else str(node.module)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == PACKAGE)


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else "__init__"


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """Module -> the modules that it imports; made by the one worker that runs these tests."""
    return {module: {one for one in imported(path) if one != module} for module, path in FILES.items()}


def test_every_folder_is_a_room_that_is_listed():
    assert {room(module) for module in FILES} == set(MAY_IMPORT)
    assert len(MAY_IMPORT) <= 16 + 2


def test_modules_import_only_what_their_room_may(imports):
    wrong = [
        f"{FILES[module].relative_to(ROOT)} imports {other}"
        for module, others in sorted(imports.items())
        for other in sorted(others)
        if room(other) not in MAY_IMPORT[room(module)] | {room(module)}
    ]
    assert wrong == []


def test_what_rooms_may_import_is_what_they_do_import(imports):
    used = {name: set() for name in MAY_IMPORT}
    for module, others in imports.items():
        used[room(module)] |= {room(other) for other in others} - {room(module)}
    assert used == MAY_IMPORT


def test_no_modules_import_each_other_in_a_circle(imports):
    order = list(TopologicalSorter(imports).static_order())  # raises CycleError, which names the circle
    assert len(order) == len(FILES)


def test_rooms_stand_on_nine_floors():
    floor: dict[str, int] = {}
    for name in TopologicalSorter(MAY_IMPORT).static_order():
        floor[name] = 1 + max((floor[below] for below in MAY_IMPORT[name]), default=0)
    assert max(floor.values()) <= FLOORS


def test_no_file_has_more_than_450_lines():
    too_long = {
        str(path.relative_to(ROOT)): count
        for path in FILES.values()
        if (count := len(path.read_text("utf-8").splitlines())) > MOST_LINES
    }
    assert too_long == {}


UNLISTED = {"engine": 30}
"""Room -> how many of its files its list may leave out. May only fall."""
READMES = sorted([*(ROOT / PACKAGE).glob("*/README.md"), *(ROOT / top / "README.md" for top in MAPPED)])


@pytest.mark.parametrize(
    "readme", [path for path in READMES if path.exists()], ids=lambda path: path.parent.name
)
def test_the_readme_of_a_room_names_each_of_its_files_and_no_other(readme):
    """A folder of a room may be named as a whole."""
    text, folder = readme.read_text("utf-8"), readme.parent
    named = set(re.findall(r"`(?:[.\w]+/)*(\w+(?:\.py|/))`", text))
    files = [path.relative_to(folder) for path in folder.rglob("*.py") if path.name != "__init__.py"]
    unnamed = [
        str(file) for file in sorted(files) if not {file.name, *(f"{part}/" for part in file.parts)} & named
    ]
    unknown = {name for name in named if name.endswith(".py")} - {file.name for file in files}
    assert unknown == set(), readme
    assert len(unnamed) <= UNLISTED.get(folder.name, 0), f"{readme}: {unnamed}"


def test_tests_stand_in_the_folder_of_a_room():
    others = {"browser", "docs", "reliability", "stories", "typing"}
    folders = {path.name for path in (ROOT / "tests").iterdir() if any(path.glob("**/test_*.py"))}
    assert {name for name in folders if not name.startswith("test_")} - others <= set(MAY_IMPORT)


def parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How many parameters a function has besides `self`."""
    every = [
        *node.args.posonlyargs,
        *node.args.args,
        *node.args.kwonlyargs,
        node.args.vararg,
        node.args.kwarg,
    ]
    return sum(one is not None and one.arg not in ("self", "cls") for one in every)


def lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How many lines a function has without its docstring."""
    text = node.body[0] if ast.get_docstring(node) is not None else None
    of_text = 0 if text is None else (text.end_lineno or 0) - text.lineno + 1
    return (node.end_lineno or 0) - node.lineno + 1 - of_text


@pytest.mark.parametrize("name", ["engine", "inference", "adapt", "belief"])
def test_functions_of_the_step_are_short_and_take_at_most_six_parameters(name):
    """What travels together through these rooms is one object, such as `FrameContext`."""
    wrong = [
        f"{module}.{node.name}: {parameters(node)} parameters, {lines(node)} lines"
        for module, path in sorted(FILES.items())
        if room(module) == name
        for node in nodes(path)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (parameters(node) > 6 or lines(node) > 60)
    ]
    assert wrong == []


def front_door() -> set[str]:
    """Modules of public names, the command, plug-ins and the reference, and those behind generated pages."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    places = [*project["scripts"].values()]
    places += [place for group in project["entry-points"].values() for place in group.values()]
    reference = re.findall(r"automodule:: ([\w.]+)", (ROOT / "docs" / "api.md").read_text("utf-8"))
    pages = {module for path in (ROOT / "docs" / "make_pages").glob("*.py") for module in imported(path)}
    registered = {place.partition(":")[0] for place in places}
    return {PACKAGE, f"{PACKAGE}.__main__", *imported(FILES[PACKAGE]), *registered, *reference, *pages}


def named(path: Path) -> set[str]:
    """The project's modules that a file names in a text, to import them later."""
    texts = {node.value for node in nodes(path) if isinstance(node, ast.Constant)}
    return {text for text in texts if isinstance(text, str) and text in FILES}


def test_each_module_is_reached_from_the_front_door(imports):
    """Tests go through it: a module that nothing there leads to could be tested by its insides alone."""
    reached, waiting = set(), front_door()
    while waiting:
        reached |= waiting
        below = {other for module in waiting for other in imports[module] | named(FILES[module])}
        waiting = below - reached
    apart = {module for module, path in FILES.items() if path.name != "__init__.py"} - reached
    assert apart == set()


def test_each_room_has_a_row_in_the_page_on_architecture():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    missing = [name for name in MAY_IMPORT if not name.startswith("__") and f"| `{name}` |" not in page]
    assert missing == []


def test_the_page_on_architecture_says_where_the_lines_are():
    """To a tenth, or 60 lines: `python benchmarks/house.py` counts them."""
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([\d,]+) \| (.*) \|$", page, re.MULTILINE)
    assert {name for name, *_ in rows} == {name for name in MAY_IMPORT if not name.startswith("__")} - set(
        MAPPED
    )
    wrong = []
    for name, lines_of_room, parts in rows:
        said = {name: lines_of_room} | {
            f"{name}/{part}": n for part, n in re.findall(r"`(\w+)` ([\d,]+)", parts)
        }
        for folder, number in said.items():
            found = sum(
                len(path.read_text("utf-8").splitlines()) for path in (ROOT / PACKAGE / folder).rglob("*.py")
            )
            if abs(int(number.replace(",", "")) - found) > max(60, found / 10):
                wrong.append(f"{folder}: {found} lines, {number} in the table")
    assert wrong == []
