"""What a run writes down: whole lines, times for every frame, and a clear error where a disk is full."""

import json
import os
import subprocess
import sys
from pathlib import Path

import av
import pytest

from bayesnet_track import Start, load_graph
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.reader import read_events, read_metrics
from bayesnet_track.journal.writer import LineFile, OutputError
from bayesnet_track.runtime import session
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory, RunDirectoryError
from bayesnet_track.runtime.run import run
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

FULL = Path("/dev/full")
linux_only = pytest.mark.skipif(not FULL.exists(), reason="/dev/full is Linux's")


@pytest.fixture(scope="module")
def graph():
    return load_graph("two_squares")


def tracked(graph, directory, frames=6, video=False):
    """Track into `directory`; the results."""
    scene = make_scene("two_squares")
    source = SceneSource(scene, "scene", frames)
    optional = ("csv", "video") if video else ("csv",)
    with Recorder(directory, graph, source.frame_interval_s, optional) as recorder:
        return list(run(graph, source, [Start(scene.start_box)], sinks=[recorder]))


def whole_lines(path):
    data = path.read_bytes()
    return data == b"" or data.endswith(b"\n")


def test_everything_a_run_gives_is_written(graph, tmp_path):
    directory = RunDirectory.create(tmp_path / "run")
    results = tracked(graph, directory, video=True)
    assert [m.frame for m in read_metrics(directory.frames)] == list(range(6))
    assert [m.centre_box for m in read_metrics(directory.frames)] == [
        pytest.approx(r.targets[0].centre_box, rel=1e-6) for r in results
    ]
    times = [json.loads(line) for line in directory.timings.read_text().splitlines()]
    assert [line["frame"] for line in times] == list(range(6))
    assert all(
        line["seconds"] == pytest.approx(r.total_seconds, abs=1e-6)
        for line, r in zip(times, results, strict=True)
    )
    assert {"planes", "belief", "color"} <= set(times[1]["parts"])
    with av.open(str(directory.video)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 6


def test_what_one_frame_gave_is_there_before_the_next(graph, tmp_path):
    """A killed run leaves whole lines, and a time for every frame that was measured."""
    directory = RunDirectory.create(tmp_path / "run")
    scene = make_scene("two_squares")
    with Recorder(directory, graph, 0.04) as recorder:
        for result in run(graph, SceneSource(scene, "scene", 3), [Start(scene.start_box)], sinks=[recorder]):
            seen = result.frame.index + 1
            assert len(list(read_metrics(directory.frames))) == seen
            assert len(directory.mot.read_text().splitlines()) == seen
            assert len(directory.timings.read_text().splitlines()) == seen
            kinds = [type(event) for event in read_events(directory.journal)]
            assert kinds[:2] == [RunStarted, TargetStarted] and RunEnded not in kinds


@linux_only
@pytest.mark.parametrize("name", ["journal", "frames", "mot", "csv", "timings", "video"])
def test_a_full_disk_is_told_at_once_and_leaves_whole_lines(graph, tmp_path, name):
    directory = RunDirectory.create(tmp_path / "run")
    (directory.path / FILES[name]).symlink_to(FULL)
    with pytest.raises((OutputError, RunDirectoryError), match="No space left on device") as failed:
        tracked(graph, directory, video=name == "video")
    assert FILES[name] in str(failed.value)
    written = [path for path in directory.path.iterdir() if path.name.endswith((".jsonl", ".txt", ".csv"))]
    assert all(whole_lines(path) for path in written if not path.is_symlink())
    if name in ("frames", "mot", "timings", "video"):  # the others fail before the first frame
        assert list(read_events(directory.journal))[-1].reason == "error"


@linux_only
@pytest.mark.parametrize("name", ["journal", "mot", "graph", "video"])
def test_a_full_disk_is_exit_code_6(tmp_path, capsys, monkeypatch, name):
    from bayesnet_track.cli.main import main

    begin = session._begin

    def with_a_full_disk(directory, *arguments):
        part = ".part" if name == "graph" else ""
        (directory.path / (FILES[name] + part)).symlink_to(FULL)
        return begin(directory, *arguments)

    monkeypatch.setattr(session, "_begin", with_a_full_disk)
    code = main(["demo", "--end", "3", "--quiet", "--out", str(tmp_path / "run")])
    out, err = capsys.readouterr()
    assert (code, out) == (6, "")
    assert err.startswith("bayesnet-track demo: ") and err.count("\n") == 1
    assert FILES[name] in err and "No space left on device" in err
    assert err.endswith(f"; free some space, then `bayesnet-track resume {tmp_path / 'run'}`\n")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of a file's size")
def test_a_disk_that_fills_in_the_middle_of_a_line(tmp_path):
    """The system cuts a write short at the limit of a file's size: as a full disk does."""
    import resource

    limit = 20_000

    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    demo = [sys.executable, "-m", "bayesnet_track", "demo", "--quiet", "--out"]
    # Compiled kernels are files, too: none may be left to write.
    subprocess.run([*demo, str(tmp_path / "before")], check=True)
    done = subprocess.run(
        [*demo, str(tmp_path / "run")],
        preexec_fn=limited,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 6
    assert "cannot write" in done.stderr and "File too large" in done.stderr
    directory = RunDirectory.open(tmp_path / "run")
    for path in (directory.journal, directory.timings, directory.mot):
        assert whole_lines(path)
    assert len(list(read_metrics(directory.frames, pytest.fail))) > 5
    assert list(read_events(directory.journal, pytest.fail))[-1].reason == "error"


def test_files_are_closed_when_one_cannot_be_made(graph, tmp_path, monkeypatch):
    directory = RunDirectory.create(tmp_path / "run")
    directory.csv.mkdir()
    opened = []
    make = LineFile.__init__

    def noted(file, path, after=None):
        make(file, path, after)
        opened.append(file)

    monkeypatch.setattr(LineFile, "__init__", noted)
    with pytest.raises(OutputError, match=r"tracks\.csv"):
        Recorder(directory, graph, 0.04, ("csv",))
    assert len(opened) == 3 and all(file._file.closed for file in opened)
    # What is left may be overwritten like any run.
    directory.csv.rmdir()
    RunDirectory.create(directory.path, overwrite=True).clear()


def test_times_are_written_before_what_they_time(graph, tmp_path, monkeypatch):
    """A run that is killed between two files has a time for every frame that it measured."""
    flushed = []
    flush = LineFile.flush
    monkeypatch.setattr(LineFile, "flush", lambda self: (flushed.append(self.path.name), flush(self))[1])
    scene = make_scene("two_squares")
    directory = RunDirectory.create(tmp_path / "run")
    with Recorder(directory, graph, 0.04, ("beliefs",)) as recorder:
        source = SceneSource(scene, "scene", 2)
        for _ in run(graph, source, [Start(scene.start_box)], sinks=[recorder]):
            of_frame = [
                name for name in flushed if name in (FILES["timings"], FILES["frames"], FILES["beliefs"])
            ]
            assert of_frame[0] == FILES["timings"] and len(set(of_frame)) == 3
            flushed.clear()
