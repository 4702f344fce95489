"""Only single tests that are bound to the clock are run again, and none that compares bytes."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
SAME_BYTES = re.compile(r"tobytes|sha256|read_bytes\(\) ==|== reports_of\(|== files\(")


def bodies(path: str) -> dict[str, str]:
    """Name -> source of each function of a file."""
    source = (ROOT / path).read_text("utf-8")
    found = [node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)]
    return {node.name: ast.get_source_segment(source, node) or "" for node in found}


def test_what_is_run_again_is_there_and_compares_no_bytes(
    clock_bound: Mapping[str, Mapping[str, str]],
) -> None:
    again = {name: bodies(path)[name] for path, names in clock_bound.items() for name in names}
    assert len(again) > 10
    assert [name for name, source in again.items() if SAME_BYTES.search(source)] == []
    everything = bodies("tests/runtime/executors/test_processes.py").values()
    assert any(SAME_BYTES.search(source) for source in everything)  # such tests are recognised


def test_nothing_else_asks_to_be_run_again() -> None:
    files = [*(ROOT / "tests").rglob("*.py"), ROOT / "pyproject.toml"]
    asking = {path.name for path in files if re.search(r"mark\.flaky|--reruns", path.read_text("utf-8"))}
    assert asking - {"test_reruns.py"} == {"conftest.py"}
