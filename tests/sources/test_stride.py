"""Every K-th frame of a source: its numbers, its times, and what is missing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track.journal.events.runs import FramesMissing
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.several import reopen
from bayesnet_track.sources.sources import SourceError, open_source
from bayesnet_track.sources.timing import Strided, strided


@pytest.fixture
def folder(tmp_path):
    """Writes images with these numbers as names, each of its number's gray level."""

    def write(numbers):
        for number in numbers:
            cv2.imwrite(str(tmp_path / f"{number:04}.png"), np.full((8, 8, 3), number, np.uint8))
        return str(tmp_path)

    return write


def frames_of(source):
    with source:
        return list(source)


@pytest.mark.parametrize(
    ("window", "expected"),
    [
        ((None, None), [0, 3, 6, 9]),
        ((2, None), [2, 5, 8]),
        ((2, 8), [2, 5]),
        ((1, 2), [1]),
        ((0, 10), [0, 3, 6, 9]),
    ],
)
def test_numbers_and_times_are_those_of_the_source(folder, window, expected):
    source = open_source(folder(range(10)), *window, stride=3)
    assert source.expected_frames == len(expected)
    items = frames_of(source)
    assert [item.index for item in items] == expected and all(isinstance(item, Frame) for item in items)
    assert {item.stride for item in items} == {3}
    assert [item.ordinal - items[0].ordinal for item in items] == list(range(len(items)))
    assert [(item.time, item.time_s, item.image[0, 0, 0]) for item in items] == [
        (float(n), pytest.approx(n / 25), n) for n in expected
    ]


def test_only_frames_that_the_source_lacks_are_missing(folder):
    numbers = [n for n in range(24) if not 7 <= n < 13]  # six of them
    items = frames_of(open_source(folder(numbers), stride=3))
    (missing,) = [item for item in items if isinstance(item, FramesMissing)]
    assert (missing.frame, missing.missing) == (9, 6.0)


def test_it_is_opened_again_with_its_stride(folder):
    source = open_source(folder(range(10)), 1, stride=4)
    with reopen(source.origin.marked()) as again:
        assert [item.index for item in again] == [1, 5, 9]


@pytest.mark.parametrize(
    ("stride", "is_live", "said"), [(0, False, "from 1 on"), (2, True, "drops the frames")]
)
def test_a_stride_that_cannot_be_is_refused(stride, is_live, said):
    class Camera:
        declared_frames, frame_interval_s, gap_from = None, 0.04, 1.5

        def __init__(self):
            self.is_live, self.is_open = is_live, True

        def close(self):
            self.is_open = False

    camera = Camera()
    with pytest.raises(SourceError, match=said):
        strided("0", camera, 0, stride)
    assert not camera.is_open and Strided.__doc__
