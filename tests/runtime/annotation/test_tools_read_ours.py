"""The tools' own packages read what is written, and what is read here is what they read of their files.

pip install pycocotools datumaro label-studio-sdk: too large for the locked test tools, so CI leaves this out.
"""

import json
import shutil
from pathlib import Path

import pytest

from bayesnet_track.runtime.annotation.asking import BoxMark
from bayesnet_track.runtime.annotation.desk import WRITERS, read_annotations, write_formats
from bayesnet_track.runtime.annotation.formats.reading import Document
from bayesnet_track.runtime.annotation.frame_store import Video

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
FIXTURES = Path(__file__).parents[2] / "fixtures" / "annotations"
VIDEO = Video("street.mp4", 6, 320, 240, 0.04)
TARGETS = ("car 1", "car 2", "Fußgänger 1")


@pytest.fixture
def ours(tmp_path):
    """All formats of three targets; the last one is gone from frame 4 on."""
    marks = {
        name: {n: BoxMark(n, (10.0 + 60 * k + n, 20.5, 30.25, 40.0), "given", 1.0) for n in range(6)}
        for k, name in enumerate(TARGETS)
    }
    marks[TARGETS[2]] |= {n: BoxMark(n, None, "gone") for n in (4, 5)}
    write_formats(tmp_path, tuple(WRITERS), Document(VIDEO, marks))
    return tmp_path, {(k, n): mark.box for k, own in enumerate(marks.values()) for n, mark in own.items()}


def test_pycocotools_reads_our_boxes(ours):
    coco = pytest.importorskip("pycocotools.coco").COCO(str(ours[0] / "coco.json"))
    found = {(one["track_id"] - 1, one["image_id"] - 1): tuple(one["bbox"]) for one in coco.anns.values()}
    assert found == {key: box for key, box in ours[1].items() if box}


def points_of(dataset, image_of):
    """(identity, frame) -> corners of the boxes that datumaro reads."""
    return {
        (one.attributes["track_id"], image_of(item.id)): one.points
        for item in dataset
        for one in item.annotations
        if not one.attributes.get("outside")
    }


@pytest.mark.parametrize(
    ("name", "file", "place", "image_of"),
    [
        ("mot_seq", "mot.txt", "gt/gt.txt", lambda name: int(name) - 1),
        ("cvat", "cvat.xml", "annotations.xml", lambda name: int(name[-6:])),
    ],
)
def test_datumaro_which_cvat_uses_reads_our_tracks(ours, name, file, place, image_of, tmp_path):
    datumaro = pytest.importorskip("datumaro")
    path = tmp_path / "dataset" / place
    path.parent.mkdir(parents=True)
    shutil.copy(ours[0] / file, path)
    found = points_of(datumaro.Dataset.import_from(str(tmp_path / "dataset"), name), image_of)
    first = min(key for key, _ in found)
    expected = {(k + first, n): box for (k, n), box in ours[1].items() if box}
    assert found.keys() == expected.keys()
    for key, (x, y, w, h) in expected.items():
        assert found[key] == pytest.approx((x, y, x + w, y + h), abs=0.011)


def test_label_studio_takes_our_task_and_interpolates_it_as_we_mean_it(ours):
    interface = pytest.importorskip("label_studio_sdk.label_interface").LabelInterface(
        '<View><Video name="video" value="$video"/><VideoRectangle name="box" toName="video"/>'
        '<Labels name="of" toName="video"><Label value="car"/><Label value="Fußgänger"/></Labels></View>'
    )
    tools = pytest.importorskip("label_studio_sdk._extensions.label_studio_tools.postprocessing.video")
    (task,) = json.loads((ours[0] / "label_studio.json").read_text())
    (annotation,) = task["annotations"]
    assert interface.validate_annotation(annotation)
    sequences = [one["value"]["sequence"] for one in tools.extract_key_frames(annotation["result"])]
    assert [[one["frame"] for one in sequence] for sequence in sequences] == [
        [1, 2, 3, 4, 5, 6],
        [1, 2, 3, 4, 5, 6],
        [1, 2, 3, 4],
    ]


@pytest.mark.parametrize(("name", "kind"), [("cvat_mot", "mot_seq"), ("cvat_video", "cvat")])
def test_datumaro_reads_of_the_fixtures_what_we_read(name, kind):
    datumaro = pytest.importorskip("datumaro")
    image_of = (lambda name: int(name) - 1) if kind == "mot_seq" else (lambda name: int(name[-6:]))
    theirs = points_of(datumaro.Dataset.import_from(str(FIXTURES / name), kind), image_of)
    found = read_annotations(FIXTURES / name, Video("clip.mp4", 12, 160, 120, 0.04))
    boxes = [one for one in found if one.kind == "box"]
    assert len(boxes) == 6
    for one in boxes:
        x, y, w, h = one.box
        first = min(key for key, _ in theirs)
        key = (first + one.target.startswith("person"), one.frame)
        assert theirs[key] == pytest.approx((x, y, x + w, y + h), abs=0.011)
