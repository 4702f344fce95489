"""`simulate` draws the prior over a frame, and says what it needs."""

import csv
import json

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("source")
    for n in range(2):
        cv2.imwrite(str(folder / f"{n}.png"), np.full((60, 80, 3), 90, np.uint8))
    return folder


def call(images, *more, graph="kalman_ball", init=("--init", "30,20,12,12")):
    return main(["simulate", graph, "--source", str(images), *init, *more])


def test_picture_csv_and_table_are_of_one_seed(images, tmp_path, capsys):
    for name in ("a", "b"):
        files = ["--png", str(tmp_path / f"{name}.png"), "--csv", str(tmp_path / f"{name}.csv")]
        assert call(images, "--frames", "5", "--draws", "7", "--seed", "4", *files) == 0
    assert capsys.readouterr().out.startswith("frames  centre, px from the start")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert len(rows) == 7 * 6 and list(rows[0])[:8] == ["trajectory", "frame", "x", "y", "w", "h", "vx", "vy"]
    assert [float(rows[0][key]) for key in "xywh"] == [30, 20, 12, 12]
    assert (cv2.imread(str(tmp_path / "a.png")) != 90).any()


def test_modes_are_named_in_the_csv(images, tmp_path):
    out = tmp_path / "a.csv"
    assert call(images, "--frames", "2", "--draws", "3", "--csv", str(out), graph="hidden_ball") == 0
    assert {row["mode"] for row in csv.DictReader(out.read_text().splitlines())} <= {"seen", "behind"}


def test_wrong_uses_are_explained(images, tmp_path, capsys):
    (tmp_path / "there.csv").write_text("kept")
    wrong = {
        "give the box of the first frame": call(images, init=()),
        "four numbers X,Y,W,H": call(images, init=("--init", "1,2,3")),
        "no plate 'dog'": call(images, init=("--init", "dog:30,20,12,12")),
        "outside the 80x60 frame": call(images, init=("--init", "300,20,12,12")),
        "no such file": call(tmp_path / "none"),
        "it is there already; --overwrite replaces it": call(images, "--csv", str(tmp_path / "there.csv")),
    }
    said = capsys.readouterr().err
    assert all(code in (2, 4, 6) for code in wrong.values()), json.dumps(wrong)
    assert [text for text in wrong if text.lower() not in said.lower()] == [], said
    assert (tmp_path / "there.csv").read_text() == "kept"
