"""References of many targets as arrays."""

import numpy as np
import pytest

from bayesnet_track.observation.likelihoods import ReferenceRows, column


def reference(value, size=2):
    return {"shares": np.full(size, value), "alpha": np.array(value)}


def test_rows_are_the_references_for_reading():
    several = [reference(0.1), reference(0.2), reference(0.3)]
    rows = ReferenceRows.of(several)
    assert isinstance(rows, ReferenceRows) and ReferenceRows.of(rows) is rows
    assert [one["shares"].tolist() for one in rows] == [one["shares"].tolist() for one in several]
    assert rows[-1]["alpha"].shape == () and float(rows[1:][0]["alpha"]) == 0.2
    with pytest.raises(ValueError, match="read-only"):
        rows[0]["shares"][0] = 9.0
    with pytest.raises(IndexError):
        rows[3]
    assert column(rows, "alpha").tolist() == column(several, "alpha").tolist() == [0.1, 0.2, 0.3]
    assert column(rows, "other", 1.0).tolist() == [1.0] * 3


def test_references_of_different_kinds_stay_as_they_are():
    for other in (reference(0.2, 3), {"alpha": np.array(1.0)}, {**reference(1), "alpha": np.array(1)}):
        several = [reference(0.1), other]
        assert ReferenceRows.of(several) is several
    assert ReferenceRows.of([]) == []


def test_rows_are_taken_replaced_and_extended():
    rows, others = ReferenceRows.of([reference(0.1), reference(0.2)]), ReferenceRows.of([reference(0.3)])
    assert column(rows.take(np.array([1])), "alpha").tolist() == [0.2]
    assert column(rows.replaced(np.array([0]), others), "alpha").tolist() == [0.3, 0.2]
    assert column(rows.extended(others), "alpha").tolist() == [0.1, 0.2, 0.3]
    assert column(rows, "alpha").tolist() == [0.1, 0.2]
    unlike = ReferenceRows.of([reference(0.3, 5)])
    assert rows.replaced(np.array([0]), unlike) is None and rows.extended(unlike) is None
    assert rows.extended([reference(0.3)]) is None


def test_a_row_of_one_target_holds_no_larger_array():
    plane = np.arange(100.0).reshape(10, 10)
    rows = ReferenceRows.of([{"crop": plane[2:4], "whole": plane}])
    assert rows.columns["crop"].base is None
    assert np.shares_memory(rows.columns["whole"], plane)
    np.testing.assert_array_equal(rows[0]["crop"], plane[2:4])
