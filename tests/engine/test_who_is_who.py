"""The stage of identities: doubt where targets cannot be told apart, none where they can, in every output."""

from __future__ import annotations

import csv
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml

from bayesnet_track import DetectionsTracker, load_graph, open_run, track
from bayesnet_track.engine.compiled import compile_graph
from bayesnet_track.engine.step import compile_stages
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graphs import find_graph
from bayesnet_track.journal.events.statuses import IdentityDoubtful
from bayesnet_track.journal.frame_columns import columns_of, lines_of
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.runtime.checkpoints.state_codec import decode_state, encode_state
from bayesnet_track.runtime.smoothing import EXCHANGE, settle_identities, smooth


def with_identity(name: str = "kalman_detections", **keys: object) -> CheckedGraph:
    graph = yaml.safe_load(find_graph(name).read_text(encoding="utf-8"))
    for plate in graph["targets"].values():
        plate["identity"] = keys
    return check_graph(graph)


def ways(gap: tuple[int, int] | None, slope: float, count: int = 2) -> list[Floats]:
    """Detections (M, 4) of targets that cross in frame 30; in a gap all are one box, or none."""
    rng, frames = np.random.default_rng(2), []
    for step in range(60):
        x = 150.0 + 5.0 * step
        lines = [(x, 240.0 + k * slope * (step - 30)) for k in np.linspace(-1, 1, count)]
        boxes = np.array([[a, b, 30.0, 60.0] for a, b in lines]) + rng.normal(0, 1.0, (count, 4))
        frames.append(boxes if gap is None or not gap[0] <= step < gap[1] else boxes[:0])
    return frames


def run(graph: CheckedGraph, frames: list[Floats], order: int = 1) -> tuple[DetectionsTracker, list, list]:
    tracker, events, doubts = DetectionsTracker(graph, size=(640, 480), fps=25), [], []
    for boxes in frames:
        boxes = boxes[::order]
        corners = np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2])
        tracker.update(SimpleNamespace(xyxy=corners, confidence=np.full(len(boxes), 0.9)))
        events += [event for event in tracker.events if isinstance(event, IdentityDoubtful)]
        doubts.append({line.target: line.identities for line in tracker.targets if line.identities})
    return tracker, events, doubts


@pytest.mark.parametrize("name", ["kalman_detections", "jpda"])
def test_a_plain_crossing_leaves_no_doubt(name: str) -> None:
    _, events, doubts = run(with_identity(name), ways(None, 6.0))
    assert any(doubts) and not doubts[-1] and not events


def test_two_that_are_not_seen_while_they_cross_may_be_each_other() -> None:
    _, events, doubts = run(with_identity(), ways((24, 36), 1.0))
    (event,) = events
    assert 0.05 < event.probability < 0.95 and event.mutual
    assert {event.target, event.other} == {"1", "2"} and event.since < 24
    assert doubts[-1][event.target][event.other] == pytest.approx(event.probability, abs=1e-9)
    assert doubts[-1][event.other][event.target] == pytest.approx(event.probability, abs=1e-9)
    assert sum(doubts[-1]["1"].values()) == pytest.approx(1.0)
    sentence = event.describe()
    assert f"identities 1 and 2 could be swapped since frame {event.since}, probability" in sentence
    assert "appearance +0.0, motion" in sentence  # the graph looks at no image


def test_the_probability_does_not_depend_on_the_order_of_detections() -> None:
    graph = with_identity()
    _, one, _ = run(graph, ways((24, 36), 1.0))
    _, other, _ = run(graph, ways((24, 36), 1.0), order=-1)
    assert one[0].probability == pytest.approx(other[0].probability, rel=1e-6)


def test_targets_and_boxes_are_those_of_a_graph_without_the_key() -> None:
    frames = ways((24, 36), 4.0, count=3)
    asked, _, doubts = run(with_identity(), frames)
    plain, _, _ = run(load_graph("kalman_detections"), frames)
    assert any(doubts)
    boxes = [[(line.target, line.centre_box) for line in tracker.targets] for tracker in (asked, plain)]
    assert boxes[0] == boxes[1]


def test_a_graph_without_the_key_does_not_enter_the_stage() -> None:
    assert "identities" not in [stage.name for stage in compile_stages(compile_graph(load_graph("jpda")))]


@pytest.mark.slow
def test_five_that_meet_at_once_are_asked_about_by_four() -> None:
    sizes = []
    for end in (28, 29, 30, 31, 32):
        tracker, _, _ = run(with_identity(), ways((29, 31), 3.0, count=5)[:end])
        sizes += [len(meeting.members) for meeting in tracker._now.state.identities["target"].meetings]
    assert max(sizes) in (3, 4)


def test_the_state_goes_through_bytes_and_the_lines_through_columns() -> None:
    graph, frames = with_identity(), ways((24, 36), 1.0)
    tracker, _, _ = run(graph, frames[:38])
    state = tracker._now.state
    assert state.identities["target"].meetings
    again = decode_state(encode_state(state), tracker._engine, state.previous)
    held, other = (one.identities["target"].meetings[0] for one in (state, again))
    assert other.members == held.members
    np.testing.assert_array_equal(other.mean, held.mean)
    lines = list(tracker.targets)
    assert any(line.identities for line in lines)
    for line, same in zip(lines, lines_of(columns_of(lines)), strict=True):
        assert same.identities == pytest.approx(line.identities, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("two_squares", "identity without an agent that measures by detections"),
        ("street", "identity of a state that has no box in the image"),
    ],
)
def test_a_graph_that_cannot_be_asked_is_refused(name: str, found: str) -> None:
    with pytest.raises(GraphError) as error:
        with_identity(name)
    assert found in str(error.value)


def recorded(frames: list[Floats], folder: Path, keep_beliefs: bool = False) -> Path:
    source = folder / "images"
    source.mkdir()
    rows = [
        f"{step + 1},-1,{x - w / 2:.2f},{y - h / 2:.2f},{w:.2f},{h:.2f},0.9"
        for step, boxes in enumerate(frames)
        for x, y, w, h in boxes
    ]
    detections = folder / "det.txt"
    detections.write_text("\n".join(rows), encoding="utf-8")
    for step in range(len(frames)):
        cv2.imwrite(str(source / f"{step:06}.png"), np.full((480, 640), 90 + step, np.uint8))
    graph, out = with_identity(), folder / "run"
    for _ in track(graph, source, detections=detections, out=out, keep_beliefs=keep_beliefs):
        pass
    return out


@pytest.mark.slow
def test_the_table_of_tracks_has_the_two_most_probable_identities(tmp_path: Path) -> None:
    out = recorded(ways((24, 36), 1.0), tmp_path)
    with (out / "tracks.csv").open(encoding="utf-8") as file:
        table = [*csv.DictReader(file)]
    doubtful = [row for row in table if row["identity"]]
    assert table[-1] in doubtful and len(doubtful) < len(table)
    assert {table[-1]["identity"], table[-1]["other_identity"]} == {"1", "2"}
    assert float(table[-1]["identity_p"]) + float(table[-1]["other_identity_p"]) == pytest.approx(
        1.0, abs=0.01
    )
    assert '"identity_doubtful"' in (out / "journal.jsonl").read_text(encoding="utf-8")


def test_smoothed_identities_are_those_of_the_filter_at_the_end_and_surer_before(tmp_path: Path) -> None:
    run = open_run(recorded(ways(None, 6.0), tmp_path, keep_beliefs=True))
    lines = [*zip(run.metrics, smooth(run).metrics, strict=True)]
    doubts = [
        [1.0 - line.identities.get(line.target, 0.0) if line.identities else 0.0 for line in pair]
        for pair in lines
    ]
    filtered, smoothed = np.array(doubts).T
    assert filtered.max() > 0.1 and smoothed.max() < filtered.max() / 2
    assert all(smoothed_line.identities == line.identities for line, smoothed_line in lines[-2:])


def test_smoothed_identities_are_those_of_all_sequences() -> None:
    """Against enumeration of the hidden sequences, of evidence that the filter has summed over."""
    rng, exchange = np.random.default_rng(1), EXCHANGE
    evidence = rng.uniform(0.05, 1.0, (5, 2))
    evidence[0] = [1.0, 0.0]  # the track begins as itself
    turn = np.array([[1.0 - exchange, exchange], [exchange, 1.0 - exchange]])
    shares = [np.array([1.0, 0.0])]
    for weights in evidence[1:]:
        posterior = weights * (shares[-1] @ turn)
        shares.append(posterior / posterior.sum())
    expected = np.zeros((5, 2))
    for states in product((0, 1), repeat=5):
        steps = np.prod([turn[a, b] for a, b in pairwise(states)])
        expected[range(5), states] += steps * np.prod(evidence[range(5), states])
    expected /= expected.sum(axis=1, keepdims=True)
    tracker, _, _ = run(with_identity(), ways(None, 6.0)[:4])
    lines = [
        replace(tracker.targets[0], target="1", frame=k, identities={"1": p, "9": q})
        for k, (p, q) in enumerate(shares)
    ]
    settled = [line.identities or {"1": 1.0} for line in settle_identities(lines)]
    for found, (p, q) in zip(settled, expected, strict=True):
        assert found.get("9", 0.0) == pytest.approx(q, abs=0.011 if p > 0.98 else 2e-3)
