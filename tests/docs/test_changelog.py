"""The version is stated alike everywhere, and the files in `changelog.d` become lines of the changelog."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml

import bayesnet_track

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
KINDS = [kind["directory"] for kind in PROJECT["tool"]["towncrier"]["type"]]


def malformed(folder: Path) -> list[str]:
    """What is wrong with each file; towncrier leaves out files with other names without a word."""
    named = re.compile(rf"\+[a-z0-9]+(-[a-z0-9]+)*\.({'|'.join(KINDS)})\.md")
    found = []
    for path in sorted(folder.iterdir()):
        text = path.read_text(encoding="utf-8")
        if path.name == ".gitignore":
            continue
        if not named.fullmatch(path.name):
            found.append(
                f"{path.name}: the name must be +WORDS.KIND.md, where KIND is one of {', '.join(KINDS)}"
            )
        elif not text.strip().endswith((".", "```")) or text.lstrip().startswith(("-", "*", "#")):
            found.append(f"{path.name}: must hold sentences, without a bullet or heading")
    return found


def test_the_version_is_the_same_everywhere():
    stated = PROJECT["project"]["version"]
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert newest is not None
    assert {str(citation["version"]), newest[1]} == {stated}
    assert bayesnet_track.__version__ == version("bayesnet-track")
    assert "__version__" in dir(bayesnet_track)


def test_every_file_for_the_changelog_has_a_name_that_is_read():
    assert malformed(ROOT / "changelog.d") == []


@pytest.mark.parametrize(
    ("name", "text", "wrong"),
    [
        ("+a-word.fixed.md", "It works.\n", False),
        ("+two2.added.md", "Two sentences. Here.", False),
        ("a-word.fixed.md", "It works.\n", True),
        ("+a-word.mended.md", "It works.\n", True),
        ("+a-word.md", "It works.\n", True),
        ("+A_Word.fixed.md", "It works.\n", True),
        ("+a-word.fixed.md", "- It works.\n", True),
        ("+a-word.fixed.md", "", True),
    ],
)
def test_a_file_that_would_be_left_out_is_found(tmp_path, name, text, wrong):
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert bool(malformed(tmp_path)) is wrong


def test_every_kind_becomes_a_section(tmp_path):
    pytest.importorskip("towncrier")
    (tmp_path / "pyproject.toml").write_bytes((ROOT / "pyproject.toml").read_bytes())
    (tmp_path / "CHANGELOG.md").write_bytes((ROOT / "CHANGELOG.md").read_bytes())
    (tmp_path / "changelog.d").mkdir()
    for kind in KINDS:
        (tmp_path / "changelog.d" / f"+some-words.{kind}.md").write_text(
            f"This was {kind}.\n", encoding="utf-8"
        )
    line = [sys.executable, "-m", "towncrier", "build", "--yes", "--version", "99.0"]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = "\n\n".join(f"### {kind.capitalize()}\n\n- This was {kind}." for kind in KINDS)
    assert f"## 99.0\n\n{sections}\n" in text
    assert (
        text.index("# Changelog") < text.index("## 99.0") < text.index(f"## {PROJECT['project']['version']}")
    )
