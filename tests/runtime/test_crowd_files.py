"""What a crowd's run writes by default and on request, and what is made of it afterwards."""

from __future__ import annotations

import csv
import io
import itertools
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.frame_file import FrameFile
from bayesnet_track.runtime.checkpoints import standing
from bayesnet_track.runtime.checkpoints.resume import ResumeError, resume
from bayesnet_track.runtime.checkpoints.standing import verify
from bayesnet_track.runtime.recording import record

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


MOST = 40
"""Boxes that are kept as text in these tests. The sixth frame has more; the first has none."""


@pytest.fixture
def short_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (record, standing):
        monkeypatch.setattr(module, "MOST_BOXES", MOST)


@pytest.mark.usefixtures("short_limit")
def test_a_long_crowd_has_its_boxes_once_and_every_reader_finds_them(
    crowd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.warns(UserWarning, match="more than 40 boxes .* writes them as text"):
        run = begun(crowd, tmp_path / "run")
    assert not (run / "tracks.txt").exists() and verify(run).status == "verified"
    monkeypatch.setattr(record, "MOST_BOXES", 10_000)
    whole, truth = begun(crowd, tmp_path / "whole"), str(crowd / "people.txt")
    assert main(["export", str(run), "--format", "mot"]) == 0
    exported = [[float(word) for word in line.split(",")] for line in capsys.readouterr().out.splitlines()]
    kept = [[float(word) for word in line.split(",")] for line in (whole / "tracks.txt").open()]
    assert np.array(exported) == pytest.approx(np.array(kept), abs=1.1e-3) and len(kept) > MOST
    told = []
    for given in (whole, run, run / "tracks.txt", run / "tracks.csv"):
        assert main(["score", str(given), "--truth", truth]) == 0
        told.append(capsys.readouterr())
    words = [[float(line.split()[1]) for line in one.out.splitlines()] for one in told]
    assert len(words[0]) > 10 and all(one == pytest.approx(words[0], abs=2e-3) for one in words[1:])
    assert "not written; read" in told[2].err and "not written; read" in told[3].err
    assert main(["compare", str(run), str(whole), "--truth", truth]) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("short_limit")
@pytest.mark.filterwarnings("ignore:.*more than 40 boxes")
def test_a_long_crowd_that_was_broken_off_anywhere_ends_with_the_same_files(
    crowd: Path, tmp_path: Path
) -> None:
    whole = begun(crowd, tmp_path / "whole")
    for frames in range(1, FRAMES):
        run = begun(crowd, tmp_path / f"run{frames}", frames)
        # A kill after the text was removed, and before the next checkpoint:
        (run / "tracks.txt").unlink(missing_ok=frames > 5)
        if frames <= 5:
            with pytest.raises(ResumeError, match=r"tracks\.txt"):
                list(resume(run))
            continue
        list(resume(run))
        assert {path.name for path in run.iterdir()} == {path.name for path in whole.iterdir()}
        for name in ("frames.npy.gz", "journal.jsonl"):
            assert (run / name).read_bytes() == (whole / name).read_bytes(), name


@pytest.mark.usefixtures("short_limit")
@pytest.mark.filterwarnings("ignore:.*more than 40 boxes")
def test_the_text_may_be_gone_where_a_checkpoint_still_counts_on_it(crowd: Path, tmp_path: Path) -> None:
    run = begun(crowd, tmp_path / "run", 4)
    checkpoint, early = (run / "checkpoint").read_bytes(), (run / "tracks.txt").read_bytes()
    for _ in itertools.islice(resume(run), 3):
        pass
    assert early and not (run / "tracks.txt").exists()
    (run / "checkpoint").write_bytes(checkpoint)
    results = resume(run)
    next(results)  # what follows the checkpoint is cut off, and the process is killed again
    again = Path(shutil.copytree(run, tmp_path / "again", ignore=shutil.ignore_patterns(".lock")))
    results.close()
    assert len(FrameFile(again / "frames.npy.gz")) < 4
    list(resume(again))
    whole = begun(crowd, tmp_path / "whole")
    assert not (again / "tracks.txt").exists()
    assert (again / "frames.npy.gz").read_bytes() == (whole / "frames.npy.gz").read_bytes()
