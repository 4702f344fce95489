"""Targets on the ground start within an area alone, and end as they leave it: by the front door."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.graph.text.messages import GraphError
from tests.engine.street import FPS, detections_of, noisy
from tests.engine.test_several_cameras import boxes_of, walk, write_graph

AREA = [[-3, 7], [1, 7], [1, 13], [-3, 13]]
CAMERAS = ("south", "east")


def graph_with(folder, area=AREA, cameras=CAMERAS):
    path = write_graph(folder, cameras)
    graph = json.loads(path.read_text())
    graph["targets"]["person"]["state"]["ground"]["area"] = area
    path.write_text(json.dumps(graph))
    return path


def ids_of(path, ways, cameras=CAMERAS):
    """Frame by frame the targets, of people who walk these ways, and which detections are whose."""
    tracker, rng, live, owners = DetectionsTracker(path, fps=FPS), np.random.default_rng(1), [], []
    for frame in range(len(ways[0])):
        given = {
            camera: detections_of(noisy(np.array([boxes_of(camera, way[frame])[0] for way in ways]), rng))
            for camera in cameras
        }
        marked = tracker.update(given if len(cameras) > 1 else given[cameras[0]], time_s=frame / FPS)
        marked = marked[cameras[0]] if len(cameras) > 1 else marked
        live.append([target.target for target in tracker.targets])
        owners.append(marked.tracker_id.tolist())
    return live, owners


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [CAMERAS, CAMERAS[:1]])
def test_what_stands_outside_is_no_target(tmp_path, cameras):
    ways = [walk(20, (-1.0, 9.0), (0.3, 0.0)), walk(20, (2.5, 11.0), (0.0, 0.0))]
    live, owners = ids_of(graph_with(tmp_path, cameras=cameras), ways, cameras)
    assert live[-1] == ["1"]
    assert owners[-1] == [1, -1]
    everywhere, _ = ids_of(write_graph(tmp_path, cameras), ways, cameras)
    assert len(everywhere[-1]) == 2


@pytest.mark.slow
def test_one_who_comes_in_becomes_a_target_and_one_who_leaves_ends(tmp_path):
    way = walk(50, (-4.5, 10.0), (1.6, 0.0))  # in at x = -3 in frame 10, out at x = 1 in frame 35
    live, _ = ids_of(graph_with(tmp_path), [way])
    is_live = np.array([bool(targets) for targets in live])
    x = way[:, 0]
    assert not is_live[x < -3.2].any()
    assert is_live[(x > -2.6) & (x < 0.8)].all()
    assert not is_live[x > 1.6].any()
    assert {target for targets in live for target in targets} == {"1"}


def test_corners_in_a_line_are_no_area(tmp_path):
    with pytest.raises(GraphError, match="corners are in a line"):
        load_graph(graph_with(tmp_path, area=[[0, 0], [1, 1], [2, 2]]))
