"""Pictures of a comparison show the frames in which two runs diverge, with the boxes of both."""

import base64
import re
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bayesnet_track.journal.compare import compare
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.view.compare_charts import WIDEST, draw_pictures, telling_frames
from bayesnet_track.view.compare_page import compare_page

BOX = (40.0, 30.0, 20.0, 10.0)


@pytest.fixture
def two_runs(metrics):
    """Two runs of a target; from frame 3 on, frame n has the second one's box n px to the right."""
    events = [TargetStarted(0, "1", "plate", BOX, ("a",))]
    lines = [replace(metrics, frame=frame, centre_box=BOX) for frame in range(20)]
    moved = [
        replace(one, centre_box=(BOX[0] + (one.frame if one.frame > 2 else 0), *BOX[1:])) for one in lines
    ]
    return [
        SimpleNamespace(name=name, events=events, metrics=which, seconds={}, costs_ms={})
        for name, which in (("runs/a", lines), ("runs/b", moved))
    ]


def images(width=320):
    return ((frame, np.full((60, width, 3), 10 * frame, dtype=np.uint8)) for frame in range(20))


def test_they_are_those_where_the_boxes_part_and_are_farthest_apart(two_runs):
    telling = telling_frames(compare(*two_runs))
    # 20 px wide and d px apart, they overlap by (20 - d) / (20 + d): 0.74 at 3 px, below a half from 7 px on.
    assert [one.frame for one in telling] == [3, 7, 19]
    assert telling[-1].what == "they are farthest apart, 19 px"
    assert telling_frames(compare(two_runs[0], two_runs[0])) == ()


def test_a_figure_has_the_image_of_its_frame_and_both_boxes(two_runs):
    figures = list(draw_pictures(images(), telling_frames(compare(*two_runs)), *two_runs))
    assert len(figures) == 3
    assert 'x="30.5" y="25.5" width="20" height="10" class="box a"' in figures[1]
    assert 'x="37.5" y="25.5" width="20" height="10" class="box b"' in figures[1]
    data = base64.b64decode(re.search('base64,([^"]*)', figures[1])[1])
    shown = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (60, 320, 3) and abs(float(shown.mean()) - 70) < 2


def test_a_wide_image_is_scaled_and_its_boxes_stay_in_its_own_pixels(two_runs):
    (figure, *_) = draw_pictures(images(4 * WIDEST), telling_frames(compare(*two_runs)), *two_runs)
    data = base64.b64decode(re.search('base64,([^"]*)', figure)[1])
    assert cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR).shape == (15, WIDEST, 3)
    assert f'viewBox="0 0 {4 * WIDEST} 60"' in figure and 'x="30.5"' in figure


def test_the_page_may_load_them_and_nothing_else(two_runs):
    compared = compare(*two_runs)
    figures = list(draw_pictures(images(), telling_frames(compared), *two_runs))
    page = compare_page(*two_runs, compared, [], pictures=figures)
    assert "img-src data:" in page and page.count("<figure>") == 3
    assert "img-src" not in compare_page(*two_runs, compared, [])


def test_two_small_boxes_are_shown_from_near(two_runs):
    wide = ((frame, np.full((600, 800, 3), 10 * frame, dtype=np.uint8)) for frame in range(20))
    (figure, *_) = draw_pictures(wide, telling_frames(compare(*two_runs)), *two_runs)
    # In frame 3 the boxes span 23 of 800 px: four times that, at the frame's left edge.
    assert 'viewBox="0 0 92 69"' in figure and "a part of the frame, 92 × 69 px" in figure
    data = base64.b64decode(re.search('base64,([^"]*)', figure)[1])
    assert cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR).shape == (69, 92, 3)


def test_the_frame_in_which_their_decisions_diverge_is_shown(two_runs):
    first, second = two_runs
    on = Activated(12, "1", "a", "root", Cause("ud_px2", 200.0, 210.0, 1, 210.0, 210.0, 1.0))
    second.events = [*second.events, on]
    telling = telling_frames(compare(first, second))
    assert [(one.frame, one.what) for one in telling if one.frame == 12] == [
        (12, "their decisions first diverge")
    ]
