"""Every executor writes the same bytes."""

from __future__ import annotations

import os
import signal

import pytest

from bayesnet_track import Start, load_graph, track
from bayesnet_track.engine.starts import has_births
from bayesnet_track.graphs import find_graph
from bayesnet_track.runtime.executors import make_executor
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

FILES = (
    "journal.jsonl",
    "frames.npy.gz",
    "tracks.txt",
)
EXECUTORS = [("processes", 1), ("processes", 2)]
GRAPHS = {
    "two_squares": "two_squares",
    "person_color_stereo": "person_color_stereo",
    "crowd": "crowd",
    "flying_ball": "kalman_ball",
    "person_parts": "person_parts",
}
SCENES = {"two_squares": 45, "person_color_stereo": 25, "crowd": 20, "flying_ball": 30, "person_parts": 10}


@pytest.fixture
def written(tmp_path):
    """The bytes of a run's files; `each_frame` is called with every result and the executor."""

    def run(name, kind, workers, frames, each_frame=lambda result, executor: None, path=None):
        scene = make_scene(name, seed=3)
        graph = load_graph(path or GRAPHS[name])
        starts = [Start(box, plate) for plate, box in scene.starts if plate in graph.targets]
        starts = [] if has_births(graph) else starts or [Start(scene.start_box)]
        out = tmp_path / f"{kind} {workers}"
        executor = make_executor(kind, workers=workers)
        source = SceneSource(scene, f"scene:{name}", frames)
        for result in track(graph, source, starts or None, out=out, executor=executor):
            each_frame(result, executor)
        return {file: (out / file).read_bytes() for file in FILES}

    return run


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_files_are_the_same(written, name):
    expected = written(name, "serial", 1, SCENES[name])
    assert all(expected.values())
    for kind, workers in EXECUTORS:
        assert written(name, kind, workers, SCENES[name]) == expected, (kind, workers)


@pytest.mark.slow
def test_the_files_are_the_same_though_workers_are_killed(written):
    killed = []

    def kill(result, executor):
        if result.frame.index % 3 == 2:
            for pid in executor.processes.workers():
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

    assert written("two_squares", "processes", 2, 30, kill) == written("two_squares", "serial", 1, 30)
    assert len(killed) == 20


@pytest.mark.slow
def test_agents_on_call_measure_the_same_wherever_they_are(written, tmp_path):
    deep = tmp_path / "deep.yaml"
    deep.write_text(find_graph("deep").read_text("utf-8").replace("refuse", "plain"), encoding="utf-8")
    expected = written("two_squares", "serial", 1, 30, path=str(deep))
    assert b'"scheduled"' in expected["journal.jsonl"]
    for kind, workers in EXECUTORS:
        assert written("two_squares", kind, workers, 30, path=str(deep)) == expected, (kind, workers)
