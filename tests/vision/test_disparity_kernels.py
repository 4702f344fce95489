"""Correlation along rows against the formula written out; smooth regions against SciPy's labels."""

import numpy as np
import pytest
from scipy import ndimage

from bayesnet_track.vision.kernels.disparity_kernels import LARGEST, correlate, label_regions

HALF = 3


def matched(left, right, low, high, rows=None, columns=None, filters=(0.0, -1.0, 0.0, 0)):
    height, width = left.shape
    rows, columns = rows or (0, height), columns or (0, width)
    found = np.empty((rows[1] - rows[0], columns[1] - columns[0]), np.float32)
    correlate(left, right, rows, columns, HALF, low, high, *filters, found)
    return found


def by_formula(left, right, y, x, d):
    """Thesis eq. 3.5, or None where a window leaves the picture or is flat."""
    height, width = left.shape
    if not (HALF <= y < height - HALF and HALF <= x < width - HALF and HALF <= x - d < width - HALF):
        return None
    one = left[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1].astype(float)
    other = right[y - HALF : y + HALF + 1, x - d - HALF : x - d + HALF + 1].astype(float)
    n = one.size
    below = n**2 * one.std() * other.std()
    return None if below == 0 else (n * (one * other).sum() - one.sum() * other.sum()) / below


def noise(shape, seed=0, top=200):
    return np.random.default_rng(seed).integers(-top, top + 1, shape).astype(np.int16)


def shifted(left, d, seed=1):
    """A right picture whose columns are those of the left one, d to the right."""
    right = noise(left.shape, seed)
    right[:, : left.shape[1] - d] = left[:, d:]
    return right


def test_the_best_match_is_that_of_the_formula():
    rng = np.random.default_rng(2)
    left = noise((16, 40))
    right = (shifted(left, 4) + rng.integers(-150, 151, left.shape)).astype(np.int16)
    low, high = 1, 9
    found = matched(left, right, low, high)
    for y in range(16):
        for x in range(40):
            scores = {d: by_formula(left, right, y, x, d) for d in range(low - 1, high + 2)}
            held = {d: score for d, score in scores.items() if score is not None}
            best = max(held, key=held.get) if held else None
            if best is None or best in (low - 1, high + 1):
                assert np.isnan(found[y, x])
                continue
            around = [scores[best + k] for k in (-1, 0, 1)]
            expected = float(best)
            if None not in around:
                a, b, c = around
                expected += 0.5 * (a - c) / (a - 2 * b + c)
            assert found[y, x] == pytest.approx(expected, abs=2e-4)


def test_the_largest_values_do_not_overflow():
    rng = np.random.default_rng(0)
    left = (LARGEST * rng.choice([-1, 1], (40, 60))).astype(np.int16)
    found = np.empty(left.shape, np.float32)
    correlate(left, shifted(left, 5), (0, 40), (0, 60), 10, 0, 9, 0.0, 0.9, 0.0, 0, found)
    assert np.nanmax(np.abs(found - 5)) < 0.3 and np.isfinite(found).sum() == 20 * (60 - 25)


def test_a_part_is_the_part_of_the_whole():
    left = noise((30, 70))
    right = shifted(left, 6)
    whole = matched(left, right, 2, 12)
    np.testing.assert_array_equal(matched(left, right, 2, 12, (7, 19), (21, 44)), whole[7:19, 21:44])


def test_flat_windows_match_nothing():
    flat = np.full((20, 40), 7, np.int16)
    assert np.isnan(matched(flat, flat, 0, 8)).all()
    assert np.isnan(matched(noise((20, 40)), flat, 0, 8)).all()


def test_each_filter_takes_out_what_it_is_for():
    left = noise((20, 60))
    right = shifted(left, 5)
    assert np.nanmax(np.abs(matched(left, right, 0, 9) - 5)[:, 12:-4]) < 0.5
    sd = left.std()
    assert np.isnan(matched(left, right, 0, 9, filters=(1.5 * sd, -1.0, 0.0, 0))).all()
    assert np.isnan(matched(left, noise((20, 60), 9), 0, 9, filters=(0.0, 0.9, 0.0, 0))).all()
    stripes = np.tile(noise((20, 6), 4), (1, 10))  # the same again every 6 columns
    assert np.isfinite(matched(stripes, stripes, 0, 15)).any()
    assert np.isnan(matched(stripes, stripes, 0, 15, filters=(0.0, -1.0, 0.1, 2)))[:, 25:].all()
    # peaks that are not further apart than the separation are those of one surface
    assert np.isfinite(matched(stripes, stripes, 0, 15, filters=(0.0, -1.0, 0.1, 20)))[3:-3, 25:-4].all()


def test_a_rival_is_another_peak_that_is_nearly_as_high_and_far_off():
    """Against the definition, where the picture matches at two shifts; ties within rounding are left out."""
    least, apart, low, high = 0.4, 2, 1, 12
    left = noise((12, 44))
    right = (0.55 * shifted(left, 3, 4) + 0.45 * shifted(left, 9, 5)).astype(np.int16)
    found = matched(left, right, low, high, filters=(0.0, -1.0, least, apart))
    whole = matched(left, right, low, high)
    seen = []
    for y, x in np.argwhere(np.isfinite(whole)):
        scores = {d: by_formula(left, right, y, x, d) for d in range(low - 1, high + 2)}
        scores = {d: np.nan if score is None else score for d, score in scores.items()}
        best = max(scores, key=lambda d: np.nan_to_num(scores[d], nan=-2.0))
        limit = (1 - least) * scores[best]
        far = [d for d in range(low, high + 1) if abs(d - best) > apart]
        peaks = [d for d in far if not (scores[d - 1] > scores[d] or scores[d + 1] > scores[d])]
        if all(abs(scores[d] - limit) > 1e-5 for d in peaks if scores[d] == scores[d]):
            seen.append(any(scores[d] > limit for d in peaks))
            assert np.isnan(found[y, x]) == seen[-1], (y, x)
    assert 20 < sum(seen) < len(seen) - 20


def test_a_match_beyond_the_range_is_none():
    left = noise((20, 60))
    right = shifted(left, 12)
    near = matched(left, right, 0, 11, filters=(0.0, 0.8, 0.0, 0))
    assert np.isnan(near).all()


@pytest.mark.parametrize("least", [1, 4, 9])
def test_regions_are_those_of_scipy_where_depth_is_the_same(least):
    rng = np.random.default_rng(least)
    depth = np.where(rng.random((40, 50)) < 0.6, 2.0, np.nan).astype(np.float32)
    labels = np.empty(depth.shape, np.int32)
    found = label_regions(depth, 0.05, least, labels)
    reference, count = ndimage.label(np.isfinite(depth))
    sizes = ndimage.sum_labels(np.ones_like(reference), reference, np.arange(count + 1))
    kept = sizes[reference] >= least
    assert found == (sizes[1:] >= least).sum() == labels.max()
    np.testing.assert_array_equal(labels > 0, kept & (reference > 0))
    pairs = {(a, b) for a, b in zip(labels[labels > 0], reference[labels > 0], strict=True)}
    assert len(pairs) == found


def test_a_step_in_depth_parts_regions_and_a_slope_does_not():
    slope = np.linspace(2.0, 4.0, 60, dtype=np.float32)[None].repeat(5, 0)
    labels = np.empty(slope.shape, np.int32)
    assert label_regions(slope, 0.05, 1, labels) == 1
    slope[:, 30:] += 1.0
    assert label_regions(slope, 0.05, 1, labels) == 2
    assert (labels[:, :30] == 1).all() and (labels[:, 30:] == 2).all()
