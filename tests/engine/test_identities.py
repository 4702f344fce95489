"""One target that is always detected has one identity, however it moves; two targets have two."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from bayesnet_track.journal.events.lives import Continued

GRAPHS = ("kalman_detections", "people_detections", "jpda")

CELLS = """\
bayesnet: 1
name: cells
targets:
  cell:
    birth: {detector: detections, confirm: {hits: 2, of: 3}, max_targets: 200}
    death: {unseen_frames: 20}
    nodes:
      cell:
        belief: {gaussian: {filter: kalman, likelihood: sigma_points, gate: 1}}
        motion: {random_walk: {sd_px: {x: 3, y: 3, w: 0.5, h: 0.5}}}
        estimate: mean
        ud_fields: [x, y]
        lost: {above: {ud_box: 100}, fit_below: 0.0001, frames: 10}
      seen: {parent: cell, agent: AGENT}
"""


def follow(graph, frames, size=(1920, 1080)):
    """The identity of each detection, frame by frame, and the events; `frames` hold corners x1 y1 x2 y2."""
    tracker, image = DetectionsTracker(graph, size=size), np.zeros((size[1], size[0], 3), np.uint8)
    picture = (image,) if graph == "people_detections" else ()
    ids, events = [], []
    for boxes in frames:
        corners = np.array(boxes, float).reshape(-1, 4)
        seen = SimpleNamespace(xyxy=corners, confidence=np.full(len(corners), 0.9))
        ids.append(tracker.update(seen, *picture).tracker_id.tolist())
        events += tracker.events
    return ids, events


def identities(ids):
    return {one for row in ids for one in row if one > 0}


def box(x, y, w=40, h=80):
    return [x, y, x + w, y + h]


@pytest.mark.parametrize("graph", GRAPHS)
@pytest.mark.parametrize("step_px", [8, 30, 45])
def test_a_target_has_one_identity_at_a_low_frame_rate(graph, step_px):
    ids, _ = follow(graph, [[box(20 + step_px * k, 300)] for k in range(18)])
    assert len(identities(ids)) == 1
    assert sum(row[0] > 0 for row in ids) >= 15


def test_a_target_that_moves_by_three_of_its_widths_a_frame_has_one_identity():
    ids, _ = follow("kalman_detections", [[box(20 + 120 * k, 300)] for k in range(15)])
    assert len(identities(ids)) == 1


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_target_that_turns_round_keeps_its_identity_and_the_log_says_why(graph):
    places = [100 + 8 * min(k, 25) - 8 * max(0, k - 25) for k in range(50)]
    ids, events = follow(graph, [[box(x, 100, 30, 60)] for x in places])
    assert len(identities(ids)) == 1
    (turn,) = [event for event in events if isinstance(event, Continued)]
    assert turn.first_frame in (26, 27)
    assert 0 < turn.distance_box < turn.continue_box
    words = turn.describe()
    assert f"target {turn.target} goes on with them" in words
    level = float(words.split("continue_box < ")[1])
    assert turn.distance_box - 0.01 <= level <= turn.distance_box


def test_below_the_level_that_the_log_names_the_target_is_a_new_one(tmp_path):
    import yaml

    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.graph.text.write import as_plain

    plain = as_plain(load_graph("kalman_detections").spec)
    frames = [[box(100 + 8 * min(k, 25) - 8 * max(0, k - 25), 100, 30, 60)] for k in range(50)]
    (turn,) = [event for event in follow("kalman_detections", frames)[1] if isinstance(event, Continued)]
    level = float(turn.describe().split("continue_box < ")[1])
    for value, count in ((level - 0.01, 2), (level + 0.01, 1)):
        plain["targets"]["target"]["nodes"]["seen"]["agent"] = {"detection": {"continue_box": value}}
        graph = tmp_path / "graph.yaml"
        graph.write_text(yaml.safe_dump(plain), encoding="utf-8")
        assert len(identities(follow(str(graph), frames)[0])) == count


def test_a_newcomer_is_no_continuation_of_a_target_that_is_still_seen():
    frames = [[box(100 + 4 * k, 300), *([box(180 + 4 * k, 300)] if k >= 10 else [])] for k in range(25)]
    ids, events = follow("kalman_detections", frames)
    assert len(identities(ids)) == 2
    assert not any(isinstance(event, Continued) for event in events)


def test_a_newcomer_far_from_a_target_that_ended_is_another():
    frames = [[box(100, 300)] if k < 10 else [box(800, 300)] for k in range(25)]
    assert len(identities(follow("kalman_detections", frames)[0])) == 2


def test_a_newcomer_where_one_target_covers_another_is_another():
    """The covered one is missed because it is covered; who comes out in front is somebody else."""
    frames = []
    for k in range(30):
        front, behind = box(100 + 6 * k, 300), box(175, 290)
        seen = [front] + ([behind] if k < 10 else [])
        frames.append(seen + ([box(172 + 6 * (k - 9), 215)] if k >= 10 else []))
    ids, _ = follow("kalman_detections", frames)
    assert len(identities(ids)) == 3


@pytest.mark.parametrize("agent, few", [("detection", True), ("{detection: {min_overlap: 0.2}}", False)])
def test_the_gate_of_the_density_alone_says_how_far_a_cell_diffuses(tmp_path, agent, few):
    graph, rng = tmp_path / "cells.yaml", np.random.default_rng(11)
    graph.write_text(CELLS.replace("AGENT", agent), encoding="utf-8")
    places = 250 + np.cumsum(rng.normal(0, 2.5, (80, 2)), axis=0)
    ids, events = follow(str(graph), [[box(x, y, 10, 10)] for x, y in places], (520, 520))
    is_one = len(identities(ids)) == 1 and not any(isinstance(event, Continued) for event in events)
    assert is_one is few


def test_a_target_that_is_hidden_for_less_than_a_second_comes_back_as_itself():
    frames = [
        [] if 35 < k < 55 else [box(50 + 5 * min(k, 30) + 5 * max(0, k - 60), 100, 60, 40)] for k in range(90)
    ]
    assert len(identities(follow("kalman_detections", frames, (640, 480))[0])) == 1


def test_false_detections_far_apart_start_no_target():
    """A far second detection needs a third on the line through both."""
    rng = np.random.default_rng(5)
    frames = [[box(*rng.uniform([0, 0], [1800, 900]))] for _ in range(60)]
    assert len(identities(follow("kalman_detections", frames)[0])) <= 1
