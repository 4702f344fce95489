"""Pairs as a source: two eyes, halves of one picture, another sensor's depth; and bad input."""

import re

import cv2
import numpy as np
import pytest

from bayesnet_track.journal.events.runs import SourceDamaged
from bayesnet_track.observation.planes import Frame, PointMap, RightEye, StereoGeometry
from bayesnet_track.sources.frames import Source
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.stereo_source import DepthReader, open_stereo_source, two_eyes
from bayesnet_track.sources.timing import Damage, Picture
from bayesnet_track.vision.calibration import RectifiedPair, write_calibration

WIDTH, HEIGHT = 32, 24
PAIR = RectifiedPair(WIDTH, HEIGHT, StereoGeometry(40.0, 0.1, 16.0, 12.0))


def image(value, size=(WIDTH, HEIGHT)):
    return np.full((size[1], size[0], 3), value, np.uint8)


def folder(path, values, size=(WIDTH, HEIGHT), first=0):
    path.mkdir()
    for number, value in enumerate(values, first):
        cv2.imwrite(str(path / f"{number:03d}.png"), image(value, size))
    return path


@pytest.fixture
def calibration(tmp_path):
    path = tmp_path / "pair.yml"
    write_calibration(path, PAIR)
    return path


def read(source):
    with source:
        items = list(source)
    return [i for i in items if isinstance(i, Frame)], [i for i in items if not isinstance(i, Frame)]


def test_two_folders_are_frames_with_a_right_eye(tmp_path, calibration):
    left, right = folder(tmp_path / "l", range(10, 15)), folder(tmp_path / "r", range(110, 115))
    source = open_stereo_source(str(left), right=str(right), calibration=calibration)
    assert (source.width, source.height, source.has_depth, source.declared_frames) == (32, 24, True, 5)
    assert source.description == f"{left} + {right}"
    frames, events = read(source)
    assert events == [] and source.end_reason == "end_of_source"
    assert [f.image[0, 0, 0] for f in frames] == [10, 11, 12, 13, 14]
    assert [f.depth.image[0, 0, 0] for f in frames] == [110, 111, 112, 113, 114]
    assert all(isinstance(f.depth, RightEye) and f.depth.geometry == PAIR.geometry for f in frames)


def test_globs_and_a_window_of_frames(tmp_path, calibration):
    folder(tmp_path / "l", range(10, 15)), folder(tmp_path / "r", range(110, 115))
    source = open_stereo_source(
        str(tmp_path / "l" / "*.png"),
        right=str(tmp_path / "r" / "*.png"),
        calibration=calibration,
        start=1,
        end=3,
    )
    frames, _ = read(source)
    assert [(f.index, f.image[0, 0, 0], f.depth.image[0, 0, 0]) for f in frames] == [
        (1, 11, 111),
        (2, 12, 112),
    ]


def test_halves_of_one_picture(tmp_path, calibration):
    (tmp_path / "both").mkdir()
    for number in range(3):
        both = np.concatenate([image(10 + number), image(110 + number)], axis=1)
        cv2.imwrite(str(tmp_path / "both" / f"{number}.png"), both)
    source = open_stereo_source(str(tmp_path / "both"), side_by_side=True, calibration=calibration)
    frames, events = read(source)
    assert events == [] and source.width == WIDTH
    assert [(f.image[5, -1, 0], f.depth.image[5, 0, 0]) for f in frames] == [(10, 110), (11, 111), (12, 112)]


def test_depth_images_in_millimetres_become_points(tmp_path, calibration):
    left, depth = folder(tmp_path / "l", [10, 11]), tmp_path / "d"
    depth.mkdir()
    for number in range(2):
        values = np.full((HEIGHT, WIDTH), 3000 + number, np.uint16)
        values[0, 0] = 0
        cv2.imwrite(str(depth / f"{number:03d}.png"), values)
    frames, _ = read(open_stereo_source(str(left), depth=str(depth), calibration=calibration))
    points = frames[1].depth.points
    assert isinstance(frames[1].depth, PointMap) and np.isnan(points[0, 0]).all()
    assert points[12, 26] == pytest.approx([10 / 40 * 3.001, 0.0, 3.001])


def test_points_of_another_sensor_need_no_calibration(tmp_path):
    left, depth = folder(tmp_path / "l", [10]), tmp_path / "d"
    depth.mkdir()
    points = np.ones((HEIGHT, WIDTH, 3), np.float32)
    points[1, 1, 2] = -1.0
    points[2, 2, 0] = np.inf
    np.save(depth / "000.npy", points)
    frames, _ = read(open_stereo_source(str(left), depth=str(depth)))
    found = frames[0].depth.points
    assert np.isnan(found[1, 1]).all() and np.isnan(found[2, 2]).all()
    assert np.isfinite(found).sum() == found.size - 6


# ------------------------------------------------------------------------------------ bad input


def refused(said, *arguments, **settings):
    with pytest.raises(SourceError) as raised:
        open_stereo_source(*map(str, arguments), **settings).close()
    assert re.search(said, str(raised.value)), raised.value


def test_files_without_a_partner_are_named(tmp_path, calibration):
    left, right = folder(tmp_path / "l", range(5)), folder(tmp_path / "r", range(4))
    said = r"5 and 4 files, and frame 4 has no partner \(left 004.png, right none\)"
    refused(said, left, right=str(right), calibration=calibration)
    (left / "002.png").unlink()
    refused("4 and 4 files, and frame 2 has no partner", left, right=str(right), calibration=calibration)


def test_a_missing_eye_and_a_missing_calibration(tmp_path, calibration):
    left = folder(tmp_path / "l", range(3))
    refused("no such file or folder", left, right=str(tmp_path / "nowhere"), calibration=calibration)
    refused("without a calibration.*calibration=FILE.*calibrate", left, right=str(left))
    refused("0 second eyes", left, calibration=calibration)
    refused("2 second eyes", left, right=str(left), side_by_side=True, calibration=calibration)
    refused("no depth file", left, depth=str(tmp_path), calibration=None)


def test_pictures_of_another_size(tmp_path, calibration):
    left = folder(tmp_path / "l", range(3))
    small = folder(tmp_path / "s", range(3), (16, 12))
    said = "frame 0: the left eye is 32x24, the right one 16x12"
    refused(said, left, right=str(small), calibration=calibration)
    said = "frame 0: the pictures are 16x12, the calibration is for 32x24"
    refused(said, small, right=str(small), calibration=calibration)
    odd = folder(tmp_path / "o", range(3), (33, 24))
    refused("33x24 has no two halves", odd, side_by_side=True, calibration=calibration)


def test_a_picture_that_is_damaged_later_is_left_out_and_said(tmp_path, calibration):
    left, right = folder(tmp_path / "l", range(10, 15)), folder(tmp_path / "r", range(110, 115))
    (right / "002.png").write_bytes(b"no image")
    cv2.imwrite(str(right / "003.png"), image(5, (16, 12)))
    source = open_stereo_source(str(left), right=str(right), calibration=calibration)
    frames, events = read(source)
    assert [f.index for f in frames] == [0, 1, 4] and source.end_reason == "source_damaged"
    damage = [event.reason for event in events if isinstance(event, SourceDamaged)]
    assert damage == [
        "right eye: 002.png: not a readable image",
        "the left eye is 32x24, the right one 16x12",
    ]


def test_depth_that_does_not_belong_to_the_picture(tmp_path, calibration):
    left, depth = folder(tmp_path / "l", [10]), tmp_path / "d"
    depth.mkdir()
    np.save(depth / "000.npy", np.ones((5, 4), np.float32))
    refused("depth is 4x5, the picture 32x24", left, depth=str(depth), calibration=calibration)
    refused("depths become points by a calibration", left, depth=str(depth))
    np.save(depth / "000.npy", np.array([{}]), allow_pickle=True)
    refused("000.npy: ", left, depth=str(depth), calibration=calibration)
    cv2.imwrite(str(depth / "000.png"), image(3))
    (depth / "000.npy").unlink()
    refused("not a depth image of one channel", left, depth=str(depth), calibration=calibration)


def test_depth_is_never_rescaled(tmp_path):
    left, depth = folder(tmp_path / "l", [10, 11]), tmp_path / "d"
    depth.mkdir()
    cv2.imwrite(str(left / "001.png"), image(11, (16, 12)))
    for number, size in enumerate(((HEIGHT, WIDTH), (12, 16))):
        np.save(depth / f"{number:03d}.npy", np.ones((*size, 3), np.float32))
    source = open_stereo_source(str(left), depth=str(depth), on_resize="rescale")
    frames, events = read(source)
    assert len(frames) == 1 and source.end_reason == "frame_size_changed"
    assert [event.action for event in events] == ["stop"]


def test_a_depth_file_that_is_gone_is_damage(tmp_path, calibration):
    left, depth = folder(tmp_path / "l", [10, 11]), tmp_path / "d"
    depth.mkdir()
    for number in range(2):
        cv2.imwrite(str(depth / f"{number:03d}.png"), np.full((HEIGHT, WIDTH), 3000, np.uint16))
    source = open_stereo_source(str(left), depth=str(depth), calibration=calibration)
    (depth / "001.png").unlink()
    frames, events = read(source)
    assert len(frames) == 1 and events == [SourceDamaged(1, "001.png: No such file or directory")]


class Eye:
    """A reader without files."""

    frame_interval_s, gap_from = 0.04, 1.5

    def __init__(self, items, declared=None):
        self.items, self.declared_frames, self.is_closed = items, declared, False

    def __iter__(self):
        return iter(self.items)

    def close(self):
        self.is_closed = True


def pictures(indices, late=0.0):
    return [Picture(n, n + late, (n + late) * 0.04, lambda n=n: (image(n), True)) for n in indices]


def joined(left, right):
    def complete(index, second, pixels):
        return two_eyes(PAIR, index, second, pixels)

    eyes = Eye(left, 9), Eye(right, 9)
    source = Source("pair", DepthReader("pair", eyes[0], complete, eyes[1]), None, None, "stop")
    frames, events = read(source)
    assert eyes[0].is_closed and eyes[1].is_closed
    assert all(f.image[0, 0, 0] == f.depth.image[0, 0, 0] == f.index for f in frames)
    return [f.index for f in frames], [getattr(e, "reason", None) for e in events], source.end_reason


@pytest.mark.parametrize("short", ["left", "right"])
def test_one_eye_that_ends_early(short):
    eyes = [pictures(range(3)), pictures(range(6))]
    indices, reasons, end = joined(*(eyes if short == "left" else eyes[::-1]))
    assert indices == [0, 1, 2] and end == "source_truncated"
    assert reasons == [f"the {short} eye ends at frame 3, the other one goes on"]


def test_an_eye_that_said_it_is_cut_short_is_not_blamed_twice():
    left = [*pictures(range(3)), Damage(3, "the file is truncated", True)]
    indices, reasons, end = joined(left, pictures(range(6)))
    assert indices == [0, 1, 2] and end == "source_truncated"
    assert reasons == ["left eye: the file is truncated"]


def test_a_picture_that_one_eye_lost_is_skipped_in_the_other():
    right = [*pictures([0, 1]), Damage(2, "the decoder refused a frame"), *pictures([3, 4])]
    indices, reasons, _ = joined(pictures(range(5)), right)
    assert indices == [0, 1, 3, 4]
    assert "right eye: the decoder refused a frame" in reasons
    assert "only the left eye has a picture" in reasons


def test_eyes_out_of_step_end_the_source():
    indices, reasons, end = joined(pictures(range(4)), pictures([0, 1]) + pictures([2, 3], late=0.8))
    assert indices == [0, 1] and end == "source_damaged"
    assert reasons == ["the eyes are out of step: left at 0.080 s, right at 0.112 s"]
