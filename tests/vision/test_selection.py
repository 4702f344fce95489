"""Blobs and non-maximum suppression."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.observation.detector import DetectorParameters
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.detectors.selection import CANDIDATES, BlobParameters, blobs, select

FRAME = Frame(0, 0.0, np.zeros((100, 120, 3), np.uint8))
OPEN = DetectorParameters(min_score=0.0, min_area_px=1, max_area_share=1.0)

numbers = st.floats(-200, 300) | st.sampled_from([float("nan"), float("inf"), -float("inf"), 0.0])


@given(st.lists(st.tuples(numbers, numbers, numbers, numbers, st.floats(0, 1)), max_size=40), st.randoms())
def test_the_chosen_are_the_greedy_ones_in_whatever_order_they_come(rows, random):
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    chosen = select(table[:, :4], table[:, 4], FRAME, OPEN)
    random.shuffle(rows)
    again = np.array(rows, dtype=np.float64).reshape(-1, 5)
    assert np.array_equal(select(again[:, :4], again[:, 4], FRAME, OPEN).boxes, chosen.boxes)
    for k, box in enumerate(chosen.boxes):
        assert (overlap(box, chosen.boxes[:k]) <= OPEN.max_overlap).all()
    # whoever was left out is unfit, or too like a better one, or beyond the count
    for *box, score in rows:
        x, y, w, h = box
        fits = np.isfinite(box).all() and w > 0 and h > 0 and 1 <= w * h <= 12000
        fits = fits and abs(2 * x - 119) < w + 120 and abs(2 * y - 99) < h + 100
        if fits and len(chosen) < OPEN.max_count:
            better = chosen.boxes[chosen.scores >= score]
            assert len(better) and (
                (better == box).all(axis=1).any() or (overlap(np.array(box), better) > OPEN.max_overlap).any()
            )


@pytest.mark.parametrize(
    ("rule", "kept"),
    [
        ({}, [0, 1, 2]),
        ({"min_score": 0.5}, [0]),
        ({"min_area_px": 150}, [0, 2]),
        ({"max_area_share": 0.02}, [0, 1]),
        ({"max_count": 1}, [0]),
    ],
)
def test_each_limit_leaves_out_what_it_says(rule, kept):
    boxes = np.array([[20.0, 20.0, 15.0, 15.0], [60.0, 20.0, 10.0, 10.0], [60.0, 70.0, 20.0, 20.0]])
    found = select(boxes, np.array([0.9, 0.4, 0.3]), FRAME, OPEN.model_copy(update=rule), ["a", "b", "c"])
    assert found.boxes.tolist() == boxes[kept].tolist()
    assert found.labels == tuple("abc"[k] for k in kept)


@pytest.mark.parametrize(("boxes", "scores"), [((2, 5), 2), ((2, 4), 1), ((4,), 4)])
def test_boxes_and_scores_of_other_shapes_are_refused(boxes, scores):
    with pytest.raises(ValueError, match=r"allowed: \(N, 4\), \(N,\)"):
        select(np.ones(boxes), np.ones(scores), FRAME, OPEN)


def test_a_hundred_thousand_boxes_on_top_of_each_other_do_not_hang():
    rng = np.random.default_rng(0)
    boxes = np.column_stack([rng.uniform(0, 100, (100_000, 2)), rng.uniform(5, 9, (100_000, 2))])
    began = time.process_time()
    found = select(boxes, rng.random(100_000), FRAME, OPEN)
    assert len(found) == 32
    assert time.process_time() - began < 60.0  # 0.1 s; all pairs of them would take hours


def blob_parameters(**more):
    return BlobParameters(**{"clean_px": 0, "join_px": 0, "min_area_px": 1, **more})


def test_a_box_has_the_exact_pixels_and_the_score_their_mean_evidence():
    evidence = np.zeros((100, 120), np.uint8)
    evidence[10:14, 20:30] = 255
    evidence[14, 29] = 51  # joined below the corner: the box grows by a row
    boxes, scores = blobs(evidence, 51, blob_parameters())
    assert boxes.tolist() == [[24.5, 12.0, 10.0, 5.0]]
    assert scores[0] == pytest.approx((40 + 0.2) / 50, abs=1e-12)
    assert blobs(evidence, 52, blob_parameters())[0].tolist() == [[24.5, 11.5, 10.0, 4.0]]


def test_corners_do_not_join_and_gaps_do_when_asked():
    evidence = np.zeros((40, 40), np.uint8)
    evidence[5:10, 5:10] = evidence[10:15, 10:15] = 255
    assert len(blobs(evidence, 1, blob_parameters())[0]) == 2
    evidence = np.zeros((40, 40), np.uint8)
    evidence[5:15, 5:10] = evidence[5:15, 14:20] = 255  # a gap of 4
    assert len(blobs(evidence, 1, blob_parameters(join_px=1))[0]) == 2
    assert len(blobs(evidence, 1, blob_parameters(join_px=2))[0]) == 1


def test_thin_lines_vanish_and_squares_of_three_stay():
    evidence = np.zeros((40, 40), np.uint8)
    evidence[5, :] = 255
    evidence[20:23, 20:23] = 255
    assert blobs(evidence, 1, blob_parameters(clean_px=1))[0].tolist() == [[21.0, 21.0, 3.0, 3.0]]


def test_a_checkerboard_gives_no_more_than_the_candidates():
    evidence = (np.indices((480, 640)).sum(axis=0) % 2 * 255).astype(np.uint8)
    assert len(blobs(evidence, 1, blob_parameters())[0]) == CANDIDATES
