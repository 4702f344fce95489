"""Formats of other tools: what is written is read again, and what does not fit the video is refused."""

import json
import random

import pytest

from bayesnet_track.runtime.annotation.asking import BoxMark
from bayesnet_track.runtime.annotation.desk import (
    WRITERS,
    read_annotations,
    read_mot,
    write_formats,
)
from bayesnet_track.runtime.annotation.formats.reading import Document, MismatchError, label_of
from bayesnet_track.runtime.annotation.frame_store import Video

VIDEO = Video("street.mp4", 6, 320, 240, 0.04)
FILES = {
    "coco": "coco.json",
    "mot": "mot.txt",
    "cvat": "cvat.xml",
    "label-studio": "label_studio.json",
    "yolo": "yolo",
}


def at(frame, how="given", probability=1.0):
    return BoxMark(frame, (10.125 + frame, 20.5, 30.25, 40.0), how, probability)


def document(*targets, how="given"):
    return Document(VIDEO, {target: {n: at(n, how) for n in range(VIDEO.frames)} for target in targets})


@pytest.mark.parametrize("name", list(WRITERS))
def test_every_format_is_read_as_it_was_written(name, tmp_path):
    targets = ("ball 1", "person 1") if name == "yolo" else ("ball 1", "ball 2", "person 1")
    write_formats(tmp_path, (name,), document(*targets))
    found = read_annotations(tmp_path / FILES[name], VIDEO)
    assert {one.kind for one in found} == {"box"}
    names = ("target 1", "target 2", "target 3") if name == "mot" else targets
    assert sorted((one.target, one.frame) for one in found) == [(t, n) for t in names for n in range(6)]
    for one in found:
        assert one.box == pytest.approx(at(one.frame).box, abs=0.001)


@pytest.mark.parametrize("name", ["coco", "cvat", "label-studio"])
def test_only_given_boxes_come_back_and_what_is_gone_does(name, tmp_path):
    own = {0: at(0), 1: at(1, "tracked", 0.8), 2: at(2, "interpolated", 0.4), 3: at(3)}
    own |= {4: BoxMark(4, None, "gone"), 5: BoxMark(5, None, "gone")}
    write_formats(tmp_path, (name,), Document(VIDEO, {"ball 1": own}))
    found = read_annotations(tmp_path / FILES[name], VIDEO)
    assert sorted((one.frame, one.kind) for one in found) == [(0, "box"), (3, "box"), (4, "gone")]


def test_a_label_is_the_name_without_its_number():
    assert [*map(label_of, ("ball 12", "car_3", "7", "lead car"))] == ["ball", "car", "target", "lead car"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda c: c["images"][2].update(width=640),
            r"images\[2\]: frames of 640x240 px; ",
        ),
        (lambda c: c["annotations"][1].update(image_id=99), r"annotations\[1\]: image_id 99 is none"),
        (
            lambda c: c["annotations"][0].pop("track_id"),
            r"annotations\[0\] \(id 1\): the key 'track_id' is missing.*attributes.track_id",
        ),
        (lambda c: c["annotations"][2].pop("bbox"), r"annotations\[2\] \(id 3\): the key 'bbox' is missing"),
        (lambda c: c["annotations"][4].update(bbox=[1, 2, 3]), r"annotations\[4\]: bbox \[1, 2, 3\]; four"),
        (lambda c: c["annotations"][5].update(bbox="1,2,3,4"), r"annotations\[5\]: bbox '1,2,3,4'; four"),
        (lambda c: c["annotations"][5].update(image_id=True), r"annotations\[5\]: image_id True"),
        (lambda c: c["annotations"].append(7), r"annotations\[6\]: 7; an object"),
        (lambda c: c.update(images={}), "images: {}; a list"),
        (lambda c: c["images"][1].update(id=1), "two images have the same id"),
        (lambda c: c["images"][1].update(video_id=2), "images of 2 videos"),
        (
            lambda c: c["images"][1].update(frame_id=float("inf")),
            r"images\[1\]: frame_id inf; a whole number",
        ),
        (lambda c: c["images"][1].update(frame_id=10**400), r"images\[1\]: frame_id a number of many digits"),
        (
            lambda c: [a.update(instance_id=a["id"]) for a in c["annotations"]],
            "two readings: identities by 'track_id', and by 'instance_id'",
        ),
    ],
)
def test_a_coco_file_that_does_not_fit_is_refused_with_the_first_mismatch(change, said, tmp_path):
    content = json.loads(WRITERS["coco"](document("ball 1"))["coco.json"])
    change(content)
    (tmp_path / "a.json").write_text(json.dumps(content))
    with pytest.raises(MismatchError, match=said):
        read_annotations(tmp_path / "a.json", VIDEO)


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ("<size>6</size>", "<size>7</size>", "size: 7 frames; the video has 6"),
        ("<width>320</width>", "<width>32</width>", "frames of 32x240 px"),
        ('frame="4"', 'frame="x"', "frame 'x'"),
        ('frame="4"', 'frame="²"', "frame '²'"),
        ('frame="4"', f'frame="{"9" * 5000}"', "frame '9999"),
        ('xtl="10.125"', 'xtl="a"', "track 0, frame 0: xtl 'a'; a number"),
        ('xtl="10.125"', "", "track 0, frame 0: xtl of <box> are missing"),
        ('<track id="0"', '<track id="1" task_id="3" label="cup"/><track id="0"', "2 tasks"),
        ("</annotations>", "", "no XML"),
        ("<annotations>", "<!DOCTYPE a><annotations>", "DOCTYPE"),
        ("<annotations>", "<!DOCTYPE a [<!ENTITY b 'c'>]><annotations>", "DOCTYPE"),
    ],
)
def test_a_cvat_file_that_does_not_fit_is_refused(was, becomes, said, tmp_path):
    text = WRITERS["cvat"](document("ball 1"))["cvat.xml"].decode()
    assert was in text
    (tmp_path / "a.xml").write_text(text.replace(was, becomes, 1))
    with pytest.raises(MismatchError, match=said):
        read_annotations(tmp_path / "a.xml", VIDEO)


def test_key_frames_of_cvat_alone_are_given(tmp_path):
    boxes = "".join(
        f'<box frame="{n}" keyframe="{int(n in (0, 3))}" outside="{int(n == 5)}" occluded="0" '
        'xtl="1" ytl="2" xbr="11" ybr="22" z_order="0"></box>'
        for n in range(6)
    )
    (tmp_path / "a.xml").write_text(f'<annotations><track id="0" label="car">{boxes}</track></annotations>')
    found = read_annotations(tmp_path / "a.xml", VIDEO)
    assert [(one.target, one.frame, one.kind) for one in found] == [
        ("car 1", 0, "box"),
        ("car 1", 3, "box"),
        ("car 1", 5, "gone"),
    ]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda value: value.update(framesCount=8), "framesCount: 8 frames; the video has 6"),
        (lambda value: value["sequence"][1].pop("x"), r"frame 2 \(counted from 1\): the key 'x' is missing"),
        (lambda value: value["sequence"][1].update(x="a"), r"frame 2 \(counted from 1\): x 'a'; a number"),
        (lambda value: value["sequence"][1].update(frame=1.5), "frame 1.5; a whole number"),
        (lambda value: value.pop("sequence"), "result target1, value: the key 'sequence' is missing"),
    ],
)
def test_a_label_studio_file_that_does_not_fit_is_refused(change, said, tmp_path):
    (task,) = json.loads(WRITERS["label-studio"](document("ball 1"))["label_studio.json"])
    change(task["annotations"][0]["result"][0]["value"])
    (tmp_path / "a.json").write_text(json.dumps([task]))
    with pytest.raises(MismatchError, match=said):
        read_annotations(tmp_path / "a.json", VIDEO)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("9,1,1,1,5,5,1,-1,-1,-1", "no box can be used: 1 of 1 box is in frames 8 to 8 .*0 to 5"),
        ("1,1,1,1", "mot.txt"),
        ("1,1,999,1,5,5", "outside of the frame of 320x240 px, .*x 999 to 1004, y 1 to 6.*line 1"),
        ("1,-1,9,1,5,5", "1 of 1 boxes have the identity -1"),
        ("1,1,9,1,5,5\n1,1,9,1,5,6", "two boxes of identity 1 .*line 1 and at line 2"),
    ],
)
def test_a_mot_file_that_does_not_fit_is_refused(line, said, tmp_path):
    (tmp_path / "mot.txt").write_text(f"{line}\n")
    with pytest.raises(MismatchError, match=said):
        read_mot(tmp_path / "mot.txt", VIDEO)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["0 0.5 0.5 0.1 0.1\n0 0.2 0.2 0.1 0.1\n"] * 6, "a second box of 'class 0', .*000000.txt:2"),
        (["0 160 120 30 40\n"] * 6, "parts of the frame"),
        (["0 0.5 0.5\n"] * 6, "class cx cy w h"),
    ],
)
def test_a_yolo_folder_that_does_not_fit_is_refused(lines, said, tmp_path):
    for number, text in enumerate(lines):
        (tmp_path / f"{number:06d}.txt").write_text(text)
    with pytest.raises(MismatchError, match=said):
        read_annotations(tmp_path, VIDEO)


def test_what_is_neither_is_refused(tmp_path):
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(MismatchError, match="no JSON"):
        read_annotations(tmp_path / "a.json", VIDEO)


@pytest.mark.parametrize(
    "images", [(), tuple(f"shot_{n + 40}.JPG" for n in range(6))], ids=["video", "files"]
)
@pytest.mark.parametrize("name", list(WRITERS))
@pytest.mark.parametrize("seed", range(12))
def test_generated_annotations_come_back(name, seed, images, tmp_path):
    """Boxes to the digits written, identities with their names, classes, and where targets are gone."""
    generator = random.Random(seed)
    targets = {}
    for label in generator.sample(["car", "person", "lead car", "Fußgänger", "a&b <c>", "\u8eca"], 3):
        for number in generator.sample(range(1, 99), 1 if name == "yolo" else generator.randint(1, 3)):
            marks = {}
            for frame in sorted(generator.sample(range(6), generator.randint(1, 6))):
                x, y = generator.uniform(-20, 300), generator.uniform(-20, 220)
                size = generator.uniform(21, 90), generator.uniform(21, 90)
                marks[frame] = BoxMark(frame, (x, y, *size), "given", 1.0)
            targets[f"{label} {number}"] = marks
    write_formats(tmp_path, (name,), Document(VIDEO, targets, images))
    found = read_annotations(tmp_path / FILES[name], VIDEO, images)
    boxes = {(one.target, one.frame): one.box for one in found if one.kind == "box"}
    names = {target: target for target in targets}
    if name == "mot":
        names = {target: f"target {number}" for number, target in enumerate(targets, 1)}
    elif name == "yolo":
        names = {target: f"{label_of(target)} 1" for target in targets}
    expected = {(names[target], n): mark.box for target, own in targets.items() for n, mark in own.items()}
    assert boxes.keys() == expected.keys()
    for key, box in boxes.items():
        assert box == pytest.approx(expected[key], abs=0.0021)
    if name == "coco":
        content = json.loads((tmp_path / "coco.json").read_text())
        assert images == () or [one["file_name"] for one in content["images"]] == list(images)
