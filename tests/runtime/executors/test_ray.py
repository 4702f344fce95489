"""Agents as actors of Ray answer as they do in the engine's process, though actors and nodes die."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

from bayesnet_track.engine.starts import Start, start_targets
from bayesnet_track.engine.step import State, make_engine, step
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.runtime.executors import make_executor
from bayesnet_track.runtime.executors.placing import PlacingError
from bayesnet_track.runtime.executors.processes import Employed
from bayesnet_track.runtime.executors.ray.ray_actors import RayActors
from bayesnet_track.runtime.executors.workers import Limits
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import make_scene

FRAMES = 12


def play(graph_name, scene_name, kind, before=lambda frame, executor: None):
    """Every frame's metrics and events, and the last references; `before` comes before a frame."""
    scene, graph = make_scene(scene_name, seed=0), load_graph(graph_name)
    starts = [Start(box, plate) for plate, box in scene.starts] or [Start(scene.start_box)]
    told, state = [], State()
    with make_executor(kind) as executor:
        engine = executor.engine(make_engine(graph))
        for frame in SceneSource(scene, "scene", FRAMES):
            before(frame.index, executor)
            first = state.previous is None
            outcome = start_targets(graph, engine, frame, starts) if first else step(engine, state, frame)
            state = outcome.state
            told.append((outcome.metrics, outcome.events))
    references = {
        (target, agent, name): np.asarray(array).tobytes()
        for target, one in state.targets.items()
        for agent, reference in one.references.items()
        for name, array in reference.items()
    }
    return told, references


@pytest.mark.slow
def test_the_same_to_the_last_bit_though_every_actor_is_killed():
    pytest.importorskip("ray")
    killed = []

    def kill(frame, executor):
        if frame == 5:
            killed.extend(executor.processes.workers())
            for pid in killed:
                os.kill(pid, signal.SIGKILL)

    stereo = "person_color_stereo"
    assert play(stereo, stereo, "ray", kill) == play(stereo, stereo, "serial")
    assert len(killed) >= 2


@pytest.mark.slow
def test_no_frame_is_lost_when_a_node_of_the_cluster_dies():
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        second = cluster.add_node(num_cpus=1)
        ray.init(address=cluster.address, log_to_driver=False, logging_level="error")
        cluster.wait_for_nodes()
        assert ray.get_runtime_context().get_node_id() == cluster.head_node.node_id
        seen = []

        def remove(frame, executor):
            if frame == 5:
                seen.append(executor.processes.nodes())
                cluster.remove_node(second, allow_graceful=False)
            if frame == 9:
                seen.append(executor.processes.nodes())

        told = play("two_squares", "two_squares", "ray", remove)
    finally:
        ray.shutdown()
        cluster.shutdown()
    before, after = seen
    assert len(set(before.values())) == 2 and len(set(after.values())) == 1
    assert told == play("two_squares", "two_squares", "serial")


def test_that_ray_is_missing_is_said_with_its_cure(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(PlacingError, match=r"pip install 'bayesnet-track\[ray\]'"):
        RayActors({"a": Employed(dict, {}, 0.0)}, Limits())
