"""What boxes of other tools mean: their order in a line, key frames, and what is not to be scored."""

import json
import warnings

import numpy as np
import pytest

from bayesnet_track.runtime.annotation.desk import read_annotations
from bayesnet_track.runtime.annotation.formats.reading import MismatchError
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import InputNotice

VIDEO = Video("street.mp4", 6, 320, 240, 0.04)


def read(path):
    """The answers of a file, and what was said of it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", InputNotice)
        return read_annotations(path, VIDEO), [str(one.message) for one in said]


def yolo(tmp_path, *lines):
    """A folder of labels, a line for each frame."""
    folder = tmp_path / "labels"
    folder.mkdir()
    for n, line in enumerate(lines):
        (folder / f"street_{n + 1}.txt").write_text(line + "\n")
    return tmp_path


BOXES = [(0.5 + n / 100, 0.6, 0.1, 0.2) for n in range(6)]
LEFT = [(0.5 + n / 100 - 0.05) * 320 for n in range(6)]


@pytest.mark.parametrize("end", ["", " 7"])
@pytest.mark.parametrize("is_first", [True, False])
def test_a_confidence_stands_before_or_behind_the_box_of_yolo(tmp_path, is_first, end):
    texts = [" ".join(map(str, box)) for box in BOXES]
    lines = [f"0 0.91 {text}{end}" if is_first else f"0 {text} 0.91{end}" for text in texts]
    found, said = read(yolo(tmp_path, *lines))
    np.testing.assert_allclose([one.box for one in found], [(x, 120, 32, 48) for x in LEFT])
    assert any("are read as `class confidence cx cy w h" in one for one in said) == is_first


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("0 0.4 0.5 0.6 0.6 0.5", "fit two readings, `class cx cy w h confidence` and `class confidence cx"),
        (
            "0 0.4 0.5 0.6 0.6 0.5 3",
            "fit two readings, `class cx cy w h confidence id` and `class confidence",
        ),
        ("0 0.9 0.9 0.9 0.9 0.9", "do not fit any of two readings"),
        ("0 7 0.5 0.6 0.1 0.2", r"the second column holds whole numbers \(7 to 7\): identities, or conf"),
    ],
)
def test_lines_of_yolo_that_fit_both_orders_or_none_are_refused_with_both(tmp_path, line, message):
    with pytest.raises(MismatchError, match=message):
        read(yolo(tmp_path, line, line))


def test_boxes_of_confidence_0_are_no_targets_to_follow(tmp_path):
    path = tmp_path / "gt.txt"
    path.write_text("1,1,10,20,30,40,1,1,1\n2,1,11,20,30,40,1,1,1\n1,2,90,20,30,40,0,7,1\n")
    found, said = read(path)
    assert [(one.frame, one.target) for one in found] == [(0, "target 1"), (1, "target 1")]
    assert said == [
        f"{path}: 1 of 3 boxes have confidence 0, which says not to be scored, and are left out: at line 3"
    ]
    path.write_text("1,2,90,20,30,40,0,7,1\n")
    with pytest.raises(MismatchError, match="1 of 1 boxes have confidence 0"):
        read(path)


def cvat(tmp_path, *tracks):
    """A file of CVAT's tracks, each a list of attributes of its boxes, one a frame."""
    text = "".join(
        f'<track id="{n}" label="car">'
        + "".join(
            f'<box frame="{k}" xtl="9" ytl="9" xbr="49" ybr="49" {more}/>' for k, more in enumerate(own)
        )
        + "</track>"
        for n, own in enumerate(tracks)
    )
    path = tmp_path / "a.xml"
    path.write_text(f"<annotations>{text}</annotations>")
    return path


BETWEEN, OUTSIDE, KEY = 'keyframe="0"', 'outside="1"', 'keyframe="1"'


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ([BETWEEN] * 3, r"1 of 1 tracks give no box: track 0 \(car\): of 3 shapes 3 between key frames"),
        ([OUTSIDE] * 3, "of 3 shapes 3 outside"),
        ([OUTSIDE, BETWEEN], "of 2 shapes 1 outside, 1 between key frames"),
        ([], "0 shapes, none given"),
    ],
)
def test_a_track_of_cvat_without_a_key_frame_gives_no_box_and_it_is_said(tmp_path, own, message):
    with pytest.raises(MismatchError, match=f"no box can be used: .*{message}"):
        read(cvat(tmp_path, own))
    found, said = read(cvat(tmp_path, [KEY], own))
    assert len(found) == 1 and "1 of 2 tracks give no box: track 1" in said[0]


def test_a_target_of_coco_without_a_key_frame_is_said(tmp_path):
    images = [{"id": n, "file_name": f"street_{n}.jpg", "frame_id": n} for n in range(6)]
    one = {"image_id": 0, "category_id": 1, "bbox": [9, 9, 40, 40], "track_id": 5}
    two = {**one, "track_id": 6, "attributes": {"keyframe": False}}
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"images": images, "annotations": [one, two]}))
    assert read(path)[1][0] == f"{path}: 1 of 2 targets give no box (outside, or between key frames): 6"
    path.write_text(json.dumps({"images": images, "annotations": [two]}))
    with pytest.raises(MismatchError, match="no box can be used: 1 of 1 targets give no box"):
        read(path)


@pytest.mark.parametrize(("name", "text"), [("a.xml", "<annotations/>"), ("a.txt", ""), ("a.txt", "\n")])
def test_a_file_without_a_box_is_refused(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(MismatchError, match="no box can be used: it holds none"):
        read(path)
