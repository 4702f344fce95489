"""A batch ends whatever happens to its processes, says how far it is, and keeps its table."""

from __future__ import annotations

import csv
import errno
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import pytest

from bayesnet_track.cli.batch import places
from bayesnet_track.cli.batch.jobs import BatchError, BatchVideo, Job
from bayesnet_track.cli.batch.places import JobProgress, Processes, most_runs
from bayesnet_track.cli.batch.results import BatchProgress, BatchTable, Silence
from bayesnet_track.cli.batch.work import FINISHED, failed_row
from bayesnet_track.cli.main import main
from bayesnet_track.sources.scenes.library import SceneSource, make_scene


def job(name, seed=0):
    return Job("g", BatchVideo("v", name), seed, name)


def rows_of(place, *jobs):
    return {
        report.job: report.row for report in place.run(jobs) if report is not None and report.row is not None
    }


def test_when_no_file_can_be_opened_each_video_fails_and_the_batch_ends(monkeypatch):
    def tie():
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(places, "tie", tie)
    rows = rows_of(Processes(2), job("a"), job("b"), job("c"))
    assert {row["status"] for row in rows.values()} == {"failed"} and len(rows) == 3
    assert all("Too many open files: raise the limit" in row["reason"] for row in rows.values())


def test_a_fault_of_another_kind_fails_the_video_and_the_batch_ends(monkeypatch):
    def tie():
        raise AssertionError("nobody foresaw this")

    monkeypatch.setattr(places, "tie", tie)
    assert [row["status"] for row in rows_of(Processes(1), job("a")).values()] == ["failed"]


def test_too_few_files_are_said_before_anything_begins(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (24, 24))
    assert most_runs() == 0
    out = str(tmp_path / "out")
    assert main(["batch", "two_squares", "--source", "a.mp4", "--init", "1,2,30,40", "--out", out]) == 2
    assert "raise the limit on open files (`ulimit -n`)" in capsys.readouterr().err


@pytest.mark.parametrize("is_stubborn", [False, True])
def test_a_video_that_takes_too_long_is_stopped_and_the_others_go_on(monkeypatch, is_stubborn):
    stubborn = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); " if is_stubborn else ""
    programs = [
        f"{stubborn}import time; time.sleep(60)",
        """import sys; sys.stdin.readline(); print('{"row": {"status": "finished"}}')""",
    ]
    begun = []

    class Other(subprocess.Popen):
        def __init__(self, *_, **options):
            super().__init__([sys.executable, "-c", programs[len(begun)]], **options)
            begun.append(self)

    monkeypatch.setattr(places.subprocess, "Popen", Other)
    monkeypatch.setattr(places, "ENDING_S", 0.2)
    started = time.monotonic()
    slow, quick = rows_of(Processes(1, 0.8), job("slow"), job("quick")).values()
    assert time.monotonic() - started < 10.0
    assert slow["status"] == "timed out" and "stopped after 0.8 s (--timeout)" in slow["reason"]
    assert quick["status"] == "finished"
    assert begun[0].poll() == -(signal.SIGKILL if is_stubborn else signal.SIGTERM)


def read(path):
    with path.open() as file:
        return [(row["video"], row["seed"], row["status"]) for row in csv.DictReader(file)]


def finished(one):
    return JobProgress(one, row=failed_row(one, "") | {"status": FINISHED})


def test_the_table_keeps_what_was_there_and_grows_while_the_batch_runs(tmp_path, monkeypatch):
    path, jobs = tmp_path / "results.csv", [job("a"), job("b")]
    with BatchTable(path, []) as results:
        pass
    assert read(path) == []
    with BatchTable(path, [job("a"), job("z")]) as results:
        results.add(JobProgress(job("a"), row=failed_row(job("a"), "x")))
        results.add(finished(job("z")))
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt), BatchTable(path, jobs) as results:
        results.add(None)
        raise KeyboardInterrupt
    assert path.read_bytes() == before, "an early Ctrl-C leaves it alone"
    monkeypatch.setattr("bayesnet_track.cli.batch.results.EVERY_S", 0.0)
    with BatchTable(path, jobs) as results:
        results.add(finished(job("b")))
        assert read(path) == [("a", "0", "failed"), ("b", "0", "finished"), ("z", "0", "finished")]
        assert [row["video"] for row in results.rows()] == ["b"], "what this batch has done"


@pytest.mark.parametrize("text", ["mine,not yours\n1,2\n", "\x00\xff\xfe"])
def test_a_file_that_is_no_table_is_not_written_over(tmp_path, text):
    path = tmp_path / "results.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(BatchError, match="not a table of results"):
        BatchTable(path, [])
    assert path.read_bytes() == text.encode("latin-1")


def test_progress_says_how_many_are_done_and_how_long_the_rest_takes(monkeypatch):
    now, written = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    stream = SimpleNamespace(write=written.append, flush=lambda: None)
    jobs = [job(str(n)) for n in range(7)]
    progress = BatchProgress(stream, jobs, is_terminal=False)
    for n, one in enumerate(jobs, start=1):
        now[0] = 20.0 * n
        progress.update(finished(one))
    assert written[2].endswith("(3 of 7, 1:20 left)\n") and written[6].endswith("(7 of 7)\n")


def test_a_silence_is_said_once_until_it_ends():
    silence = Silence(0.0)
    assert silence.hear(JobProgress(job("a")), 0.0) == [] and silence.hear(None, 59.0) == []
    assert silence.hear(JobProgress(job("b"), 12, 100), 59.0) == []
    assert silence.hear(None, 60.0) == ["a seed 0: no progress for 60 s, frame 0"]
    assert silence.hear(None, 119.0) == ["b seed 0: no progress for 60 s, frame 12/100"]
    assert silence.hear(None, 500.0) == []
    assert silence.hear(JobProgress(job("a"), 3), 500.0) == []
    assert silence.hear(None, 561.0) == ["a seed 0: no progress for 61 s, frame 3"]
    for name in ("a", "b"):
        silence.hear(finished(job(name)), 600.0)
    assert silence.hear(None, 700.0) == ["no run has been heard of for 100 s"]


@pytest.mark.parametrize("address", [None, "10.0.0.9:6379"])
def test_a_cluster_that_does_not_start_in_time_is_a_clear_error(tmp_path, monkeypatch, capsys, address):
    def init(**_):
        raise Exception("The current node timed out during startup.\nThis could happen because ...")

    ray = SimpleNamespace(is_initialized=lambda: False, init=init)
    monkeypatch.setitem(sys.modules, "ray", ray)
    command = ["batch", "two_squares", "--source", "a.mp4", "--init", "1,2,30,40", "--on", "ray"]
    more = [] if address is None else ["--ray-address", address]
    assert main([*command, *more, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "timed out during startup" in error and "Traceback" not in error
    assert ("cannot be started here" if address is None else f"no Ray cluster at {address}") in error


def outputs(folder):
    """What is a function of graph, source, start and seed: file -> bytes."""
    names = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "graph.yaml")
    return {name: (folder / name).read_bytes() for name in names}


@pytest.mark.slow
def test_a_process_leaves_nothing_of_a_video_to_the_next_one(tmp_path, monkeypatch):
    """In any order, the files are those that a fresh process writes."""
    for scene in ("two_squares", "gray_square"):
        (tmp_path / scene).mkdir()
        for frame in SceneSource(make_scene(scene, seed=0), scene, 12):
            cv2.imwrite(str(tmp_path / scene / f"{frame.index:03}.png"), frame.image)
    kinds = [("general", "two_squares"), ("general", "gray_square"), ("two_squares", "two_squares")]

    def tracked(where, order):
        top = tmp_path / where
        jobs = [
            Job(
                graph,
                BatchVideo(str(tmp_path / scene), scene, init="60,50,40,40"),
                3,
                str(top / graph / scene),
            )
            for graph, scene in order
        ]
        rows = rows_of(Processes(1), *jobs)
        assert [row["status"] for row in rows.values()] == 3 * [FINISHED]
        return {(job.graph, job.video.name): outputs(Path(job.out)) for job in jobs}

    begun = []
    begin = subprocess.Popen

    def counted(*arguments, **options):
        begun.append(begin(*arguments, **options))
        return begun[-1]

    monkeypatch.setattr(places.subprocess, "Popen", counted)
    monkeypatch.setattr(places, "MOST_JOBS", 1)
    fresh = tracked("fresh", kinds)
    assert len(begun) == 3
    monkeypatch.setattr(places, "MOST_JOBS", 100)
    assert tracked("warm", kinds) == tracked("other", kinds[::-1]) == fresh
    assert len(begun) == 5 and all(process.poll() is not None for process in begun)


def test_after_a_video_that_failed_the_process_is_another(monkeypatch):
    statuses = iter(["failed", "finished", "finished"])
    program = """import sys
for line in sys.stdin: print('{"row": {"status": "%s"}}', flush=True)"""
    begun = []

    class Other(subprocess.Popen):
        def __init__(self, *_, **options):
            super().__init__([sys.executable, "-c", program % next(statuses)], **options)
            begun.append(self)

    monkeypatch.setattr(places.subprocess, "Popen", Other)
    rows = rows_of(Processes(1), job("a"), job("b"), job("c"), job("d"))
    assert [row["status"] for row in rows.values()] == ["failed", "finished", "finished", "finished"]
    assert len(begun) == 2 and all(process.poll() is not None for process in begun)
