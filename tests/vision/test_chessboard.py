"""Calibration against cameras that are known: chessboards drawn as they see them."""

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.vision.calibration import (
    Rectification,
    StereoCalibrationError,
    calibrate_pair,
    read_rectification,
)

BOARD, SQUARE, SIZE = (8, 5), 0.04, (400, 300)
LEFT = np.array([[380.0, 0, 204], [0, 380, 148], [0, 0, 1]])
RIGHT = np.array([[376.0, 0, 196], [0, 377, 153], [0, 0, 1]])
TURN, SHIFT = np.array([0.005, -0.02, 0.01]), np.array([-0.12, 0.002, 0.004])
POSES = [  # how the board is turned, and where its corner is, m
    ((0.0, 0.0, 0.0), (-0.12, -0.1, 0.62)),
    ((0.4, 0.1, 0.1), (-0.12, -0.08, 0.6)),
    ((-0.4, 0.2, -0.1), (-0.1, -0.06, 0.62)),
    ((0.1, 0.5, 0.05), (-0.08, -0.08, 0.66)),
    ((0.2, -0.5, -0.05), (-0.12, -0.1, 0.6)),
    ((0.3, 0.3, 0.3), (-0.06, -0.12, 0.7)),
    ((-0.3, -0.3, -0.2), (-0.13, -0.05, 0.65)),
]


def seen(matrix, turn, shift, pose):
    """The picture of a plane board by a camera without distortion: one homography."""
    board_turn, board_at = cv2.Rodrigues(np.array(pose[0]))[0], np.array(pose[1])
    turn = cv2.Rodrigues(turn)[0]
    plane = np.column_stack([*(turn @ board_turn).T[:2], turn @ board_at + shift])
    cells = 20  # px per square of the drawn board, drawn twice as large as it is looked at
    across, down = BOARD[0] + 3, BOARD[1] + 3
    squares = np.indices((down, across)).sum(0) % 2 * 255
    squares[[0, -1]] = 255
    squares[:, [0, -1]] = 255
    drawn = np.kron(squares, np.ones((cells, cells))).astype(np.uint8)
    # the drawn pixel (cells * 2 - 0.5) is the first inner corner, the origin of the board
    to_metres = np.array([[SQUARE / cells, 0, 0], [0, SQUARE / cells, 0], [0, 0, 1.0]]) @ np.array(
        [[1, 0, 0.5 - 2 * cells], [0, 1, 0.5 - 2 * cells], [0, 0, 1.0]]
    )
    twice = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1.0]])
    large = cv2.warpPerspective(
        drawn, twice @ matrix @ plane @ to_metres, (2 * SIZE[0], 2 * SIZE[1]), borderValue=255
    )
    small = cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA)
    return np.repeat(small[..., None], 3, 2)


@pytest.fixture(scope="module")
def boards():
    left = [seen(LEFT, np.zeros(3), np.zeros(3), pose) for pose in POSES]
    return left, [seen(RIGHT, TURN, SHIFT, pose) for pose in POSES]


@pytest.fixture(scope="module")
def folders(boards, tmp_path_factory):
    places = []
    for name, pictures in zip(("left", "right"), boards, strict=True):
        places.append(tmp_path_factory.mktemp(name))
        for number, picture in enumerate(pictures):
            cv2.imwrite(str(places[-1] / f"{number}.png"), picture)
    return [str(place) for place in places]


def test_the_cameras_are_found(boards):
    """Corners are found to about 0.05 px; seven boards then fix the focal length to about half a percent."""
    fitted = calibrate_pair(*boards, BOARD, SQUARE)
    assert fitted.used == tuple(range(len(POSES)))
    assert max(fitted.left_rms_px, fitted.right_rms_px, fitted.pair_rms_px) < 0.15
    assert fitted.epipolar_px < 0.1
    assert fitted.cameras.left[0, 0] == pytest.approx(380, rel=0.01)
    assert fitted.cameras.right[0, 0] == pytest.approx(376, rel=0.01)
    np.testing.assert_allclose(fitted.cameras.translation, SHIFT, atol=0.002)
    np.testing.assert_allclose(cv2.Rodrigues(fitted.cameras.rotation)[0].ravel(), TURN, atol=0.01)


def test_a_pair_without_a_whole_board_is_left_out(boards):
    left, right = ([*pictures] for pictures in boards)
    right[2] = np.full_like(right[2], 200)
    assert calibrate_pair(left, right, BOARD, SQUARE).used == (0, 1, 3, 4, 5, 6)


def test_what_cannot_be_calibrated_is_refused(boards):
    left, right = boards
    with pytest.raises(StereoCalibrationError, match="7 left pictures and 6 right ones"):
        calibrate_pair(left, right[:-1], BOARD, SQUARE)
    with pytest.raises(StereoCalibrationError, match=r"several sizes \(200x150, 400x300\)"):
        calibrate_pair(left, [*right[:-1], right[-1][::2, ::2]], BOARD, SQUARE)
    with pytest.raises(StereoCalibrationError, match=r"9x7 .* whole in 0 of 7 pairs .* check board="):
        calibrate_pair(left, right, (9, 7), SQUARE)


def test_the_command_writes_what_a_run_reads(folders, tmp_path, capsys):
    out = tmp_path / "pair.yml"
    line = ["calibrate", "stereo", *folders, "--board", "8x5", "--square", "0.04", "--out", str(out)]
    assert main(line) == 0
    said = capsys.readouterr().out
    assert "board whole in 7 of 7 pairs" in said and "reprojection rms: left 0." in said
    assert "right camera at 1" in said and f"wrote {out}" in said
    back = read_rectification(out)
    assert isinstance(back, Rectification) and back.geometry.baseline_m == pytest.approx(0.12, abs=0.002)
    assert main(line) == 6 and "--overwrite" in capsys.readouterr().err
    assert main([*line, "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        ({"--board": "9"}, 2, "two numbers such as 9x6"),
        ({"--board": "2x9"}, 2, "from 3 to 100"),
        ({"--board": "9x7"}, 2, "whole in 0 of 7 pairs"),
        ({"left": "nowhere"}, 4, "no such file or folder"),
    ],
)
def test_mistakes_of_the_command(folders, tmp_path, capsys, change, code, said):
    given = {"--board": "8x5", "left": folders[0]} | change
    out = tmp_path / "pair.yml"
    line = ["calibrate", "stereo", given["left"], folders[1], "--board", given["--board"], "--square", "0.04"]
    assert main([*line, "--out", str(out)]) == code
    assert said in capsys.readouterr().err and not out.exists()


def test_a_square_has_a_size(folders, capsys):
    with pytest.raises(SystemExit):
        main(["calibrate", "stereo", *folders, "--board", "8x5", "--square", "-1", "--out", "x.yml"])
    assert "a length above 0 in metres" in capsys.readouterr().err
