"""The calibration file, what is refused in it, and rectification against points that are projected."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.observation.planes import StereoGeometry
from bayesnet_track.vision.calibration import (
    Cameras,
    Rectification,
    RectifiedPair,
    StereoCalibrationError,
    read_rectification,
    rectification,
    write_calibration,
)

GEOMETRY = StereoGeometry(310.5, 0.125, 161.0, 118.25, -3.5)


def cameras(shift=(-0.2, 0.01, 0.005), turn=(0.01, -0.03, 0.02)):
    left = np.array([[300.0, 0, 165], [0, 302, 118], [0, 0, 1]])
    right = np.array([[295.0, 0, 157], [0, 296, 124], [0, 0, 1]])
    rotation = cv2.Rodrigues(np.array(turn))[0]
    bent = np.array([-0.1, 0.02, 0.001, -0.002, 0.0])
    return Cameras(320, 240, left, bent, right, 0.5 * bent, rotation, np.array(shift))


def test_a_rectified_pair_comes_back(tmp_path):
    path = tmp_path / "pair.yml"
    write_calibration(path, RectifiedPair(320, 240, GEOMETRY, 0.0002))
    assert read_rectification(path) == RectifiedPair(320, 240, GEOMETRY, 0.0002)


def test_cameras_come_back_and_opencv_reads_them(tmp_path):
    path = tmp_path / "cameras.yml"
    write_calibration(path, cameras())
    back = read_rectification(path)
    assert isinstance(back, Rectification)
    assert back.geometry == rectification(cameras()).geometry
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("M2").mat(), cameras().right)
    np.testing.assert_array_equal(storage.getNode("T").mat().ravel(), cameras().translation)


def test_rectified_points_share_a_row_and_their_disparity_is_their_depth():
    """Points drawn where both real cameras see them; rectified, they lie where the geometry says."""
    pair = cameras()
    rectified = rectification(pair)
    points = np.array([[-0.4, -0.3, 2.0], [0.3, 0.2, 3.0], [0.1, -0.1, 1.5], [-0.2, 0.3, 2.5]])
    for point in points:
        eyes = []
        for matrix, bent, turn, shift in (
            (pair.left, pair.left_distortion, np.eye(3), np.zeros(3)),
            (pair.right, pair.right_distortion, pair.rotation, pair.translation),
        ):
            at = cv2.projectPoints(point[None], cv2.Rodrigues(turn)[0], shift, matrix, bent)[0].ravel()
            rows, columns = np.mgrid[:240, :320]
            spot = 255 * np.exp(-0.5 * ((columns - at[0]) ** 2 + (rows - at[1]) ** 2) / 2.0**2)
            eyes.append(np.repeat(np.rint(spot).astype(np.uint8)[..., None], 3, 2))
        left, right = rectified.rectify(*eyes)
        one, other = (centre(eye) for eye in (left, right))
        # 8-bit spots of 2 px sd and remapping by 1/32 px: their centres are known to about 0.1 px.
        assert one[1] == pytest.approx(other[1], abs=0.15)
        turned = cv2.stereoRectify(
            pair.left, pair.left_distortion, pair.right, pair.right_distortion, (320, 240),
            pair.rotation, pair.translation.reshape(3, 1), flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
        )[0] @ point  # fmt: skip
        assert one[0] - other[0] == pytest.approx(rectified.geometry.disparity_of(turned[2]), abs=0.2)
    assert rectified.geometry.baseline_m == pytest.approx(np.linalg.norm(pair.translation))


def centre(image):
    weights = image[..., 0].astype(float)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    return (columns * weights).sum() / weights.sum(), (rows * weights).sum() / weights.sum()


@pytest.mark.parametrize("shift", [(0.2, 0, 0), (-0.1, 0.3, 0), (0, 0, 0)])
def test_eyes_that_are_not_left_and_right_are_refused(shift, tmp_path):
    path = tmp_path / "swapped.yml"
    write_calibration(path, cameras(shift=shift))
    with pytest.raises(StereoCalibrationError, match="exchange left and right"):
        read_rectification(path)


HEAD = "%YAML:1.0\n---\nimage_width: 320\nimage_height: 240\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "No such file"),
        (b"\xff\xfe\x00", "not a text file"),
        ("", "not OpenCV YAML"),
        ("focal: 3\n", "not OpenCV YAML"),
        ("%YAML:1.0\n---\n- 1\n", "not OpenCV YAML|image_width is missing"),
        ("%YAML:1.0\n---\nimage_width: 320\n", "image_height is missing"),
        (HEAD, "M1 is missing"),
        (HEAD.replace("320", "0"), "image_width is not a number above 0"),
        (HEAD + "focal_px: 300.\n", "baseline_m is missing"),
        (HEAD + "focal_px: -1.\nbaseline_m: 0.1\ncentre_x_px: 1.\ncentre_y_px: 1.\n", "focal_px is not"),
        (HEAD + "focal_px: .nan\nbaseline_m: 0.1\ncentre_x_px: 1.\ncentre_y_px: 1.\n", "focal_px is not"),
        (
            HEAD + "M1: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ 1., 2. ]\n",
            "M1 is 1 x 2",
        ),
        (HEAD + "M1: { a: 1 }\n", "not OpenCV YAML|M1 is missing"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, text, said):
    path = tmp_path / "bad.yml"
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(StereoCalibrationError, match=said) as raised:
        read_rectification(path)
    assert str(path) in str(raised.value) and "calibrate" in str(raised.value)


def test_a_file_that_cannot_be_written_is_an_error_of_the_system(tmp_path):
    with pytest.raises(OSError):
        write_calibration(Path(tmp_path / "no" / "folder.yml"), cameras())
