"""Files as other tools write them give their boxes, identities and classes; a README there says which."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.sources.detection_files import file_detector
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.mot_blocks import KITTI, layout_of
from bayesnet_track.sources.mot_lines import parse_mot, read_text

FILES = Path(__file__).parents[1] / "fixtures" / "files"


def read(name):
    """What a fixture holds, and what was said of it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", InputNotice)
        return parse_mot(read_text(FILES / name), name), [str(one.message) for one in said]


@pytest.mark.parametrize(
    ("name", "frames", "ids", "box", "classes"),
    [
        (
            "mot17_gt.txt",
            [0, 1, 0, 1, 2, 0, 1, 0],
            [1, 1, 2, 2, 2, 3, 3, 5],
            [912, 484, 97, 109],
            "771111112",
        ),
        ("mot17_det.txt", [0, 0, 1, 1], [-1] * 4, [1359.1, 413.27, 120.26, 362.77], ""),
        ("trackeval_mot17.txt", [0, 0, 1, 1, 2], [1, 2, 1, 2, 1], [1338.5, 418.2, 166, 378.5], ""),
        ("visdrone_mot.txt", [0, 1, 0, 1, 2, 0, 1], [0, 0, 1, 1, 1, 7, 7], [593, 43, 174, 190], "0011144"),
        ("kitti_results.txt", [0, 1], [3, 3], [296.74, 161.75, 158.48, 130.62], "CarCar"),
        ("excel_semicolons.csv", [0, 1], [1, 1], [10, 40, 20, 24], ""),
        ("excel_unicode_text.txt", [0, 1], [1, 1], [10, 40, 20, 24], ""),
        ("supervision_csvsink.csv", [0, 0, 1], [1, 2, 1], [10.5, 40, 20, 24], "personcarperson"),
    ],
)
def test_what_the_file_holds_is_read(name, frames, ids, box, classes):
    lines, said = read(name)
    assert lines.frames.tolist() == frames and lines.ids.tolist() == ids and said == []
    np.testing.assert_allclose(lines.boxes[0], box, atol=1e-9)
    assert "".join(lines.classes) == classes


def test_areas_that_kitti_does_not_label_have_confidence_0():
    lines, _ = read("kitti_0000.txt")
    assert lines.rest[:2, 0].tolist() == [0, 0] and np.isnan(lines.rest[2:, 0]).all()
    assert (
        lines.frames.tolist() == [0, 0, 0, 0, 1, 1] and lines.classes[2] == "Van" and KITTI.first_frame == 0
    )
    assert lines.boxes[2, 2:] == pytest.approx([455.226042 - 296.744956, 292.372804 - 161.752147])


def test_rows_without_a_box_are_left_out_and_said():
    lines, said = read("pandas_to_csv.csv")
    assert lines.frames.tolist() == [0, 1, 3] and lines.boxes[2].tolist() == [19, 46, 20, 24]
    assert said == ["pandas_to_csv.csv: 1 of 4 boxes is not finite or has no area and is left out: line 4"]


def test_the_tracks_of_a_run_count_frames_from_0_and_lost_boxes_are_left_out():
    lines, said = read("own_tracks.csv")
    assert lines.frames.tolist() == [0, 1] and lines.boxes[1].tolist() == [13, 42, 20, 24]
    assert said == ["own_tracks.csv: 1 box of a target that is lost is left out"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "excel_decimal_commas.csv",
            ":2: '10,5' has a comma between other separators: a decimal comma (write 10.5)",
        ),
        ("bytetrack_kitti.txt", "left,top,width,height or corners left,top,right,bottom"),
        ("vot_polygons.txt", "polygons"),
    ],
)
def test_what_can_be_meant_in_two_ways_is_refused(name, message):
    with pytest.raises(ValueError) as error:
        parse_mot(read_text(FILES / name), name)
    assert message in str(error.value)


def test_a_header_line_makes_corners_of_what_was_refused():
    text = "frame_index,id,x1,y1,x2,y2,score,class_id\n" + read_text(FILES / "bytetrack_kitti.txt")
    lines = parse_mot(text)
    assert lines.frames.tolist() == [0, 0, 1, 1, 2] and lines.classes.tolist() == ["0", "2", "0", "2", "0"]
    assert lines.boxes[0] == pytest.approx([1109.93, 174.78, 90.85, 140.46])


def test_classes_of_detections_are_their_labels():
    with pytest.warns(InputNotice, match="columns that are not used: colour_of_hat"):
        found = parse_with_column("colour of hat")
    assert found == ["person"]
    assert file_detector(FILES / "supervision_csvsink.csv").found[0].labels == ("person", "car")


def parse_with_column(name):
    """The classes of a file with a column that nothing is known of."""
    return parse_mot(f"frame,id,x,y,w,h,class,{name}\n1,1,2,3,4,5,person,red\n").classes.tolist()


@pytest.mark.parametrize(
    "header", ["frame,x,y,w", "frame,left,top,width,bottom", "a,b,c,d,e,f,g", "frame,id,x1,y1,x2,h"]
)
def test_a_header_that_names_no_box_is_refused(header):
    with pytest.raises(ValueError, match=r"^f:1: a header line .* in which no column is called"):
        layout_of((1, header.split(",")), "f")
