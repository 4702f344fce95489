"""The overlay: where the estimate is, in its colour, all of it inside the picture, at every size."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayesnet_track.journal.metrics import PartMetrics
from bayesnet_track.view.overlay import PART_COLOUR, STATUS_COLOUR, TRUTH_COLOUR, draw_overlay

GRAY = np.full((240, 320, 3), 100, dtype=np.uint8)


def pixels(image, colour):
    return (np.abs(image.astype(int) - np.array(colour)).max(axis=2) <= 12).nonzero()


@pytest.mark.parametrize("status", ["tracking", "lost"])
def test_the_box_is_drawn_on_the_pixels_it_covers(metrics, status):
    before = GRAY.copy()
    drawn = draw_overlay(GRAY, replace(metrics, status=status, cloud=()))
    np.testing.assert_array_equal(GRAY, before)
    rows, columns = pixels(drawn, STATUS_COLOUR[status])
    below = rows > 92  # beneath the label, which is written in the same colour
    # The centre box 154, 110, 41 x 31 covers columns 134 .. 174 and rows 95 .. 125.
    assert (columns[below].min(), columns[below].max()) == (134, 174)
    assert (rows[below].min(), rows[below].max()) == (95, 125)


def test_a_turned_target_has_a_turned_box_too(metrics):
    """By 90 degrees the sides of 41 x 31 change places: lower, and 15.5 columns from the middle."""
    status = replace(metrics, status="tracking", cloud=())
    rows, columns = pixels(draw_overlay(GRAY, replace(status, angle=90.0)), STATUS_COLOUR["tracking"])
    upright = pixels(draw_overlay(GRAY, status), STATUS_COLOUR["tracking"])
    assert max(rows) > max(upright[0]) + 3
    below = columns[rows > max(upright[0])]
    assert abs(below.min() - (154 - 15.5)) <= 1.5 and abs(below.max() - (154 + 15.5)) <= 1.5


def test_the_two_statuses_look_different(metrics):
    lost = draw_overlay(GRAY, replace(metrics, status="lost"))
    assert not pixels(lost, STATUS_COLOUR["tracking"])[0].size


def test_the_cloud_is_drawn_where_the_hypotheses_are(metrics):
    with_cloud, without = draw_overlay(GRAY, metrics), draw_overlay(GRAY, replace(metrics, cloud=()))
    rows, columns = (with_cloud != without).any(axis=2).nonzero()
    assert (columns.min(), columns.max()) == (130, 178)
    assert rows.max() == 128


def test_truth_is_dashed_and_may_be_absent(metrics):
    plain = draw_overlay(GRAY, metrics)
    np.testing.assert_array_equal(draw_overlay(GRAY, metrics, np.full(4, np.nan)), plain)
    drawn = draw_overlay(GRAY, metrics, (20.0, 150.0, 40.0, 30.0))
    top = (drawn[150, 20:60] == TRUTH_COLOUR).all(axis=1)
    assert 0.3 < top.mean() < 0.8
    assert not (drawn[150, 60:80] == TRUTH_COLOUR).all(axis=1).any()


@pytest.mark.parametrize("size", [(240, 320), (1080, 1920), (48, 64), (8, 8)])
@pytest.mark.parametrize("at", [(0.0, 0.0), (1.0, 1.0), (0.5, 0.02)])
def test_the_label_stays_inside_and_readable(metrics, size, at):
    image = np.full((*size, 3), 100, dtype=np.uint8)
    box = (at[0] * size[1], at[1] * size[0], 41.0, 31.0)
    agents = tuple(f"agent_with_a_long_name_{n}" for n in range(9))
    drawn = draw_overlay(image, replace(metrics, centre_box=box, active=agents, cloud=()))
    assert drawn.shape == image.shape and drawn.dtype == np.uint8
    if size[0] >= 240:
        plate = (
            np.abs(drawn.astype(int) - 47).max(axis=2) <= 8
        ).nonzero()  # what the dark plate leaves of 100
        height = plate[0].max() - plate[0].min() + 1
        assert plate[1].min() >= 0 and plate[1].max() < size[1]
        assert height >= 24 * min(max(size[0] / 480, 0.7), 2.5)  # two lines of letters


far = st.one_of(st.floats(-1e9, 1e9), st.floats(-50, 400))


@given(x=far, y=far, w=st.floats(1, 1e7), h=st.floats(1, 1e7), ud=st.floats(allow_nan=True))
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_no_box_is_too_strange(metrics, x, y, w, h, ud):
    drawn = draw_overlay(GRAY, replace(metrics, centre_box=(x, y, w, h), ud_px2=ud), (x, y, w, h))
    assert drawn.shape == GRAY.shape


def test_parts_have_boxes_of_their_own_dashed_where_hidden(metrics):
    """The hidden part lies away from the estimate; its sides are drawn in dashes, the seen one's in full."""
    seen = PartMetrics((40.5, 200.5, 20.0, 20.0), (1.0,) * 4, 2.0, "seen")
    hidden = replace(seen, centre_box=(240.5, 200.5, 20.0, 20.0), status="hidden")
    whole = replace(metrics, cloud=(), parts={"head": seen, "torso": hidden})
    drawn = draw_overlay(GRAY, whole)
    assert (drawn[191, 31:51] == PART_COLOUR).all()
    assert 0.3 < (drawn[191, 231:251] == PART_COLOUR).all(axis=1).mean() < 0.9
    without = draw_overlay(GRAY, replace(whole, parts={"head": seen}))
    assert (drawn != without)[:92, 134:].any()  # the label says what is hidden


def test_the_most_probable_mode_stands_below_the_agents(metrics):
    """One line more on the plate, which is dark: more pixels of it than without modes."""
    moded = replace(metrics, cloud=(), modes={"seen": 0.07, "behind": 0.93}, hidden=0.93)
    without, with_one = (
        (draw_overlay(GRAY, one).max(axis=2) < 60).sum() for one in (replace(metrics, cloud=()), moded)
    )
    assert with_one > without + 200
