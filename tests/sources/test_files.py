"""Files that sources read: lines of boxes, depths of another sensor, and whether they still hold the same."""

import numpy as np
import pytest

from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.sources.mot_lines import parse_mot
from bayesnet_track.sources.origin import fingerprint_files
from bayesnet_track.sources.paths import depth_files
from bayesnet_track.sources.scenes.scene import gray_cells, shaded_cells, smooth_background
from bayesnet_track.sources.scenes.shapes import SIDE, crowd
from bayesnet_track.sources.stereo_source import read_depth_points


def test_lines_of_boxes_have_commas_or_spaces_and_count_frames_from_one():
    lines = parse_mot("1,7,10,20,30,40,0.5\n\n3 8 1 2 3 4\n", "found.txt")
    assert lines.frames.tolist() == [0, 2] and lines.ids.tolist() == [7, 8]
    assert lines.boxes.tolist() == [[10, 20, 30, 40], [1, 2, 3, 4]]
    assert lines.rest[0, 0] == 0.5 and np.isnan(lines.rest[1]).all() and lines.place(1) == "found.txt:3"
    assert len(lines.only(lines.ids == 8)) == 1


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("1,7,10,20,30", "5 numbers; expected 6 to 10"),
        ("0,7,10,20,30,40", "frames of MOT files count from 1"),
        ("1.5,7,10,20,30,40", "frame 1.5 is not a whole number"),
        ("1,7,ten,20,30,40", "'ten' is not a number"),
    ],
)
def test_a_wrong_line_is_named(line, what):
    with pytest.raises(ValueError, match=f"boxes:2: .*{what}"):
        parse_mot(f"1,7,10,20,30,40\n{line}", "boxes")


def test_points_without_depth_are_none(tmp_path):
    points = np.ones((2, 3, 3), np.float32)
    points[0, 0, 2], points[0, 1, 2], points[1, 1, 0] = 0.0, -1.0, np.inf
    np.save(tmp_path / "points.npy", points)
    found = read_depth_points(tmp_path / "points.npy", None)
    assert np.isnan(found).all(axis=2).tolist() == [[True, True, False], [False, True, False]]


@pytest.mark.parametrize(
    ("values", "what"),
    [
        (np.ones((2, 3)), "depths become points by a calibration"),
        (np.ones((2, 3, 4)), r"allowed: \(H, W\) depths, \(H, W, 3\) points"),
        (np.array([["a"]]), "not an array of numbers"),
        (np.array([[None]], dtype=object), "Python objects"),
    ],
)
def test_other_arrays_are_no_depth(values, what, tmp_path):
    np.save(tmp_path / "depth.npy", values)
    with pytest.raises(PictureError, match=what):
        read_depth_points(tmp_path / "depth.npy", None)


def test_a_broken_link_keeps_its_place_among_the_depth_files(tmp_path):
    np.save(tmp_path / "1.npy", np.ones((2, 3)))
    (tmp_path / "0.npy").symlink_to(tmp_path / "gone.npy")
    broken, whole = depth_files(str(tmp_path))
    assert (broken.name, whole.name) == ("0.npy", "1.npy")
    with pytest.raises(PictureError, match=r"0\.npy"):
        read_depth_points(broken, None)


def test_a_fingerprint_is_of_names_sizes_and_bytes(tmp_path):
    first, second = tmp_path / "a.png", tmp_path / "b.png"
    first.write_bytes(b"one")
    second.write_bytes(b"two")
    before = fingerprint_files([first, second])
    assert (before.files, before.size) == (2, 6) and fingerprint_files([first, second]) == before
    second.write_bytes(b"owt")
    assert fingerprint_files([first, second]) != before
    second.write_bytes(b"two")
    assert fingerprint_files([first, second.rename(tmp_path / "c.png")]) != before
    with pytest.raises(OSError, match="not a plain file"):
        fingerprint_files([tmp_path])


@pytest.mark.slow
def test_a_crowd_begins_apart_and_has_as_many_as_asked_for():
    scene = crowd(seed=4, count=6, frames=20)
    boxes = np.array([scene.truth, *scene.others])[:, :5]
    assert len(boxes) == 6
    away = np.abs(boxes[:, None] - boxes[None])[..., :2].max(axis=-1)[~np.eye(6, dtype=bool)]
    assert away.min() > SIDE + 2
    with pytest.raises(ValueError, match="no room for 900 discs"):
        crowd(count=900, frames=1)


def test_surfaces_stay_within_their_levels():
    rng = np.random.default_rng(1)
    hills = smooth_background(50, 30, 100.0, 12.0, rng)
    assert hills.shape == (30, 50, 3) and 88 <= hills.min() < hills.max() <= 112
    np.testing.assert_array_equal(hills[..., 0], hills[..., 2])
    cells = gray_cells(4, 5, 10, 12, rng)
    assert set(np.unique(cells)) == {10, 11, 12}
    shades = shaded_cells(4, 5, (10.0, 20.0, 40.0), 0.5, rng) / np.array([10.0, 20.0, 40.0])
    assert shades.min() >= 0.5 and shades.max() <= 1 and np.ptp(shades, axis=2).max() < 1e-12
