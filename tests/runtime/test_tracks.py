"""Tracks as MOT and CSV: columns, conventions, stable bytes."""

import csv

import pytest

from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.runtime.recording.tracks import CSV_COLUMNS, CsvWriter, MotWriter, Tracked


def metrics(frame, target="square", box=(30.0, 35.0, 41.0, 31.0), **more):
    values = {
        "time_s": frame * 0.04,
        "map": box,
        "sd": (1.0,) * 4,
        "ud_px2": 212.34567,
        "ud_nodes": {},
        "quiet_px2": None,
        "status": "tracking",
        "score": 0.87654321,
        "log_evidence": -1.0,
        "surprise": 0.4,
        "ess": 10.0,
        "particles": 20,
        "active": ("color", "motion"),
        "kl": {},
        "contribution": {},
        "agent_ud_px2": {},
        "strength": {},
        "learn_rate": 0.0,
        "region50": (0.0,) * 4,
        "region90": (0.0,) * 4,
        "cloud": (),
    }
    return FrameMetrics(frame=frame, target=target, centre_box=box, **(values | more))


def lines_of(writer_class, path, rows):
    with writer_class(path) as writer:
        for row in rows:
            writer.write(Tracked.of([row]))
            writer.flush()
    data = path.read_bytes()
    assert b"\r" not in data
    return data.decode().splitlines()


def test_mot_lines_count_from_1_and_hold_the_corner_box(tmp_path):
    lines = lines_of(MotWriter, tmp_path / "t", [metrics(0), metrics(1, box=(0.0, 0.0, 1.0, 1.0), score=1.0)])
    assert lines == [
        "1,1,10.000,20.000,41.000,31.000,0.876543,-1,-1,-1",
        "2,1,0.000,0.000,1.000,1.000,1.000000,-1,-1,-1",
    ]
    assert {len(line.split(",")) for line in lines} == {10}


def test_mot_ids_are_given_in_the_order_of_appearance(tmp_path):
    rows = [metrics(0, "b"), metrics(0, "a"), metrics(1, "a"), metrics(1, "b")]
    lines = lines_of(MotWriter, tmp_path / "t", rows)
    assert [line.split(",")[1] for line in lines] == ["1", "2", "2", "1"]


def test_csv_has_the_documented_columns(tmp_path):
    lines = lines_of(CsvWriter, tmp_path / "t", [metrics(3, status="lost"), metrics(4, active=())])
    rows = list(csv.DictReader(lines))
    assert tuple(rows[0]) == CSV_COLUMNS
    assert rows[0] == {
        "frame": "3",
        "time_s": "0.120000",
        "target": "square",
        "x": "10.000",
        "y": "20.000",
        "w": "41.000",
        "h": "31.000",
        "status": "lost",
        "score": "0.876543",
        "ud_px2": "212.346",
        "active": "color motion",
    }
    assert rows[1]["active"] == ""


def test_the_csv_header_is_there_before_the_first_frame(tmp_path):
    assert lines_of(CsvWriter, tmp_path / "t", []) == [",".join(CSV_COLUMNS)]


@pytest.mark.parametrize("writer_class", [MotWriter, CsvWriter])
def test_minus_zero_is_written_as_zero(tmp_path, writer_class):
    text = "\n".join(lines_of(writer_class, tmp_path / "t", [metrics(0, box=(-1e-9, -0.0, 1.0, 1.0))]))
    assert "-0" not in text


@pytest.mark.parametrize("writer_class", [MotWriter, CsvWriter])
def test_a_frame_is_in_the_file_once_it_is_flushed(tmp_path, writer_class):
    writer = writer_class(tmp_path / "t")
    before = (tmp_path / "t").read_bytes()
    writer.write(Tracked.of([metrics(0)]))
    assert (tmp_path / "t").read_bytes() == before
    writer.flush()
    assert len((tmp_path / "t").read_bytes().splitlines()) == len(before.splitlines()) + 1
    writer.close()


def test_lost_targets_may_be_left_out_of_mot_and_never_of_csv(tmp_path):
    """Numbers are given when a target appears, lost or not."""
    rows = [metrics(0, "a", status="lost"), metrics(0, "b"), metrics(1, "a"), metrics(1, "b", status="lost")]
    with MotWriter(tmp_path / "tracks.txt", lost=False) as writer:
        for row in rows:
            writer.write(Tracked.of([row]))
    kept = [line.split(",")[:2] for line in (tmp_path / "tracks.txt").read_text().splitlines()]
    assert kept == [["1", "2"], ["2", "1"]]
    assert len(lines_of(CsvWriter, tmp_path / "tracks.csv", rows)) == 5
