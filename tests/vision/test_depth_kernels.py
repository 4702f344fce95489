"""The features of boxes against NumPy, where every pixel is a sample."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.kernels.blob_kernels import (
    DEPTH,
    FEATURES,
    HEIGHT,
    SHARE,
    SPREAD,
    WIDTH,
    blob_features,
)

LAYER = float(np.log(1.12)) / 3


def features(points, boxes, cells=12, origin=(0, 0)):
    found = np.full((len(boxes), FEATURES), 7.0)
    blob_features(for_reading(points), np.array(boxes, float), np.array(origin), cells, LAYER, found)
    return found


def plane(depth, rows=24, columns=24, focal=100.0):
    """Points of a picture whose pixels all have this depth (an array, or one number)."""
    z = np.broadcast_to(np.asarray(depth, np.float32), (rows, columns))
    y, x = np.mgrid[:rows, :columns]
    return np.stack([x / focal * z, y / focal * z, z], axis=-1).astype(np.float32)


def test_a_box_full_of_one_depth():
    """12 samples over 12 pixels: each pixel once, so that the box's size comes back exactly."""
    (one,) = features(plane(2.0), [(11.5, 11.5, 12, 12)])
    assert one[[SHARE, DEPTH, SPREAD]].tolist() == [1.0, 2.0, 0.0]
    assert one[[WIDTH, HEIGHT]] == pytest.approx(12 / 100 * 2.0, rel=1e-5)


def test_the_fullest_layer_is_the_blob():
    depth = np.full((24, 24), 6.0)
    depth[4:20, 8:16] = 3.0
    depth[:, 12:] = np.where(depth[:, 12:] == 3.0, 3.05, np.nan)  # one layer with the other half
    (one,) = features(plane(depth), [(11.5, 11.5, 12, 12)])
    # the box spans columns and rows 6..17: 4 columns of 3 m and 4 of 3.05 m, 2 columns of 6 m, 2 of nothing
    assert one[SHARE] == pytest.approx(8 / 12)
    assert one[DEPTH] == pytest.approx(3.025, rel=1e-5)
    valid = np.repeat([3.0, 3.05, 6.0], [48, 48, 24])
    assert one[SPREAD] == pytest.approx(valid.std(), rel=1e-4)


@pytest.mark.parametrize("points", [plane(np.nan), plane(0.0), plane(-1.0), plane(1e6)])
def test_no_valid_point_no_blob(points):
    assert (features(points, [(11.5, 11.5, 12, 12)]) == 0).all()


def test_what_lies_outside_counts_as_missing():
    inside, half, out = features(plane(2.0), [(11.5, 11.5, 12, 12), (-0.5, 11.5, 12, 12), (-30, 5, 9, 9)])
    assert (inside[SHARE], half[SHARE], out[SHARE]) == (1.0, 0.5, 0.0)


def test_the_crop_does_not_matter():
    points = plane(np.random.default_rng(0).uniform(2, 3, (24, 24)))
    boxes = [(10.3, 11.2, 8.0, 6.5), (12, 12, 3, 3)]
    np.testing.assert_array_equal(
        features(points, boxes), features(np.ascontiguousarray(points[5:20, 4:22]), boxes, origin=(4, 5))
    )


@given(seed=st.integers(0, 2**32 - 1))
def test_order_and_company_change_nothing_and_shares_are_shares(seed):
    rng = np.random.default_rng(seed)
    depth = np.where(rng.random((24, 24)) < 0.7, rng.choice([1.0, 2.0, 9.0], (24, 24)), np.nan)
    boxes = np.column_stack([rng.uniform(-5, 30, (9, 2)), rng.uniform(0.1, 40, (9, 2))])
    found = features(plane(depth), boxes)
    np.testing.assert_array_equal(found[::-1], features(plane(depth), boxes[::-1]))
    assert np.isfinite(found).all() and (found >= 0).all() and (found[:, SHARE] <= 1).all()
    held = found[:, SHARE] > 0
    assert np.isin(np.round(found[held, DEPTH], 5), [1.0, 2.0, 9.0]).all()
