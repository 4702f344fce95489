"""The halves of the real sequences, and the figures that are reported of them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.graph.text.load import load_graph

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def frames():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import real_video_frames
        import real_video_halves  # noqa: F401  the script itself: its imports hold

        yield real_video_frames
    finally:
        sys.path.remove(str(BENCHMARKS))


def test_the_coin_splits_each_stratum_and_never_falls_anew(frames):
    coin = sys.modules["real_video_coin"]
    assert coin.toss() == coin.HALVES
    assert set(coin.HALVES["A"]).isdisjoint(coin.HALVES["B"])
    assert {*coin.HALVES["A"], *coin.HALVES["B"]} == {*coin.OLD, *coin.NEW}
    assert [len(set(half) & set(coin.NEW)) for half in coin.HALVES.values()] == [6, 6]
    assert coin.HALVES["A"][:3] == ("Basketball", "Crossing", "Girl")


def test_anchors_begin_where_enough_frames_remain_and_the_target_is_seen(frames):
    """150 frames, 4 starts: 0, 37, 75, and 112 with too few left; at 37 there is no true box."""
    anchors, sequences = sys.modules["real_video_anchors"], sys.modules["sequences"]
    truth = np.arange(600.0).reshape(150, 4)
    truth[37] = np.nan
    one = sequences.Sequence("a", [Path(f"{k}.jpg") for k in range(150)], truth)

    def places(**how):
        return [[int(f.stem) for f in piece.files] for piece in anchors.Anchors(**how).of(one)]

    assert places() == [[*range(150)]]
    assert places(count=4, length=70) == [[*range(70)], [*range(75, 145)]]
    assert places(stride=2, backwards=True, count=3) == [[*range(149, -1, -2)]]
    (piece,) = anchors.Anchors(backwards=True, length=2).of(one)
    assert (piece.name, piece.truth[:, 0].tolist()) == ("a", [596.0, 592.0])
    assert [str(anchors.Anchors(4, 2, True)), str(anchors.Anchors())] == [
        "4 starts, every 2 frames, backwards",
        "",
    ]


@pytest.mark.parametrize("graph", ["general", "deep"])
def test_a_graph_without_its_rules_is_valid(frames, graph):
    name, spec = sys.modules["real_video_halves"].read_graph(f"{graph}:always")
    plates = load_graph(spec).targets.values()
    assert name == f"{graph}:always"
    assert [plate.inference(plate.root).adapt for plate in plates] == [None]


def _made(frames, sequence, iou, score, tracker="one", auc=0.5):
    status = ["tracking" if value > 0.5 else "lost" for value in score]
    found = frames.Frames(iou, score, status, [0.01] * len(iou))
    return frames.Pass(tracker, "g", sequence, 0, auc, auc, 0.0, 2.0, 0.5, 0.9, found)


def test_auroc_weighs_sequences_alike(frames):
    """Good frames of a: .9, .2 and of b: .6; poor ones of a: .3, of b: .3 and .7."""
    passes = [
        _made(frames, "a", [0.8, 0.8, 0.0], [0.9, 0.2, 0.3]),
        _made(frames, "b", [0.8, 0.0, 0.0], [0.6, 0.3, 0.7]),
    ]
    # Pairs above: .9 over .3, .3, .7; .2 over none; .6 over .3, .3; all frames weigh a third.
    assert frames.auroc(passes) == pytest.approx(5 / 9)
    assert frames.share(passes, lambda _, s: s != "tracking", lambda iou: iou > 0.5) == pytest.approx(0.25)


def test_a_difference_names_the_sequence_that_moves_it_most(frames):
    passes = [
        _made(frames, name, [0.8], [0.9], tracker, auc)
        for name, own, other in (("a", 0.9, 0.2), ("b", 0.5, 0.4), ("c", 0.5, 0.6))
        for tracker, auc in (("one", own), ("two", other))
    ]
    label, mean, interval, rest = frames.difference(passes, "one", "two")
    assert (label, mean, rest) == ("one − two", "+0.233", "+0.000 (a)")
    low, high = (float(part) for part in interval.split(" .. "))
    assert np.isclose(low, -0.1, atol=0.07) and np.isclose(high, 0.7, atol=0.1)


def test_a_part_of_each_box_is_replaced_by_the_true_one(frames):
    """A box of 20 x 5 at x = 5, the true one of 20 x 20 at 0: area and aspect are off by a factor of 4."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import real_video_errors
    finally:
        sys.path.remove(str(BENCHMARKS))
    truth = np.array([[0.0, 0.0, 20.0, 20.0], [0.0, 0.0, np.nan, np.nan]])
    boxes = np.array([[5.0, 0.0, 20.0, 5.0], [0.0, 0.0, 1.0, 1.0]])
    parts = real_video_errors.replaced(boxes[:1], truth[:1])
    assert parts["centre"][0].tolist() == [0.0, 0.0, 20.0, 5.0]
    assert parts["size"][0].tolist() == [5.0, 0.0, 20.0, 20.0]
    assert parts["area"][0].tolist() == pytest.approx([5.0, 0.0, 40.0, 10.0])
    assert parts["aspect"][0].tolist() == pytest.approx([5.0, 0.0, 10.0, 10.0])
    found = real_video_errors.aucs(boxes, truth)  # the frame without a target does not count
    assert found["centre; first size"] == pytest.approx(20 / 21)
    assert found["centre"] == pytest.approx(5 / 21)  # IoU 0.25: above 0, .05, .1, .15 and .2
