"""Files of other tools where lines of boxes are expected: read by what they hold, or said what they are."""

import json
import shutil

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.sources.detection_files import parse_detections
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.entrances.text_lines import explain_foreign
from bayesnet_track.sources.mot_blocks import corner_boxes


@pytest.fixture(scope="module")
def dark(tmp_path_factory):
    """Six black images of 120x90 px."""
    folder = tmp_path_factory.mktemp("dark")
    for index in range(6):
        cv2.imwrite(str(folder / f"{index:03}.png"), np.zeros((90, 120, 3), np.uint8))
    return folder


@pytest.fixture
def run(dark, tmp_path, capsys):
    """Run with a text as the file of detections: the exit code, and what was said."""

    def run_with(text, name="det.txt"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        command = ["run", "kalman_detections", "--source", str(dark), "--detections", str(path), "-q"]
        shutil.rmtree(tmp_path / "run", ignore_errors=True)
        code = main([*command, "--out", str(tmp_path / "run")])
        return code, capsys.readouterr().err

    return run_with


TENSORFLOW = "filename,frame,width,height,class,xmin,ymin,xmax,ymax\n"


def test_corners_win_over_the_size_of_the_image(run, tmp_path):
    text = TENSORFLOW + "".join(f"{n}.jpg,{n},120,90,person,20,30,60,80\n" for n in range(1, 7))
    code, said = run(text)
    assert code == 0 and "width and height are the size of the image (120x90 px)" in said
    boxes = [line.split(",")[2:6] for line in (tmp_path / "run/tracks.txt").read_text().splitlines()]
    assert boxes
    np.testing.assert_allclose(np.array(boxes, float), [[20, 30, 40, 50]] * len(boxes), atol=1)


def test_corners_that_are_parts_of_the_image_are_multiplied_by_its_size():
    text = TENSORFLOW + "a.jpg,1,120,90,person,0.25,0.5,0.5,1\nb.jpg,2,240,90,person,0.25,0.5,0.5,1\n"
    with pytest.warns(InputNotice, match=r"size of the image \(120x90 px and 1 more\), and corners"):
        found = parse_detections(text)
    assert [one.boxes.tolist() for one in found.values()] == [[[44.5, 67, 30, 45]], [[89.5, 67, 60, 45]]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "frame,left,top,width,height,right,bottom\n1,20,30,40,50,90,85\n",
            "det.txt:2: the columns fit two readings: corners (20,30 to 90,85: 70x55 px), and left, top, "
            "width, height (40x50 px)",
        ),
        (
            "frame,id,track_id,x,y,w,h\n1,0,7,20,30,40,50\n2,1,7,20,30,40,50\n",
            "the columns 'id' and 'track_id' part the rows in different ways",
        ),
        (
            "frame,frame_number,x,y,w,h\n1,5,20,30,40,50\n2,5,20,30,40,50\n",
            "the columns 'frame' and 'frame_number' part the rows",
        ),
    ],
)
def test_a_header_that_fits_two_readings_is_refused_with_both(run, text, message):
    code, said = run(text)
    assert code == 2 and message in said


def test_columns_that_say_the_same_twice_are_no_matter(recwarn):
    text = "frame,frame_no,id,track_id,x,y,w,h,x2,y2\n1,1,a,7,20,30,40,50,60,80\n2,2,b,8,20,30,40,50,60,80\n"
    assert parse_detections(text)[1].boxes.tolist() == [[39.5, 54.5, 40, 50]]
    assert not [one for one in recwarn if "readings" in str(one.message)]


def test_rows_that_cannot_be_used_do_not_decide_what_a_column_is():
    box = np.array([[np.nan] * 4, [20.0, 30, 60, 80], [9, 9, 9, 9]])
    found = corner_boxes(box, np.array([[5.0, 5], [40, 50], [1, 1]]), [2, 3, 4], "f")
    assert found[1].tolist() == [20, 30, 40, 50]


@pytest.mark.parametrize(
    "text",
    ["", "1,2,3,4\n", "1 0.5 0.5 0.2 0.3\n2 0.5 0.5 0.2 0.3\n3 0.5 0.5 0.2 0.3\n", "[1]", "{", "x y\n1 2"],
)
def test_nothing_is_said_of_a_text_that_is_not_known(text):
    assert explain_foreign(text) is None


RLE = {"size": [90, 120], "counts": "PPYo1"}
FOREIGN = [
    (json.dumps([{"image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4], "score": 0.5}]), "COCO results"),
    (json.dumps([{"image_id": 1, "category_id": 1, "segmentation": RLE}]), "COCO results with masks"),
    (
        json.dumps({"images": [], "annotations": []}, indent=1),
        "COCO JSON (images and annotations); `annotate",
    ),
    (json.dumps(RLE), "run-length encoded masks"),
    (json.dumps([RLE, RLE]), "run-length encoded masks"),
    (json.dumps([{"data": {"video": "a.mp4"}, "annotations": []}]), "a task of Label Studio"),
    ("<annotations><version>1.1</version></annotations>", "XML of CVAT's annotations; `annotate --import`"),
    ("<annotation><object/></annotation>", "XML of Pascal VOC"),
    ("m10,10,20,20,5,3,17,3\nm10,10,20,20,5,3,17,3\n0\n", "regions of VOT that are masks"),
    ("1\n12,13,40,50\n12,14,40,50\n2\n", "results of a VOT toolkit"),
    ("0 0.5 0.5 0.2 0.3\n1 0.1 0.2 0.1 0.1\n", "labels of YOLO"),
    ("0 0.91 0.5 0.5 0.2 0.3\n0 0.8 0.1 0.2 0.1 0.1\n", "labels of YOLO"),
    (b"\x93NUMPY\x01\x00\xff", "not a text file (an array of NumPy (.npy))"),
]


@pytest.mark.parametrize(("text", "message"), FOREIGN, ids=[message for _, message in FOREIGN])
def test_what_a_file_is_and_what_takes_it_is_said(run, dark, tmp_path, capsys, text, message):
    code, said = run(text)
    assert code == 2 and message in said
    truth = ["run", "general", "--source", str(dark), "--init-from", str(tmp_path / "det.txt"), "-q"]
    assert main([*truth, "--out", str(tmp_path / "other")]) == 2
    assert message in capsys.readouterr().err


def test_detections_are_not_annotations(dark, tmp_path, capsys):
    path = tmp_path / "a.json"
    path.write_text(FOREIGN[3][0])
    command = ["annotate", str(dark), "--graph", "general", "--import", str(path), "--no-view"]
    assert main([*command, "--out", str(tmp_path / "session")]) != 0
    assert "run-length encoded masks" in capsys.readouterr().err


SHARES = "all coordinates are about 0 to 1"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("".join(f"{n},-1,.2,.3,.25,.5,.9\n" for n in range(1, 7)), SHARES),
        ("1,-1,.2,.3,.25,.5,.9\n", SHARES),
        ("frame,x1,y1,x2,y2\n1,.2,.3,.25,.5\n", SHARES),
        ('{"frame": 0, "detections": [{"box": [0.2, 0.3, 0.25, 0.5]}]}\n', SHARES),
    ],
)
def test_shares_of_the_frame_are_refused_and_how_the_size_is_given_is_said(run, text, message):
    code, said = run(text)
    assert code == 2 and message in said
    assert "multiply x and width by the frame's width" in said and "xmin,ymin,xmax,ymax,width,height" in said


def test_confidences_that_are_mapped_are_said_with_the_numbers(run):
    code, said = run("".join(f"{n},-1,20,30,40,50,{95 + n}\n" for n in range(1, 7)))
    assert code == 0
    assert (
        "confidences from 96 to 101 are no probabilities, and are mapped: 96 becomes 0 and 101 becomes 1"
        in said
    )
    code, said = run("".join(f"{n},-1,20,30,40,50,7\n" for n in range(1, 7)))
    assert code == 0 and "confidences from 7 to 7 are no probabilities, and are mapped: all become 1" in said
    assert run("".join(f"{n},-1,20,30,40,50,-1\n" for n in range(1, 7))) == (0, "")


@pytest.mark.parametrize(
    ("confidences", "scores", "notice"),
    [
        ((99.5, 50.5, -1), [1, 0.995, 0.505], "percent"),  # -1 says none, as beside probabilities
        ((100.0, 0.5, 0), [1, 0.005, 0], "percent"),
        ((10.0,), [0.1], "percent"),
        ((9.5, 4.75, 0), [1, 0.5, 0], "mapped"),  # margins or logits
        ((60.0, 10.0, -40.0), [1, 0.5, 0], "mapped"),
        ((150.0, 100.0, 50.0), [1, 0.5, 0], "mapped"),
    ],
)
def test_percent_are_divided_by_100_and_other_scales_mapped(confidences, scores, notice):
    rows = "".join(f"1,-1,{20 * k},0,4,4,{value}\n" for k, value in enumerate(confidences))
    with pytest.warns(InputNotice, match=notice):
        assert parse_detections(rows)[0].scores.tolist() == scores


def test_a_confidence_of_minus_1_beside_others_does_not_rescale_them():
    with pytest.warns(InputNotice, match="1 of 3 confidences are -1, which says none"):
        found = parse_detections("1,-1,0,0,4,4,.9\n1,-1,9,0,4,4,.8\n1,-1,20,0,4,4,-1\n")
    assert found[0].scores.tolist() == [1, 0.9, 0.8]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "scorer,DLC,DLC,DLC\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n0,20.5,30.5,0.99\n",
            "a CSV of DeepLabCut (points of bodies",
        ),
        (
            "LABEL,ID,TRACK_ID,POSITION_X,POSITION_Y,FRAME\nLabel,Spot ID,Track ID,X,Y,Frame\n",
            "spots of TrackMate (POSITION_X and POSITION_Y are centres, frames count from 0",
        ),
        (
            json.dumps([[{"name": "car", "box": {"x1": 1, "y1": 2, "x2": 3, "y2": 4}}], []]),
            "a JSON list; write its boxes as MOT lines",
        ),
    ],
)
def test_a_file_of_another_tool_is_named(run, text, message):
    code, printed = run(text)
    assert code == 2 and f"it is {message}" in printed


def test_centres_are_read_where_the_header_names_them():
    text = "frame,x_center,y_center,width,height,conf\n1,35,80,30,40,0.5\n"
    (found,) = parse_detections(text).values()
    assert found.boxes.tolist() == [[34.5, 79.5, 30, 40]]
    with pytest.raises(ValueError, match="no column is called left, top"):
        parse_detections(text.replace("width,", "breadth,"))
    short = "frame,l,t,w,h,conf\n1,20,60,30,40,0.5\n"
    assert next(iter(parse_detections(short).values())).boxes.tolist() == [[34.5, 79.5, 30, 40]]
