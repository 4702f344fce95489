"""Lines of numbers: what is written is read back, and what is not meant for it is refused, never guessed."""

import re
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.evaluate.truth import parse_truth
from bayesnet_track.sources.entrances.boxes import are_corners, count_up, refuse_shares
from bayesnet_track.sources.entrances.text_lines import split_lines, split_words
from bayesnet_track.sources.mot_lines import LEAST, MOST, exact_int, parse_mot

ROWS = st.lists(
    st.tuples(
        st.integers(1, 10**6),
        st.integers(-1, 2**63 - 1),
        *[st.floats(-1e5, 1e5)] * 2,
        *[st.floats(1e-3, 1e5)] * 2,
        st.floats(-1e3, 1e3),
    ),
    min_size=1,
    max_size=9,
)
SEPARATORS = st.sampled_from([",", ";", "\t", " ", ", "])


@given(ROWS, SEPARATORS, st.sampled_from(["\n", "\r\n", "\r"]), st.booleans())
def test_what_is_written_is_read_back(rows, separator, end, has_header):
    """Under a header in another order; without one as MOT. Identities to the last digit."""
    if has_header:
        lines = ["h,id,frame,w,y,x,conf".replace(",", separator.strip(" ") or separator)]
        order = [5, 1, 0, 4, 3, 2, 6]
    else:
        lines, order = [], list(range(7))
    lines += [separator.join(repr(row[k]) for k in order) for row in rows]
    read = parse_mot(end.join(lines), is_given=True)
    assert read.ids.tolist() == [row[1] for row in rows]
    assert read.frames.tolist() == [row[0] - 1 for row in rows]
    np.testing.assert_array_equal(read.boxes, [row[2:6] for row in rows])
    np.testing.assert_array_equal(read.rest[:, 0], [row[6] for row in rows])


WORDS = st.one_of(
    st.integers(-2, 9).map(str),
    st.floats().map(repr),
    st.sampled_from(
        ["", "x", "1,5", "nan", '"7"', "1_0", "٣", "id", "frame", "#", "\x00", "1e400", "7.0", "-"]
    ),
)


@given(
    st.lists(st.tuples(st.lists(WORDS, min_size=1, max_size=12), SEPARATORS), max_size=6),
    st.sampled_from(["", "frame,id,x,y,w,h\n", "x;y\n"]),
)
def test_hostile_lines_are_read_or_refused_with_their_place(lines, header):
    text = header + "\n".join(separator.join(words) for words, separator in lines)
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        try:
            read = parse_mot(text, "file")
        except ValueError as error:
            assert re.match(r"file(:\d+)?: .", str(error))
            return
    assert np.isfinite(read.boxes).all() and (read.boxes[:, 2:] > 0).all() and (read.frames >= 0).all()
    assert len(read) <= len(lines) + 1 and LEAST < MOST


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1,2,,", ["1", "2"]),
        ("1;2;3,5", ["1", "2", "3,5"]),
        ('"1","2"', ["1", "2"]),
        ('"1" "2"', ["1", "2"]),
        ('"1"\t"2 3"', ["1", "2 3"]),
        (";;", []),
        ("  ", []),
    ],
)
def test_words_of_a_line(line, words):
    assert split_words(line) == words


@pytest.mark.parametrize(
    ("first", "is_header"),
    [
        ("frame,id", True),
        ("nan nan", False),
        ("#frame id", True),
        ("1|2", False),
        (",frame", True),
        ("a,1", False),
    ],
)
def test_which_first_line_is_a_header(first, is_header):
    assert (split_lines(f"\n{first}\n1,2", "f").header is not None) is is_header


@pytest.mark.parametrize(
    ("word", "number"),
    [
        ("7.0", 7),
        ("1e3", 1000),
        (" 7", 7),
        ("9223372036854775807.0", 2**63 - 1),
        ("9223372036854775808", None),
    ]
    + [(word, None) for word in ("7.5", "nan", "1_0", "٣", "", "1e999999999", "inf")],
)
def test_whole_numbers_are_exact(word, number):
    assert exact_int(word) == number


def test_sizes_that_are_small_or_do_not_follow_the_place_are_no_corners():
    rng = np.random.default_rng(0)
    places, sizes = rng.uniform(0, 300, (40, 2)), rng.uniform(20, 60, (40, 2))
    assert are_corners(np.hstack([places, places + sizes])) and not are_corners(np.hstack([places, sizes]))
    assert not are_corners(np.hstack([rng.uniform(0, 20, (40, 2)), rng.uniform(30, 300, (40, 2))]))
    assert count_up(np.arange(1, 5)) and not count_up(np.arange(2))
    refuse_shares(np.array([[0.0, 0.0, 1.0, 1.0]]), "f")
    with pytest.raises(ValueError, match="about 0 to 1"):
        refuse_shares(np.array([[0.0, 0.0, 0.5, 1.0]]), "f")
    with pytest.raises(ValueError, match="shares"):  # partly outside
        refuse_shares(np.array([[-0.01, 0.9, 0.5, 0.2]]), "f")


@pytest.mark.parametrize("line", ["{n},40,60,30,40,0.9", "{n},4{n},60,30,0.8,1", "{n},0,0.75,40,60,30,40"])
def test_scores_in_a_column_of_the_boxes_are_refused_with_both_readings(line):
    text = "\n".join(line.format(n=n) for n in range(1, 9))
    with pytest.raises(ValueError, match="lines can be boxes or scores in another order"):
        parse_mot(text)
    assert len(parse_mot(text, is_given=True)) == 8


def test_scores_behind_boxes_without_frames_are_refused():
    with pytest.raises(ValueError, match="every height is from 0 to 1"):
        parse_truth("\n".join(f"{n},60,30,40,1" for n in range(1, 9)))
