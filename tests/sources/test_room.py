"""The room that several cameras see: its files, and what each of its faults does to the last camera."""

import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.sources.scenes.people import (
    LATE_S,
    ROOM_BIAS_PX,
    ROOM_FPS,
    ROOM_FRAMES,
    ROOMS,
    room,
    write_room,
)


def offsets_of(ground, frames, late=0):
    """(N, 2) px of the detections in some frames from the nearest box that the calibration expects."""
    rows = ground.detections[np.isin(ground.detections[:, 0], frames) & (ground.detections[:, 5] >= 0.7)]
    centres = rows[:, 1:3] + rows[:, 3:5] / 2 - 0.5
    boxes = np.array([ground.camera.boxes(ground.paths[:, int(frame) - late]) for frame in rows[:, 0]])
    offsets = centres[:, None] - boxes[..., :2]
    return offsets[np.arange(len(rows)), np.hypot(*offsets.transpose(2, 0, 1)).argmin(axis=1)]


def errors_of(ground, frames, bias=(0.0, 0.0)):
    return np.hypot(*(offsets_of(ground, frames) - bias).T)


def biases(seed=0):
    """Camera -> how far its calibration is off, px."""
    return {
        name: np.median(offsets_of(ground, range(60)), axis=0) for name, ground in room(seed=seed).items()
    }


def test_calibrations_are_off_as_the_graph_says():
    drawn = np.concatenate([np.stack([*biases(seed).values()]) for seed in range(12)])
    assert drawn.std() == pytest.approx(ROOM_BIAS_PX, rel=4.0 / np.sqrt(2.0 * drawn.size))


@pytest.mark.parametrize("fault", ROOMS.values())
def test_only_the_last_camera_has_the_fault(fault):
    (*others, last), bias = room(fault, frames=60).items(), biases()
    early, late = range(30), range(30, 60)
    for name, ground in others:
        assert np.median(errors_of(ground, [*early, *late], bias[name])) < 3.0
    name, ground = last
    assert (np.median(errors_of(ground, early, bias[name])) > 4.0) == (fault == "late")
    assert (np.median(errors_of(ground, late, bias[name])) > 4.0) == (fault != "")


def test_a_late_clock_shows_what_was_before():
    frames, steps = 60, round(LATE_S * ROOM_FPS)
    late = room("late", frames=frames)["west"]
    offsets = offsets_of(late, range(steps, frames), steps) - biases()["west"]
    assert np.median(np.hypot(*offsets.T)) < 3.0


@pytest.mark.slow
def test_every_one_is_seen_by_some_camera_most_of_the_time(tmp_path):
    _, detections, truth = write_room(tmp_path)
    assert set(detections) == {"north", "east", "west"}
    rows = np.loadtxt(truth, delimiter=",", skiprows=1)
    assert np.all(np.bincount(rows[:, 1].astype(int))[1:] > 0.9 * ROOM_FRAMES)


@pytest.mark.slow
def test_the_demo_scores_in_metres(tmp_path, capsys):
    assert main(["demo", "room", "--end", "30", "--out", str(tmp_path / "room")]) == 0
    scores = dict(line.split()[:2] for line in capsys.readouterr().out.splitlines() if len(line.split()) > 1)
    assert float(scores["error_m"]) < 0.15
