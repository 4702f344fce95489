"""A batch of many videos: what is finished costs nothing, parts for several computers, and how it ends."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
from pathlib import Path

import cv2
import pytest

from bayesnet_track.cli.batch import work
from bayesnet_track.cli.batch.jobs import BatchVideo, Job, Part
from bayesnet_track.cli.batch.places import JobProgress, Needs, Processes
from bayesnet_track.cli.batch.results import BatchTable, Ledger, overview
from bayesnet_track.cli.batch.work import ROW, do, failed_row
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.executors.workers import PlacingError
from bayesnet_track.sources.scenes import make_scene

SCENE = make_scene("two_squares", 0)
BOX = "{:g},{:g},{:g},{:g}".format(*SCENE.start_box)
NAMES = ("a", "b", "c", "d", "e")


@pytest.fixture
def videos(tmp_path: Path) -> Path:
    for length, name in enumerate(NAMES, start=3):
        (tmp_path / "data" / name / "img").mkdir(parents=True)
        for number in range(length):
            cv2.imwrite(str(tmp_path / "data" / name / "img" / f"{number}.png"), SCENE.frames[number])
    return tmp_path


class Here:
    """Jobs done in this process, as they come; remembers which."""

    def __init__(self) -> None:
        self.done: list[str] = []

    def run(self, place: Processes, jobs: list[Job]):
        for job in jobs:
            self.done.append(job.video.name)
            try:
                row = do(job, lambda done, expected: None)
            except ValueError as error:
                row = failed_row(job, str(error))
            yield JobProgress(job, row=row)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Here:
    place = Here()
    monkeypatch.setattr(Processes, "run", lambda self, jobs: place.run(self, jobs))
    return place


def batch(folder: Path, *more: str) -> int:
    given = ["--source", f"{folder}/data/*/img", "--init", BOX, "--out", str(folder / "out")]
    return main(["batch", "two_squares", *given, *more])


def table(path: Path) -> list[str]:
    with path.open() as file:
        return [row["video"] for row in csv.DictReader(file) if row["status"] == "finished"]


def test_finished_runs_are_not_opened_again(videos, here, monkeypatch, capsys):
    assert batch(videos) == 0 and here.done == ["e", "d", "c", "b", "a"]  # the longest first
    before = (videos / "out" / "results.csv").read_bytes()
    assert table(videos / "out" / "results.csv") == list(NAMES)
    monkeypatch.setattr(work, "row_of", None)
    (videos / "out" / "results.csv").unlink()
    assert batch(videos) == 0 and len(here.done) == len(NAMES)
    assert "5 of 5 runs were finished before" in capsys.readouterr().err
    assert (videos / "out" / "results.csv").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize("change", ["removed", "touched", "unfinished"])
def test_a_run_that_is_not_as_it_was_is_looked_at_again(videos, here, change):
    batch(videos)
    run = videos / "out" / "b"
    if change == "removed":
        shutil.rmtree(run)
    elif change == "touched":
        os.utime(run / "manifest.json", ns=(1, 1))
    else:
        (run / "manifest.json").unlink()
    batch(videos)
    assert here.done[len(NAMES) :] == ["b"]
    assert batch(videos) == 0 and len(here.done) == len(NAMES) + 1


@pytest.mark.slow
def test_other_requests_are_not_taken_for_what_is_finished(videos, here, capsys):
    batch(videos)
    assert batch(videos, "--end", "2", "--json") == 5
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["failed"] == 5 and "asked for otherwise: end none, now 2" in told["runs"][0]["reason"]


@pytest.mark.slow
def test_changed_ground_truth_is_scored_with_again(videos, here):
    truth = videos / "truth.txt"
    rows = [",".join(f"{value:g}" for value in box) for box in SCENE.truth[:7]]
    truth.write_text("\n".join(rows) + "\n")
    assert batch(videos, "--truth", str(truth)) == 0 == batch(videos, "--truth", str(truth))
    assert len(here.done) == 5
    truth.write_text("\n".join("1,1,5,5" for _ in rows) + "\n")
    batch(videos, "--truth", str(truth))
    assert len(here.done) == 10
    with (videos / "out" / "results.csv").open() as file:
        assert all(float(row["auc"]) < 0.1 for row in csv.DictReader(file))


def test_a_batch_that_is_killed_loses_no_row(videos, tmp_path):
    """Results that are never left, as by a kill: what is on the disk counts, but for a torn line."""
    jobs = [
        Job(
            "two_squares", BatchVideo(str(videos / "data" / name), name, BOX), 0, str(tmp_path / "out" / name)
        )
        for name in NAMES
    ]

    def results() -> BatchTable:
        return BatchTable(tmp_path / "out" / "results.csv", jobs, Ledger(tmp_path / "out", "whole", "graph"))

    killed = results()
    for job in jobs[:2]:
        killed.add(JobProgress(job, row=do(job, lambda done, expected: None)))
    ledger = tmp_path / "out" / ".batch" / "whole.jsonl"
    ledger.write_bytes(ledger.read_bytes()[:-9])
    again = results()
    assert again.todo == jobs[1:] and [row["video"] for row in again.rows()] == ["a"]
    again.add(JobProgress(jobs[1], row=do(jobs[1], lambda done, expected: None)))
    assert results().todo == jobs[2:]


@pytest.mark.slow
def test_parts_share_a_folder_and_the_whole_finds_them_done(videos, here):
    for number in (1, 2):
        assert batch(videos, "--part", f"{number}/2", "--quiet") == 0
    assert sorted(here.done) == list(NAMES)
    assert table(videos / "out" / "results.1-of-2.csv") == ["a", "c", "e"]
    assert table(videos / "out" / "results.2-of-2.csv") == ["b", "d"]
    assert not (videos / "out" / "results.csv").exists()
    assert batch(videos, "--quiet") == 0 and len(here.done) == 5
    assert table(videos / "out" / "results.csv") == list(NAMES)


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "1/0", "-1/3", "a/b", "1/3/5", "1.5/3", "²/3", ""])
def test_a_part_that_there_is_not_is_refused(videos, capsys, text):
    with pytest.raises(SystemExit):
        batch(videos, f"--part={text}")
    assert "K/N is needed, part K of N" in capsys.readouterr().err
    assert not (videos / "out").exists()


def test_a_part_without_a_video_is_refused(videos, capsys):
    assert batch(videos, "--part", "7/7") == 2
    assert "of 5 videos this part has none; give at most 5 parts" in capsys.readouterr().err


def test_parts_are_all_videos_once() -> None:
    videos = [BatchVideo(f"{n}.mp4", str(n)) for n in range(103)]
    parts = [Part(k, 8).select(videos) for k in range(1, 9)]
    assert sorted((one for part in parts for one in part), key=videos.index) == videos
    assert {len(part) for part in parts} == {12, 13}


def test_the_largest_come_first_and_equal_ones_in_their_order(tmp_path: Path) -> None:
    for name, size in (("small", 10), ("large", 1000), ("same", 10)):
        (tmp_path / name).write_bytes(b"x" * size)
    names = ["small", "missing", "large", "same"]
    jobs = [Job("g", BatchVideo(str(tmp_path / name), name), 0, name) for name in names]
    assert [job.out for job in BatchTable(tmp_path / "results.csv", jobs).todo] == [
        "large",
        "small",
        "same",
        "missing",
    ]


def test_as_many_runs_at_a_time_as_fit() -> None:
    assert Needs(1, 4 << 30).fitting(16, 10 << 30) == 2
    assert Needs(3).fitting(16, 10 << 30) == 5 and Needs().fitting(16, None) == 16
    with pytest.raises(PlacingError, match=r"8\.0 GiB \(--memory\), and there are 16 and 4\.0 GiB"):
        Needs(1, 8 << 30).check(16, 4 << 30)


@pytest.mark.parametrize("text", ["2", "G", "-1G", "1.5G", "0M", "2K"])
def test_memory_is_a_whole_number_with_a_unit(videos, capsys, text):
    with pytest.raises(SystemExit):
        batch(videos, f"--memory={text}")
    assert "a whole number of M, G or T (bytes) is needed" in capsys.readouterr().err


def test_more_than_there_is_is_refused(videos, capsys):
    assert batch(videos, "--memory", "900T") != 0
    assert "(--memory), and there are" in capsys.readouterr().err


def test_a_batch_ends_with_a_mean_and_a_page(videos, here, capsys):
    (videos / "data" / "bad<b>" / "img").mkdir(parents=True)
    (videos / "data" / "bad<b>" / "img" / "0.png").write_bytes(b"no image")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            Here, "run", lambda self, place, jobs: (JobProgress(job, row=_row(job)) for job in jobs)
        )
        assert batch(videos) == 5
    told = capsys.readouterr().out
    assert re.search(r"^mean: frames 5, ", told, re.MULTILINE)
    page = (videos / "out" / "overview.html").read_text()
    assert page.index("mean of finished runs") < page.index("bad_b_") < page.index(">a</a>")
    assert "6 runs, 1 not finished" in page and "no &lt;image&gt;" in page and 'href="./a/"' in page


def _row(job: Job) -> dict[str, object]:
    row = dict.fromkeys(ROW) | {"video": job.video.name, "seed": 0}
    if "bad" in job.video.name:
        return row | {"status": "failed", "reason": "no <image>"}
    return row | {"status": "finished", "frames": 3 + NAMES.index(job.video.name), "score_mean": 0.5}


def test_a_page_lists_the_least_sure_and_says_how_many_it_leaves_out() -> None:
    rows = [
        dict.fromkeys(ROW) | {"video": f"v{n}", "seed": 0, "status": "finished", "score_mean": n / 3000}
        for n in range(3000)
    ]
    page = overview("many", [(str(row["video"]), row) for row in rows], {}, "results.csv")
    assert "1000 more, of higher scores" in page and "v1999<" in page and "v2000<" not in page
