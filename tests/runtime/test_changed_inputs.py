"""Files that something else changes while a run reads them: the run says so, and vouches for what it read."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import Result, Start, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime import session
from bayesnet_track.runtime.checkpoints.origins import file_sha256
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.results import Summary
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 5


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The first frames of a scene as images."""
    (tmp_path / "frames").mkdir()
    for frame in SceneSource.named("two_squares", 0, FRAMES):
        assert isinstance(frame, Frame)
        cv2.imwrite(str(tmp_path / "frames" / f"{frame.index:03}.png"), frame.image)
    return tmp_path / "frames"


def start() -> list[Start]:
    return [Start(SceneSource.named("two_squares", 0, 1).scene.start_box)]


def blackened(path: Path) -> None:
    image = cv2.imread(str(path))
    cv2.imwrite(str(path), np.zeros_like(image))


@pytest.mark.parametrize("number", [0, 1, 3])
def test_an_image_that_is_changed_during_the_run_is_damage_of_the_source(
    folder: Path, tmp_path: Path, number: int
) -> None:
    """Whether it was read before or after, and whichever of them it is."""
    summary = Summary()
    results = track("two_squares", str(folder), start(), out=tmp_path / "run", summary=summary)
    next(results)
    blackened(folder / f"{number:03}.png")
    assert len(list(results)) == FRAMES - 1
    assert not summary.complete and summary.reason == "source_damaged"
    *_, damaged, ended = open_run(tmp_path / "run").events
    assert damaged.frame == FRAMES and damaged.reason == f"changed while it was read: {number:03}.png"
    assert isinstance(ended, RunEnded) and not ended.complete


def test_it_is_exit_code_5(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = Recorder.frame

    def then_changed(recorder: Recorder, result: Result) -> None:
        frame(recorder, result)
        blackened(folder / "002.png")

    monkeypatch.setattr(Recorder, "frame", then_changed)
    box = ",".join(str(side) for side in start()[0].box)
    given = ["run", "two_squares", "--source", str(folder), "--init", box, "--out", str(tmp_path / "run")]
    assert main(given) == 5
    assert "changed while it was read: 002.png" in capsys.readouterr().err


def test_images_that_come_or_go_meanwhile_were_not_read_wrongly(folder: Path, tmp_path: Path) -> None:
    summary = Summary()
    results = track("two_squares", str(folder), start(), out=tmp_path / "run", summary=summary)
    for _ in islice(results, 3):
        pass
    (folder / "000.png").unlink()
    (folder / "009.png").write_bytes((folder / "002.png").read_bytes())
    list(results)
    assert summary.complete


def births(tmp_path: Path) -> Path:
    """A graph that starts targets where a file has detections."""
    path = tmp_path / "born.yaml"
    path.write_text(
        "bayesnet: 1\nname: born\ntargets:\n  one:\n    birth: {detector: detections}\n    nodes:\n"
        "      one: {belief: {particles: {size: 50}}, motion: {random_walk: {sd_px: {x: 2, y: 2}}}}\n"
        "      color: {parent: one, agent: color_histogram}\n"
    )
    return path


def rewritten(path: Path) -> None:
    path.write_text(path.read_text().replace("0.9", "0.8"))


def test_detections_that_change_while_they_are_loaded_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    detections = tmp_path / "found.txt"
    detections.write_text("1,-1,270,190,40,40,0.9,-1,-1,-1\n")
    prepare: Callable[..., object] = session.prepare

    def then_rewritten(*given: object) -> object:
        engine = prepare(*given)
        rewritten(detections)
        return engine

    monkeypatch.setattr(session, "prepare", then_rewritten)
    source = SceneSource.named("two_squares", 0, 2)
    with pytest.raises(SourceError, match=r"found\.txt': changed while it was read"):
        track(births(tmp_path), source, detections=detections, out=tmp_path / "run")
    assert not (tmp_path / "run" / "run.json").exists()


def test_detections_that_change_later_are_those_of_the_start(tmp_path: Path) -> None:
    detections = tmp_path / "found.txt"
    detections.write_text("1,-1,270,190,40,40,0.9,-1,-1,-1\n")
    sha256 = file_sha256(detections)
    source = SceneSource.named("two_squares", 0, 2)
    results = track(births(tmp_path), source, detections=detections, out=tmp_path / "run")
    next(results)
    rewritten(detections)
    with pytest.warns(InputNotice, match=r"found\.txt: changed during the run, which used what it held"):
        list(results)
    given = Recipe.read(tmp_path / "run").detections
    assert given is not None and given.sha256 == sha256 != file_sha256(detections)
    begun = json.loads((tmp_path / "run" / "journal.jsonl").read_text().splitlines()[0])
    assert begun["inputs"] == {str(detections): sha256}
