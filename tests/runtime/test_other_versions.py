"""A run of another version is refused by every command, which names that version and changes no byte."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from bayesnet_track import Start, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.codec import JournalError
from bayesnet_track.runtime.checkpoints.recipe import Recipe, RecipeError
from bayesnet_track.sources.scenes.library import SceneSource


def begin(out: Path, overwrite: bool = False) -> None:
    source = SceneSource.named("flying_ball")
    frames = track(
        "kalman_ball",
        source,
        [Start(source.scene.start_box)],
        out=out,
        overwrite=overwrite,
        keep_beliefs=True,
    )
    assert sum(1 for _ in frames) > 6


def content(folder: Path) -> dict[str, str]:
    files = (path for path in folder.iterdir() if path.name != ".lock")
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "one"
    begin(out)
    return out


def by(version: str, number: int, run: Path) -> Path:
    """The run as another version would have left it, by the first line of its journal."""
    journal = run / "journal.jsonl"
    first, *others = journal.read_text().splitlines(keepends=True)
    line = json.loads(first) | {"journal": number, "versions": {"bayesnet-track": version}}
    journal.write_text("".join([json.dumps(line) + "\n", *others]))
    return run


@pytest.fixture(params=["0.1.0", "7.5"])
def other(request: pytest.FixtureRequest, finished: Path, tmp_path: Path) -> Path:
    return by(
        request.param, 1 if request.param == "0.1.0" else 99, shutil.copytree(finished, tmp_path / "run")
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ["log", "RUN"],
        ["report", "RUN"],
        ["export", "RUN", "--format", "mot"],
        ["export", "RUN", "--format", "csv"],
        ["compare", "RUN", "OWN"],
        ["compare", "OWN", "RUN"],
        ["score", "RUN"],
        ["diagnose", "RUN"],
        ["resume", "RUN"],
        ["verify", "RUN"],
        [
            "what-if",
            "RUN",
            "--seed",
            "1",
            "--set",
            "ball.belief.gaussian.gate=0.9",
            "--out",
            "NEW",
        ],
        ["smooth", "RUN", "--out", "NEW"],
    ],
    ids=" ".join,
)
def test_every_command_refuses_it_and_names_the_version(
    other: Path, finished: Path, tmp_path: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = content(other)
    paths = {"RUN": str(other), "OWN": str(finished), "NEW": str(tmp_path / "new")}
    assert main([paths.get(word, word) for word in arguments]) == 4
    printed = capsys.readouterr().err
    writer = json.loads((other / "journal.jsonl").read_text().splitlines()[0])["versions"]["bayesnet-track"]
    assert printed.count("\n") == 1 and f"{other}: format " in printed
    assert f"which wrote it (python -m pip install bayesnet-track=={writer})" in printed
    assert content(other) == before and not (tmp_path / "new").exists()


def test_an_unfinished_one_is_refused_too(other: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (other / "manifest.json").unlink()
    before = content(other)
    assert main(["resume", str(other)]) == 4
    assert "format " in capsys.readouterr().err
    assert content(other) == before


@pytest.mark.slow
def test_it_is_refused_in_python_and_may_be_overwritten(other: Path) -> None:
    with pytest.raises(JournalError, match="reads format 2: read it with bayesnet-track "):
        open_run(other)
    begin(other, overwrite=True)
    assert len(open_run(other).metrics) > 1


def test_a_recipe_of_another_format_is_refused_with_the_version_that_wrote_it(other: Path) -> None:
    path = other / "run.json"
    later = json.loads(path.read_text()) | {"recipe": 9, "versions": {"bayesnet-track": "7.5"}, "new": []}
    path.write_text(json.dumps(later))
    with pytest.raises(RecipeError, match=r"format 9 of run\.json.*reads format 1.*bayesnet-track 7\.5"):
        Recipe.read(other)
