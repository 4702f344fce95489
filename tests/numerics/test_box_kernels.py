"""Boxes in a crop by counting pixels one by one, and suppression by comparing all pairs."""

import numpy as np

from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.numerics.kernels.box_kernels import keep_best, pixels_of_boxes


def covered(centre, side, first, extent):
    """Cells of the frame that lie in one axis of a box, and those of them in the crop."""
    cells = [cell for cell in range(-200, 200) if centre - side / 2 <= cell < centre + side / 2]
    cells = cells or [int(np.floor(centre + 0.5))]
    return cells, [cell - first for cell in cells if 0 <= cell - first < extent]


def test_pixels_are_those_whose_centres_lie_inside():
    rng = np.random.default_rng(5)
    boxes = np.column_stack([rng.uniform(-20, 60, (200, 2)), rng.uniform(0.1, 30, (200, 2))])
    corners, visible, nominal = pixels_of_boxes(boxes, 4, -3, 30, 25)
    for n, (x, y, w, h) in enumerate(boxes):
        (all_columns, columns), (all_rows, rows) = covered(x, w, 4, 30), covered(y, h, -3, 25)
        assert nominal[n] == len(all_columns) * len(all_rows) and visible[n] == len(columns) * len(rows)
        for axis, cells in ((0, columns), (1, rows)):
            if cells:
                assert (corners[n, axis], corners[n, 2 + axis]) == (cells[0], cells[-1] + 1)
    assert 0 < (visible == 0).sum() < 200 and (visible < nominal).any()


def test_a_box_that_is_no_number_leaves_no_index_outside():
    corners, visible, _ = pixels_of_boxes(np.full((1, 4), np.nan), 0, 0, 30, 25)
    assert corners.min() >= 0 and (corners <= [30, 25, 30, 25]).all() and visible[0] <= 1


def test_the_best_of_those_alike_are_kept():
    rng = np.random.default_rng(6)
    boxes = np.column_stack([rng.uniform(0, 40, (60, 2)), rng.uniform(5, 20, (60, 2))])
    expected: list[int] = []
    for n, box in enumerate(boxes):
        if all(overlap(boxes[k][None], box[None])[0] <= 0.3 for k in expected):
            expected.append(n)
    assert keep_best(boxes, 0.3, 60).tolist() == expected and len(expected) < 60
    assert keep_best(boxes, 0.3, 4).tolist() == expected[:4]
