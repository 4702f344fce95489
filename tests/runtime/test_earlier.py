"""Runs of earlier versions (`earlier`): each command opens them, or names the version that can."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.runtime.checkpoints.checkpoint_file import CheckpointError
from bayesnet_track.runtime.checkpoints.recipe import Recipe, RecipeError
from bayesnet_track.runtime.checkpoints.standing import standing

EARLIER = Path(__file__).with_name("earlier")
VERSIONS = sorted(path.name for path in EARLIER.iterdir() if path.is_dir())


def content(folder: Path) -> dict[str, str]:
    files = (path for path in folder.iterdir() if path.name != ".lock")
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(params=VERSIONS)
def version(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of what one version left."""
    return shutil.copytree(EARLIER / request.param, tmp_path / "runs")


@pytest.mark.parametrize("name", ["finished", "unfinished"])
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["log"], "frame 11: "),
        (["log", "--why", "12"], "frame 12"),
        (["log", "--target", "1"], "square 1"),
        (["log", "--json"], '"event": "toggled"'),
        (["report", "--frames", "none"], "report.html"),
        (["export", "--format", "mot"], "1,1,"),
        (["export", "--format", "jsonl"], '"frame"'),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_every_command_opens_them(
    version: Path, name: str, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command, *options = arguments
    assert main([command, str(version / name), *options]) == 0
    assert words in capsys.readouterr().out


def test_they_are_compared_and_scored(version: Path, capsys: pytest.CaptureFixture[str]) -> None:
    finished, unfinished = str(version / "finished"), str(version / "unfinished")
    assert main(["compare", finished, unfinished]) == 0
    assert "AUC" in capsys.readouterr().out
    for run in (finished, unfinished):
        assert main(["score", run, "--json", "--truth", str(version / "finished" / "truth.txt")]) == 0
        assert json.loads(capsys.readouterr().out)["auc"] > 0.5


def test_a_finished_one_is_finished(version: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = content(version / "finished")
    assert main(["resume", str(version / "finished")]) == 0
    assert "it is finished" in capsys.readouterr().out
    assert content(version / "finished") == before


def test_an_unfinished_one_of_another_checkpoint_format_is_refused_and_keeps_every_byte(
    version: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = version / "unfinished"
    before, writer = content(run), Recipe.read(run).versions["bayesnet-track"]
    with pytest.raises(CheckpointError):
        standing(run)
    assert main(["resume", str(run)]) == 4
    said = capsys.readouterr().err
    assert "format 1 of checkpoints; this version reads format 4" in said
    assert f"bayesnet-track=={writer}" in said and "--overwrite" in said
    assert content(run) == before


def test_a_recipe_of_another_format_is_refused_with_the_version_that_wrote_it(version: Path) -> None:
    path = version / "finished" / "run.json"
    later = json.loads(path.read_text()) | {"recipe": 9, "versions": {"bayesnet-track": "7.5"}, "new": []}
    path.write_text(json.dumps(later))
    with pytest.raises(RecipeError, match=r"format 9 of run\.json.*reads format 1.*bayesnet-track 7\.5"):
        Recipe.read(version / "finished")
