"""`learn-stereo`: how much the features of a rendered person vary, and what it says of mistakes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from bayesnet_track.cli.main import main
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.sources.scenes.library import format_truth
from bayesnet_track.vision.calibration import RectifiedPair, write_calibration

FRAMES = range(0, 60, 4)
SET = ["--set", "max_depth_m=6", "--set", "camera_height_m=1.2"]
DEFAULT = {name: 0.3 for name in ("sd_depth_m", "sd_spread_m", "sd_log_shape")} | {"sd_height_m": 0.25}


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Scene]:
    """Every fourth picture of a person who walks to and fro, as folders of both eyes and of true depth."""
    folder, scene = tmp_path_factory.mktemp("filmed"), make_scene("person_stereo", 0)
    assert scene.stereo is not None
    for name in ("left", "right", "depth"):
        (folder / name).mkdir()
    for index in FRAMES:
        cv2.imwrite(str(folder / f"left/{index:02d}.png"), scene.frames[index])
        cv2.imwrite(str(folder / f"right/{index:02d}.png"), scene.stereo.right[index])
        np.save(folder / f"depth/{index:02d}.npy", scene.stereo.true_depth(index).astype(np.float32))
    (folder / "truth.txt").write_text(format_truth(scene.truth[FRAMES.start : FRAMES.stop : FRAMES.step]))
    write_calibration(folder / "pair.yml", RectifiedPair(scene.width, scene.height, scene.stereo.geometry))
    return folder, scene


@pytest.fixture
def work(filmed: tuple[Path, Scene], monkeypatch: pytest.MonkeyPatch) -> Scene:
    monkeypatch.chdir(filmed[0])
    return filmed[1]


PAIR = ["--source", "left", "--right", "right", "--calibration", "pair.yml"]
EXACT = ["--source", "left", "--depth", "depth", "--calibration", "pair.yml"]
TRUTH = ["--truth", "truth.txt"]


def learnt(capsys: pytest.CaptureFixture[str], *options: str) -> dict[str, float]:
    assert main(["learn-stereo", *options, *TRUTH, *SET]) == 0
    return yaml.safe_load(capsys.readouterr().out)["stereo"]


def true_depths(scene: Scene) -> np.ndarray:
    assert scene.stereo is not None
    return np.asarray(scene.stereo.depths_m[1])[FRAMES.start : FRAMES.stop : FRAMES.step]


@pytest.mark.slow
def test_with_true_depth_it_is_the_variance_of_the_walk(
    work: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three digits are printed. A block is flat, so that its depth does not spread: 1 % of the default."""
    found = learnt(capsys, *EXACT, "--prior", "0")
    assert found["sd_depth_m"] == pytest.approx(true_depths(work).std(ddof=1), rel=0.006)
    assert found["sd_spread_m"] == pytest.approx(0.003)
    within = learnt(capsys, *EXACT, "--prior", "0", "--within", "5")
    walk = true_depths(work).reshape(3, 5)
    assert within["sd_depth_m"] == pytest.approx(np.sqrt(walk.var(axis=1, ddof=1).mean()), rel=0.006)


def test_from_both_eyes_it_is_that_and_little_noise(work: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    """At 4.3 m a disparity of 60 / 4.3 px that is wrong by 0.1 px, for the whole blob, is 3 cm of depth."""
    found = learnt(capsys, *PAIR, "--prior", "0")
    walk = true_depths(work).std(ddof=1)
    assert abs(found["sd_depth_m"] - walk) < np.hypot(walk, 0.03) - walk + 0.005
    assert found["sd_height_m"] < 0.05 and found["sd_log_shape"] < 0.1  # a block keeps its size


def test_it_shrinks_to_the_default_as_stated(work: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    raw = learnt(capsys, *EXACT, "--prior", "0")
    for prior in (10, 1000):
        found = learnt(capsys, *EXACT, "--prior", str(prior))
        for name, default in DEFAULT.items():
            mean = (prior * default**2 + 14 * raw[name] ** 2) / (prior + 14)
            assert found[name] == pytest.approx(np.sqrt(mean), rel=0.02)


def test_the_answer_is_an_agent_with_what_was_set(work: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["learn-stereo", *EXACT, *TRUTH, *SET, "--every", "2"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("# 8 examples; the default counts for 10 more\n# sd_depth_m: 0.")
    agent = yaml.safe_load(said)
    made = installed_cues()["stereo"].parameters(**agent["stereo"])
    assert (made.max_depth_m, made.camera_height_m) == (6.0, 1.2)  # type: ignore[attr-defined]


def test_boxes_without_a_blob_are_left_out_by_name(work: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    rows = Path("truth.txt").read_text().splitlines()
    rows[2], rows[5] = "nan,nan,nan,nan", "250,20,30,30"  # absent; the wall, out of range
    Path("holes.txt").write_text("\n".join(rows))
    assert main(["learn-stereo", *EXACT, "--truth", "holes.txt", *SET]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("# 13 examples")
    assert said.err == "1 left out, without a blob of depth in the box: frame 5\n"


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (
            ["--source", "left", *TRUTH],
            4,
            "bayesnet-track learn-stereo: source 'left': 0 second eyes are given; allowed: one of "
            "--right SOURCE, --stereo side_by_side and --depth FOLDER; choose one\n",
        ),
        (
            ["--source", "left", "--right", "right", *TRUTH],
            4,
            "bayesnet-track learn-stereo: source 'left': a pair without a calibration has no depth; allowed: "
            "a pair with --calibration FILE (OpenCV YAML); make one from chessboard pictures with "
            "`bayesnet-track calibrate stereo`\n",
        ),
        (
            [*PAIR, "--truth", "none.txt"],
            2,
            "bayesnet-track learn-stereo: --truth none.txt: No such file or directory; expected a "
            "text file with one box x,y,w,h per line\n",
        ),
        (
            [*PAIR, *TRUTH, "--start", "15"],
            2,
            "bayesnet-track learn-stereo: truth.txt: no box from frame 15 on, of 15\n",
        ),
        (
            [*EXACT, *TRUTH, "--set", "sd_valid=0.2"],
            2,
            "bayesnet-track learn-stereo: --set sd_valid: it is what is estimated; leave it out\n",
        ),
        (
            [*EXACT, *TRUTH, "--set", "cells=3"],
            2,
            "bayesnet-track learn-stereo: cells: Input should be greater than or equal to 4 (Samples along "
            "each side of a box (count))\n",
        ),
        (
            [*EXACT, *TRUTH, "--set", "max_depth_m=1.5", "--end", "2"],
            2,
            "2 left out, without a blob of depth in the box: frame 0, 1\n"
            "bayesnet-track learn-stereo: no frame of left with depth depth has a box with a blob of depth\n",
        ),
        (
            [*EXACT, *TRUTH, *SET, "--every", "4", "--within", "3"],
            2,
            "bayesnet-track learn-stereo: too few boxes with a blob of depth: 4 examples in 4 groups: one "
            "group of two at least is needed; a larger --within makes fewer groups\n",
        ),
    ],
)
@pytest.mark.usefixtures("work")
def test_mistakes_are_told(
    options: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["learn-stereo", *options]) == code
    captured = capsys.readouterr()
    assert captured.err == said
    assert captured.out == ""


@pytest.mark.usefixtures("work")
def test_a_right_eye_that_ends_early_is_told_and_the_rest_is_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A picture that cannot be read in the middle."""
    (tmp_path / "right").mkdir()
    for path in sorted(Path("right").iterdir()):
        broken = path.name == "32.png"
        (tmp_path / "right" / path.name).write_bytes(b"not a picture" if broken else path.read_bytes())
    options = ["--source", "left", "--right", str(tmp_path / "right"), "--calibration", "pair.yml"]
    assert main(["learn-stereo", *options, *TRUTH, *SET]) == 5
    captured = capsys.readouterr()
    assert "source damaged; learnt from what could be read" in captured.err
    assert yaml.safe_load(captured.out)["stereo"]["sd_depth_m"] > 0


@pytest.mark.parametrize("option", [["--within", "1"], ["--prior", "-1"], ["--every", "0"], []])
def test_arguments_out_of_range_are_refused(option: list[str]) -> None:
    given = [*PAIR, *TRUTH] if option else PAIR
    with pytest.raises(SystemExit) as stopped:
        main(["learn-stereo", *given, *option])
    assert stopped.value.code == 2
