"""Cameras decoded at hosts of their own: equal bytes, also where hosts are killed."""

from __future__ import annotations

import os
import shutil
import signal

import pytest

from bayesnet_track import track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.executors import PlacingError, make_executor
from bayesnet_track.sources.paths import SourceError
from tests.runtime.room import detections_in, sources_in, write_room
from tests.runtime.test_several_sources import options_of

FILES = ("journal.jsonl", "tracks.csv", "cameras.csv", "frames.npy.gz", "tracks.txt")


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    graph = write_room(folder, count=12)
    named = [*options_of(sources_in(folder), "--source"), *options_of(detections_in(folder))]
    assert main(["run", str(graph), *named, "--out", str(folder / "engine"), "--quiet"]) == 0
    return folder


def assert_equal_bytes(room, other):
    for file in FILES:
        assert (room / "engine" / file).read_bytes() == (room / other / file).read_bytes(), file


@pytest.fixture
def blind(monkeypatch):
    """An engine that cannot open a video."""

    def refuse(*arguments):
        raise AssertionError("the engine opens a source")

    monkeypatch.setattr("bayesnet_track.sources.sources.make_reader", refuse)


@pytest.mark.slow
def test_hosts_in_processes_give_equal_bytes(room, blind):
    named = [*options_of(sources_in(room), "--source"), *options_of(detections_in(room))]
    options = ["--hosts", "process", "--out", str(room / "process"), "--quiet"]
    assert main(["run", str(room / "room.yaml"), *named, *options]) == 0
    assert_equal_bytes(room, "process")


@pytest.mark.slow
def test_a_host_that_is_killed_changes_no_byte(room, blind):
    """Both, one between frames and one while it is asked next; the engine has no pixels."""
    executor = make_executor(hosts="process")
    results = track(
        room / "room.yaml",
        sources_in(room),
        detections=detections_in(room),
        executor=executor,
        out=room / "killed",
        tracks_csv=True,
    )
    killed = set()
    for result in results:
        assert all(not frame.image.any() for frame in result.frame.cameras.values())
        if result.frame.index in (4, 7):
            hosts = executor.processes.workers()
            assert {name for agents in hosts.values() for name in agents} == {
                "camera east",
                "camera south",
                "person.color.east",
                "person.color.south",
            }
            for process in sorted(hosts)[: 1 if result.frame.index == 4 else 2]:
                os.kill(process, signal.SIGKILL)
                killed.add(process)
    assert len(killed) == 3
    assert not killed & executor.processes.workers().keys()
    assert_equal_bytes(room, "killed")


@pytest.mark.slow
def test_a_run_whose_engine_stops_goes_on_at_hosts_with_equal_bytes(room, blind):
    results = track(
        room / "room.yaml",
        sources_in(room),
        detections=detections_in(room),
        executor=make_executor(hosts="process"),
        out=room / "stopped",
        tracks_csv=True,
    )
    for _ in range(5):
        next(results)
    results.close()
    assert len(list(resume(room / "stopped", executor=make_executor(hosts="process")))) == 7
    assert_equal_bytes(room, "stopped")


def test_a_host_says_why_it_cannot_read_its_source(room, tmp_path):
    (tmp_path / "east.avi").write_bytes(b"no video")
    for name, message in (("gone.avi", "no such file"), ("east.avi", "not a readable video")):
        sources = sources_in(room) | {"east": str(tmp_path / name)}
        executor = make_executor(hosts="process")
        with pytest.raises(SourceError, match=f"{name}.*{message}"):
            track(room / "room.yaml", sources, detections=detections_in(room), executor=executor)
        assert not executor.processes.workers()


@pytest.mark.slow
def test_a_run_does_not_go_on_with_another_video(room):
    folder = room / "changed"
    folder.mkdir()
    for file in (*sources_in(room).values(), *detections_in(room).values()):
        shutil.copy(file, folder)
    results = track(
        room / "room.yaml",
        sources_in(folder),
        detections=detections_in(folder),
        executor=make_executor(hosts="process"),
        out=folder / "run",
    )
    next(results)
    results.close()
    shutil.copy(folder / "south.avi", folder / "east.avi")
    with pytest.raises(SourceError, match=r"east.avi.*not what it was: source: 1 file.*now 1 file"):
        list(resume(folder / "run", executor=make_executor(hosts="process")))


def test_an_annotated_video_is_refused_beside_hosts(room, tmp_path):
    with pytest.raises(ValueError, match="an annotated video beside hosts"):
        track(
            room / "room.yaml",
            sources_in(room),
            detections=detections_in(room),
            executor=make_executor(hosts="process"),
            out=tmp_path / "run",
            video=True,
        )


def test_hosts_are_refused_where_nothing_looks_at_images(tmp_path):
    graph = write_room(tmp_path, count=2, agents=())
    with pytest.raises(PlacingError, match="agents that look at the images of several cameras"):
        track(
            graph,
            sources_in(tmp_path),
            detections=detections_in(tmp_path),
            executor=make_executor(hosts="process"),
        )
