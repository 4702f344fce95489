"""What is recorded of the innovations of cameras, and what `diagnose` says of it."""

from __future__ import annotations

import json
import re
from functools import partial

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.cli.main import main
from bayesnet_track.engine.compiled import compile_graph
from bayesnet_track.engine.lifecycle.sensing import Found, Mixed
from bayesnet_track.evaluate.motion_evidence import NoiseRatio
from bayesnet_track.journal.frame_columns import CAMERA_NUMBERS
from bayesnet_track.journal.frame_file import FrameFile
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.runtime.recording.run_reader import open_run
from bayesnet_track.sources.scenes.people import write_room

EDGES_PX = 1.5
"""Noise of the edges of detections in the room: that of a centre is less by sqrt(2), that of a side more."""
PLACE_PX, SIZE_PX = EDGES_PX / 2**0.5, EDGES_PX * 2**0.5


def write_with_noise(folder, factor=1.0, seed=0):
    """The room with settings of noise that are too large by a factor."""
    graph, detections, _ = write_room(folder, seed=seed)
    noise = f"sd_place: 0, sd_size: 0, sd_place_px: {factor * PLACE_PX}, sd_size_px: {factor * SIZE_PX}"
    graph.write_text(re.sub(r"detection: \{.*?\}", f"detection: {{{noise}}}", graph.read_text()))
    named = [part for name, path in detections.items() for part in ("--detections", f"{name}={path}")]
    return graph, ["run", str(graph), *named, "--quiet"]


def sensor_of(folder):
    graph, _ = write_with_noise(folder)
    return compile_graph(load_graph(graph)).plates["person"].sensors["seen.north"]


@pytest.mark.parametrize("bias_px", [0.0, 4.0])
def test_innovations_drawn_from_the_model_have_one_per_degree_of_freedom(tmp_path, bias_px):
    sensor = sensor_of(tmp_path)
    count, rng = 4000, np.random.default_rng(3)
    lasting, fields = len(sensor.views.lasting), 6 + len(sensor.views.lasting)
    spread = np.diag([0.05, 0.08, 0.02, 0.03, 0.3, 0.3, *[3.0] * lasting]) ** 2
    mean = np.array([4.0, 3.0, 0.55, 1.7, *np.zeros(2 + lasting)])
    centre, state = mean, np.tile(mean, (count, 1))
    state[:, :6] += rng.normal(size=(count, 6)) * np.sqrt(np.diag(spread)[:6])
    at = [6 + k for k, error in enumerate(sensor.view.lasting) if sensor.is_bias(error)]
    state[:, at] = bias_px  # the same of all, as a calibration that is off
    noise = np.array([PLACE_PX, PLACE_PX, SIZE_PX, SIZE_PX])
    detections = Found(
        sensor.boxes(state) + noise * rng.normal(size=(count, 4)), np.ones(count), np.arange(count)
    )
    each = Mixed(np.arange(count + 1), np.arange(count), np.ones(count), np.zeros(count))
    moments = np.tile(centre, (count, 1)), np.tile(spread, (count, 1, 1))
    assert state.shape == (count, fields)
    numbers = sensor.check(*moments, detections, each)
    assert [*numbers] == list(CAMERA_NUMBERS)
    assert numbers["targets"] == numbers["detections"] == count
    information = np.array([[numbers["xx"], numbers["xy"]], [numbers["xy"], numbers["yy"]]])
    mean = np.array([numbers["x_px"], numbers["y_px"]])
    assert np.abs(mean - bias_px).max() < 4 * np.linalg.inv(information).diagonal().max() ** 0.5 + 0.2
    # Pairs that the gate refuses are not there: the others are as a chi-square that is cut.
    limit = chi_square_quantile(sensor.association.gate, 4)
    draws = rng.chisquare(4, 4_000_000)
    gated = draws[draws <= limit].mean() / 4
    without_mean = numbers["place_nis"] - mean @ information @ mean
    for nis, part in ((without_mean, "place"), (numbers["size_nis"], "size")):
        assert numbers[f"{part}_dof"] == pytest.approx(2 * count * gated, rel=2e-3)
        assert nis / (2 * count) == pytest.approx(1.0, abs=4 * (2 / (2 * count)) ** 0.5 + 0.03)
        assert 0.0 < numbers[f"{part}_noise"] < 2 * count


def test_an_edge_that_was_cut_takes_a_degree_of_freedom(tmp_path):
    sensor = sensor_of(tmp_path)
    lasting = len(sensor.views.lasting)
    moments = np.array([[4.0, 3.0, 0.55, 1.7, *np.zeros(2 + lasting)]]), 0.01 * np.eye(6 + lasting)[None]
    each = Mixed(np.arange(2), np.arange(1), np.array([0.5]), np.array([0.5]))
    gated, (x, y, w, h) = sensor.share_gated, sensor.boxes(moments[0])[0]
    check = partial(sensor.check, *moments, mixed=each)
    whole = check(detections=Found(np.array([[x, y, w, h]]), np.ones(1), np.zeros(1, int)))
    cut = check(detections=Found(np.array([[w / 2 - 0.5, y, w, h]]), np.ones(1), np.zeros(1, int)))
    assert (whole["place_dof"], whole["size_dof"]) == pytest.approx((gated, gated))  # of half a detection
    assert (cut["place_dof"], cut["size_dof"]) == pytest.approx((gated / 2, gated / 2))


@pytest.mark.parametrize(("alike", "least"), [(1, 0.92), (6, 0.87)])
def test_the_interval_holds_the_ratio_also_of_frames_that_are_alike(alike, least):
    rng, held, runs = np.random.default_rng(5), 0, 400
    dof = np.full(300, 6.0)
    for _ in range(runs):
        ratio = NoiseRatio.estimate(np.repeat(rng.chisquare(6, 300 // alike), alike), dof, dof)
        held += ratio.low <= 1.0 <= ratio.high
    assert least <= held / runs <= 0.99


def test_columns_are_of_cameras_on_the_ground_alone(tmp_path):
    _, line = write_with_noise(tmp_path)
    assert main([*line, "--end", "12", "--out", str(tmp_path / "whole")]) == 0
    frames = [*FrameFile(tmp_path / "whole" / "frames.npy.gz").columns()]
    named = [name for name in frames[-1] if name.startswith("cameras/")]
    assert named == ["cameras/north", "cameras/east", "cameras/west"]
    assert all(frames[-1][name].shape == (len(CAMERA_NUMBERS),) for name in named)
    assert main(["demo", "gray_square", "--quiet", "--end", "4", "--out", str(tmp_path / "one")]) == 0
    for columns in FrameFile(tmp_path / "one" / "frames.npy.gz").columns():
        assert not any(name.startswith("cameras/") for name in columns)
    assert open_run(tmp_path / "whole").metrics[-1].target in open_run(tmp_path / "whole").targets


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5])
@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_wrong_noise_is_noticed_and_the_value_to_try_is_close_to_the_right_one(
    tmp_path, capsys, factor, seed
):
    _, line = write_with_noise(tmp_path, factor, seed)
    assert main([*line, "--out", str(tmp_path / "run")]) == 0
    capsys.readouterr()
    assert main(["diagnose", str(tmp_path / "run"), "--json"]) == 0
    checks = json.loads(capsys.readouterr().out)["innovations"]
    assert [check["camera"] for check in checks] == ["north", "east", "west"]
    for check in checks:
        tried = dict(setting.split("=") for setting in check["settings"])
        sides = {key: float(value) for key, value in tried.items() if key.endswith("sd_size_px")}
        if factor == 1.0:
            assert not sides and 0.8 < check["size"]["ratio"] < 1.25
        else:
            assert sides == {"seen.agent.detection.sd_size_px": pytest.approx(SIZE_PX, rel=0.2)}
        assert abs(check["x_px"]) < 4 * check["x_sd"] + 0.2
    assert sum(check["missed"] for check in checks) == pytest.approx(1.0)
