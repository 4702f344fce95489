"""Kernels that judge rows, by hand."""

import numpy as np

from bayesnet_track.numerics.kernels.judging_kernels import count_frames, extend_streaks


def test_streaks_begin_again_are_kept_and_remember_values():
    counts, values = np.array([[2, 5, 3]]), np.array([[[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]])
    holds, new, keeps = np.array([[True, False, True]]), np.array([[7.0, 8.0, 9.0]]), np.zeros((1, 3), bool)
    keeps[0, 2] = True
    after, last = extend_streaks(counts, values, holds, new, keeps)
    assert after.tolist() == [[3, 0, 3]]
    assert last[0, 0].tolist() == [2.0, 7.0] and last[0, 2].tolist() == [5.0, 6.0]
    assert counts.tolist() == [[2, 5, 3]] and values[0, 0].tolist() == [1.0, 2.0]


def test_frames_are_counted_since_birth_while_lost_and_while_unseen():
    before = np.array([-1, 4, 4, 4]), np.array([0, 0, 2, 3]), np.array([0, 5, 6, 7])
    is_lost, lost_count = np.array([False, False, True, False]), np.array([0, 1, 3, 0])
    since, lost, unseen, known = count_frames(before, is_lost, lost_count, 9)
    assert since.tolist() == [9, 4, 4, 4]
    assert lost.tolist() == [0, 0, 3, 0]
    assert unseen.tolist() == [1, 6, 7, 8]
    assert known.tolist() == [True, False, False, True]
