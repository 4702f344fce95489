"""Precision, recall and F of long-term tracking, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.evaluate.scores import Confident, LongTerm, long_term, score_pass


def seen(iou, confidence, present):
    return Confident(
        np.array(iou, dtype=float), np.array(confidence, dtype=float), np.array(present, dtype=bool)
    )


def test_one_sequence_by_hand():
    one = seen([1.0, 0.5, 0.0, 0.0], [0.9, 0.6, 0.4, 0.1], [True, True, True, False])
    # At 0.9: 1 and 1/3, F 1/2. At 0.6: 3/4 and 1/2, F 3/5. At 0.4: 1/2 and 1/2. At 0.1: 3/8 and 1/2.
    found = long_term([one])
    assert found == LongTerm(0.75, 0.5, pytest.approx(0.6), 0.6)


def test_reporting_an_absent_target_costs_precision_only():
    held = seen([1.0, 0.0], [0.9, 0.2], [True, False])
    sure = seen([1.0, 0.0], [0.9, 0.9], [True, False])
    assert long_term([held]) == LongTerm(1.0, 1.0, 1.0, 0.9)
    assert long_term([sure]) == LongTerm(0.5, 1.0, pytest.approx(2 / 3), 0.9)


def test_sequences_count_alike_and_a_silent_one_has_no_precision():
    short, long = seen([1.0], [0.9], [True]), seen([0.5] * 4, [0.3] * 4, [True] * 4)
    # At 0.9 only the first reports: precision 1, recall 1/2. At 0.3: 3/4 and 3/4.
    assert long_term([short, long]) == LongTerm(0.75, 0.75, 0.75, 0.3)


def test_of_equal_f_the_highest_threshold_is_named_and_nothing_to_find_has_no_figure():
    assert long_term([seen([0.0, 0.0], [0.4, 0.8], [True, True])]) == LongTerm(0.0, 0.0, 0.0, 0.8)
    assert long_term([seen([0.0], [0.4], [False])]) is None
    assert long_term([]) is None


def test_score_has_the_figures_where_the_target_is_absent_in_some_frames():
    box, gone = [10.0, 10.0, 20.0, 20.0], [np.nan] * 4
    plain = score_pass([box] * 4, [False] * 4, [box] * 4, confidence=[1.0, 0.9, 0.9, 0.1])
    assert plain.long_f is None and "long_" not in plain.text(explained=True)
    found = score_pass([box] * 4, [False] * 4, [box, box, gone, box], confidence=[1.0, 0.9, 0.2, 0.8])
    assert (found.long_precision, found.long_recall, found.long_f, found.long_f_at) == (1.0, 1.0, 1.0, 0.8)
    assert "long_f         1\n" in found.text()
