"""A batch: what is to be done, done in processes of their own, and told as one table."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.batch.jobs import BatchError, Job, Video, read_list, videos_of
from bayesnet_track.batch.work import ROW, do
from bayesnet_track.cli import main
from bayesnet_track.runtime.session import track
from bayesnet_track.scenes import make_scene


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
    assert read_list(tmp_path / "list") == [Video("a.mp4", "first", "1,2,3,4"), Video("b.mp4", "b")]


@pytest.mark.parametrize("text", ["", "source\n", "src\na\n", "{x", '{"source": 1}', "source,init\n,1\n"])
def test_a_malformed_list_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "list").write_text(text)
    with pytest.raises(BatchError, match="list"):
        read_list(tmp_path / "list")


def test_a_job_is_begun_gone_on_with_and_found_finished(data: Path, tmp_path: Path) -> None:
    truth = str(data / "one" / "groundtruth.txt")
    video = Video(str(data / "one" / "img"), "one", None, truth, truth)
    job = Job("two_squares", video, 0, str(tmp_path / "run"))
    assert Job.from_json(job.to_json()) == job
    box = tuple(float(value) for value in make_scene("two_squares", 0).truth[0])
    results = track("two_squares", video.source, box, out=job.out)
    next(results), next(results)
    results.close()
    told: list[int] = []
    first = do(job, lambda done, expected: told.append(done))
    assert told == [3, 4, 5, 6]
    assert (first["status"], first["frames"], first["lost_frames"]) == ("finished", 6, 0)
    assert isinstance(first["auc"], float) and first["auc"] > 0.5
    assert do(job, lambda done, expected: told.append(done)) == first and len(told) == 4


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


def test_a_batch_without_start_boxes_is_a_mistake(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(f"batch two_squares --source {data}/*/img --out {tmp_path}/out".split()) == 2
    assert "bad: no start box" in capsys.readouterr().err
    assert main(f"batch two_squares --out {tmp_path}/out".split()) == 2
