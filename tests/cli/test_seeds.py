"""`run --seeds`: a run for each seed, and one summary."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.sources.scenes import make_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of a scene with its ground truth."""
    folder, made = tmp_path_factory.mktemp("scene"), make_scene("two_squares", 0)
    (folder / "img").mkdir()
    for number in range(6):
        cv2.imwrite(str(folder / "img" / f"{number}.png"), made.frames[number])
    np.savetxt(folder / "truth.txt", made.truth[:6], delimiter=",")
    return folder


def test_each_seed_is_a_run_and_all_are_one_summary(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "runs"
    given = ["--source", str(scene / "img"), "--init-from", str(scene / "truth.txt"), "--out", str(out)]
    assert main(["run", "two_squares", *given, "--seed", "3", "--seeds", "3", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["seeds"] == [3, 4, 5] and sorted(one.name for one in out.iterdir()) == [
        "seed-3",
        "seed-4",
        "seed-5",
    ]
    rows = []
    for seed in told["seeds"]:
        assert main(["score", str(out / f"seed-{seed}"), "--truth", str(scene / "truth.txt"), "--json"]) == 0
        rows.append(json.loads(capsys.readouterr().out))
    auc = told["summary"]["auc"]
    assert auc["seeds"] == 3 and auc["mean"] == pytest.approx(np.mean([row["auc"] for row in rows]))
    assert auc["low"] <= auc["mean"] <= auc["high"]
    assert main(["run", "two_squares", *given, "--seeds", "2", "--view"]) == 2
    assert "--view is for one run; leave out --seeds" in capsys.readouterr().err


def test_ground_truth_of_one_run_is_for_score(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--source", str(scene / "img"), "--init", "1,2,5,5", "--out", str(tmp_path / "run")]
    assert main(["run", "two_squares", *given, "--truth", "gt.txt"]) == 2
    assert main(["run", "two_squares", *given, "--seeds", "2", "--truth", "gt.txt"]) == 2
    assert not (tmp_path / "run").exists()
    assert "--truth is for --seeds; `score RUN --truth FILE`" in capsys.readouterr().err
