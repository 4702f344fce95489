"""Scoring a run directory."""

import json

import pytest

from bayesnet_track.evaluate import format_truth, score_run


def metrics(frame: int, corner: tuple[float, float, float, float], target: str = "1", **more) -> dict:
    x, y, w, h = corner
    line = {
        "frame": frame,
        "target": target,
        "box": [x + (w - 1) / 2, y + (h - 1) / 2, w, h],
        "status": "tracking",
        "active": ["hue"],
        "region50": [0, 50, 0, 5],
        "region90": [0, 50, 0, 50],
    }
    return {**line, **more}


def write(folder, name, lines):
    (folder / name).write_text("".join(json.dumps(line) + "\n" for line in lines))


@pytest.fixture
def truth(tmp_path):
    path = tmp_path / "truth.txt"
    path.write_text(format_truth([(10.0 * i, 10.0, 20.0, 20.0) for i in range(4)]))
    return path


def test_rows_of_the_truth_are_frame_indices(tmp_path, truth):
    lines = [metrics(i, (10.0 * i, 10.0, 20.0, 20.0)) for i in (1, 2, 3, 4, 5)]
    lines[1] |= {"status": "lost", "active": ["hue", "flow"]}
    write(tmp_path, "frames.jsonl", lines)
    write(tmp_path, "timings.jsonl", [{"frame": i, "seconds": 0.1} for i in range(1, 6)])
    got = score_run(tmp_path, truth)
    assert (got.frames, got.mean_iou, got.lost_when_on) == (3, 1.0, pytest.approx(1 / 3))
    assert got.fps == pytest.approx(10) and got.mean_active == pytest.approx(4 / 3)
    assert got.coverage50 == (1.0, 0.0) and got.coverage90 == (1.0, 1.0)


def test_without_timings_there_is_no_rate(tmp_path, truth):
    write(tmp_path, "frames.jsonl", [metrics(0, (0.0, 10.0, 20.0, 20.0))])
    assert score_run(tmp_path, truth).fps is None


def test_a_line_cut_off_at_the_end_is_left_out(tmp_path, truth):
    write(tmp_path, "frames.jsonl", [metrics(0, (0.0, 10.0, 20.0, 20.0))])
    with (tmp_path / "frames.jsonl").open("a") as file:
        file.write('{"frame": 1, "tar')
    assert score_run(tmp_path, truth).frames == 1


def test_several_targets_must_be_told_apart(tmp_path, truth):
    write(tmp_path, "frames.jsonl", [metrics(0, (0, 10, 20, 20), "1"), metrics(0, (0, 10, 20, 10), "2")])
    with pytest.raises(ValueError, match=r"several targets \(1, 2\); name one"):
        score_run(tmp_path, truth)
    assert score_run(tmp_path, truth, target="2").mean_iou == 0.5
    with pytest.raises(ValueError, match="no target '3'; there are 1, 2"):
        score_run(tmp_path, truth, target="3")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("frames.jsonl", '{"frame": 0}\n', r"frames.jsonl:1: expected an object with frame, target, box"),
        ("frames.jsonl", "frame 0\n", r"frames.jsonl:1: not JSON"),
        ("frames.jsonl", "", r"no target ''; there are none"),
        ("timings.jsonl", '{"frame": 9, "seconds": 1}\n', r"timings.jsonl: no time for frame 0"),
    ],
)
def test_damaged_files_are_named(tmp_path, truth, name, text, message):
    write(tmp_path, "frames.jsonl", [metrics(0, (0, 10, 20, 20))])
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        score_run(tmp_path, truth)


def test_a_truth_of_other_frames_is_refused(tmp_path, truth):
    write(tmp_path, "frames.jsonl", [metrics(9, (0, 10, 20, 20))])
    with pytest.raises(ValueError, match="4 boxes, none of them for a frame of"):
        score_run(tmp_path, truth)
