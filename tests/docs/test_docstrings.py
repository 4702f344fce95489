"""The examples in docstrings give what they say, module by module."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import bayesnet_track
import bayesnet_track.cues

FOLDERS = {one.__name__: Path(one.__path__[0]) for one in (bayesnet_track, bayesnet_track.cues)}


def modules_with_examples() -> list[str]:
    """Their names; files without a prompt are not imported."""
    return sorted(
        ".".join((package, *path.relative_to(folder).with_suffix("").parts)).removesuffix(".__init__")
        for package, folder in FOLDERS.items()
        for path in folder.rglob("*.py")
        if ">>> " in path.read_text("utf-8")
    )


MODULES = modules_with_examples()


def test_there_are_examples() -> None:
    assert len(MODULES) > 50


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_give_what_they_say(name: str) -> None:
    module = importlib.import_module(name)
    said: list[str] = []
    runner = doctest.DocTestRunner(verbose=False)
    for example in doctest.DocTestFinder(exclude_empty=True).find(module, name):
        runner.run(example, out=said.append)
    tried = runner.summarize(verbose=False)
    assert tried.attempted > 0
    assert tried.failed == 0, "".join(said)
