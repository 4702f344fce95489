"""Sensors that tell late: the readings are of the state some frame intervals ago, against a Kalman filter."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import Tracker, load_graph, open_run
from bayesnet_track.cli.main import main
from bayesnet_track.graph.text.messages import GraphError

FRAMES = 15
FAST = 100 + 4 * np.arange(FRAMES) + np.random.default_rng(1).normal(0, 6, FRAMES)
NOISE = np.random.default_rng(2).normal(0, 2, FRAMES)
IMAGE = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)


def graph_of(folder, belief, delay, late="x", **more):
    """A ball that a fast sensor sees at once, and a precise one `delay` frame intervals late."""
    values = 100 + 4 * (np.arange(FRAMES) - delay) + NOISE
    for name, quantity, rows in (("fast", "x", FAST), ("late", late, values)):
        text = "".join(f"{frame},{value:.9f}\n" for frame, value in enumerate(rows))
        (folder / f"{name}.csv").write_text(f"frame,{quantity}\n{text}", encoding="utf-8")

    def readings(name, quantity, sd, **own):
        return {
            "readings": {"file": str(folder / f"{name}.csv"), "sd": {quantity: sd}, "floor": 1e-12, **own}
        }

    root = {
        "belief": belief,
        "motion": {"constant_velocity": {"sd_velocity_px": 1, "start_velocity_sd_px": 3}},
        "fuse": "product",
        "estimate": "mean",
        **more,
    }
    measures = {} if late == "x" else {"measures": {late: "x + y"}}
    nodes = {
        "ball": root,
        "fast": {"parent": "ball", "agent": readings("fast", "x", 6)},
        "late": {"parent": "ball", "agent": readings("late", late, 2, delay=delay), **measures},
    }
    return {"bayesnet": 1, "name": "late", "targets": {"ball": {"nodes": nodes}}}


def follow(graph, times):
    tracker = Tracker(load_graph(graph))
    tracker.init(IMAGE, (90, 110, 20, 20), time_s=0.0)
    for time in times:
        tracker.update(IMAGE, time_s=time / 25)
    return tracker.targets[0]


def exact(delay):
    """Mean and sd of x: a Kalman filter of x, its velocity, and what x was before, written out."""
    lags = int(np.ceil(delay))
    size, whole, share = 2 + lags, int(delay), delay % 1.0
    step = np.zeros((size, size))
    step[0, :2], step[1, 1] = 1.0, 1.0
    for lag in range(lags):
        step[2 + lag, 0 if lag == 0 else 1 + lag] = 1.0
    noise = np.zeros((size, size))
    noise[:2, :2] = [[1 / 3, 1 / 2], [1 / 2, 1]]
    start = np.vstack([np.eye(2), *([[1, -lag]] for lag in range(1, lags + 1))])
    mean, covariance = np.array([99.5, 0.0, *[99.5] * lags]), start @ np.diag([0, 9.0]) @ start.T
    looks = np.zeros(size)
    looks[whole and 1 + whole] += 1.0 - share
    if share:
        looks[2 + whole] += share
    late = 100 + 4 * (np.arange(FRAMES) - delay) + NOISE
    for frame in range(1, FRAMES):
        mean, covariance = step @ mean, step @ covariance @ step.T + noise
        for value, row, error in ((FAST[frame], np.eye(size)[0], 36.0), (late[frame], looks, 4.0)):
            gain = covariance @ row / (row @ covariance @ row + error)
            mean, covariance = (
                mean + gain * (value - row @ mean),
                covariance - np.outer(gain, row @ covariance),
            )
    return mean[0], np.sqrt(covariance[0, 0])


EXTENDED = {"gaussian": {"filter": "extended", "gate": 1}}
UNSCENTED = {"gaussian": {"filter": "unscented", "gate": 1}}


@pytest.mark.parametrize("delay", [1, 2, 2.5])
@pytest.mark.parametrize("belief", [EXTENDED, UNSCENTED], ids=["extended", "unscented"])
def test_a_late_reading_is_of_the_state_when_it_was_taken(belief, delay, tmp_path):
    last = follow(graph_of(tmp_path, belief, delay), range(1, FRAMES))
    mean, sd = exact(delay)
    assert last.centre_box[0] == pytest.approx(mean, abs=1e-5)
    assert last.sd[0] == pytest.approx(sd, abs=1e-5)
    assert not any("@" in name for name in last.state)


def test_particles_keep_the_past_too(tmp_path):
    mean, sd = exact(2)
    last = follow(graph_of(tmp_path, {"particles": {"size": 3000}}, 2), range(1, FRAMES))
    assert last.centre_box[0] == pytest.approx(mean, abs=0.5) and last.sd[0] == pytest.approx(sd, rel=0.15)


def test_without_the_delay_the_answer_is_behind(tmp_path):
    graph = graph_of(tmp_path, EXTENDED, 2)
    right = follow(graph, range(1, FRAMES)).centre_box[0]
    del graph["targets"]["ball"]["nodes"]["late"]["agent"]["readings"]["delay"]
    assert follow(graph, range(1, FRAMES)).centre_box[0] < right - 3


def test_a_delay_is_in_time_also_where_frames_are_left_out(tmp_path):
    """A target at an even pace: the delayed reading fits it wherever frames are missing."""
    graph = graph_of(tmp_path, EXTENDED, 2.5)
    kept = [frame for frame in range(1, FRAMES) if frame not in (3, 4, 8)]
    nodes = graph["targets"]["ball"]["nodes"]
    for name, delay in (("fast", 0), ("late", 2.5)):
        rows = "".join(f"{number},{100 + 4 * (frame - delay)}\n" for number, frame in enumerate([0, *kept]))
        path = Path(nodes[name]["agent"]["readings"]["file"])
        path.write_text(f"frame,x\n{rows}", encoding="utf-8")
    last = follow(graph, kept)
    assert last.centre_box[0] == pytest.approx(100 + 4 * (FRAMES - 1), abs=0.6)


def test_functions_of_the_state_are_delayed_too(tmp_path):
    graph = graph_of(tmp_path, EXTENDED, 2, late="u")
    text = "".join(f"{f},{100 + 4 * (f - 2) + 119.5 + n:.9f}\n" for f, n in enumerate(NOISE))
    (tmp_path / "late.csv").write_text(f"frame,u\n{text}", encoding="utf-8")
    graph["targets"]["ball"]["nodes"]["ball"]["motion"] = {
        "expressions": {
            "fields": {"vx": {"sd": 3}},
            "drift": {"x": "x + vx * dt"},
            "sd": {"x": 0.5, "vx": 1},
        }
    }
    last = follow(graph, range(1, FRAMES))
    assert last.centre_box[0] == pytest.approx(156, abs=4)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"belief": {"gaussian": {"filter": "kalman"}}},
            "delay beside filter: kalman, whose state has",
        ),
        (
            {"belief": {"particles": {"proposal": "second_pass"}}},
            "delay beside proposal: second_pass, which draws hypotheses without a past",
        ),
        (
            {
                "belief": {"grid": {}},
                "motion": {"random_walk": {"sd_px": {"x": 1, "y": 1}}},
            },
            "delay beside a grid, which keeps no past; allowed: particles or gaussian",
        ),
    ],
)
def test_beliefs_that_keep_no_past_are_refused(changes, said, tmp_path):
    graph = graph_of(tmp_path, EXTENDED, 2)
    graph["targets"]["ball"]["nodes"]["ball"] |= changes
    with pytest.raises(GraphError, match=said):
        load_graph(graph)


def test_a_negative_delay_and_kept_beliefs_are_refused(tmp_path, capsys):
    with pytest.raises(GraphError, match="delay is -1; allowed: a number at least 0, at most 16"):
        load_graph(graph_of(tmp_path, EXTENDED, -1))
    path = tmp_path / "late.yaml"
    path.write_text(json.dumps(graph_of(tmp_path, EXTENDED, 2)), encoding="utf-8")
    (tmp_path / "images").mkdir()
    for frame in range(4):
        assert cv2.imwrite(str(tmp_path / "images" / f"{frame}.png"), IMAGE)
    command = ["run", str(path), "--source", str(tmp_path / "images"), "--init", "90,110,20,20", "--out"]
    assert main([*command, str(tmp_path / "a"), "--keep-beliefs"]) == 2
    assert (
        "ball.late has a delay, and beliefs with their past cannot be smoothed yet" in capsys.readouterr().err
    )
    assert main([*command, str(tmp_path / "b")]) == 0
    assert len(open_run(tmp_path / "b").metrics) == 4
