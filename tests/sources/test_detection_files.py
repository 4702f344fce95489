"""Detections from files: what `detect` writes is found again, and mistakes name file and line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.observation.detector import Detections, Detector
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.sources.detection_files import file_detector, format_frame, parse_detections
from bayesnet_track.sources.entrances.notices import InputNotice


def frame(index):
    return Frame(index, float(index), np.zeros((48, 64, 3), np.uint8))


def found_in(detector, index):
    return detector.detect(FramePair(frame(index), None), detector.start())[0]


boxes = st.tuples(
    *[st.integers(-999_000, 999_000)] * 2, *[st.integers(1_001, 999_000).map(lambda half: 2 * half)] * 2
).map(lambda thousandths: np.array(thousandths) / 1000)
frames = st.lists(
    st.lists(st.tuples(boxes, st.integers(0, 10**6), st.sampled_from(["", "person", 'a "b"\n', "é"]))),
    max_size=5,
)


@given(frames, st.booleans())
def test_what_is_written_is_found_again(several, as_json):
    """Boxes to half a thousandth of a pixel (their text has 3 decimals), scores bit for bit."""
    written = []
    for found in several:
        found.sort(key=lambda one: -one[1])
        written.append(
            Detections(
                np.array([box for box, _, _ in found]).reshape(-1, 4),
                np.array([score / 1e6 for _, score, _ in found]),
                tuple(label if as_json else "" for _, _, label in found),
            )
        )
    text = "\n".join(
        line for n, found in enumerate(written) for line in format_frame(frame(n), found, as_json)
    )
    read = parse_detections(text)
    assert set(read) == {n for n, found in enumerate(written) if len(found)}
    for n, back in read.items():
        np.testing.assert_allclose(back.boxes, written[n].boxes, atol=1.001e-3, rtol=0)
        assert back.scores.tolist() == written[n].scores.tolist() and back.labels == written[n].labels


def test_a_detector_finds_the_boxes_of_the_current_frame_the_best_first(tmp_path):
    path = tmp_path / "det.txt"
    path.write_text("9,-1,0,0,3,3,0.5\r\n3,-1,10,20,41,31,0.25,-1,-1,-1\n\n3 -1 0 0 1 1 0.75\n3,4,5,5,2,2\n")
    detector = file_detector(path)
    assert isinstance(detector, Detector)
    found = found_in(detector, 2)
    assert found.boxes.tolist() == [[5.5, 5.5, 2, 2], [0, 0, 1, 1], [30, 35, 41, 31]]
    assert found.scores.tolist() == [1.0, 0.75, 0.25] and found.labels == ("", "", "")
    assert [len(found_in(detector, n)) for n in (0, 3, 8, 9)] == [0, 0, 1, 0]


@pytest.mark.parametrize(
    ("confidences", "scores"),
    [
        ((-1, -1), [1, 1]),
        ((0, 1), [1, 0]),
        ((0.2, 0.4), [0.4, 0.2]),
        ((100, 300, 500), [1, 0.5, 0]),
        ((10, 30, 50), [0.5, 0.3, 0.1]),  # percent
        ((-0.5, 0.5), [1, 0]),
    ],
)
def test_confidences_on_another_scale_are_mapped_to_scores(confidences, scores):
    text = "\n".join(f"1,-1,0,0,4,4,{confidence}" for confidence in confidences)
    assert parse_detections(text)[0].scores.tolist() == scores


@pytest.mark.parametrize("text", ["", "\n \n", '{"frame": 4, "detections": []}\n'])
def test_a_file_may_hold_nothing(tmp_path, text):
    path = tmp_path / "none"
    path.write_text(text)
    assert len(found_in(file_detector(path), 4)) == 0


GOOD_MOT, GOOD_JSON = "1,-1,0,0,4,4,1", '{"frame": 0, "detections": [{"box": [0, 0, 4, 4]}]}'
WRONG = {
    "1,-1,0,0,4": "5 numbers; expected 6 to 10 (frame,id,left,top,width,height,confidence,...)",
    "1,-1,0,0,4,4,1,1,1,1,1": "11 numbers; expected 6 to 10 (frame,id,left,top,width,height,confidence,...)",
    "1,-1,0,,4,4": "'' is not a number; expected frame,id,left,top,width,height,confidence,...",
    "one,-1,0,0,4,4": "'one' is not a number; expected frame,id,left,top,width,height,confidence,...",
    "0,-1,0,0,4,4": "frame 0; frames of MOT files count from 1: add 1 to each, or call the column "
    "frame_index in a header line (frame_index,id,left,top,width,height,confidence), which counts from 0",
    "-3,-1,0,0,4,4": "frame -3; expected a whole number from 1 on",
    "1.5,-1,0,0,4,4": "frame 1.5 is not a whole number",
    "1,nan,0,0,4,4": "id nan is not a whole number",
    "1e300,1,0,0,4,4": "frame 1e300 is not a whole number",
    "1,-1,0 5,0,4,4": "'0 5' is separated by a space, and the line by commas: decimal commas (write points), "
    "or separators (separate all by the same sign)",
    "1;-1;0,5;0;4;4": "'0,5' has a comma between other separators: a decimal comma (write 0.5), or two "
    "numbers (separate all by the same sign)",
    "1_0,-1,0,0,4,5": "'1_0' is not a number; expected frame,id,left,top,width,height,confidence,...",
    '{"frame": 0': "expected an object with frame and detections",
    "[1]": "expected an object with frame and detections",
    '{"frame": -1, "detections": []}': "frame -1; expected a whole number from 0 on",
    '{"frame": true, "detections": []}': "frame true; expected a whole number from 0 on",
    '{"frame": 1, "detections": {}}': "detections {}; expected a list",
    '{"frame": 1, "detections": [7]}': "detection 1: 7; expected an object with box, score, label",
    '{"frame": 1, "detections": [{"box": [0, 0, 4, 4]}, {"box": [1, 2, 3]}]}': (
        "detection 2: box [1, 2, 3]; expected [left, top, width, height]"
    ),
    '{"frame": 1, "detections": [{"box": [0, 0, "4", 4]}]}': (
        'detection 1: box [0, 0, "4", 4]; expected [left, top, width, height]'
    ),
    '{"frame": 1, "detections": [{"box": [0, 0, 4, 4], "score": 1.5}]}': (
        "detection 1: score 1.5; expected a number from 0 to 1"
    ),
    '{"frame": 1, "detections": [{"box": [0, 0, 4, 4], "label": 3}]}': (
        "detection 1: label 3; expected a text"
    ),
}


@pytest.mark.parametrize("line", WRONG)
def test_a_wrong_line_is_named(tmp_path, line):
    path = tmp_path / "det"
    path.write_text(f"{GOOD_JSON if line[0] in '{[' else GOOD_MOT}\n\n{line}\n")
    with pytest.raises(ValueError) as error:
        file_detector(path)
    assert str(error.value) == f"{path}:3: {WRONG[line]}"


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (
            "1,-1,0,0,4,4,1\n2,-1,0,0,4,0,1\n3,-1,0,inf,4,4,1\n4,-1,nan,nan,nan,nan,1\n5,-1,0,0,4,4,1\n",
            "2, 3, 4",
        ),
        (
            '{"frame": 0, "detections": [{"box": [0, 0, 4, 4]}, {"box": [0, 0, NaN, 4]}]}\n'
            '{"frame": 3, "detections": [{"box": [0, 0, -1, 4]}, {"box": [null, 0, 4, 4]}]}\n'
            '{"frame": 4, "detections": [{"box": [0, 0, 4, 4]}]}\n',
            "1, 2, 2",
        ),
    ],
)
def test_boxes_that_cannot_be_used_are_left_out_and_said(text, lines):
    with pytest.warns(InputNotice) as said:
        found = parse_detections(text, "det")
    assert sorted(found) == [0, 4] and [len(one) for one in found.values()] == [1, 1]
    assert [str(one.message) for one in said] == [
        f"det: 3 of 5 boxes are not finite or have no area and are left out: line {lines}"
    ]


def test_a_confidence_that_is_not_finite_is_none():
    with pytest.warns(
        InputNotice, match="2 of 3 boxes are left out, whose confidence is not finite: line 1, 3"
    ):
        found = parse_detections("1,-1,0,0,4,4,inf\n1,-1,5,5,4,4,0.5\n1,-1,0,0,4,4,nan\n")
    assert found[0].scores.tolist() == [0.5]


def test_classes_become_labels():
    found = parse_detections("1,-1,0,0,4,4,1,3,0.5\n1,-1,5,0,4,4,1,1,1\n")
    assert found[0].labels == ("3", "1")
    assert parse_detections("frame,x,y,w,h,class\n1,0,0,4,4,car\n1,0,0,4,4,\n")[0].labels == ("car", "")


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "picture.png"
    path.write_bytes(b"\x89PNG\r\n\xff")
    with pytest.raises(ValueError, match=r"picture\.png: not a text file"):
        file_detector(path)
