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


def errors_of(ground, frames, frames_late=0):
    """(n, 2) px, from the nearest box that the calibration expects to each sure detection in some frames."""
    rows = ground.detections[np.isin(ground.detections[:, 0], frames) & (ground.detections[:, 5] >= 0.7)]
    centres = rows[:, 1:3] + rows[:, 3:5] / 2 - 0.5
    boxes = [ground.camera.boxes(ground.paths[:, int(frame) - frames_late]) for frame in rows[:, 0]]
    apart = centres[:, None] - np.array(boxes)[..., :2]
    return apart[np.arange(len(apart)), np.argmin(np.hypot(*apart.transpose(2, 0, 1)), axis=1)]


def typical(errors, lasting):
    """Median distance, px, but for the lasting error."""
    return np.median(np.hypot(*(errors - lasting).T))


@pytest.fixture(scope="module")
def lasting():
    """Camera -> its lasting error, px."""
    return {name: np.median(errors_of(ground, range(60)), axis=0) for name, ground in room(frames=60).items()}


def test_all_boxes_of_a_camera_are_off_alike(lasting):
    errors = np.array(list(lasting.values()))
    assert (np.hypot(*errors.T) > 0.5).all()
    assert np.abs(errors).max() < 3.5 * ROOM_BIAS_PX


@pytest.mark.parametrize("fault", ROOMS.values())
def test_only_the_last_camera_has_the_fault(fault, lasting):
    cameras = room(fault, frames=60)
    early, late = (
        {name: typical(errors_of(ground, frames), lasting[name]) for name, ground in cameras.items()}
        for frames in (range(30), range(30, 60))
    )
    for name in ("north", "east"):
        assert max(early[name], late[name]) < 3.0
    assert (early["west"] > 4.0) == (fault == "late")
    assert (late["west"] > 4.0) == (fault != "")


def test_a_late_clock_shows_what_was_before(lasting):
    frames, steps = 60, round(LATE_S * ROOM_FPS)
    late = room("late", frames=frames)["west"]
    assert typical(errors_of(late, range(steps, frames), steps), lasting["west"]) < 3.0


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
