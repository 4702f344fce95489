"""Boxes of estimates: each convention by its name, no `box` any more, and what a line shows of itself."""

import numpy as np
import pytest

from bayesnet_track.journal.metrics import GONE, PartMetrics


@pytest.fixture
def part():
    return PartMetrics((30.0, 35.0, 41.0, 31.0), (1.0,) * 4, 2.0, "seen")


def test_the_three_conventions_are_float64_arrays_of_the_same_box(part):
    boxes = {"xywh": [10, 20, 41, 31], "xyxy": [10, 20, 51, 51], "cxcywh": [30, 35, 41, 31]}
    for name, expected in boxes.items():
        found = getattr(part, name)
        assert found.dtype == np.float64 and found.shape == (4,)
        assert found.tolist() == expected, name


def test_box_is_gone_and_the_error_names_what_to_use(part):
    with pytest.raises(AttributeError, match=r"use \.xywh \(left, top, width, height\), \.xyxy"):
        _ = part.box
    assert GONE.format(kind="PartMetrics").startswith("PartMetrics has no `box`")


def test_a_part_says_what_matters(part):
    assert repr(part) == "<part: seen, xywh 10.0,20.0,41.0,31.0>"
