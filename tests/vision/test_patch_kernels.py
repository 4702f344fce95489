"""Moments of a patch are the weighted sums over its cells, within the frame and over its edge."""

import numpy as np
import pytest

from bayesnet_track.vision.kernels.patch_kernels import edge_units, patch_moments, patch_projections

GRAY = np.random.default_rng(0).integers(0, 256, (12, 16)).astype(float)
FRAME = np.array([16, 12])
BOXES = [
    (8.0, 6.0, 6.0, 6.0),
    (7.5, 5.5, 3.0, 9.0),
    (0.5, 5.5, 6.0, 6.0),  # over the left edge
    (14.0, 10.5, 6.0, 6.0),  # over the lower right corner
    (40.0, 6.0, 6.0, 6.0),  # outside
    (8.0, 6.0, 0.001, 6.0),  # too narrow
    (np.nan, 6.0, 6.0, 6.0),
]


def cells_of(box, cells):
    """Means of the cells inside the frame and the share of each that lies in it, by pixels' overlaps."""
    x, y, w, h = box
    means, shares = np.zeros((cells, cells)), np.zeros((cells, cells))
    for j in range(cells):
        for i in range(cells):
            left, top = x - w / 2 + 0.5 + w * i / cells, y - h / 2 + 0.5 + h * j / cells
            across = np.clip(
                np.minimum(np.arange(16) + 1, left + w / cells) - np.maximum(np.arange(16), left), 0, 1
            )
            down = np.clip(
                np.minimum(np.arange(12) + 1, top + h / cells) - np.maximum(np.arange(12), top), 0, 1
            )
            area = down.sum() * across.sum()
            means[j, i] = down @ GRAY @ across / area if area > 0 else 0.0
            shares[j, i] = area / (w * h / cells**2)
    return means, shares


def integral_of(x0, y0):
    integral = np.zeros((12 - y0 + 1, 16 - x0 + 1))
    integral[1:, 1:] = GRAY[y0:, x0:].cumsum(0).cumsum(1)
    return integral


@pytest.mark.parametrize("box", BOXES)
def test_moments_are_weighted_sums(box):
    rng = np.random.default_rng(1)
    reference, weights = rng.uniform(0, 255, (3, 3)), rng.random((3, 3))
    expected = np.zeros(6)
    if 0 < box[0] < 20 and box[2] > 0.1:
        v, shares = cells_of(box, 3)
        w, r = weights * shares, reference
        expected = np.array([(w * part).sum() for part in (np.ones((3, 3)), r, v, r * r, r * v, v * v)])
    for origin in ((0, 0), (4, 1)):
        if origin != (0, 0) and not box[0] > 5:
            continue  # the crop covers the box
        found = np.full((1, 6), np.nan)
        patch_moments(
            integral_of(*origin), np.array([box]), np.array(origin), FRAME, reference, weights, found
        )
        np.testing.assert_allclose(found[0], expected, rtol=1e-9)


@pytest.mark.parametrize("box", BOXES)
def test_projections_are_weighted_sums_of_products(box):
    rng = np.random.default_rng(2)
    line, polynomials = rng.random(3), rng.normal(size=(3, 3))
    expected = np.zeros(6)
    if 0 < box[0] < 20 and box[2] > 0.1:
        v, shares = cells_of(box, 3)
        w = shares * np.outer(line, line)
        off = w * (v - (w * v).sum() / w.sum())
        powers = [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
        expected = np.array([w.sum(), *(polynomials[b] @ off @ polynomials[a] for a, b in powers)])
    found = np.full((1, 6), np.nan)
    patch_projections(integral_of(0, 0), np.array([box]), np.zeros(2, int), FRAME, line, polynomials, found)
    np.testing.assert_allclose(found[0], expected, rtol=1e-9, atol=1e-9)


def test_edges_in_steps_of_a_pixel():
    units, spans = np.zeros(4, np.int64), np.zeros(3, np.int64)
    assert edge_units(2.0, 3.0, 1, 10, units, spans) == 3072
    assert units.tolist() == [1024, 2048, 3072, 4096] and spans.tolist() == [1024] * 3
    assert edge_units(-1.0, 3.0, 0, 10, units, spans) == 3072
    assert units.tolist() == [0, 0, 1024, 2048] and spans.tolist() == [1024] * 3
    assert edge_units(8.5, 3.0, 2, 10, units, spans) == 3072
    assert units.tolist() == [6656, 7680, 8192, 8192] and spans.tolist() == [1024] * 3
    assert edge_units(1.0, 1.0, 0, 10, units, spans) == 1024  # not a multiple of 3: rounded
    assert units.tolist() == [1024, 1365, 1707, 2048] and spans.tolist() == [341, 342, 341]


@pytest.mark.parametrize(
    ("low", "size", "fits"),
    [
        (0.0, 3 / 1024, True),
        (0.0, 2 / 1024, False),
        (10.0, 3.0, False),
        (9.99, 3.0, True),
        (-3.0, 3.0, False),
        (-2.99, 3.0, True),
        (-43.9, 80.0, True),
        (-44.0, 80.0, False),  # 4 frames and 4 px off
        (-40.0, 87.9, True),
        (-40.0, 88.0, False),
        (1.0, 0.0, False),
        (np.inf, 3.0, False),
        (1.0, np.nan, False),
    ],
)
def test_what_can_be_sampled(low, size, fits):
    units, spans = np.zeros(4, np.int64), np.zeros(3, np.int64)
    assert (edge_units(low, size, 0, 10, units, spans) > 0) == fits


def test_a_box_that_cannot_be_seen_does_not_keep_the_next_from_being_seen():
    """Outside on one axis alone, too narrow, not finite: rows of 0; the others are as by themselves."""
    rng = np.random.default_rng(2)
    line, polynomials = rng.random(3), rng.normal(size=(3, 3))
    good = (8.0, 6.0, 6.0, 6.0)
    bad = [(40.0, 6.0, 6.0, 6.0), (8.0, 40.0, 6.0, 6.0), (8.0, 6.0, 0.001, 6.0), (8.0, np.inf, 6.0, 6.0)]

    def projected(boxes):
        found = np.full((len(boxes), 6), np.nan)
        patch_projections(
            integral_of(0, 0), np.array(boxes), np.zeros(2, int), FRAME, line, polynomials, found
        )
        return found

    (alone,) = projected([good])
    found = projected([good, *bad, good, (7.5, 5.5, 3.0, 9.0), good])
    np.testing.assert_array_equal(found[1:5], 0.0)
    for row in (0, 5, 7):
        np.testing.assert_array_equal(found[row], alone)
    assert alone[0] > 0 and (found[6, 1:] != alone[1:]).all()


def test_a_patch_without_weight_has_no_projections():
    found = np.full((1, 6), np.nan)
    boxes, nothing = np.array([(8.0, 6.0, 6.0, 6.0)]), np.zeros(3)
    patch_projections(integral_of(0, 0), boxes, np.zeros(2, int), FRAME, nothing, np.ones((3, 3)), found)
    np.testing.assert_array_equal(found, 0.0)
