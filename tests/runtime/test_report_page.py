"""The page of a run as a text: what a notebook shows is what `report` writes."""

import shutil

import pytest

from bayesnet_track import open_run
from bayesnet_track.cli.main import main
from bayesnet_track.evaluate.truth import read_truth
from bayesnet_track.runtime.recording.run_reader import page_html
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.view.run_page import LARGEST


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "run"
    assert main(["demo", "two_squares", "--end", "6", "--quiet", "--out", str(out)]) == 0
    return open_run(out)


def test_a_page_has_the_pictures_and_the_truth_that_a_report_has(run, tmp_path):
    assert main(["report", str(run.directory.path), "--out", str(tmp_path / "page.html")]) == 0
    assert run.page(read_truth(run.directory.truth), largest=LARGEST).html == (
        tmp_path / "page.html"
    ).read_text("utf-8")
    assert run.page().html != run.page(read_truth(run.directory.truth)).html


def test_the_page_of_a_run_without_frames_says_so(run, tmp_path):
    shutil.copytree(run.directory.path, tmp_path / "run")
    (tmp_path / "run/frames.npy.gz").write_text("")
    page = page_html(RunDirectory(tmp_path / "run"), run.events, (), None, 1)
    assert page.startswith("<!doctype html>") and page.endswith("</html>\n")
    with pytest.raises(ValueError, match="it does not begin with run_started"):
        page_html(run.directory, (), (), None, 1)
