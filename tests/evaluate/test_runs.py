"""Scoring a run directory."""

import json
from dataclasses import replace
from itertools import groupby

import pytest

from bayesnet_track.evaluate.runs import score_run
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.journal.frame_file import FrameWriter
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.sources.scenes.library import format_truth


def metrics(frame, corner, target="1", status="tracking", active=("hue",)) -> FrameMetrics:
    x, y, w, h = map(float, corner)
    box = (x + (w - 1) / 2, y + (h - 1) / 2, w, h)
    return FrameMetrics(
        frame=frame,
        time_s=frame / 25,
        target=target,
        centre_box=box,
        map=box,
        sd=(1.0, 1.0, 0.1, 0.1),
        ud_px2=2.0,
        ud_nodes={"square": 2.0},
        quiet_px2=None,
        status=status,
        score=0.5,
        log_evidence=-1.0,
        surprise=0.4,
        ess=100.0,
        particles=500,
        active=tuple(active),
        kl={},
        contribution={},
        agent_ud_px2={},
        strength={},
        learn_rate=0.0,
        region50=(0.0, 50.0, 0.0, 5.0),
        region90=(0.0, 50.0, 0.0, 50.0),
        cloud=(),
    )


def write_metrics(folder, lines):
    with FrameWriter(folder / "frames.npy.gz") as writer:
        for _, of_frame in groupby(lines, key=lambda line: line.frame):
            writer.write(list(of_frame))


def write_timings(folder, frames, seconds):
    lines = (json.dumps({"frame": frame, "seconds": seconds}) + "\n" for frame in frames)
    (folder / "timings.jsonl").write_text("".join(lines))


@pytest.fixture
def truth(tmp_path):
    path = tmp_path / "truth.txt"
    path.write_text(format_truth([(10.0 * i, 10.0, 20.0, 20.0) for i in range(4)]))
    return path


def test_rows_of_the_truth_are_frame_indices(tmp_path, truth):
    lines = [metrics(i, (10.0 * i, 10.0, 20.0, 20.0)) for i in (1, 2, 3, 4, 5)]
    lines[1] = replace(lines[1], status="lost", active=("hue", "flow"))
    write_metrics(tmp_path, lines)
    write_timings(tmp_path, range(1, 6), 0.1)
    got = score_run(tmp_path, truth)
    assert (got.frames, got.mean_iou, got.lost_when_on) == (3, 1.0, pytest.approx(1 / 3))
    assert got.fps == pytest.approx(10) and got.mean_active == pytest.approx(4 / 3)
    assert got.coverage50 == (1.0, 0.0) and got.coverage90 == (1.0, 1.0)


def test_the_first_lost_frame_is_a_number_of_the_source(tmp_path):
    rows = [(10.0, 10.0, 20.0, 20.0)] * 40
    rows[7] = (float("nan"),) * 4
    (tmp_path / "truth.txt").write_text(format_truth(rows))
    lines = [metrics(i, (10, 10, 20, 20) if i < 19 else (500, 10, 20, 20)) for i in range(4, 40, 3)]
    write_metrics(tmp_path, lines)
    got = score_run(tmp_path, tmp_path / "truth.txt")
    assert (got.scored_frames, got.lost_episodes, got.first_lost) == (11, 1, 19)


def write_ended(folder, frames):
    end = RunEnded(frames, frames, True, "end_of_source")
    (folder / "journal.jsonl").write_text(to_json(end) + "\n")


def still(folder, absent=()):
    rows = [(float("nan"),) * 4 if i in absent else (10.0, 10.0, 20.0, 20.0) for i in range(12)]
    (folder / "truth.txt").write_text(format_truth(rows))
    return folder / "truth.txt"


def test_frames_after_the_end_of_a_target_count_as_lost(tmp_path):
    write_metrics(tmp_path, [metrics(i, (10, 10, 20, 20)) for i in range(2, 6)])
    write_timings(tmp_path, range(14), 0.1)
    write_ended(tmp_path, 14)
    got = score_run(tmp_path, still(tmp_path, absent=[8]))
    assert (got.frames, got.scored_frames, got.reported_lost) == (10, 9, 6)
    assert got.mean_iou == pytest.approx(4 / 9) == got.precision20
    assert (got.lost_episodes, got.first_lost, got.lost_when_off, got.lost_when_on) == (1, 6, 1.0, 0.0)
    # What an ended target does not have is no part of the means.
    assert got.mean_active == 1.0 and got.coverage90 == (1.0, 1.0) and got.fps == pytest.approx(10)
    assert got.long_recall == pytest.approx(3 / 8) and got.long_precision == 1.0


def test_frames_of_other_targets_show_the_end_without_timings(tmp_path):
    lines = [metrics(i, (10, 10, 20, 20), str(n)) for i in range(6) for n in (1, 2) if n == 2 or i < 3]
    write_metrics(tmp_path, lines)
    assert score_run(tmp_path, still(tmp_path), target="1").mean_iou == pytest.approx(3 / 6)
    assert score_run(tmp_path, still(tmp_path), target="2").mean_iou == 1.0


def test_a_frame_that_a_killed_run_only_timed_is_not_lost(tmp_path):
    write_metrics(tmp_path, [metrics(i, (10, 10, 20, 20)) for i in range(3)])
    write_timings(tmp_path, range(4), 0.1)
    assert score_run(tmp_path, still(tmp_path)).frames == 3


def test_without_timings_there_is_no_rate(tmp_path, truth):
    write_metrics(tmp_path, [metrics(0, (0.0, 10.0, 20.0, 20.0))])
    assert score_run(tmp_path, truth).fps is None


def test_a_line_cut_off_at_the_end_is_left_out(tmp_path, truth):
    write_metrics(tmp_path, [metrics(0, (0.0, 10.0, 20.0, 20.0))])
    with (tmp_path / "frames.npy.gz").open("ab") as file:
        file.write(b"\x1f\x8b\x08")
    assert score_run(tmp_path, truth).frames == 1


def test_several_targets_must_be_told_apart(tmp_path, truth):
    write_metrics(tmp_path, [metrics(0, (0, 10, 20, 20), "1"), metrics(0, (0, 10, 20, 10), "2")])
    with pytest.raises(ValueError, match=r"several targets \(1, 2\); name one"):
        score_run(tmp_path, truth)
    assert score_run(tmp_path, truth, target="2").mean_iou == 0.5
    with pytest.raises(ValueError, match="no target '3'; there are 1, 2"):
        score_run(tmp_path, truth, target="3")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("frames.npy.gz", "a text that is longer than a header\n", r"frames.npy.gz: byte 0: no frame begins"),
        ("frames.npy.gz", "", r"no target ''; there are none"),
        ("timings.jsonl", '{"frame": 0}\n', r"timings.jsonl:1: expected an object with frame and seconds"),
        ("timings.jsonl", '{"frame": 9, "seconds": 1}\n', r"timings.jsonl: no time for frame 0"),
    ],
)
def test_damaged_files_are_named(tmp_path, truth, name, text, message):
    write_metrics(tmp_path, [metrics(0, (0, 10, 20, 20))])
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        score_run(tmp_path, truth)


def test_a_truth_of_other_frames_is_refused(tmp_path, truth):
    write_metrics(tmp_path, [metrics(9, (0, 10, 20, 20))])
    with pytest.raises(ValueError, match="4 boxes, none of them for a frame of"):
        score_run(tmp_path, truth)
