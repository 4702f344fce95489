"""Ground-truth files in every published form, and clear errors for the others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.evaluate.truth import EXPECTED, is_mot, parse_truth, read_truth
from bayesnet_track.sources.scenes.library import format_truth


@pytest.mark.parametrize(
    "line",
    [
        "198,214,34,81",
        "198\t214\t34\t81",
        "198 214 34 81",
        "198;214;34;81",
        '198,"214",34,81',
        " 198, 214,\t34 , 81 ",
    ],
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
        ("1,2,3\n", f"FILE:1: 3 numbers; {EXPECTED}"),
        ("1,2,3,4\n\n1,2,3,4\n", f"FILE:2: 0 numbers; {EXPECTED}"),
        ("1|2|3|4\n", "FILE:1: '1|2|3|4' is not a number; expected x,y,w,h"),
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
    np.testing.assert_array_equal(parse_truth(format_truth(boxes), form="boxes"), np.array(boxes))


def test_absent_rows_are_written_too():
    boxes = np.array([[1, 2, 3, 4], [np.nan] * 4])
    np.testing.assert_array_equal(parse_truth(format_truth(boxes)), boxes)


MOVING = [(10 + 3 * i, 40 + 2 * (i % 5), 20, 24) for i in range(30)]


def lines_of(pattern):
    """A line of this pattern for each box of `MOVING`; the frame is n, from 1."""
    return "".join(
        pattern.format(n=i + 1, x=x, y=y, w=w, h=h, r=x + w, b=y + h) + "\n"
        for i, (x, y, w, h) in enumerate(MOVING)
    )


@pytest.mark.parametrize(
    ("pattern", "several"),
    [
        ("{n},7,{x},{y},{w},{h}", True),
        ("{n},7,{x},{y},{w},{h},1", True),
        ("{n},7,{x},{y},{w},{h},1,3", True),
        ("{n},7.0,{x},{y},{w},{h},1,3,0.5", True),
        ("{n} 7 {x} {y} {w} {h} 0.93 -1 -1 -1", True),
        ("{n};{x};{y};{w};{h}", False),
        ("{x}.0,{y},{r},{y},{r},{b},{x},{b}", False),
        ("{x},{y},{r},{y},{r},{b},{x},{b}", False),
    ],
)
def test_what_the_lines_hold_decides(tmp_path, pattern, several):
    path = tmp_path / "truth.txt"
    path.write_text(lines_of(pattern))
    assert read_truth(path).tolist() == [list(box) for box in MOVING]
    assert is_mot(path) is several


@pytest.mark.parametrize(
    ("header", "pattern"),
    [
        ("x,y,w,h", "{x},{y},{w},{h}"),
        ("X1;Y1;X2;Y2", "{x};{y};{r};{b}"),
        ("frame,xmin,ymin,xmax,ymax", "{n},{x},{y},{r},{b}"),
        ("x1,y1,x2,y2,x3,y3,x4,y4", "{x},{y},{r},{y},{r},{b},{x},{b}"),
        ("h,w,top,left,id,frame", "{h},{w},{y},{x},9,{n}"),
        ("# frame id x y w h conf", "{n} 5 {x} {y} {w} {h} 1"),
    ],
)
def test_a_header_line_names_the_columns(header, pattern):
    assert parse_truth(f"{header}\n{lines_of(pattern)}").tolist() == [list(box) for box in MOVING]


BOTH = {
    "{x},{y},{r},{b}": ["corners", "boxes"],
    "{n},7,{x},{w}": ["boxes", "frame numbers"],
}


@pytest.mark.parametrize("pattern", BOTH)
def test_lines_with_two_readings_are_refused_and_both_named(pattern):
    with pytest.raises(ValueError, match="form=") as error:
        parse_truth(lines_of(pattern), "truth.txt")
    assert all(reading in str(error.value) for reading in BOTH[pattern])
    assert len(parse_truth(lines_of(pattern), form="boxes")) == len(MOVING)


def test_mot_whose_lines_are_rectangles_too_is_refused():
    """Line n is a rectangle with the corners n,1 and conf,class, so that both readings hold."""
    text = "".join(f"{n},1,{n + 50},1,{50 + 1},31,1,31\n" for n in range(1, 9))
    with pytest.raises(ValueError, match=r"can be MOT .* or polygons .*form=mot or polygons"):
        parse_truth(text)
    assert parse_truth(text, form="mot")[0].tolist() == [51, 1, 51, 31]
    assert parse_truth(text, form="polygons")[0].tolist() == [1, 1, 50, 30]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.1,0.2,0.3,0.4\n", "all coordinates are about 0 to 1"),
        ("5,1,2,3,4\n5,2,3,4,5\n", ":2: 5 numbers, the first 5; expected frame,x,y,w,h with frames"),
        ("1,1,0,0,9,9,1\n1,2,5,5,9,9,1\n", "boxes of 2 targets (1, 2); expected those of one"),
        ("1,1,0,0,9,9,1\n1,1,5,5,9,9,1\n", ":2: a second box in frame 1"),
        ("0,1,0,0,9,9,1\n", ":1: frame 0; frames of MOT files count from 1: add 1"),
        (
            "a,b,c,d\n1,2,3,4\n",
            ":1: a header line (a,b,c,d) in which no column is called left, top, width or",
        ),
        ("x,y,w,h,x\n1,2,3,4,5\n", ":1: the header names 'x' twice"),
        ("198,5 214,5 34,0 81,0\n", ":1: '5 214' is separated by a space, and the line by commas"),
        ("10,5,40,5,20,0,24,0\n13,5,41,5,20,0,24,0\n16,2,43,5,20,0,24,0\n", "4 numbers with decimal commas"),
        ("1,1,0.1,0.2,0.3,0.4,1\n", "all coordinates are about 0 to 1"),
        ("1\t10,5\t2\t3\n", "decimal commas"),
        ("1;10,5;2;3\n", "'10,5' has a comma between other separators: a decimal comma (write 10.5)"),
        ("1,9223372036854775808,0,0,9,9\n", "id 9223372036854775808 is not a whole number"),
    ],
)
def test_what_cannot_be_meant_is_said(text, message):
    with pytest.raises(ValueError) as error:
        parse_truth(text, "truth.txt")
    assert message in str(error.value)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "utf-8"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_spreadsheets_write_other_encodings_and_line_ends(tmp_path, encoding, end):
    path = tmp_path / "truth.txt"
    path.write_bytes(end.join(["frame\tx\ty\tw\th", "1\t10\t20\t30\t40", "3\t1\t2\t3\t4"]).encode(encoding))
    found = read_truth(path)
    assert found[[0, 2]].tolist() == [[10, 20, 30, 40], [1, 2, 3, 4]] and np.isnan(found[1]).all()


@pytest.mark.parametrize(
    "line", ["1,1,1e308,1e308", "1,1,1e308,1,1e308,1e308,1,1e308", "1,1,-1e308,5,9,9,1,1"]
)
def test_numbers_too_large_to_calculate_with_are_read_or_refused_in_a_sentence(line):
    try:
        boxes = parse_truth(f"{line}\n" * 16)
    except ValueError as error:
        assert "<truth>" in str(error)
    else:
        assert boxes.shape == (16, 4)
