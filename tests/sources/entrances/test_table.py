"""The table of entrances: every function that reads a file is in it, or named as reading files of our own."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

import pytest

from bayesnet_track.sources.entrances.table import ENTRANCES, FRAMES
from make_pages.entrances import entrances_page

ROOT = Path(__file__).parents[3]
PACKAGE = "bayesnet_track"

RUN = "a run directory, whose files the manifest verifies"
SESSION = "a folder of `annotate`, verified by its own reader"
WRITES = "nothing is read: it is written there, or synced"
SYSTEM = "the operating system or the installation"

_BY_REASON: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        RUN: (
            "cli.batch.results.Ledger._read",
            "cli.batch.results.read_table",
            "evaluate.runs._has_end",
            "evaluate.world.end_of_run",
            "journal.frame_file.FrameFile.__init__",
            "journal.frame_file.FrameFile.columns",
            "journal.frame_file.FrameFile.contents",
            "journal.reader._read",
            "journal.reader.read_seconds",
            "journal.writer.read_position",
            "runtime.checkpoints.checkpoint._of_another",
            "runtime.checkpoints.checkpoint.read_checkpoint",
            "runtime.checkpoints.recipe.Recipe.load_graph",
            "runtime.checkpoints.recipe.Recipe.read",
            "runtime.checkpoints.standing._ending",
            "runtime.checkpoints.standing._ends_with_newline",
            "runtime.arguments.held_files",
            "runtime.recording.beliefs.read_beliefs",
            "runtime.recording.manifest._restore",
            "runtime.recording.manifest.read_manifest",
            "runtime.recording.videowriter.remux",
            "runtime.recording.manifest._complete",
            "runtime.recording.run_reader.open_run",
            "runtime.recording.rundir.RunDirectory.check_version",
            "runtime.recording.manifest.write_smoothed",
            "view.page_data.read_timings",
            "view.run_page.is_page",
        ),
        SESSION: (
            "cli.commands.annotate_identities.annotate_identities",
            "runtime.annotation.answers.read_answers",
            "runtime.annotation.frame_store.FrameStore.image",
            "runtime.annotation.identity_desk.open_answers",
            "runtime.annotation.session.open_session",
        ),
        WRITES: (
            "cli.arguments.mute",
            "journal.disk.sync_folder",
            "runtime.recording.manifest.lock_run",
            "vision.calibration.write_calibration",
            "vision.camera_calibration.write_camera",
        ),
        "the cache of compiled kernels, sealed by a hash": (
            "numerics.compiled.SealedFiles._load_data",
            "numerics.compiled.SealedFiles._load_index",
            "numerics.compiled.is_whole",
        ),
        SYSTEM: (
            "cli.batch.places._memory",
            "cli.commands.graphs._init",
            "cli.doctor.check_package",
            "cli.doctor._installed",
            "runtime.executors.worker.own_bytes",
            "view.run_page._built",
        ),
        "the fingerprint of a source, which changes nothing but a comparison": ("sources.origin._samples",),
    }
)

OWN_FILES: Mapping[str, str] = MappingProxyType(
    {f"{PACKAGE}.{name}": reason for reason, names in _BY_REASON.items() for name in names}
)
"""Dotted path -> why what it reads is no entrance."""

READS = {
    "read_text",
    "read_bytes",
    "imread",
    "imreadmulti",
    "imdecode",
    "imdecodeanimation",
    "imreadanimation",
}
READS |= {
    "readNet",
    "readNetFromONNX",
    "InferenceSession",
    "VideoCapture",
    "FileStorage",
    "ZipFile",
    "TarFile",
}
READS_OF = {
    "np": {"load", "loadtxt", "fromfile", "genfromtxt", "memmap"},
    "json": {"load"},
    "csv": {"reader", "DictReader"},
    "yaml": {"load"},
    "ET": {"parse", "iterparse"},
    "Tree": {"parse", "iterparse"},
}
NO_FILES = {"RunDirectory", "webbrowser", "Image"}
"""What has an `open` that reads nothing, or reads by other functions that are found."""


MAY_READ = {"open", *READS, *(name for names in READS_OF.values() for name in names)}


def calls_of(function: ast.AST) -> Iterator[str]:
    """The calls in a function that read a file."""
    for node in ast.walk(function):
        if not isinstance(node, ast.Call):
            continue
        called = node.func
        name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
        if name not in MAY_READ:
            continue
        of = ast.unparse(called.value) if isinstance(called, ast.Attribute) else ""
        if name in READS or name in READS_OF.get(of, ()) or (name == "open" and opens_to_read(node, of)):
            yield ast.unparse(node)


def opens_to_read(call: ast.Call, of: str) -> bool:
    if of in NO_FILES:
        return False
    modes = [*call.args[:2], *(word.value for word in call.keywords if word.arg == "mode")]
    texts = [mode.value for mode in modes if isinstance(mode, ast.Constant) and isinstance(mode.value, str)]
    return not any(re.fullmatch(r"[wax]b?\+?", text) for text in texts)


def readers_in(module: str, source: str) -> dict[str, list[str]]:
    """Dotted path -> the calls that read, of the functions and methods of a module."""
    found: dict[str, list[str]] = {}

    def visit(node: ast.AST, before: str) -> None:
        for part in ast.iter_child_nodes(node):
            if isinstance(part, ast.ClassDef):
                visit(part, f"{before}.{part.name}")
            elif calls := list(calls_of(part)):
                name = getattr(part, "name", "<module>")
                found.setdefault(f"{before}.{name}", []).extend(calls)

    visit(ast.parse(source), module)
    return found


@cache
def all_readers() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for path in (*(ROOT / PACKAGE).rglob("*.py"), *(ROOT / "cues").glob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        parts = parts if parts[0] == PACKAGE else (PACKAGE, *parts)
        module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found |= readers_in(module, path.read_text("utf-8"))
    return found


OPTIONS = [path.read_text("utf-8") for path in (ROOT / PACKAGE / "cli").rglob("*.py")]
IN_TABLE = {reader for entrance in ENTRANCES for reader in entrance.readers}


def resolved(dotted: str) -> object:
    """What a dotted path names; raises ImportError, AttributeError."""
    module, names = dotted, []
    while True:
        try:
            found: object = import_module(module)
            break
        except ModuleNotFoundError:
            module, _, name = module.rpartition(".")
            names.insert(0, name)
    for name in names:
        found = getattr(found, name)
    return found


def test_every_function_that_reads_a_file_is_in_the_table():
    unknown = {name: calls for name, calls in all_readers().items() if name not in IN_TABLE | set(OWN_FILES)}
    assert unknown == {}, (
        "these functions read files: put each into the row of its entrance in "
        "bayesnet_track/sources/entrances/table.py, which says what it does not use and what it refuses; or, "
        "where it reads what this program wrote, into OWN_FILES"
    )


@pytest.mark.parametrize("dotted", sorted(IN_TABLE | set(OWN_FILES)))
def test_what_the_table_names_is_there(dotted):
    assert callable(resolved(dotted))


def test_what_reads_our_own_files_still_reads_them_and_is_no_entrance():
    assert set(OWN_FILES) <= set(all_readers())
    assert not IN_TABLE & set(OWN_FILES)


def test_a_new_reader_is_found():
    source = """
class A:
    def read(self):
        return np.load(path)
def text(path):
    def inner():
        return path.read_text()
    return inner()
def first(path):
    with path.open() as file:
        return file.readline()
def second(path):
    return open(path, encoding="utf-8").read()
def third(path):
    return av.open(str(path), mode="r")
def writes(path):
    with path.open("wb") as file, open(path, "a") as other, av.open(path, mode="w"):
        pass
def parses(text):
    return json.loads(text)
VALUES = cv2.imread("a.png")
"""
    found = set(readers_in("m", source))
    assert found == {"m.A.read", "m.text", "m.first", "m.second", "m.third", "m.<module>"}


def test_each_entrance_has_a_row_of_its_own_with_every_cell():
    names = [entrance.name for entrance in ENTRANCES]
    assert len(set(names)) == len(names) > 20 and set(FRAMES) < set(ENTRANCES)
    for entrance in ENTRANCES:
        cells = (entrance.reached, entrance.says, entrance.refuses, entrance.confused)
        assert entrance.reads and all(cells) and not any(cell.endswith(".") for cell in cells)


def test_the_page_is_made_from_the_table():
    again = "python docs/make_pages/entrances.py > docs/entrances.md"
    assert (ROOT / "docs" / "entrances.md").read_text("utf-8") == entrances_page(), again
    assert "\nentrances\n" in (ROOT / "docs" / "index.md").read_text("utf-8")


@pytest.mark.parametrize("entrance", ENTRANCES, ids=lambda one: one.name)
def test_the_options_that_a_row_names_exist(entrance):
    for option in re.findall(r"--[a-z][a-z-]+", entrance.reached):
        assert any(f'"{option}"' in text for text in OPTIONS) or option.startswith("--no-")
