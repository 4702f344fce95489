"""A batch: what is to be done, done in processes of their own, and told as one table."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.cli.batch import places
from bayesnet_track.cli.batch.jobs import BatchError, BatchVideo, Job, allow_job, read_list, videos_of
from bayesnet_track.cli.batch.work import ROW, do
from bayesnet_track.cli.main import main
from bayesnet_track.observation import plugins
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.runtime.recording.manifest import lock_run
from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError
from bayesnet_track.sources.scenes import make_scene


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    scene = make_scene("two_squares", 0)
    for name in ("one", "two"):
        (folder / name / "img").mkdir(parents=True)
        for number in range(6):
            cv2.imwrite(str(folder / name / "img" / f"{number}.png"), scene.frames[number])
        np.savetxt(folder / name / "groundtruth.txt", scene.truth[:6], delimiter=",")
    (folder / "bad" / "img").mkdir(parents=True)
    (folder / "bad" / "img" / "0.png").write_bytes(b"no image")
    (folder / "bad" / "groundtruth.txt").write_text("1,1,9,9\n")
    return folder


def test_patterns_name_videos_and_their_files(data: Path) -> None:
    found = videos_of([f"{data}/*/img"], "{folder}/groundtruth.txt", "truth/{name}.txt")
    assert [one.name for one in found] == ["bad", "one", "two"]
    assert found[1].init_from == f"{data}/one/groundtruth.txt" and found[1].truth == "truth/one.txt"
    assert [one.name for one in videos_of(["a/x.mp4", "b/x.mp4"])] == ["x", "x-2"]
    with pytest.raises(BatchError, match="matches nothing"):
        videos_of([f"{data}/*/none"])
    with pytest.raises(BatchError, match="may stand in braces"):
        videos_of(["a.mp4"], "{nome}.txt")


@pytest.mark.parametrize(
    "text",
    [
        'source,name,init\na.mp4,first,"1,2,3,4"\nb.mp4,,\n',
        '{"source": "a.mp4", "name": "first", "init": "1,2,3,4"}\n\n{"source": "b.mp4"}\n',
    ],
)
def test_a_list_is_csv_or_json_lines(tmp_path: Path, text: str) -> None:
    (tmp_path / "list").write_text(text)
    assert read_list(tmp_path / "list") == [BatchVideo("a.mp4", "first", "1,2,3,4"), BatchVideo("b.mp4", "b")]


@pytest.mark.parametrize("text", ["", "source\n", "src\na\n", "{x", '{"source": 1}', "source,init\n,1\n"])
def test_a_malformed_list_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "list").write_text(text)
    with pytest.raises(BatchError, match="list"):
        read_list(tmp_path / "list")


def test_a_job_is_begun_gone_on_with_and_found_finished(data: Path, tmp_path: Path) -> None:
    truth = str(data / "one" / "groundtruth.txt")
    video = BatchVideo(str(data / "one" / "img"), "one", None, truth, truth)
    job = Job("two_squares", video, 0, str(tmp_path / "run"))
    assert Job.from_json(job.to_json()) == job
    box = tuple(float(value) for value in make_scene("two_squares", 0).truth[0])
    results = track("two_squares", video.source, box, out=job.out)
    next(results), next(results)
    results.close()
    progress: list[int] = []
    first = do(job, lambda done, expected: progress.append(done))
    assert progress == [3, 4, 5, 6]
    assert (first["status"], first["frames"], first["lost_frames"]) == ("finished", 6, 0)
    assert isinstance(first["auc"], float) and first["auc"] > 0.5
    assert do(job, lambda done, expected: progress.append(done)) == first and len(progress) == 4


def test_a_run_that_was_asked_for_otherwise_is_not_taken_for_this_one(data: Path, tmp_path: Path) -> None:
    truth = str(data / "one" / "groundtruth.txt")
    job = Job(
        "two_squares", BatchVideo(str(data / "one" / "img"), "one", None, truth), 0, str(tmp_path / "run")
    )
    do(job, lambda done, expected: None)
    folder = tmp_path / "run"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    graph = tmp_path / "other.yaml"
    graph.write_text((folder / "graph.yaml").read_text().replace("two_squares", "other", 1))
    other = str(data / "two" / "img")
    for changed, what in [
        ({"graph": str(graph)}, "graph"),
        ({"seed": 3}, "seed 0, now 3"),
        ({"end": 5}, "end none, now 5"),
        ({"on_resize": "rescale"}, "on_resize stop, now rescale"),
        ({"max_side": 160}, "max_side none, now 160"),
        ({"video": BatchVideo(other, "one", None, truth)}, f"source .*one/img, now {other}"),
        ({"video": replace(job.video, init="1,2,30,40", init_from=None)}, "start"),
    ]:
        with pytest.raises(BatchError, match=f"{folder}: .*{what}.*another --out"):
            do(replace(job, **changed), lambda done, expected: None)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_ground_truth_of_several_targets_is_refused_before_anything_is_tracked(
    data: Path, tmp_path: Path
) -> None:
    many = tmp_path / "many.txt"
    many.write_text("1,1,9,9,20,20,1,1,1\n1,2,40,40,20,20,1,1,1\n")
    video = BatchVideo(
        str(data / "one" / "img"), "one", None, str(data / "one" / "groundtruth.txt"), str(many)
    )
    with pytest.raises(
        ValueError, match=r"boxes of 2 targets .*; nothing was tracked\. .*`score RUN --truth"
    ):
        do(Job("two_squares", video, 0, str(tmp_path / "run")), lambda *_: None)
    assert not (tmp_path / "run").exists()


def test_a_run_that_another_process_writes_is_left_alone(data: Path, tmp_path: Path) -> None:
    truth = str(data / "one" / "groundtruth.txt")
    job = Job(
        "two_squares", BatchVideo(str(data / "one" / "img"), "one", None, truth), 0, str(tmp_path / "run")
    )
    with lock_run(RunDirectory.create(job.out)):
        with pytest.raises(RunDirectoryError, match="another process is writing this run"):
            do(job, lambda done, expected: None)
        assert [path.name for path in (tmp_path / "run").iterdir()] == [".lock"]


def test_a_job_that_begins_while_the_batch_is_ended_ends_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others are ended while this one's process is being started."""
    has_begun, may_go_on = threading.Event(), threading.Event()
    begun: list[subprocess.Popen[str]] = []

    class Late(subprocess.Popen[str]):
        def __init__(self, *arguments: object, **options: object) -> None:
            has_begun.set()
            may_go_on.wait(10.0)
            super().__init__([sys.executable, "-c", "import time; time.sleep(20)"], **options)  # type: ignore[call-overload]
            begun.append(self)

    monkeypatch.setattr(places.subprocess, "Popen", Late)
    running = places.Processes(1).run([Job("g", BatchVideo("v", "v"), 0, str(tmp_path))])
    next(running)
    assert has_begun.wait(10.0)
    threading.Timer(0.2, may_go_on.set).start()
    started = time.monotonic()
    running.close()
    assert time.monotonic() - started < 10.0
    assert begun[0].poll() == -signal.SIGTERM


@pytest.mark.slow
def test_a_failed_video_is_told_and_stops_no_other(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run() -> int:
        here = f"batch two_squares --source {data}/*/img --init-from {{folder}}/groundtruth.txt"
        return main(f"{here} --out {tmp_path}/out --jobs 2 --end 5".split())

    assert run() == 5
    said = capsys.readouterr()
    assert "3 of 3 runs done, 1 failed" in said.out and "bad seed 0: failed: source" in said.err
    with (tmp_path / "out" / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == ROW
    assert [(row["video"], row["status"], row["frames"]) for row in rows] == [
        ("bad", "failed", ""),
        ("one", "finished", "5"),
        ("two", "finished", "5"),
    ]
    before = (tmp_path / "out" / "one" / "timings.jsonl").read_bytes()
    assert run() == 5
    assert (tmp_path / "out" / "one" / "timings.jsonl").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--quiet"]])
def test_what_a_job_does_not_use_is_said(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    truth = tmp_path / "longer.txt"
    truth.write_text((data / "one" / "groundtruth.txt").read_text() * 2)
    line = f"batch two_squares --source {data}/one/img --init-from {{folder}}/groundtruth.txt --truth {truth}"
    assert main([*line.split(), "--out", str(tmp_path / "out"), *options]) == 0
    said = f"one seed 0: {truth} has 12 rows, the run 6 frames: is it of this video?"
    assert capsys.readouterr().err.count(said) == 1


def test_a_batch_without_start_boxes_is_a_mistake(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(f"batch two_squares --source {data}/*/img --out {tmp_path}/out".split()) == 2
    assert "bad: no start box" in capsys.readouterr().err
    assert main(f"batch two_squares --out {tmp_path}/out".split()) == 2


def test_a_job_takes_its_cue_files_to_its_process(tmp_path):
    file = tmp_path / "plain.py"
    file.write_text("from bayesnet_track import CueDeclaration\nCUE = CueDeclaration('plain', make=object)\n")
    job = Job("general", BatchVideo("a.mkv", "a"), 0, "out", cue_files=(str(file),))
    assert Job.from_json(job.to_json()) == job
    allow_job(job)
    assert "plain" in installed_cues()
    plugins.forget()
