"""The room that several cameras see: its files, and what each of its faults does to the last camera."""

import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.sources.scenes.people import LATE_S, ROOM_FPS, ROOM_FRAMES, ROOMS, room, write_room


def errors_of(ground, frames):
    """Distances, px, of the detections in some frames from the nearest box that the calibration expects."""
    rows = ground.detections[np.isin(ground.detections[:, 0], frames) & (ground.detections[:, 5] >= 0.7)]
    centres = rows[:, 1:3] + rows[:, 3:5] / 2 - 0.5
    boxes = np.array([ground.camera.boxes(ground.paths[:, int(frame)]) for frame in rows[:, 0]])
    return np.sort(np.hypot(*(boxes[..., :2] - centres[:, None]).transpose(2, 0, 1)), axis=1)[:, 0]


@pytest.mark.parametrize("fault", ROOMS.values())
def test_only_the_last_camera_has_the_fault(fault):
    *others, last = room(fault, frames=60).values()
    early, late = range(30), range(30, 60)
    for ground in others:
        assert np.median(errors_of(ground, [*early, *late])) < 3.0
    assert (np.median(errors_of(last, early)) > 4.0) == (fault == "late")
    assert (np.median(errors_of(last, late)) > 4.0) == (fault != "")


def test_a_late_clock_shows_what_was_before():
    frames, steps = 60, round(LATE_S * ROOM_FPS)
    late = room("late", frames=frames)["west"]
    rows = late.detections[late.detections[:, 5] >= 0.7]
    rows = rows[rows[:, 0] >= steps]
    centres = rows[:, 1:3] + rows[:, 3:5] / 2 - 0.5
    boxes = np.array([late.camera.boxes(late.paths[:, int(frame) - steps]) for frame in rows[:, 0]])
    apart = np.hypot(*(boxes[..., :2] - centres[:, None]).transpose(2, 0, 1)).min(axis=1)
    assert np.median(apart) < 3.0


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
