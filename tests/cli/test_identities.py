"""`diagnose` of runs whose identities go on as others: how many, why, and a setting that keeps them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesnet_track.cli.main import main

WORSE = "seen.agent={detection: {gate: GATE, continue_box: 0}}"


@pytest.fixture
def run(tmp_path, capsys):
    import cv2

    def track(graph, frames, *changes):
        images = tmp_path / "images"
        images.mkdir()
        for k in range(len(frames)):
            cv2.imwrite(str(images / f"{k + 1:06d}.png"), np.full((120, 640, 3), 90, np.uint8))
        lines = [
            f"{k + 1},-1,{x},{y},{w},{h},.9,-1,-1,-1\n"
            for k, boxes in enumerate(frames)
            for x, y, w, h in boxes
        ]
        (tmp_path / "found.txt").write_text("".join(lines))
        sets = [argument for change in changes for argument in ("--set", change)]
        arguments = ["--source", str(images), "--detections", str(tmp_path / "found.txt"), "-q", *sets]
        assert main(["run", graph, *arguments, "--out", str(tmp_path / "run")]) == 0
        capsys.readouterr()
        return str(tmp_path / "run")

    return track


def diagnosed(run, capsys, *more):
    assert main(["diagnose", run, *more]) == 0
    return capsys.readouterr().out


def u_turn():
    at = [100 + 8 * min(k, 25) - 8 * max(0, k - 25) for k in range(45)]
    return [[(x, 40, 30, 60)] for x in at]


@pytest.mark.slow
def test_a_turn_beyond_the_gate_is_found_and_a_setting_keeps_the_identity(run, capsys):
    out = run("kalman_detections", u_turn(), WORSE.replace("GATE", "0.9"))
    text = diagnosed(out, capsys)
    assert text.startswith("target 1: 2 identities are 1 track by where they end and start: 2.0 a track")
    assert "first in frame 26: 16 px away, d² 32.71 > 7.78 (gate 0.9)" in text
    assert "what-if" in text and "continue_box=0.19" in text
    tried = diagnosed(out, capsys, "--try").splitlines()
    assert "2 identities, 1 of which go on as another" in tried[0]
    assert any("continue_box=0.19: 1 identity, 0 of which" in line for line in tried[1:])


def test_identities_of_one_frame_each_stand_out(run, capsys):
    slow = "target.nodes.target.motion.constant_velocity.sd_velocity_px=0.01"
    start = "target.nodes.target.motion.constant_velocity.start_velocity_sd_px=0.1"
    frames = [[(5 + 30 * k, 40, 30, 60)] for k in range(18)]
    changes = WORSE.replace("GATE", "0.5"), "birth.confirm={hits: 1, of: 1}", slow, start
    out = run("kalman_detections", frames, *changes)
    (finding, *_) = json.loads(diagnosed(out, capsys, "--json"))["findings"]
    assert finding["found"].startswith("18 identities are ") and "1 frame long" in finding["found"]
    assert finding["measure"] == "identities" and finding["settings"]


@pytest.mark.slow
def test_a_target_that_ends_while_it_is_hidden_is_found(run, capsys):
    frames = [[] if 35 < k < 55 else [(50 + 5 * min(k, 30), 40, 60, 40)] for k in range(70)]
    out = run("kalman_detections", frames, "death.unseen_frames=10")
    text = diagnosed(out, capsys)
    assert "2 identities are 1 track" in text and "death.unseen_frames=" in text
    tried = diagnosed(out, capsys, "--try").splitlines()
    assert "1 identity, 0 of which go on as another" in tried[1]


def test_targets_that_come_and_go_are_tracks_of_their_own(run, capsys):
    frames = [[(20 + 5 * k, 40, 30, 60)] if k < 20 else [(400 - 5 * k, 20, 20, 30)] for k in range(50)]
    out = run("kalman_detections", frames)
    assert "identities are" not in diagnosed(out, capsys)
    assert diagnosed(out, capsys, "--try").startswith("no setting to try")
