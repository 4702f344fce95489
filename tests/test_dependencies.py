"""What the project says of its dependencies: bounds, extras, lock files."""

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CORE = [Requirement(text) for text in PROJECT["project"]["dependencies"]]
EXTRAS = {
    extra: [Requirement(text) for text in texts]
    for extra, texts in PROJECT["project"]["optional-dependencies"].items()
}
TEST = EXTRAS["test"]
EVERY = [*CORE, *(one for extra in EXTRAS.values() for one in extra)]
BUILD = [Requirement(text) for text in PROJECT["build-system"]["requires"]]

MODULE_OF = {"opencv-python-headless": "cv2", "pyyaml": "yaml", "rerun-sdk": "rerun"}
OPTIONAL = {"onnxruntime", "matplotlib", "rerun", "ray"}
"""Modules that some command needs and that an extra installs."""
ELSEWHERE = {"supervision", "pydantic_core"}
"""What the user's own program has installed, and what pydantic installs in the one version that fits it."""
LOCKS = {"run.txt": CORE, "test.txt": CORE + TEST, "all.txt": EVERY}


def lock(name: str) -> str:
    return (ROOT / "requirements" / name).read_text(encoding="utf-8")


def locked(name: str) -> list[Requirement]:
    lines = (line.removesuffix("\\") for line in lock(name).splitlines() if re.match(r"[a-z0-9]", line))
    return [Requirement(line) for line in lines]


@pytest.mark.parametrize("requirement", [*EVERY, *BUILD], ids=str)
def test_every_dependency_has_both_bounds(requirement):
    bounds = {one.operator: one.version for one in requirement.specifier}
    assert sorted(bounds) == ["<", ">="]
    # Before 1.0 a minor version may break what was; from then on a major one.
    assert len(bounds["<"].split(".")) == (2 if bounds["<"].startswith("0.") else 1)


def test_a_plain_installation_has_what_the_package_imports():
    imported = set()
    for path in [*(ROOT / "bayesnet_track").rglob("*.py"), *(ROOT / "cues").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported.add(node.module.split(".")[0])
    imported -= {"bayesnet_track", *sys.stdlib_module_names}
    core = {MODULE_OF.get(one.name, one.name) for one in CORE}
    assert imported <= core | OPTIONAL | ELSEWHERE
    assert core <= imported


@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_holds_every_dependency_within_its_bounds(name):
    there: dict[str, list[Requirement]] = {}
    for one in locked(name):
        there.setdefault(canonicalize_name(one.name), []).append(one)
    for wanted in LOCKS[name]:
        found = there[canonicalize_name(wanted.name)]  # several where they depend on the interpreter
        assert all(wanted.specifier.contains(str(one.specifier).removeprefix("==")) for one in found)


@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_has_hashes_and_no_index(name):
    entries = re.split(r"^(?=[a-z0-9])", lock(name), flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in entry for entry in entries)
    assert not re.search(r"https?:|//|index|find-links|file:| @ ", lock(name))


def test_the_locks_agree():
    everything = set(map(str, locked("all.txt")))
    assert all(set(map(str, locked(name))) <= everything for name in LOCKS)
