"""What readers of formats share, against enumeration: shapes, names, texts, archives, YOLO's lines."""

import math
import random
import zipfile
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.runtime.annotation.formats.reading import (
    MismatchError,
    annotations_in,
    ellipse_box,
    identity_text,
    mask_box,
    number,
    turned_box,
    unpacked_folder,
    whole_value,
)
from bayesnet_track.runtime.annotation.formats.rows import NO_FRAME, frames_of_names
from bayesnet_track.runtime.annotation.formats.yolo import boxes_of_lines, parse_line
from bayesnet_track.runtime.annotation.frame_store import Video

VIDEO = Video("clip.mp4", 12, 160, 120, 0.04)


def runs_of(mask):
    """COCO's runs of a mask (H, W): by columns, beginning with zeros."""
    flat = mask.T.reshape(-1)
    runs, last = [0], 0
    for value in flat:
        if value != last:
            runs.append(0)
            last = value
        runs[-1] += 1
    return runs


def text_of(runs):
    """COCO's compressed text of runs, as its C code writes it."""
    text = ""
    for n, run in enumerate(runs):
        left = run - (runs[n - 2] if n > 2 else 0)
        more = True
        while more:
            bits = left & 31
            left >>= 5
            more = left != (-1 if bits & 16 else 0)
            text += chr(48 + bits + 32 * more)
    return text


def test_boxes_of_masks_are_those_of_their_pixels():
    generator = np.random.default_rng(0)
    for _ in range(300):
        height, width = generator.integers(1, 60, 2)
        mask = np.zeros((height, width), dtype=int)
        top, left = generator.integers(0, height), generator.integers(0, width)
        mask[top : top + generator.integers(1, 50), left : left + generator.integers(1, 50)] = 1
        mask &= generator.random(mask.shape) < generator.choice([0.1, 0.9, 2.0])
        rows, columns = np.nonzero(mask)
        runs = runs_of(mask)
        found = mask_box(runs, int(height))
        assert mask_box(text_of(runs), int(height)) == pytest.approx(found, nan_ok=True)
        if len(rows):
            size = np.ptp(columns) + 1, np.ptp(rows) + 1
            assert found == (columns.min(), rows.min(), *size)
        else:
            assert all(map(math.isnan, found))


@pytest.mark.parametrize("counts", [[1, -2], [1.5], [True], "0!", "Z", "\u0100"])
def test_a_damaged_mask_is_refused(counts):
    with pytest.raises(ValueError, match="mask"):
        mask_box(counts, 5)


def test_a_turned_box_and_ellipse_hold_what_they_are_drawn_of():
    for degrees in range(-360, 720, 7):
        x, y, w, h = turned_box((10.0, 20.0, 30.0, 40.0), degrees)
        assert (x + w / 2, y + h / 2) == pytest.approx((25, 40))
        assert max(w, h) <= 50 + 1e-9
        assert min(w, h) >= 30 - 1e-9
        angles = np.linspace(0, 2 * math.pi, 20000)
        turn = math.radians(degrees)
        px = 5 * np.cos(angles) * math.cos(turn) - 3 * np.sin(angles) * math.sin(turn)
        py = 5 * np.cos(angles) * math.sin(turn) + 3 * np.sin(angles) * math.cos(turn)
        expected = (px.min(), py.min(), np.ptp(px), np.ptp(py))
        assert ellipse_box((0.0, 0.0), (5.0, 3.0), degrees) == pytest.approx(expected, abs=1e-5)
    assert all(map(math.isnan, turned_box((1.0, 2.0, 3.0, 4.0), math.inf)))


@pytest.mark.parametrize(
    ("names", "images", "frames"),
    [
        (["clip_1.txt", "clip_7.txt"], (), [0, 6]),  # ultralytics counts from 1
        (["frame_000001", "frame_000007.PNG"], (), [1, 7]),  # CVAT counts from 0
        (["cam2_000000.txt", "cam2_000003.txt"], (), [0, 3]),
        (["a/b\\000012.txt"], (), [11]),
        (["x_0007_jpg.rf.0a1b2c3d4e5f.txt", "x_0000_jpg.rf.ffffffffff99.txt"], (), [7, 0]),
        (["b.txt", "a.txt"], ("a.png", "b.png"), [1, 0]),
        (["b.txt", "z.txt"], ("a.png", "b.png"), [1, NO_FRAME]),
        (["00120.txt", "00121.txt"], ("00120.jpg", "00121.jpg"), [0, 1]),
        (["00120.txt", "00125.txt"], ("00120.jpg", "00121.jpg"), [0, NO_FRAME]),
        (["c_1.txt", "c_11.txt"], tuple(f"c_{n:02d}.png" for n in range(1, 13)), [0, 10]),
        (["20.txt", "0.txt"], (), [20, 0]),
    ],
)
def test_names_are_frames(names, images, frames):
    assert list(frames_of_names(names, VIDEO, images, "x").values()) == frames


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["a.txt"], "no number in the name 'a.txt'"),
        (["9" * 5000 + ".txt"], "no number in the name '9999"),
        (["000003.txt", "3.png"], "have the same number"),
        (["000003.txt", "000004.txt"], "two readings"),
        (["000020.txt"], "two readings"),
    ],
)
def test_names_that_say_no_frame_are_refused(names, said):
    with pytest.raises(MismatchError, match=said):
        frames_of_names(names, VIDEO, (), "x")


def test_others_show_where_numbers_begin_if_they_are_named_alike():
    assert frames_of_names(["000003.txt"], VIDEO, (), "x", ["images/000000.jpg"]) == {"000003.txt": 3}
    assert frames_of_names(["000003.txt"], VIDEO, (), "x", ["images/000012.jpg"]) == {"000003.txt": 2}
    images = tuple(f"{n:06d}.png" for n in range(1, 13))
    assert frames_of_names(["000003.txt"], VIDEO, images, "x") == {"000003.txt": 2}
    assert frames_of_names(["000003.txt"], VIDEO, images, "x", ["000000.png"]) == {"000003.txt": 3}
    assert frames_of_names(["000003.txt"], VIDEO, images, "x", ["000050.png"]) == {"000003.txt": 2}
    with pytest.raises(MismatchError, match="two readings"):
        frames_of_names(["000003.txt"], VIDEO, (), "x", ["images/other_000000.jpg"])


def test_numbers_of_files():
    assert [number(value, "x", "") for value in (1, "2.5", 10**400)] == [1, 2.5, math.inf]
    assert [whole_value(value, "x", "") for value in (1, "2", 3.0)] == [1, 2, 3]
    assert [identity_text(value, "x", "") for value in (2**63 - 1, "7", 7.0)] == [str(2**63 - 1), "7", "7"]
    for value in (True, None, [], {}, "a", math.nan):
        with pytest.raises(MismatchError, match="number is needed"):
            whole_value(value, "x", "")


def test_a_damaged_zip_and_one_with_a_way_out_are_harmless(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("../../escaped.txt", "x" * 5000)
        archive.writestr("gt/gt.txt", "y")
    with unpacked_folder(path) as folder:
        assert annotations_in(folder) == folder / "gt" / "gt.txt"
        assert not (tmp_path / "escaped.txt").exists()
        inside = [file for file in folder.rglob("*") if file.is_file()]
        assert sorted(file.name for file in inside) == ["escaped.txt", "gt.txt"]
    assert not folder.exists()
    data = path.read_bytes()
    generator = random.Random(0)
    for _ in range(60):
        broken = bytearray(data)
        broken[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
        path.write_bytes(broken)
        try:
            with unpacked_folder(path):
                pass
        except MismatchError as error:
            assert "unzip it" in str(error)


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["a.json", "b.xml"], r"a\.json, b\.xml: name the file"),
        (["a.json", "000001.txt"], r"a\.json, 000001\.txt: name the file"),
        (["a.json", "README.dataset.txt", "._b.json"], "a.json"),
        (["train/_annotations.coco.json", "README.roboflow.txt"], "train/_annotations.coco.json"),
        (["labels/1.txt", "classes.txt", "notes.json"], "."),
        (["annotations.xml", "images/1.txt"], "annotations.xml"),
        (["train/labels/1.txt", "data.yaml"], "."),
    ],
)
def test_the_annotations_of_a_folder(names, found, tmp_path):
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    if "name the file" in found:
        with pytest.raises(MismatchError, match=found):
            annotations_in(tmp_path)
    else:
        assert annotations_in(tmp_path) == tmp_path / found


def test_lines_of_as_many_numbers_are_read_alike():
    texts = ["0 .5 .5 .2 .2 0.9 4", "0 .5 .5 .2 .2 1 5", "1 .4 .4 .6 .4 .6 .6 .4 .6 0.5 4", "1 .5 .5 .2 .2"]
    lines = [parse_line(text, f"a:{n}", "x") for n, text in enumerate(texts)]
    found = boxes_of_lines(lines, None, Path("x"))
    assert [one.identity for one in found] == [4, 5, 4, None]
    for one in found:
        assert one.box(VIDEO) == pytest.approx((64, 48, 32, 24))
