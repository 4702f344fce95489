"""Detections shared out by overlap, in passes: cases by hand, and the sparse form against the full."""

from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track.adapt.association import (
    UNASSIGNED,
    assign_total,
    first_observed,
    observe_hypotheses,
    share_by_overlap,
    share_in_passes,
)
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.observation.cue import AssociationRule

RULE = AssociationRule(0.1, 0.1, 1.0, 0.3, 0.0, similarity="iou")
NONE = np.empty((2, 0))


def boxes(*places):
    return np.array([[x, 0.0, 10.0, 20.0] for x in places])


def shared(rule, expected, found, scores, observed=None):
    remembered = np.empty((len(expected), 0)) if observed is None else observed
    return share_by_overlap(rule, expected, remembered, found, np.array(scores)).tolist()


def test_a_detection_of_low_score_waits_for_the_second_pass():
    expected, found = boxes(0.0, 30.0), boxes(0.0, 1.0, 29.0)
    # In one pass the first target takes what fits best, whatever its score.
    assert shared(RULE, expected, found, [0.2, 0.9, 0.3]) == [0, 2]
    by_score = replace(RULE, first_score=0.6)
    assert shared(by_score, expected, found, [0.2, 0.9, 0.3]) == [1, 2]


def test_the_second_pass_takes_nothing_from_the_first():
    by_score = replace(RULE, first_score=0.6)
    assert shared(by_score, boxes(0.0), boxes(4.0, 0.0), [0.9, 0.5]) == [0]


def test_what_overlaps_too_little_is_rejected_in_every_pass():
    by_score = replace(RULE, first_score=0.6)
    # 6 px of 10 apart: 4 / 16 = .25 of both
    assert shared(by_score, boxes(0.0), boxes(6.0), [0.9]) == [UNASSIGNED]
    assert shared(by_score, boxes(0.0), boxes(6.0), [0.1]) == [UNASSIGNED]


def test_a_target_left_is_found_by_its_last_detection():
    rule = replace(RULE, recover=True)
    # The filter ran on to 40 while the target stood still at 0.
    observed = first_observed(rule, boxes(0.0), 8)
    assert shared(rule, boxes(40.0), boxes(1.0), [0.9], observed) == [0]
    assert shared(RULE, boxes(40.0), boxes(1.0), [0.9]) == [UNASSIGNED]


def test_direction_decides_between_two_that_overlap_alike():
    rule = replace(RULE, direction=0.2)
    # Both are expected as near to either detection; one comes from the left, one from the right.
    expected, found = boxes(0.0, 0.0), boxes(-3.0, 3.0)
    rows = first_observed(rule, boxes(-20.0, 20.0), 8)
    for ways in ((-10.0, 10.0), (-1.0, 1.0)):
        rows = observe_hypotheses(
            rule, rows, (np.zeros((2, 8)), np.zeros((2, 8, 8))), boxes(*ways), np.ones(2, bool), 1.0
        )
    assert shared(rule, expected, found, [0.9, 0.9], rows) == [1, 0]
    assert shared(rule, expected, found, [0.9, 0.9], rows[::-1]) == [0, 1]


@pytest.mark.parametrize("seed", range(5))
def test_groups_give_the_total_of_the_full_assignment(seed):
    rng = np.random.default_rng(seed)
    expected, found = (
        np.column_stack([rng.uniform(0, 200, (n, 2)), rng.uniform(10, 60, (n, 2))]) for n in (40, 50)
    )
    common = overlap(expected[:, None], found[None])
    full = assign_total(common, (common > 0) & (common >= 0.3))
    assert shared(RULE, expected, found, np.ones(50)) == full.tolist()


def test_no_detections_and_no_targets_are_no_pairs():
    assert shared(RULE, boxes(0.0), np.empty((0, 4)), []) == [UNASSIGNED]
    assert shared(RULE, np.empty((0, 4)), boxes(0.0), [0.9]) == []
    assert share_in_passes(RULE, np.empty(0), 2, lambda *_: pytest.fail("nothing to ask")).tolist() == [
        UNASSIGNED,
        UNASSIGNED,
    ]
