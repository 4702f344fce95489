"""Callers see the types that `public_types` states, with mypy and with pyright."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
STATED = Path(__file__).with_name("public_types.py")


def said_of(tmp_path: Path, checker: str, source: Path) -> tuple[int, str]:
    """Exit code and output of a checker; node is asked for first, since pyright would download one."""
    if checker == "mypy":
        line = ["mypy", "--config-file", str(ROOT / "pyproject.toml"), str(source)]
    else:
        pytest.importorskip("pyright")
        if shutil.which("node") is None:
            pytest.skip("pyright needs node")
        settings = tmp_path / "pyrightconfig.json"
        rules = {"typeCheckingMode": "basic", "reportUnnecessaryTypeIgnoreComment": "error"}
        of_pyright = {"enableTypeIgnoreComments": False, "pythonVersion": "3.11"}
        paths = {"include": [str(source)], "extraPaths": [str(ROOT)]}
        settings.write_text(json.dumps(rules | of_pyright | paths))
        line = ["pyright", "--project", str(settings), "--pythonpath", sys.executable]
    alone = {**os.environ, "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}  # else it asks a network for newer versions
    done = subprocess.run(
        [sys.executable, "-m", *line],
        cwd=ROOT,
        env=alone,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("checker", ["mypy", "pyright"])
def test_callers_see_the_stated_types(checker, tmp_path):
    code, said = said_of(tmp_path, checker, STATED)
    assert code == 0, said


@pytest.mark.slow
@pytest.mark.parametrize("checker", ["mypy", "pyright"])
def test_a_type_that_differs_is_reported(checker, tmp_path):
    changed = tmp_path / "changed.py"
    text = STATED.read_text(encoding="utf-8")
    for right, wrong in (
        ("assert_type(tracker.score, float)", "assert_type(tracker.score, int)"),
        ("(1, 2, 3))  # type: ignore[arg-type]", "(1, 2, 3, 4))  # type: ignore[arg-type]"),
    ):
        assert text.count(right) == 1
        text = text.replace(right, wrong)
    changed.write_text(text, encoding="utf-8")
    code, said = said_of(tmp_path, checker, changed)
    lines = text.splitlines()
    wrong = [n for n, line in enumerate(lines, 1) if "score, int" in line or "(1, 2, 3, 4))  # type" in line]
    assert code == 1
    assert all(f"changed.py:{number}:" in said for number in wrong), said
    assert f"{len(wrong)} errors" in said
