"""Runs with a factor: every executor writes the same bytes, a resumed run goes on, what-if changes it."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from bayesnet_track import Start, load_graph, track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.executors import make_executor
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 8
FILES = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "graph.yaml")


def begun(folder: Path, frames: int | None = None, graph: object = "road", **options: object) -> Path:
    source = SceneSource.named("occluder_long", 0, FRAMES)
    results = track(graph, source, [Start(source.scene.start_box)], out=folder, **options)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return folder


def written(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return begun(tmp_path_factory.mktemp("whole") / "run")


def test_a_run_that_was_broken_off_goes_on(tmp_path: Path, whole: Path) -> None:
    run = begun(tmp_path / "run", 4)
    assert len(list(resume(run))) == FRAMES - 4
    assert written(run) == written(whole)


@pytest.mark.slow
def test_every_executor_writes_the_same(tmp_path: Path, whole: Path) -> None:
    assert written(begun(tmp_path / "run", executor=make_executor("processes", workers=2))) == written(whole)


def test_the_recorded_graph_has_the_factor_and_runs_the_same(tmp_path: Path, whole: Path) -> None:
    recorded = load_graph(whole / "graph.yaml")
    assert recorded.targets["target"].factors == load_graph("road").targets["target"].factors
    assert written(begun(tmp_path / "run", graph=recorded)) == written(whole)


@pytest.mark.parametrize(
    "change", ["constants.left_y=90", "targets.target.nodes.road.factor=normal(y, 150, 3)"]
)
def test_what_if_it_were_another_factor(tmp_path: Path, whole: Path, change: str) -> None:
    out = tmp_path / "other"
    assert main(["what-if", str(whole), "--set", change, "--quiet", "--out", str(out)]) == 0
    assert written(out)["tracks.txt"] != written(whole)["tracks.txt"]
    assert change.partition("=")[2] in written(out)["graph.yaml"].decode()
