"""Files as other tools write them (`tests/fixtures/annotations`): every box, identity and class."""

import json
import random
import re
import shutil
import warnings
import zipfile
from pathlib import Path

import pytest

from bayesnet_track.runtime.annotation.answers import read_answer
from bayesnet_track.runtime.annotation.desk import read_annotations
from bayesnet_track.runtime.annotation.formats.reading import MismatchError
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import InputNotice, heard

FIXTURES = Path(__file__).parents[2] / "fixtures" / "annotations"
VIDEO = Video("clip.mp4", 12, 160, 120, 0.04)
IMAGES = tuple(f"{n:06d}.png" for n in range(1, 13))
NAMED = ("car 1", "person 1")
UNNAMED = ("class 0 1", "class 1 1")
SCENE = {
    "cvat_coco": (NAMED, ()),
    "cvat_yolo": (NAMED, ()),
    "cvat_mot": (("car 1", "person 2"), ()),
    "cvat_ultralytics_track": (NAMED, ()),
    "cvat_video": (NAMED, ("16 boxes between key frames are left to the tracker",)),
    "cvat_images": (NAMED, ()),
    "label_studio": (NAMED, ()),
    "label_studio_min": (NAMED, ()),
    "ultralytics_track": (UNNAMED, ()),
    "ultralytics_track_conf": (UNNAMED, ()),
    "ultralytics_predict_conf": (UNNAMED, ()),
    "ultralytics_obb_track": (UNNAMED, ("6 of 6 boxes are the upright box around a rotated box or polygon",)),
    "ultralytics_segment": (UNNAMED, ("6 of 6 boxes are the upright box around a polygon",)),
}


def scene(car, person):
    boxes = {(car, n): (10 + n, 40, 20, 24) for n in (0, 5, 10)}
    return boxes | {(person, n): (100 - n, 10, 20, 24) for n in (0, 5, 10)}


def read(path, video=VIDEO, images=()):
    """Boxes, frames from which targets are gone, and notices without the path."""
    said = []
    with heard(said.append):
        found = read_annotations(path, video, images)
    boxes = {(one.target, one.frame): one.box for one in found if one.kind == "box"}
    gone = {(one.target, one.frame) for one in found if one.kind == "gone"}
    assert len(boxes) + len(gone) == len(found)
    return boxes, gone, [text.split(": ", 1)[1] for text in said]


def assert_scene(boxes, names=NAMED):
    expected = scene(*names)
    assert boxes.keys() == expected.keys()
    for key, box in expected.items():
        assert boxes[key] == pytest.approx(box, abs=0.005)


@pytest.mark.parametrize("images", [(), IMAGES], ids=["video", "folder"])
@pytest.mark.parametrize("name", list(SCENE))
def test_every_box_and_identity_of_a_tools_file_is_read(name, images):
    names, notices = SCENE[name]
    boxes, gone, said = read(FIXTURES / name, images=images)
    assert_scene(boxes, names)
    assert tuple(said) == notices
    at_the_end = name in ("cvat_video", "label_studio", "label_studio_min")
    assert gone == ({(target, 11) for target in NAMED} if at_the_end else set())


@pytest.mark.parametrize("name", list(SCENE))
def test_a_zip_is_read_as_its_folder_and_named_in_errors(name, tmp_path):
    path = tmp_path / "export.zip"
    shutil.make_archive(str(path.with_suffix("")), "zip", FIXTURES / name)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("__MACOSX/._annotations.xml", b"junk")
        archive.writestr("images/frame_000000.PNG", b"no text")
    assert read(path) == read(FIXTURES / name)
    said = []
    try:
        with heard(said.append):
            read_annotations(path, Video("other.mp4", 3, 32, 24, 0.04))
    except MismatchError as error:
        said.append(str(error))
    assert said and all(text.startswith(f"{path}") and "Temp" not in text for text in said)


def test_a_rotated_box_gives_its_upright_box_with_a_notice():
    boxes, _, said = read(FIXTURES / "cvat_coco_rotated")
    for n in (0, 5, 10):
        x, y, w, h = boxes["car 1", n]
        assert (x + w / 2, y + h / 2) == pytest.approx((20 + n, 52))
        assert (w, h) == pytest.approx((20 * 0.8660254 + 24 * 0.5, 20 * 0.5 + 24 * 0.8660254))
    assert said == ["3 of 6 boxes are the upright box around a rotated box"]


def changed(name, file, tmp_path, change):
    """A copy of a fixture with one file changed; of JSON its content is handed over, else its text."""
    folder = tmp_path / name
    shutil.copytree(FIXTURES / name, folder)
    (path,) = folder.glob(file)
    if path.suffix == ".json":
        content = json.loads(path.read_text())
        content = change(content) or content
        path.write_text(json.dumps(content))
    else:
        path.write_text(change(path.read_text()))
    return path


def coco(tmp_path, change):
    return changed("cvat_coco", "annotations/*.json", tmp_path, change)


def moved_identity(to, make=lambda value: value):
    def change(content):
        for one in content["annotations"]:
            value = make(one["attributes"].pop("track_id"))
            (one if to[0] is None else one["attributes"])[to[1]] = value

    return change


@pytest.mark.parametrize(
    ("to", "make"),
    [
        ((None, "track_id"), int),
        (("attributes", "track_id"), str),
        (("attributes", "track_id"), lambda value: 2**63 - 1 - value),
        (("attributes", "track_id"), lambda value: str(2**63 - 1 - value)),
        ((None, "instance_id"), int),
        (("attributes", "instance_id"), int),
        (("attributes", "id"), lambda value: f"a{value}"),
    ],
)
def test_identities_of_coco_are_found_where_tools_put_them(to, make, tmp_path):
    boxes, _, said = read(coco(tmp_path, moved_identity(to, make)))
    assert_scene(boxes)
    assert said == []


def test_a_missing_identity_of_coco_names_key_annotation_and_place(tmp_path):
    path = coco(tmp_path, lambda content: content["annotations"][3]["attributes"].pop("track_id") and None)
    with pytest.raises(
        MismatchError, match=r"\.json, annotations\[3\] \(id 4\): the key 'attributes.track_id'"
    ):
        read(path)


def test_coco_shapes_without_boxes_give_upright_boxes(tmp_path):
    def change(content):
        for one in content["annotations"]:
            x, y, w, h = one["bbox"]
            x, y, w, h = int(x), int(y), int(w), int(h)
            if one["category_id"] == 1:
                one["bbox"], one["segmentation"] = [], [[x, y, x + w, y + 3, x + w, y + h, x, y + h]]
            else:
                runs = [x * 120 + y] + [h, 120 - h] * w
                runs[-1] = 160 * 120 - sum(runs[:-1])
                del one["bbox"]
                one.update(iscrowd=1, segmentation={"size": [120, 160], "counts": runs})

    boxes, _, said = read(coco(tmp_path, change))
    assert_scene(boxes)
    assert sorted(said) == [
        "3 of 6 boxes are the upright box around a mask",
        "3 of 6 boxes are the upright box around a polygon",
    ]


@pytest.mark.parametrize("images", [(), IMAGES], ids=["video", "folder"])
def test_coco_images_are_frames_by_the_numbers_of_their_names(images, tmp_path):
    def unpadded(content):
        for one in content["images"]:
            one["file_name"] = f"cam3/img{one['id']}.jpg"  # img10 comes before img2 as text
        content["images"].reverse()

    assert_scene(read(coco(tmp_path, unpadded), images=images)[0])


def test_coco_boxes_as_texts_and_interpolated_ones(tmp_path):
    def change(content):
        for one in content["annotations"]:
            one["bbox"] = [str(value) for value in one["bbox"]]
        more = {**content["annotations"][0], "id": 99, "image_id": 2}
        content["annotations"].append({**more, "attributes": {**more["attributes"], "keyframe": False}})

    boxes, _, said = read(coco(tmp_path, change))
    assert_scene(boxes)
    assert said == ["1 of 7 boxes are interpolated ones (keyframe false), and are left to the tracker"]


@pytest.mark.parametrize(
    ("bad", "sentence"),
    [
        (
            {"bbox": [1, 2, 0, 4]},
            "1 of 7 boxes is not finite or has no area and is left out: at annotations[6]",
        ),
        ({"bbox": [float("nan"), 2, 3, 4]}, "1 of 7 boxes is not finite"),
        ({"bbox": [float("inf"), 2, 3, 4]}, "1 of 7 boxes is not finite"),
        ({"bbox": [10**400, 2, 3, 4]}, "1 of 7 boxes is not finite"),
        (
            {"bbox": [200, 2, 30, 4]},
            "1 of 7 boxes is outside of the frame of 160x120 px, and left out (x 200 to 230, y 2 to 6): at "
            "annotations[6]",
        ),
        (
            {"image_id": 13},
            "1 of 7 boxes is in frames 12 to 12 (counted from 0), and left out; the video has",
        ),
    ],
)
def test_a_bad_row_is_left_out_and_said(bad, sentence, tmp_path):
    def change(content):
        content["images"].append({**content["images"][0], "id": 13, "file_name": "frame_000012.PNG"})
        content["annotations"].append({**content["annotations"][0], "id": 99, "image_id": 2, **bad})

    boxes, _, said = read(coco(tmp_path, change))
    assert_scene(boxes)
    assert len(said) == 1 and said[0].startswith(sentence)


def test_a_file_whose_every_box_is_of_no_use_is_refused(tmp_path):
    path = coco(
        tmp_path, lambda content: [one.update(bbox=[1, 1, 0, 0]) for one in content["annotations"]] and None
    )
    with pytest.raises(
        MismatchError, match="no box can be used: 6 of 6 boxes are not finite or have no area"
    ):
        read(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100000, "nested too deeply"),
        ('{"images": [], "images": [], "annotations": []}', "the key 'images' twice"),
        ('{"images": [{"id": 1e999}], "annotations": []}', "id inf; a whole number or a text"),
        ('{"images": [], "annotations": [' + "9" * 5000 + "]}", "it is no JSON"),
        ('{"images": [], "annotations": [{"image_id": [1]}]}', "missing"),
        ('{"images": [{"id": 1, "frame_id": Infinity}], "annotations": []}', "frame_id inf; a whole number"),
        ("\x00\x01", "it is no JSON"),
    ],
)
def test_hostile_json_is_refused_in_a_sentence(text, said, tmp_path):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(MismatchError, match=rf"a\.json.*{said}"):
        read(tmp_path / "a.json")


def test_json_and_xml_in_utf_16_are_read_and_a_dtd_in_it_is_not(tmp_path):
    text = (FIXTURES / "cvat_coco/annotations/instances_default.json").read_text()
    (tmp_path / "a.json").write_bytes(text.encode("utf-16"))
    assert_scene(read(tmp_path / "a.json")[0])
    text = (FIXTURES / "cvat_video/annotations.xml").read_text().replace("utf-8", "utf-16")
    (tmp_path / "a.xml").write_bytes(text.encode("utf-16"))
    assert_scene(read(tmp_path / "a.xml")[0])
    bomb = "<!DOCTYPE annotations [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]><annotations>&b;"
    (tmp_path / "a.xml").write_bytes(text.replace("<annotations>", bomb).encode("utf-16"))
    with pytest.raises(MismatchError, match=r"a\.xml: it has a <!DOCTYPE>"):
        read(tmp_path / "a.xml")


def cvat(tmp_path, change):
    return changed("cvat_video", "annotations.xml", tmp_path, change)


def renumbered(text):
    """The same task, of every third frame of a video from frame 30 on."""
    for n in reversed(range(12)):
        text = text.replace(f'frame="{n}" key', f'frame="{30 + 3 * n}" key')
    text = text.replace("<start_frame>0<", "<start_frame>30<").replace("<stop_frame>11<", "<stop_frame>63<")
    return text.replace("<frame_filter></", "<frame_filter>step=3</")


def test_cvat_tasks_of_a_part_are_read_for_the_whole_video_and_for_their_own_frames(tmp_path):
    path = cvat(tmp_path, renumbered)
    boxes, _, said = read(path)
    assert_scene(boxes)
    assert said[0] == "its frames 30 to 63 in steps of 3 are taken as the 12 of the video"
    boxes, gone, _ = read(path, Video("whole.mp4", 100, 160, 120, 0.04))
    assert sorted(boxes) == [(name, n) for name in NAMED for n in (30, 45, 60)]
    assert gone == {(name, 63) for name in NAMED}
    with pytest.raises(MismatchError, match="size: 12 frames; the video has 40"):
        read(path, Video("other.mp4", 40, 160, 120, 0.04))


def test_a_cvat_job_of_a_part_of_the_video_is_read(tmp_path):
    path = cvat(tmp_path, lambda text: text.replace("<task>", "<job>").replace("</task>", "</job>"))
    assert_scene(read(path, Video("whole.mp4", 100, 160, 120, 0.04))[0])


@pytest.mark.parametrize(
    ("shape", "box", "made"),
    [
        ('<box {} rotation="90.0" xtl="10" ytl="20" xbr="30" ybr="30"/>', (15, 15, 10, 20), "rotated box"),
        ('<polygon {} points="10,20;30,25;12,40.5"/>', (10, 20, 20, 20.5), "polygon"),
        ('<polyline {} points="10,20;30,25"/>', (10, 20, 20, 5), "polyline"),
        ('<points {} points="10,20;30,25"/>', (10, 20, 20, 5), "set of points"),
        ('<ellipse {} cx="20" cy="30" rx="5" ry="10"/>', (15, 20, 10, 20), "ellipse"),
        ('<mask {} rle="0, 6" left="10" top="20" width="3" height="2"/>', (10, 20, 3, 2), "mask"),
        (
            '<skeleton {}><points outside="0" points="1,2"/><points outside="1" points="90,90"/>'
            '<points outside="0" points="5,9"/></skeleton>',
            (1, 2, 4, 7),
            "skeleton",
        ),
    ],
)
def test_shapes_of_cvat_give_upright_boxes(shape, box, made, tmp_path):
    text = shape.format('frame="3" keyframe="1" outside="0" occluded="0" z_order="2"')
    path = tmp_path / "a.xml"
    path.write_text(f'<annotations><track id="4" label="car">{text}<tag label="x"/></track></annotations>')
    boxes, _, said = read(path)
    assert boxes == {("car 1", 3): pytest.approx(box)}
    assert said == [
        "1 <tag> are no boxes, and are not used",
        f"1 of 1 box is the upright box around a {made}",
    ]


def test_tracks_of_cvat_of_a_label_are_targets_each(tmp_path):
    boxes, _, _ = read(cvat(tmp_path, lambda text: text.replace('label="person"', 'label="car"')))
    assert_scene(boxes, ("car 1", "car 2"))


def yolo(tmp_path, lines, first=0):
    folder = tmp_path / "labels"
    folder.mkdir(exist_ok=True)
    for n, text in enumerate(lines, first):
        if text is not None:
            (folder / f"frame_{n:06d}.txt").write_text(text)
    return tmp_path


BOX = "0 0.125 0.43333333 0.125 0.2"


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([f"{BOX} 3", f"{BOX} 0.5"], "the last column is 0.5 here, and up to 3 elsewhere"),
        (["0 .1 .1 .3 .1 .3 1 .2 1", "0 .1 .1 .3 .1 .3 1 .2 1"], "9 columns fit two readings"),
        ([f"{BOX} 0.1 0.2 2 0.3 0.4 1 0.1 0.1 0"], "14 columns fit two readings: a box with keypoints"),
        ([f"{BOX} x"], "frame_000000.txt:1: .* is needed, separated by spaces"),
        (["0.5 0.1 0.1 0.1 0.1"], "frame_000000.txt:1"),
        (["0 20 52 20 24"], "parts of the frame are needed"),
        ([None, None, BOX], None),
    ],
)
def test_yolo_lines_without_a_reading_or_with_two_are_refused(lines, said, tmp_path):
    path = yolo(tmp_path, lines)
    if said is None:
        assert read(path)[0] == {("class 0 1", 2): pytest.approx((10, 40, 20, 24), abs=1e-4)}
        return
    with pytest.raises(MismatchError, match=said):
        read(path)


def test_yolo_keypoints_are_known_by_kpt_shape(tmp_path):
    path = yolo(tmp_path, [f"{BOX} 0.1 0.2 2 0.3 0.4 1 0.1 0.1 0", f"{BOX} 0.1 0.2 2 0.3 0.4 1 0.1 0.1 0 "])
    (path / "data.yaml").write_text("names: [ant]\nkpt_shape: [3, 3]\n")
    assert sorted(read(path)[0]) == [("ant 1", 0), ("ant 1", 1)]


def test_yolo_boxes_without_a_track_beside_tracked_ones_are_left_out_and_said(tmp_path):
    path = yolo(
        tmp_path, [f"{BOX} 7", BOX, f"{BOX} {2**63 - 1}\n{BOX.replace('0.125', '0.5', 1)} {2**63 - 2}"]
    )
    boxes, _, said = read(path)
    assert sorted(boxes) == [("class 0 1", 0), ("class 0 2", 2), ("class 0 3", 2)]
    assert said == ["1 of 4 boxes have no identity, and are left out: at labels/frame_000001.txt:1"]


@pytest.mark.parametrize(
    ("numbers", "images", "frames"),
    [
        ([0, 3], (), [0, 3]),  # from 0, since there is a 0
        ([1, 12], (), [0, 11]),  # from 1, since there is a 12
        ([1, 3], IMAGES, [0, 2]),  # as the images are called
        ([0, 3], IMAGES, [0, 3]),  # not as the images are called: there is no 000000.png
        ([3, 5], (), None),
    ],
)
def test_yolo_files_are_frames_by_their_names(numbers, images, frames, tmp_path):
    for n in numbers:
        (tmp_path / f"{n:06d}.txt").write_text(BOX)
    (tmp_path / "classes.txt").write_text("car\n")
    if frames is None:
        with pytest.raises(
            MismatchError, match=r"numbers 3 to 5 of the names fit two readings: .*from 0, and from 1"
        ):
            read(tmp_path, images=images)
        (tmp_path / "train.txt").write_text("".join(f"images/{n:06d}.jpg\n" for n in range(12)))
        frames = [3, 5]
    assert sorted(read(tmp_path, images=images)[0]) == [("car 1", n) for n in frames]


def test_yolo_files_behind_the_video_and_of_other_images_are_said(tmp_path):
    path = yolo(tmp_path, [BOX] * 20)
    boxes, _, said = read(path)
    assert sorted(boxes) == [("class 0 1", n) for n in range(12)]
    assert said[0].startswith(
        "8 of 20 boxes are in frames 12 to 19 (counted from 0), and left out; the video has"
    )
    for file in (path / "labels").iterdir():
        file.rename(file.with_name(f"{int(file.stem[6:]) + 5:06d}.txt"))
    boxes, _, said = read(path, images=IMAGES)
    assert sorted(boxes) == [("class 0 1", n) for n in range(4, 12)]
    assert said[0].startswith(
        "12 of 20 boxes are in images that the video does not have, and left out: at labels/"
    )


def studio(tmp_path, change):
    return changed("label_studio", "*.json", tmp_path, lambda content: change(content[0]))


def test_label_studio_turns_about_the_corner_and_ends_where_not_enabled(tmp_path):
    def change(task):
        sequence = task["annotations"][0]["result"][0]["value"]["sequence"]
        sequence[1].update(rotation=90, enabled=False)
        sequence[2]["enabled"] = True

    def wrapped(task):
        change(task)
        return [task]

    boxes, gone, said = read(studio(tmp_path, wrapped))
    assert boxes["car 1", 5] == pytest.approx((15 - 24, 40, 24, 20))
    assert gone == {("car 1", 6), ("person 1", 11)}
    assert said == ["1 of 6 boxes is the upright box around a rotated box"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda task: task["annotations"].append(task["annotations"][0]), r"2 annotations \(id 5, 5\)"),
        (lambda task: task.update(annotations=[]), "the task has 0 annotations"),
        (lambda task: task.pop("annotations"), "the key 'annotations' is missing"),
        (lambda task: task["annotations"][0]["result"][0].pop("value"), r"result\[0\]: the key 'value'"),
        (
            lambda task: task["annotations"][0]["result"][0]["value"].update(framesCount=24),
            "24 frames.*frameRate",
        ),
    ],
)
def test_label_studio_tasks_that_do_not_fit_are_refused(change, said, tmp_path):
    with pytest.raises(MismatchError, match=said):
        read(studio(tmp_path, lambda task: [[task], change(task)][0]))


def test_label_studio_cancelled_annotations_and_other_results_are_not_used(tmp_path):
    def change(task):
        done = task["annotations"][0]
        task["annotations"].insert(0, {**done, "id": 4, "was_cancelled": True, "result": []})
        done["result"].append({"type": "choices", "value": {"choices": ["day"]}, "id": "x"})
        done["result"][0]["value"]["framesCount"] = 13
        return [task]

    boxes, _, said = read(studio(tmp_path, change))
    assert_scene(boxes)
    assert said[0] == "1 results of type choices are no boxes of a video, and are not used"
    assert said[1] == "13 frames; the video has 12"


def test_a_class_that_changes_is_one_target_with_its_most_frequent_class(tmp_path):
    path = yolo(tmp_path, [f"{BOX} 7", f"1{BOX[1:]} 7", f"1{BOX[1:]} 7"])
    boxes, _, said = read(path)
    assert {name for name, _ in boxes} == {"class 1 1"}
    assert said == ["identity 7 has the classes class 0, class 1; it is taken as class 1"]


def test_a_notice_is_a_warning_in_python():
    with pytest.warns(InputNotice, match="upright box around a rotated box"):
        read_annotations(FIXTURES / "cvat_coco_rotated", VIDEO)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_annotations(FIXTURES / "cvat_coco", VIDEO)


WORDS = ("nan", "inf", "-1", "1e999", "", "x", "\u00b2", "0", "9" * 5000, "1.5", "\0", "1_0", "<", "&", '"')
VALUES = (
    None,
    True,
    -1,
    1e999,
    float("nan"),
    2**63,
    10**400,
    "",
    "x",
    [],
    {},
    [[]],
    {"a": 1},
    ["1", 2, 3, 4],
)


def damage(path, generator):
    """Another word in place of a number, or another value in a JSON file."""
    text = path.read_text()
    if path.suffix != ".json":
        start, end = generator.choice([one.span() for one in re.finditer(r"[0-9.]+", text)])
        path.write_text(text[:start] + generator.choice(WORDS) + text[end:])
        return
    places = []
    content = json.loads(text, object_hook=lambda one: places.extend((one, key) for key in one) or one)
    one, key = generator.choice(places)
    one[key] = generator.choice(VALUES)
    path.write_text(json.dumps(content))


@pytest.mark.parametrize("name", list(SCENE))
def test_a_damaged_file_is_refused_in_a_sentence_or_gives_answers_that_can_be_kept(name, tmp_path):
    generator = random.Random(name)
    kept = 0
    for number in range(25):
        folder = tmp_path / str(number)
        shutil.copytree(FIXTURES / name, folder)
        files = [file for file in folder.rglob("*") if file.suffix in (".json", ".xml", ".txt")]
        damage(generator.choice([file for file in files if re.search(r"\d", file.read_text())]), generator)
        try:
            with heard(list().append):
                found = read_annotations(folder, VIDEO, generator.choice([(), IMAGES]))
        except MismatchError as error:
            assert str(folder) in str(error)
        else:
            kept += 1
            for one in found:
                read_answer(one.as_dict(), VIDEO.frames, VIDEO.width, VIDEO.height)
    assert kept < 25


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.json", '[{"image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4]}]', "it is COCO results"),
        ("a.json", '{"info": {}, "categories": {}, "items": []}', "it is JSON of Datumaro"),
        ("a.json", "[]", "neither COCO .* nor a task"),
        ("a.json", "7", "neither COCO .* nor a task"),
        ("a.tar.gz", "x", "only a zip is read; unpack it"),
        ("labels/1.txt", b"\xff\xfe\x00", "not a text file"),
        ("data.yaml", "a: &a [x,x,x]\nb: &b [*a,*a,*a]\nnames: [*b]\n", "`names` of the classes are needed"),
        ("data.yaml", "names: [a]\nkpt_shape: [[3, 3]]\n", "kpt_shape in its YAML"),
        ("data.yaml", "names: {" + "9" * 5000 + ": a}\n", "it is no YAML|a whole number"),
        ("data.yaml", "names: [\n", "it is no YAML"),
    ],
)
def test_what_is_of_no_known_format_is_refused_with_what_would_be(name, text, said, tmp_path):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    if not name.startswith("a."):
        yolo(tmp_path, [BOX])
        path = tmp_path
    with pytest.raises(MismatchError, match=said):
        read(path)


def test_a_project_of_cvat_is_checked_by_its_task(tmp_path):
    def change(text):
        text = text.replace("<task>", "<project><tasks><task>").replace(
            "</task>", "</task></tasks></project>"
        )
        return text.replace('label="car"', 'label="car" task_id="7"').replace(
            'label="person"', 'label="person" task_id="7"'
        )

    path = cvat(tmp_path, change)
    assert_scene(read(path)[0])
    with pytest.raises(MismatchError, match="size: 12 frames; the video has 13"):
        read(path, Video("other.mp4", 13, 160, 120, 0.04))


def test_our_coco_of_a_part_of_a_video_is_read_for_the_whole(tmp_path):
    def change(content):
        content["images"] = [{**one, "frame_id": one["id"] - 1} for one in content["images"][:11]][5:]
        content["annotations"] = content["annotations"][2:]

    boxes, _, _ = read(coco(tmp_path, change))
    assert sorted(boxes) == [(name, n) for name in NAMED for n in (5, 10)]


def test_identities_of_mot_up_to_2_63_are_exact(tmp_path):
    ids = (2**63 - 1, 2**63 - 2)
    (tmp_path / "a.txt").write_text(
        "".join(f"1,{one},{9 * n + 1},1,5,5,1,-1,-1,-1\n" for n, one in enumerate(ids))
    )
    assert sorted(read(tmp_path / "a.txt")[0]) == [(f"target {one}", 0) for one in sorted(ids)]
