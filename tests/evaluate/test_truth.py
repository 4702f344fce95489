"""Ground-truth files in every published form, and clear errors for the others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.evaluate.truth import parse_truth, read_truth
from bayesnet_track.sources.scene_source import format_truth


@pytest.mark.parametrize(
    "line", ["198,214,34,81", "198\t214\t34\t81", "198 214 34 81", " 198, 214,\t34 , 81 "]
)
def test_separators(line):
    assert parse_truth(line).tolist() == [[198, 214, 34, 81]]


def test_polygons_become_their_bounding_box():
    assert parse_truth("10,20, 30,15.5, 40,50, 8,44").tolist() == [[8, 15.5, 32, 34.5]]


@pytest.mark.parametrize(
    "line",
    [
        *("nan,nan,nan,nan", "NaN,2,3,4", "1,2,0,4", "1,2,3,-1", "inf,1,2,3", "0 0 0 0"),
        *("1,2,nan,4,5,6,7,8", "1,2,3,4,5,6,7,nan", "1,inf,3,4,5,6,7,8"),
    ],
)
def test_absent_targets_are_nan_rows(line):
    boxes = parse_truth(f"1,2,3,4\n{line}\n5,6,7,8\n")
    assert np.isnan(boxes[1]).all()
    assert boxes[[0, 2]].tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "FILE: no boxes; expected one x,y,w,h per line"),
        ("1,2,3,4\n1,2,x,4\n", "FILE:2: 'x' is not a number; expected x,y,w,h"),
        ("1,2,3\n", "FILE:1: 3 numbers; expected 4 (x,y,w,h) or 8 (a polygon)"),
        ("1,2,3,4\n\n1,2,3,4\n", "FILE:2: 0 numbers; expected 4 (x,y,w,h) or 8 (a polygon)"),
        ("1;2;3;4\n", "FILE:1: '1;2;3;4' is not a number; expected x,y,w,h"),
    ],
)
def test_errors_say_file_and_line(tmp_path, text, message):
    path = tmp_path / "groundtruth.txt"
    path.write_text(text)
    with pytest.raises(ValueError) as caught:
        read_truth(path)
    assert str(caught.value) == message.replace("FILE", str(path))


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "image.jpg"
    path.write_bytes(b"\xff\xd8\xff")
    with pytest.raises(ValueError, match=r"image\.jpg: not a text file"):
        read_truth(path)


def test_byte_order_mark_and_windows_line_ends(tmp_path):
    path = tmp_path / "truth.txt"
    path.write_bytes(b"\xef\xbb\xbf1,2,3,4\r\n5,6,7,8\r\n\r\n")
    assert read_truth(path).tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]


corner = st.floats(-1e6, 1e6)
side = st.floats(1e-3, 1e6)


@given(st.lists(st.tuples(corner, corner, side, side), min_size=1, max_size=20))
def test_what_is_written_is_read_back_bit_for_bit(boxes):
    np.testing.assert_array_equal(parse_truth(format_truth(boxes)), np.array(boxes))


def test_absent_rows_are_written_too():
    boxes = np.array([[1, 2, 3, 4], [np.nan] * 4])
    np.testing.assert_array_equal(parse_truth(format_truth(boxes)), boxes)
