"""The strata of the real sequences, and the figures that are reported of them."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from bayesnet_track import load_graph

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark():
    """The modules of the benchmark: sequences, passes, and tables."""
    before = set(sys.modules)
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import real_video
        import real_video_whole
        import sequences

        yield SimpleNamespace(sets=sequences, passes=real_video, tables=real_video_whole)
    finally:
        sys.path.remove(str(BENCHMARKS))
        for name in {"real_video", "real_video_whole", "sequences", "measuring"} - before:
            sys.modules.pop(name, None)


def test_the_coin_splits_each_stratum_and_never_falls_anew(benchmark):
    sets = benchmark.sets
    assert sets.toss() == sets.HALVES
    assert set(sets.HALVES["A"]).isdisjoint(sets.HALVES["B"])
    assert {*sets.HALVES["A"], *sets.HALVES["B"]} == {*sets.OLD, *sets.NEW}
    assert [len(set(half) & set(sets.NEW)) for half in sets.HALVES.values()] == [6, 6]
    assert sets.HALVES["A"][:3] == ("Basketball", "Crossing", "Girl")


@pytest.mark.parametrize("graph", ["general", "deep"])
def test_a_graph_without_its_rules_is_valid(benchmark, graph):
    name, spec = benchmark.passes.read_graph(f"{graph}:always")
    plates = load_graph(spec).targets.values()
    assert name == f"{graph}:always"
    assert [plate.inference(plate.root).adapt for plate in plates] == [None]


def _made(benchmark, sequence, iou, score, tracker="one", auc=0.5):
    status = ["tracking" if value > 0.5 else "lost" for value in score]
    found = benchmark.passes.Frames(iou, score, status, [0.01] * len(iou))
    return benchmark.passes.Pass(tracker, "g", sequence, 0, auc, auc, 0.0, 2.0, 0.5, 0.9, found)


def test_auroc_weighs_sequences_alike(benchmark):
    """Good frames of a: .9, .2 and of b: .6; poor ones of a: .3, of b: .3 and .7."""
    passes = [
        _made(benchmark, "a", [0.8, 0.8, 0.0], [0.9, 0.2, 0.3]),
        _made(benchmark, "b", [0.8, 0.0, 0.0], [0.6, 0.3, 0.7]),
    ]
    # Pairs above: .9 over .3, .3, .7; .2 over none; .6 over .3, .3; all frames weigh a third.
    assert benchmark.tables.auroc(passes) == pytest.approx(5 / 9)
    assert benchmark.tables.share(
        passes, lambda _, s: s != "tracking", lambda iou: iou > 0.5
    ) == pytest.approx(0.25)


def test_calibration_error_weighs_sequences_alike(benchmark):
    """Of the bin at .9 (weights 1/4 of a, 1/2 of b) 1/4 of 3/4 is good; that at .2 (1/4) is good alone."""
    passes = [
        _made(benchmark, "a", [0.8, 0.8], [0.9, 0.2]),
        _made(benchmark, "b", [0.1], [0.9]),
    ]
    assert benchmark.tables.calibration_error(passes) == pytest.approx((0.675 - 0.25) + (0.25 - 0.05))


def test_the_tables_give_each_stratum_and_the_differences_in_it(benchmark):
    aucs = {"a": (0.9, 0.2), "b": (0.5, 0.4), "c": (0.5, 0.6)}
    passes = [
        _made(benchmark, name, [0.8, 0.0], [0.9, 0.1], tracker, auc)
        for name, of_each in aucs.items()
        for tracker, auc in zip(("one", "two"), of_each, strict=True)
    ]
    strata = {"first": ("a", "b"), "second": ("c",), "empty": ("d",)}
    first, of_first, second, _, differences, each = benchmark.tables.report(passes, strata)
    assert "| one | 1.000 | 0.000 | 0.0000 | 0.0000 | 0.000 | 0.100 | 0.50, 0.50 to 0.50 | 0.90" in of_first
    assert first.startswith("first: 2 sequences\n") and "| one | 0.700 |" in first
    assert second.startswith("second: 1 sequences\n") and "| two | 0.600 |" in second
    assert "+0.400 [+0.100, +0.700], ahead on 2 of 2" in differences
    assert "-0.100 [-0.100, -0.100], ahead on 0 of 1" in differences
    assert "| b | first | 0.500 | 0.400 |" in each
