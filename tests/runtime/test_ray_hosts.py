"""Cameras decoded by actors on the nodes of a Ray cluster, each of which alone finds its camera's video.

All nodes are on this computer: each is started in a folder of its own, and sources are names in that folder.
The engine works in another folder, and is refused to open any video besides.
"""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest

from bayesnet_track import track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.executors import Limits, PlacingError, make_executor
from tests.runtime.room import detections_in, write_room
from tests.runtime.test_camera_hosts import FILES, blind  # noqa: F401
from tests.runtime.test_several_sources import options_of

pytestmark = pytest.mark.slow
ray = pytest.importorskip("ray")
CAMERAS = ("south", "east")
SOURCES = {camera: f"{camera}.avi" for camera in CAMERAS}


@contextmanager
def inside(folder):
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    graph = write_room(folder, count=12)
    named = [*options_of(SOURCES, "--source"), *options_of(detections_in(folder))]
    with inside(folder):
        assert main(["run", str(graph), *named, "--out", str(folder / "engine"), "--quiet"]) == 0
    (folder / "elsewhere").mkdir()
    return folder


class Nodes:
    """A cluster with a node for each camera, in whose folder the camera's video is."""

    def __init__(self, room):
        from ray.cluster_utils import Cluster

        self.room = room
        self.cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
        self.nodes = {camera: self.add(camera) for camera in CAMERAS}

    def add(self, camera):
        folder = self.room / f"node_{camera}"
        folder.mkdir(exist_ok=True)
        shutil.copy(self.room / SOURCES[camera], folder)
        with inside(folder):
            return self.cluster.add_node(num_cpus=1, resources={camera: 1})


@pytest.fixture(scope="module")
def started(room):
    cluster = Nodes(room)
    yield cluster
    ray.shutdown()
    cluster.cluster.shutdown()


@pytest.fixture
def nodes(room, started, monkeypatch, blind):  # noqa: F811
    monkeypatch.setenv("RAY_ADDRESS", started.cluster.address)
    monkeypatch.chdir(room / "elsewhere")
    return started


def assert_equal_bytes(room, other):
    for file in FILES:
        assert (room / "engine" / file).read_bytes() == (room / other / file).read_bytes(), file


def tracked(room, out, **limits):
    executor = make_executor(hosts="ray", limits=Limits(**limits))
    detections = detections_in(room)
    return executor, track(
        room / "room.yaml", SOURCES, detections=detections, executor=executor, out=room / out, tracks_csv=True
    )


def test_hosts_on_nodes_that_alone_have_the_videos_give_equal_bytes(room, nodes):
    named = [*options_of(SOURCES, "--source"), *options_of(detections_in(room))]
    options = ["--hosts", "ray", "--out", str(room / "ray"), "--quiet"]
    assert main(["run", str(room / "room.yaml"), *named, *options]) == 0
    assert_equal_bytes(room, "ray")


def test_an_actor_that_is_killed_changes_no_byte(room, nodes):
    executor, results = tracked(room, "killed")
    for result in results:
        assert all(not frame.image.any() for frame in result.frame.cameras.values())
        if result.frame.index in (4, 7):
            workers = sorted(executor.processes.workers())
            assert len(workers) == 2
            for number in workers[: 1 if result.frame.index == 4 else 2]:
                ray.kill(executor.processes.hosts.actors[number])
    assert len(executor.processes.hosts.actors) == 5
    assert_equal_bytes(room, "killed")


def test_a_node_that_is_lost_is_waited_for_and_then_ends_the_run_which_goes_on_later(room, nodes):
    _, results = tracked(room, "lost", first_s=2.0)
    with pytest.raises(PlacingError, match=r"no host of camera east.*no node.*'east'.*with the resources"):
        for result in results:
            if result.frame.index == 4:
                nodes.cluster.remove_node(nodes.nodes["east"])
    with pytest.raises(PlacingError, match="no host of camera east"):
        list(resume(room / "lost", executor=make_executor(hosts="ray")))
    nodes.add("east")
    assert list(resume(room / "lost", executor=make_executor(hosts="ray")))
    assert_equal_bytes(room, "lost")


def test_another_fingerprint_is_refused(room, nodes, monkeypatch):
    machine = {"numpy": "0.1"}
    monkeypatch.setattr("bayesnet_track.runtime.executors.worker_pool.describe_machine", lambda: machine)
    with pytest.raises(PlacingError, match=r"camera south.*numpy 0.1, now.*allow_other_machine"):
        tracked(room, "other")
    _, results = tracked(room, "other", allow_other_machine=True)
    assert len(list(results)) == 12
    assert_equal_bytes(room, "other")
