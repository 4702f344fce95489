"""What is remembered of a target's detections, and the direction consistency: cases worked by hand."""

import numpy as np
import pytest

from bayesnet_track.adapt.association import (
    COUNT,
    GAP,
    LAST,
    PartColumns,
    direction_consistency,
    earlier,
    first_observed,
    observe_hypotheses,
)
from bayesnet_track.observation.cue import AssociationRule

RULE = AssociationRule(
    0.1, 0.1, 1.0, 0.3, 0.0, similarity="iou", direction=0.2, direction_frames=3, re_update=True
)
BELIEFS = np.zeros((1, 6)), np.eye(6)[None]


def box(x, y=0.0):
    return np.array([x, y, 10.0, 20.0])


def after(*places):
    """One target that was detected at these x, None where it was not; the first is where it starts."""
    rows = first_observed(RULE, box(places[0])[None], 6)
    for place in places[1:]:
        own = np.zeros((1, 4)) if place is None else box(place)[None]
        rows = observe_hypotheses(RULE, rows, BELIEFS, own, np.array([place is not None]), 1.0)
    return rows


def test_nothing_is_remembered_where_no_rule_asks_for_it():
    plain = AssociationRule(0.1, 0.1, 1.0, 0.3, 0.0)
    assert first_observed(plain, np.ones((3, 4)), 6).shape == (3, 0)
    assert observe_hypotheses(
        plain, np.empty((3, 0)), BELIEFS, np.ones((3, 4)), np.ones(3, bool), 1.0
    ).shape == (3, 0)


def test_gap_and_last_detection_are_counted():
    rows = after(0.0, 1.0, None, None)
    assert rows[0, LAST].tolist() == box(1.0).tolist()
    assert (rows[0, GAP], rows[0, COUNT]) == (2.0, 1.0)


def test_the_belief_is_kept_from_the_first_missing_frame_on():
    layout = PartColumns.of(RULE, 6)
    seen = after(0.0, 1.0)
    assert np.isnan(seen[0, layout.mean]).all()
    parted = observe_hypotheses(
        RULE, seen, (np.full((1, 6), 7.0), BELIEFS[1]), np.zeros((1, 4)), np.array([False]), 1.0
    )
    later = observe_hypotheses(
        RULE, parted, (np.full((1, 6), 9.0), BELIEFS[1]), np.zeros((1, 4)), np.array([False]), 1.0
    )
    assert later[0, layout.mean].tolist() == [7.0] * 6
    np.testing.assert_array_equal(later[0, layout.covariance].reshape(6, 6), np.eye(6))


@pytest.mark.parametrize(
    ("places", "origin"),
    [
        ((0.0, 1.0, 2.0, 3.0, 4.0), 2.0),  # three frames back
        ((0.0, 1.0, 2.0, None, 4.0), 2.0),
        ((0.0, 1.0, None, None, None, None), 1.0),  # beyond the window: the last one
    ],
)
def test_directions_start_at_the_earliest_detection_of_the_window(places, origin):
    assert earlier(PartColumns.of(RULE, 6), after(*places))[0, 0] == origin


def test_direction_consistency_by_hand():
    rows = after(0.0, 10.0, 20.0, 30.0)  # heads to the right; the earliest of three frames is at 10
    boxes = np.array([box(40.0), box(10.0, 30.0), box(-20.0)])
    scores = np.array([1.0, 1.0, 0.5])
    found = direction_consistency(RULE, rows, boxes, scores)
    # on ahead: angle 0; straight down: pi / 2; back: pi
    np.testing.assert_allclose(found, [[0.1, 0.0, -0.05]], atol=1e-4)  # arccos near 1 magnifies rounding


def test_a_target_without_a_direction_prefers_none():
    assert direction_consistency(RULE, after(0.0), box(5.0)[None], np.ones(1)).tolist() == [[0.0]]
    assert direction_consistency(RULE, after(0.0, 5.0), box(9.0)[None], np.ones(1)).tolist() == [[0.0]]
