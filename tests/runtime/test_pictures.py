"""The pictures of a run, read again: from the source, from the run's video, or not at all and why."""

import shutil

import cv2
import numpy as np
import pytest

from bayesnet_track import open_run
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.recording.run_reader import pictures_of
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.sources.sources import open_source
from bayesnet_track.view import run_page


@pytest.fixture
def tracked(tmp_path):
    """A run of six frames on a folder of images, with its video; (run, images)."""
    images = tmp_path / "images"
    images.mkdir()
    rng = np.random.default_rng(2)
    picture = rng.integers(60, 100, (56, 72, 3), dtype=np.uint8)
    for number in range(8):
        picture[:] = picture.mean() + number
        picture[14:26, 20:36] = (30, 130, 240)
        cv2.imwrite(str(images / f"{number:04d}.png"), picture)
    run = tmp_path / "run"
    line = ["run", "gray_square", "--source", str(images), "--init", "20,14,16,12", "--out", str(run)]
    assert main([*line, "--start", "2", "--quiet", "--video"]) == 0
    return run, images


def found(run):
    directory = RunDirectory.open(run)
    started = open_run(directory.path).events[0]
    with pictures_of(directory, started, 2, 7) as (pictures, missing):
        if pictures is None:
            return None, missing
        return {frame: image for frame, image in pictures.images}, pictures.annotated


@pytest.mark.parametrize("has_recipe", [True, False])
def test_the_source_is_opened_again_also_for_runs_without_a_recipe(tracked, has_recipe):
    run, images = tracked
    if not has_recipe:
        (run / "run.json").unlink()
    pictures, annotated = found(run)
    assert list(pictures) == [2, 3, 4, 5, 6, 7] and not annotated
    np.testing.assert_array_equal(pictures[4], cv2.imread(str(images / "0004.png")))


def test_without_its_source_the_annotated_video_is_shown(tracked):
    run, images = tracked
    shutil.rmtree(images)
    pictures, annotated = found(run)
    assert list(pictures) == [2, 3, 4, 5, 6, 7] and annotated


def test_a_video_that_was_scaled_down_is_shown_in_the_size_of_the_source(tracked):
    run, images = tracked
    small = run.with_name("small")
    line = ["run", "gray_square", "--source", str(images), "--init", "20,14,16,12", "--out", str(small)]
    assert main([*line, "--start", "2", "--quiet", "--video", "--video-side", "36"]) == 0
    with open_source(str(small / "video.mkv")) as video:
        assert (video.width, video.height) == (36, 28)
    shutil.rmtree(images)
    pictures, annotated = found(small)
    assert [image.shape for image in pictures.values()] == 6 * [(56, 72, 3)] and annotated
    sharp = cv2.blur(found(run)[0][4], (5, 5))
    assert np.corrcoef(cv2.blur(pictures[4], (5, 5)).ravel(), sharp.ravel())[0, 1] > 0.9


def test_a_size_without_a_video_is_refused(tracked, capsys):
    run, images = tracked
    line = ["run", "gray_square", "--source", str(images), "--init", "20,14,16,12", "--out", str(run)]
    assert main([*line, "--overwrite", "--video-side", "36"]) == 2
    assert "--video-side is for --video" in capsys.readouterr().err


def test_without_either_it_says_why(tracked):
    run, images = tracked
    for path in images.iterdir():
        cv2.imwrite(str(path), np.zeros((30, 40, 3), np.uint8))
    (run / "video.mkv").unlink()
    pictures, missing = found(run)
    assert pictures is None
    assert "40x30 px now, and was 72x56" in missing and "no video.mkv" in missing


def test_report_works_without_pictures_and_names_what_is_missing(tracked, capsys):
    run, images = tracked
    shutil.rmtree(images)
    (run / "video.mkv").unlink()
    assert main(["report", str(run)]) == 0
    assert "the page has no pictures" in capsys.readouterr().err
    assert (run / "report.html").read_text().count("<script>") == 1


def test_report_refuses_folders_of_others_and_what_is_no_run(tracked, tmp_path):
    run, images = tracked
    assert main(["report", str(run), "--frames", "full", "--out", str(images)]) == 2
    assert main(["report", str(tmp_path)]) == 4
    assert main(["report", str(run), "--out", str(images)]) == 2
    mine, page = tmp_path / "mine.html", tmp_path / "page.html"
    mine.write_text("<p>mine</p>")
    assert main(["report", str(run), "--out", str(mine)]) == 2 and mine.read_text() == "<p>mine</p>"
    assert [main(["report", str(run), "--out", str(page)]) for _ in range(2)] == [0, 0]
    assert main(["report", str(run), "--frames", "full", "--out", str(tmp_path / "page")]) == 0
    names = {path.name for path in (tmp_path / "page" / "frames").iterdir()}
    assert names == {f"{frame:06d}.jpg" for frame in range(2, 8)}


def test_a_report_that_was_killed_can_be_made_again(tracked, tmp_path, monkeypatch):
    run, _ = tracked
    pictures = run_page.full_pictures

    def killed(images):
        for picture in pictures(images):
            yield picture
            raise KeyboardInterrupt

    again = ["report", str(run), "--frames", "full"]
    for out in ([], ["--out", str(tmp_path / "page")]):
        monkeypatch.setattr(run_page, "full_pictures", killed)
        assert main([*again, *out]) == 130
        monkeypatch.setattr(run_page, "full_pictures", pictures)
        assert main([*again, *out]) == 0
    page = tmp_path / "page" / "index.html"
    before = page.read_bytes()
    assert b"<script" in before and len(list((tmp_path / "page" / "frames").iterdir())) == 6

    def torn(*_):
        yield "half a page"
        raise KeyboardInterrupt

    monkeypatch.setattr(run_page, "with_folder", torn)
    assert main([*again, *out]) == 130 and page.read_bytes() == before, "the page is whole at any moment"


def test_report_of_a_killed_run_shows_what_is_there(tracked):
    run, _ = tracked
    with (run / "frames.npy.gz").open("ab") as file:
        file.write(b'{"event": "frame_met')
    journal = (run / "journal.jsonl").read_text().splitlines()
    (run / "journal.jsonl").write_text("\n".join(journal[:2]) + "\n")
    (run / "graph.yaml").unlink()
    assert main(["report", str(run), "--frames", "none"]) == 0
