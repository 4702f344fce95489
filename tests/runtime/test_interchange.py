"""A run as other tools take it: detections, tables, MOT, COCO, CSV, JSON Lines."""

import csv
import io
import json
import sys
from types import ModuleType

import numpy as np
import pytest

from bayesnet_track import Detections, Start, Tracker, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.recording.exports import as_coco, as_csv, as_jsonl, as_mot
from bayesnet_track.runtime.recording.interchange import AGENT_COLUMNS, TRACK_COLUMNS
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.scenes import make_scene

COLUMNS = (
    "frame,time_s,target,kind,x,y,w,h,angle,status,score,ud_px2,quiet_px2,sd_x,sd_y,sd_w,sd_h,"
    "log_evidence,surprise,ess,particles,learn_rate,active"
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two kinds of targets, 12 frames."""
    out = tmp_path_factory.mktemp("interchange") / "run"
    assert main(["demo", "orange_and_gray", "--end", "12", "--quiet", "--out", str(out)]) == 0
    return open_run(out)


def boxes_of(text):
    """Lines of MOT -> (frame, id) -> (left, top, width, height, score)."""
    rows = [line.split(",") for line in text.splitlines()]
    return {(int(row[0]), int(row[1])): tuple(map(float, row[2:7])) for row in rows}


def test_mot_is_what_the_run_wrote_itself(run):
    mine, its = boxes_of("".join(as_mot(run, lost=True))), boxes_of(run.directory.mot.read_text())
    assert list(mine) == list(its)
    # The journal keeps 9 significant digits, so the third decimal may be rounded the other way.
    np.testing.assert_allclose(list(mine.values()), list(its.values()), atol=1.001e-3)


def test_detections_have_the_fields_and_shapes_of_supervision(run):
    found = run.detections()
    assert found.xyxy.shape == (len(run.metrics), 4) and len(found) == len(run.metrics)
    assert [a.shape for a in (found.confidence, found.class_id, found.tracker_id)] == [(len(found),)] * 3
    assert {column.shape for column in found.data.values()} == {(len(found),)}
    assert [str(kind) for kind in found.data["class_name"][:2]] == list(run.kinds.values())
    assert sorted(set(found.class_id)) == [0, 1] and list(run.spec.targets) == list(run.kinds.values())
    mot = list(boxes_of(run.directory.mot.read_text()).values())
    wide = np.array([[x, y, x + w, y + h] for x, y, w, h, _ in mot])
    np.testing.assert_allclose(found.xyxy, wide, atol=2.1e-3)
    for box, confidence, kind, target, data in run.detections(3):
        assert (
            box.shape == (4,) and 0 <= confidence <= 1 and {kind, target} <= {0, 1, 2} and data["frame"] == 3
        )


def test_lost_targets_are_left_out_unless_asked_for(run):
    from dataclasses import replace

    lines = [replace(line, status="lost") for line in run.metrics[:2]]
    assert len(Detections.of(lines)) == 0 and Detections.of(lines).xyxy.shape == (0, 4)
    assert len(Detections.of(lines, lost=True)) == 2


def test_from_a_result_and_from_a_tracker(tmp_path):
    scene = make_scene("two_squares")
    tracker = Tracker("two_squares")
    tracker.init(scene.frames[0], scene.start_box)
    found = tracker.detections()
    (box,) = found.xyxy
    assert np.isnan(found.data["time_s"]).all()  # no clock came with the frames
    x, y, w, h = scene.start_box
    assert tuple(box) == (x, y, x + w, y + h)
    folder = tmp_path / "frames"
    folder.mkdir()
    import cv2

    for index in range(3):
        cv2.imwrite(str(folder / f"{index}.png"), scene.frames[index])
    results = list(track("two_squares", folder, scene.start_box))
    assert [result.kinds for result in results] == [{"1": "square"}] * 3
    found = results[2].detections()
    assert list(found.data["class_name"]) == ["square"] and list(found.tracker_id) == [1]


def test_the_class_of_a_result_is_numbered_as_in_the_graph(run, tmp_path):
    import cv2

    scene = make_scene("orange_and_gray")
    cv2.imwrite(str(tmp_path / "0.png"), scene.frames[0])
    _, second = run.spec.targets
    (result,) = track("orange_and_gray", tmp_path, [Start(scene.start_box, second)])
    found = result.detections()
    assert (found.class_id.tolist(), found.data["class_name"].tolist()) == ([1], [second])


def test_to_supervision_hands_over_the_same_fields(run, monkeypatch):
    given = {}
    fake = ModuleType("supervision")
    fake.Detections = lambda **fields: given.update(fields)
    monkeypatch.setitem(sys.modules, "supervision", fake)
    run.detections().to_supervision()
    assert sorted(given) == ["class_id", "confidence", "data", "tracker_id", "xyxy"]
    assert type(given["data"]) is dict


def test_to_supervision_without_it_says_what_to_install(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "supervision", None)
    with pytest.raises(ImportError, match="pip install supervision"):
        run.detections().to_supervision()


def test_columns_stay(run):
    assert ",".join(TRACK_COLUMNS) == COLUMNS
    table = run.to_dict()
    assert {len(column) for column in table.values()} == {len(run.metrics)}
    assert table["kind"][:2] == list(run.kinds.values())
    agents = run.agents_to_dict()
    assert tuple(agents) == AGENT_COLUMNS
    assert len(agents["kl"]) == sum(len(line.active) for line in run.metrics)


def test_csv_and_json_lines_hold_the_same_rows(run):
    head, *rows = csv.reader(io.StringIO(as_csv(run)))
    assert ",".join(head) == COLUMNS and len(rows) == len(run.metrics)
    lines = [json.loads(line) for line in as_jsonl(run).splitlines()]
    for row, line in zip(rows, lines, strict=True):
        cells = dict(zip(head, row, strict=True))
        assert cells["active"].split() == line["active"]
        assert float(cells["x"]) == line["x"] and cells["target"] == line["target"]
        assert cells["quiet_px2"] == "" or line["quiet_px2"] is not None


def test_coco_holds_together(run):
    coco = json.loads(as_coco(run))
    images = {image["id"]: image for image in coco["images"]}
    categories = {one["id"]: one["name"] for one in coco["categories"]}
    assert list(categories.values()) == list(run.spec.targets) and len(images) == 12
    assert len({one["id"] for one in coco["annotations"]}) == len(coco["annotations"]) == len(run.metrics)
    mot = boxes_of(run.directory.mot.read_text())
    for one in coco["annotations"]:
        x, y, w, h, score = mot[images[one["image_id"]]["frame_id"] + 1, one["track_id"]]
        assert one["bbox"] == pytest.approx([x, y, w, h], abs=1.001e-3)
        assert one["area"] == pytest.approx(w * h, rel=1e-3) and one["score"] == pytest.approx(
            score, abs=2e-6
        )
        assert categories[one["category_id"]] == list(run.kinds.values())[one["track_id"] - 1]


def test_the_command_writes_and_does_not_overwrite(run, tmp_path, capsys):
    out = tmp_path / "tracks.json"
    line = ["export", run.name, "--format", "coco", "--out", str(out)]
    assert main(line) == 0 and json.loads(out.read_text())["images"]
    assert main(line) == 6 and "--overwrite" in capsys.readouterr().err
    assert main(["export", run.name, "--format", "csv"]) == 0
    assert capsys.readouterr().out.startswith(COLUMNS)


def test_a_folder_that_is_no_run(tmp_path, capsys):
    assert main(["export", str(tmp_path), "--format", "csv"]) == 4
    assert "no journal.jsonl in it" in capsys.readouterr().err


def test_coco_names_the_images_of_the_source_while_they_are_there(tmp_path, monkeypatch):
    import cv2

    scene = make_scene("two_squares")
    folder = tmp_path / "frames"
    folder.mkdir()
    for index in range(5):
        cv2.imwrite(str(folder / f"shot-{index + 7}.PNG"), scene.frames[index])
    monkeypatch.chdir(tmp_path)
    box = ",".join(str(value) for value in scene.start_box)
    line = [
        "run",
        "gray_square",
        "--source",
        "frames",
        "--start",
        "1",
        "--init",
        box,
        "--quiet",
        "--out",
        "run",
    ]
    assert main(line) == 0
    names = [image["file_name"] for image in json.loads(as_coco(open_run("run")))["images"]]
    assert names == [f"shot-{index}.PNG" for index in (8, 9, 10, 11)]
    monkeypatch.chdir(folder)  # the folder is found from everywhere
    run = open_run(tmp_path / "run")
    assert [image["file_name"] for image in json.loads(as_coco(run))["images"]] == names
    (folder / "shot-9.PNG").write_bytes((folder / "shot-8.PNG").read_bytes() + b"more")
    with pytest.warns(InputNotice, match="frames: changed since the run; images are named by frame"):
        text = as_coco(run)
    assert [image["file_name"] for image in json.loads(text)["images"]] == [
        f"{n:06d}.jpg" for n in (1, 2, 3, 4)
    ]
    for file in folder.iterdir():
        file.unlink()
    assert json.loads(as_coco(run))["images"][0]["file_name"] == "000001.jpg"
