"""The command `init` copies any graph of the library, so that the copy is valid and does the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from bayesnet_track import load_graph
from bayesnet_track.cli.main import main
from bayesnet_track.graphs import find_graph, graph_names


@pytest.mark.parametrize("source", graph_names())
def test_a_copy_of_any_graph_has_its_comments_and_does_the_same(source: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    assert main(["init", str(path), "--from", source]) == 0
    copied, given = load_graph(path).spec, load_graph(source).spec
    assert copied.name == "mine"
    assert copied.model_copy(update={"name": given.name}) == given
    comments = [line for line in find_graph(source).read_text("utf-8").splitlines() if "#" in line]
    assert set(comments) <= set(path.read_text("utf-8").splitlines())


def test_the_default_reconfigures_itself_and_says_how_to_run_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.yaml"
    assert main(["init", str(path)]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"wrote {path}, a copy of the graph adaptive\n"
    assert f"next: `bayesnet-track run {path} --source VIDEO --init X,Y,W,H --out runs/mine`" in printed.err
    text = path.read_text("utf-8")
    assert f"bayesnet-track run {path} --source VIDEO" in text
    (plate,) = load_graph(path).targets.values()
    assert plate.inference(plate.root).adapt is not None


def test_a_file_that_is_there_is_kept_without_overwrite(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("precious")
    assert main(["init", str(path)]) == 2
    assert "is there already; `--overwrite` replaces it" in capsys.readouterr().err
    assert path.read_text() == "precious"
    assert main(["init", str(path), "--overwrite"]) == 0
    assert load_graph(path).spec.name == "mine"


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("1st try.yaml", "graph_1st_try"),
        ("null.yaml", "graph_null"),
        ("ball-2.yml", "ball_2"),
        ("größe.yaml", "gr__e"),
    ],
)
def test_any_name_of_a_file_gives_a_valid_graph(file: str, name: str, tmp_path: Path) -> None:
    assert main(["init", str(tmp_path / file)]) == 0
    assert load_graph(tmp_path / file).spec.name == name


def test_an_unknown_graph_is_refused_with_the_nearest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["init", str(tmp_path / "mine.yaml"), "--from", "genral"]) == 2
    assert "no graph 'genral'; there are adaptive, " in (err := capsys.readouterr().err)
    assert "nearest: general" in err
