"""What a crowd's run writes by default and on request, and what is made of it afterwards."""

from __future__ import annotations

import csv
import io
import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.frame_file import FrameFile
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.recording.verify import verify

PEOPLE, FRAMES = 12, 8


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Black images, and detections of people who walk apart, with their identities."""
    folder = tmp_path_factory.mktemp("crowd")
    (folder / "images").mkdir()
    rng = np.random.default_rng(0)
    lines = []
    for frame, person in itertools.product(range(FRAMES), range(PEOPLE)):
        if person == 0:
            cv2.imwrite(str(folder / "images" / f"{frame:03}.png"), np.zeros((240, 640, 3), np.uint8))
        x, y = 20 + 50 * person + frame + rng.normal(0, 0.3), 60 + 2 * frame + rng.normal(0, 0.3)
        lines.append(f"{frame + 1},{person + 1},{x:.3f},{y:.3f},24,60,0.9")
    (folder / "people.txt").write_text("\n".join(lines) + "\n")
    return folder


def begun(crowd: Path, run: Path, frames: int | None = None, graph: str = "sort", **options: bool) -> Path:
    """A run of the crowd, or its first frames."""
    results = track(graph, crowd / "images", out=run, detections=crowd / "people.txt", **options)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return run


def test_only_the_mot_file_has_the_boxes_as_text_unless_csv_is_asked_for(crowd: Path, tmp_path: Path) -> None:
    run, both = begun(crowd, tmp_path / "run"), begun(crowd, tmp_path / "both", tracks_csv=True)
    assert (run / "tracks.txt").read_bytes() == (both / "tracks.txt").read_bytes() != b""
    assert not (run / "tracks.csv").exists()
    assert verify(run).status == verify(both).status == "verified"
    assert verify(both).outputs["tracks.csv"] == "ok"


def test_export_makes_what_the_csv_has(
    crowd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = begun(crowd, tmp_path / "both", tracks_csv=True)
    assert main(["export", str(both), "--format", "csv"]) == 0
    exported = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    with (both / "tracks.csv").open(encoding="utf-8") as file:
        written = list(csv.DictReader(file))
    assert len(exported) == len(written) > PEOPLE
    for ours, theirs in zip(exported, written, strict=True):
        for name in ("frame", "target", "status", "active"):
            assert ours[name] == theirs[name]
        for name in ("time_s", "x", "y", "w", "h", "score"):
            assert float(ours[name]) == pytest.approx(float(theirs[name]), abs=6e-4)
        assert float(ours["ud_px2"]) == pytest.approx(float(theirs["ud_px2"]), rel=1e-3, abs=6e-4)


@pytest.mark.parametrize("option", ["--no-lost", "--lost"])
def test_export_as_mot_has_the_digits_of_the_file(
    crowd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    run = begun(crowd, tmp_path / "run")
    assert main(["export", str(run), "--format", "mot", option]) == 0
    exported = capsys.readouterr().out.splitlines()
    assert set((run / "tracks.txt").read_text().splitlines()) <= set(exported)


def test_an_interrupted_run_goes_on_with_the_files_that_it_has(crowd: Path, tmp_path: Path) -> None:
    for number, asked in enumerate((False, True)):
        whole = begun(crowd, tmp_path / f"whole{number}", tracks_csv=asked)
        run = begun(crowd, tmp_path / f"run{number}", 4, tracks_csv=asked)
        list(resume(run))
        assert (run / "tracks.csv").exists() is asked
        for name in ("tracks.txt", "frames.npy.gz", *["tracks.csv"] * asked):
            assert (run / name).read_bytes() == (whole / name).read_bytes(), name


def test_a_crowd_has_widths_of_three_digits_and_all_digits_on_request(crowd: Path, tmp_path: Path) -> None:
    short = begun(crowd, tmp_path / "short", graph="kalman_detections")
    precise = begun(crowd, tmp_path / "precise", graph="kalman_detections", all_hypotheses=True)
    columns = [next(FrameFile(run / "frames.npy.gz").columns()) for run in (short, precise)]
    assert [one["sd"].dtype for one in columns] == [np.float16, np.float32]
    assert all(one["box"].dtype == one["score"].dtype == np.float32 for one in columns)
    pairs = list(zip(open_run(short).metrics, open_run(precise).metrics, strict=True))
    assert len(pairs) > PEOPLE and any(ours.sd != theirs.sd for ours, theirs in pairs)
    for ours, theirs in pairs:
        assert ours.centre_box == theirs.centre_box and ours.score == theirs.score
        assert ours.log_evidence == theirs.log_evidence
        assert ours.sd == pytest.approx(theirs.sd, rel=6e-4)
        assert ours.region90 == pytest.approx(theirs.region90, abs=2e-3 * max(theirs.sd))
        assert ours.p_values == pytest.approx(theirs.p_values, rel=6e-4)
        assert ours.quiet_px2 == (None if theirs.quiet_px2 is None else pytest.approx(theirs.quiet_px2, 6e-4))


def test_score_of_a_csv_that_was_not_written_reads_the_same_boxes(
    crowd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, truth = begun(crowd, tmp_path / "run"), str(crowd / "people.txt")
    assert main(["score", str(run / "tracks.txt"), "--truth", truth]) == 0
    expected = capsys.readouterr().out
    assert main(["score", str(run / "tracks.csv"), "--truth", truth]) == 0
    said = capsys.readouterr()
    assert said.out == expected and "run --tracks-csv" in said.err and "tracks.txt" in said.err
    assert main(["score", str(tmp_path / "tracks.csv"), "--truth", truth]) != 0
