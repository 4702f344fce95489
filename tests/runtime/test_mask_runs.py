"""Files that a graph names: recorded by SHA-256, and refused where they are gone or have changed."""

from __future__ import annotations

import itertools
import json
import shutil
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import Field

from bayesnet_track import CueDeclaration, CueParameters, Start, Tracker, load_graph, track
from bayesnet_track.cli.main import main
from bayesnet_track.engine.starts import StartError
from bayesnet_track.graphs import graph_folder
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.runtime.checkpoints.recipe import Recipe, make_recipe
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.checkpoints.standing import ResumeError, check_files
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 6
NETWORK = """bayesnet: 1
name: network
targets:
  target:
    birth: {{detector: {{onnx: {{model: {net}}}}}}}
    nodes:
      target: {{motion: constant_velocity}}
      looks: {{parent: target, agent: {{looking: {{model: {looks}}}}}}}
"""


class LookingParameters(CueParameters):
    model: str = Field(description="file")


LOOKING = CueDeclaration("looking", "", LookingParameters, lambda p: None, files=lambda p: (p.model,))


def begun(folder: Path, graph: object, frames: int | None = None) -> Path:
    source = SceneSource.named("occluder_long", 0, FRAMES)
    results = track(graph, source, [Start(source.scene.start_box)], out=folder)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return folder


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    for end in (".yaml", ".png"):
        shutil.copy(Path(graph_folder(), "road_mask" + end), tmp_path)
    return tmp_path / "road_mask.yaml"


def written(run: Path) -> list[bytes]:
    return [(run / name).read_bytes() for name in ("journal.jsonl", "frames.npy.gz", "tracks.txt")]


def test_a_run_with_a_mask_goes_on_wherever_it_is_asked_from(
    tmp_path: Path, graph: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = begun(tmp_path / "whole", graph)
    held = json.loads((whole / "run.json").read_text())["masks"]["road_mask.png"]
    assert held["sha256"] == sha256((tmp_path / "road_mask.png").read_bytes()).hexdigest()
    run = begun(tmp_path / "run", graph, 3)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert len(list(resume(run))) == FRAMES - 3
    assert written(run) == written(whole)


def gone(mask: Path) -> None:
    mask.unlink()


def changed(mask: Path) -> None:
    cv2.imwrite(str(mask), np.full((240, 320), 200, np.uint8))


@pytest.mark.parametrize(
    ("change", "words"),
    [(gone, "it reads this file, and it cannot be read"), (changed, "not what it was: .*road_mask.png")],
)
def test_a_mask_that_is_gone_or_changed_is_refused(
    tmp_path: Path, graph: Path, capsys: pytest.CaptureFixture[str], change: object, words: str
) -> None:
    run = begun(tmp_path / "run", graph, 3)
    change(tmp_path / "road_mask.png")  # type: ignore[operator]
    before = written(run)
    with pytest.raises(ResumeError, match=words):
        list(resume(run))
    assert written(run) == before
    assert main(["what-if", str(run), "--seed", "1", "--quiet", "--out", str(tmp_path / "other")]) == 4
    assert "road_mask.png" in capsys.readouterr().err
    assert Recipe.read(run).load_graph(run).masks.keys() == {"road_mask.png"}  # it can be shown all the same


def test_what_if_it_were_another_factor_of_the_mask(tmp_path: Path, graph: Path) -> None:
    run, out = begun(tmp_path / "run", graph), tmp_path / "other"
    change = "road.factor=0.5 + mask(x, y)"
    assert main(["what-if", str(run), "--set", change, "--quiet", "--out", str(out)]) == 0
    assert written(out) != written(run)
    assert Recipe.read(out).masks == Recipe.read(run).masks


def test_a_mask_of_another_size_than_the_frames_is_refused(graph: Path) -> None:
    with pytest.raises(StartError, match="320x240 px, and the frames have 64x48 px"):
        Tracker(graph).init(np.zeros((48, 64, 3), np.uint8), (10, 10, 9, 9))


def test_model_files_of_agents_and_detectors_are_recorded(tmp_path: Path) -> None:
    names = {name: tmp_path / f"{name}.onnx" for name in ("net", "looks")}
    for name, file in names.items():
        file.write_text(name)
    (tmp_path / "g.yaml").write_text(NETWORK.format(**names))
    graph = load_graph(tmp_path / "g.yaml", (LOOKING,))
    recipe = make_recipe(graph, SceneSource.named("occluder_long", 0, FRAMES), [])
    assert {path: file.sha256 for path, file in recipe.models.items()} == {
        str(file): sha256(name.encode()).hexdigest() for name, file in names.items()
    }
    recipe.write(tmp_path)
    assert Recipe.read(tmp_path) == recipe
    check_files(recipe)
    names["looks"].write_text("another")
    with pytest.raises(ResumeError, match=r"looks\.onnx: "):
        check_files(recipe)


@pytest.mark.parametrize(
    ("cue", "parameters"),
    [
        ("opencv_tracker", {"tracker": "Vit", "models": {"net": "a.onnx"}}),
        ("shape", {"model": "a.onnx"}),
        ("embedding", {"model": "a.onnx"}),
    ],
)
def test_cues_say_which_files_they_read(cue: str, parameters: dict[str, object]) -> None:
    declaration = installed_cues()[cue]
    assert declaration.files is not None
    assert declaration.files(declaration.parameters.model_construct(**parameters)) == ("a.onnx",)
    assert declaration.files(declaration.parameters()) == ()
