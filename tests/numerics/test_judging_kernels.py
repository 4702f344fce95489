"""Kernels that judge rows, by hand."""

import numpy as np

from bayesnet_track.numerics.kernels.judging_kernels import append_streaks, count_frames, read_levels

INF, NAN = np.inf, np.nan


def test_too_wide_and_unfit_rows_look_lost():
    ud, fit, scale = np.array([1.0, 9.0, 1.0, 9.0]), np.array([0.5, 0.5, 0.0, 0.0]), np.full(4, 3.0)
    value, lost_value, unfit_value, lost, found = read_levels(ud, fit, scale, 2.0, 0.1)
    assert lost.tolist() == [False, True, True, True] == (~found).tolist()
    assert value.tolist() == [1 / 3, 3.0, 1 / 3, 3.0]
    assert lost_value.tolist() == [1 / 3, 3.0, INF, INF]  # where nothing fits, no level would have kept it
    assert unfit_value.tolist() == [0.5, -INF, 0.0, -INF]


def test_an_unknown_scale_makes_nothing_too_wide():
    value, _, _, lost, _ = read_levels(np.full(2, 9.0), np.ones(2), np.array([NAN, 0.0]), 0.0, 0.1)
    assert value.tolist() == [0.0, 0.0]
    assert not lost.any()


def test_streaks_begin_again_and_values_are_kept():
    counts, values = np.array([2, 5]), np.array([[1.0, 2.0], [3.0, 4.0]])
    new, holds = np.array([7.0, 8.0]), np.array([True, False])
    after, last, others = append_streaks(counts, values, -values, holds, new, -new)
    assert after.tolist() == [3, 0]
    assert last.tolist() == (-others).tolist() == [[2.0, 7.0], [4.0, 8.0]]
    assert values.tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_frames_are_counted_since_birth_while_lost_and_while_unseen():
    before = np.array([-1, 4, 4, 4]), np.array([0, 0, 2, 3]), np.array([0, 5, 6, 7])
    is_lost, lost_count = np.array([False, False, True, False]), np.array([0, 1, 3, 0])
    since, lost, unseen, known = count_frames(before, is_lost, lost_count, 9)
    assert since.tolist() == [9, 4, 4, 4]
    assert lost.tolist() == [0, 0, 3, 0]
    assert unseen.tolist() == [1, 6, 7, 8]
    assert known.tolist() == [True, False, False, True]
