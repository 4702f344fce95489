"""`learn-shape`: from masks and from boxes, and what it says when something is wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.vision.shape import load_model


def ellipse(across: int, down: int, ink: int = 255, ground: int = 0) -> np.ndarray:
    image = np.full((120, 160), ground, np.uint8)
    cv2.ellipse(image, (80, 60), (across, down), 0, 0, 360, ink, -1)
    return image


@pytest.fixture
def masks(tmp_path: Path) -> Path:
    folder = tmp_path / "masks"
    folder.mkdir()
    for number, across in enumerate((20, 24, 28, 32)):
        cv2.imwrite(str(folder / f"{number}.png"), ellipse(across, 40))
    (folder / "notes.txt").write_text("not a mask")
    return folder


@pytest.fixture
def video(tmp_path: Path) -> tuple[Path, Path]:
    folder = tmp_path / "video"
    folder.mkdir()
    boxes = []
    for number, across in enumerate((20, 24, 28, 32)):
        cv2.imwrite(str(folder / f"{number}.png"), ellipse(across, 40, 190, 80))
        boxes.append(f"{80 - across},20,{2 * across + 1},81\n")
    (tmp_path / "boxes.txt").write_text("".join(boxes) + "nan,nan,nan,nan\n")
    return folder, tmp_path / "boxes.txt"


def test_masks_and_boxes_give_the_same_model(
    masks: Path, video: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = tmp_path / "a.npz", tmp_path / "b.npz"
    assert main(["learn-shape", str(a), "--masks", str(masks)]) == 0
    said = capsys.readouterr().out
    assert "4 examples, grid 16x16, 1 mode with" in said  # wider and narrower is one direction
    assert main(["learn-shape", str(b), "--source", str(video[0]), "--truth", str(video[1])]) == 0
    first, second = load_model(a), load_model(b)
    # edges of the picture and of the mask may lie a pixel apart, of 28 to 40 px half sides
    assert np.abs(first.mean - second.mean).max() < 0.1
    assert first.variances[0] == pytest.approx(second.variances[0], rel=0.3)
    assert first.modes[0] @ second.modes[0] > 0.9


def test_boxes_after_the_last_frame_are_said(
    video: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    long = tmp_path / "long.txt"
    rows = video[1].read_text().splitlines()
    long.write_text("\n".join([*rows, *rows[-1:] * 3]) + "\n")
    command = ["learn-shape", str(tmp_path / "m.npz"), "--source", str(video[0]), "--truth"]
    assert main([*command, str(long)]) == 0
    assert f"{long} has 8 rows, " in (said := capsys.readouterr().err)
    assert "4 frames: is it of this video? Not used: rows 4 to 7, counted from 0" in said


def test_every_and_grid_are_obeyed(video: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "m.npz"
    options = ["--source", str(video[0]), "--truth", str(video[1]), "--every", "2", "--grid", "8"]
    assert main(["learn-shape", str(out), *options]) == 0
    assert (load_model(out).examples, load_model(out).grid) == (2, 8)


def test_what_shows_no_silhouette_is_left_out(
    video: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(video[0] / "2.png"), np.full((120, 160), 80, np.uint8))
    options = ["--source", str(video[0]), "--truth", str(video[1])]
    assert main(["learn-shape", str(tmp_path / "m.npz"), *options]) == 0
    assert "1 left out, with too little of the silhouette on edges: frame 2" in capsys.readouterr().err
    assert load_model(tmp_path / "m.npz").examples == 3


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (["--masks", "none"], 2, "none: No such file"),
        (["--masks", "."], 2, "holds no images"),
        (["--masks", "black"], 2, "0.png: the mask is empty"),
        (["--source", "video"], 2, "--source and --truth belong together"),
        (["--source", "video", "--truth", "none.txt"], 2, "none.txt: No such file"),
        (["--source", "none", "--truth", "boxes.txt"], 4, "source 'none'"),
        (["--source", "video", "--truth", "absent.txt"], 2, "no box for any frame"),
        (["--source", "flat", "--truth", "boxes.txt"], 2, "no example is left of 1; nothing is written"),
    ],
)
@pytest.mark.usefixtures("masks", "video")
def test_mistakes_are_told_and_nothing_is_written(
    change: list[str],
    code: int,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("black", "flat"):
        Path(name).mkdir()
        cv2.imwrite(f"{name}/0.png", np.zeros((120, 160), np.uint8))
    Path("absent.txt").write_text("nan,nan,nan,nan\n")
    assert main(["learn-shape", "m.npz", *change]) == code
    assert said in capsys.readouterr().err
    assert not Path("m.npz").exists()


def test_a_model_that_cannot_be_written_says_so(masks: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["learn-shape", "/no/such/folder/m.npz", "--masks", str(masks)]) == 6
    assert "cannot write: No such file" in capsys.readouterr().err


@pytest.mark.parametrize("option", [["--grid", "3"], ["--keep", "0"], ["--edge-gray", "nan"], []])
def test_arguments_out_of_range_are_refused(option: list[str], masks: Path) -> None:
    given = ["--masks", str(masks)] if option else []
    with pytest.raises(SystemExit) as stopped:
        main(["learn-shape", "m.npz", *given, *option])
    assert stopped.value.code == 2
