"""A batch as tasks of a Ray cluster: the same table as in processes."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.batch.jobs import BatchVideo, Job
from bayesnet_track.cli.batch.places import Needs
from bayesnet_track.cli.batch.ray_place import RayTasks
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.executors import PlacingError
from bayesnet_track.sources.scenes import make_scene

MEASURED = ("frames", "agents_per_frame", "score_mean", "auc", "status")


@pytest.mark.slow
def test_the_same_table_as_in_processes(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    scene = make_scene("two_squares", 0)
    (tmp_path / "one" / "img").mkdir(parents=True)
    for number in range(6):
        cv2.imwrite(str(tmp_path / "one" / "img" / f"{number}.png"), scene.frames[number])
    np.savetxt(tmp_path / "one" / "groundtruth.txt", scene.truth[:6], delimiter=",")
    (tmp_path / "bad" / "img").mkdir(parents=True)
    (tmp_path / "bad" / "img" / "0.png").write_bytes(b"no image")
    (tmp_path / "bad" / "groundtruth.txt").write_text("1,1,9,9\n")

    tables = []
    for where in ("here", "ray"):
        out = tmp_path / where
        code = main(
            ["batch", "two_squares", "--source", f"{tmp_path}/*/img", "--out", str(out), "--quiet"]
            + [
                "--init-from",
                "{folder}/groundtruth.txt",
                "--truth",
                "{folder}/groundtruth.txt",
                "--on",
                where,
            ]
        )
        assert code == 5  # one video fails, and stops no other
        rows = list(csv.DictReader((out / "results.csv").open()))
        tables.append([[row[name] for name in MEASURED] for row in rows])
    assert tables[0] == tables[1]
    assert [row[-1] for row in tables[0]] == ["failed", "finished"]


def test_that_ray_is_missing_is_said_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(PlacingError, match=r"pip install 'bayesnet-track\[ray\]'"):
        next(RayTasks().run([]))


@pytest.mark.slow
def test_progress_and_notices_of_tasks_are_told(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    scene = make_scene("two_squares", 0)
    (tmp_path / "img").mkdir()
    for number in range(6):
        cv2.imwrite(str(tmp_path / "img" / f"{number}.png"), scene.frames[number])
    (tmp_path / "img" / "scan.heic").write_bytes(b"")  # an image that is not read
    box = "{:g},{:g},{:g},{:g}".format(*scene.start_box)
    jobs = [
        Job("two_squares", BatchVideo(str(tmp_path / "img"), name, box), 0, str(tmp_path / name))
        for name in "ab"
    ]
    reports = [report for report in RayTasks(needs=Needs(1, 100 << 20)).run(jobs) if report is not None]
    for job in jobs:
        told = [report for report in reports if report.job == job]
        assert told[-1].row is not None and told[-1].row["status"] == "finished"
        assert [report.row for report in told[:-1]] == [None] * (len(told) - 1)
        assert any("scan.heic" in (report.notice or "") for report in told)
        assert any(report.notice is None for report in told[:-1])
    with pytest.raises(PlacingError, match="90000 processors"):
        next(RayTasks(needs=Needs(90000)).run(jobs))
