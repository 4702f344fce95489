"""Images of a folder that are named unlike the others, and images that a viewer turns, are said."""

import struct

import cv2
import numpy as np
import pytest

from bayesnet_track import Tracker, track
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.sources import open_source

FRAME = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)


def folder(path, names):
    path.mkdir()
    for name in names:
        cv2.imwrite(str(path / name), FRAME)
    return str(path)


NUMBERED = [f"{number:04d}.png" for number in range(8)]


@pytest.mark.parametrize("stray", ["cover.png", "0003 (1).png", "0003_copy.png"])
def test_an_image_that_is_named_unlike_the_others_is_said_and_read(tmp_path, stray):
    with pytest.warns(InputNotice, match="1 of 9 images are named otherwise") as caught:
        source = open_source(folder(tmp_path / "img", [*NUMBERED, stray]))
    with source:
        assert stray in str(caught[0].message) and sum(1 for _ in source) == 9


@pytest.mark.parametrize(
    "names", [NUMBERED, [f"img{n}.png" for n in (8, 9, 10, 11)], ["a.png", "b.png", "c.png"], ["one.png"]]
)
def test_usual_names_are_passed_over_in_silence(tmp_path, names, recwarn):
    with open_source(folder(tmp_path / "img", names)) as source:
        assert sum(1 for _ in source) == len(names)
    assert not [one for one in recwarn if issubclass(one.category, InputNotice)]


def with_orientation(path, turn):
    """Write a JPEG whose EXIF says how to turn it."""
    cv2.imwrite(str(path), FRAME)
    data = path.read_bytes()
    tags = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, turn, 0, 0)
    body = b"Exif\0\0" + tags
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:])


def test_an_orientation_that_is_not_applied_is_said_once(tmp_path):
    (tmp_path / "img").mkdir()
    for name in ("0.jpg", "1.jpg", "2.jpg"):
        with_orientation(tmp_path / "img" / name, 6)
    with pytest.warns(InputNotice) as caught:
        source = open_source(str(tmp_path / "img"))
    with source:
        assert [(frame.width, frame.height) for frame in source] == [(32, 24)] * 3
    assert len(caught) == 1 and "show 24x32 px, frames and boxes are of the 32x24 px" in str(
        caught[0].message
    )


def test_an_upright_orientation_is_none(tmp_path, recwarn):
    (tmp_path / "img").mkdir()
    with_orientation(tmp_path / "img" / "0.jpg", 1)
    with open_source(str(tmp_path / "img")):
        pass
    assert not [one for one in recwarn if issubclass(one.category, InputNotice)]


@pytest.mark.parametrize("source", [[FRAME, FRAME], np.array([FRAME, FRAME]), 3])
def test_what_is_no_source_is_refused_with_what_to_use(source):
    with pytest.raises(TypeError, match=r"for frames in memory use Tracker\.init and update"):
        track("two_squares", source, (5, 5, 10, 10))


def test_times_far_apart_end_in_no_error():
    frames = [np.roll(FRAME, 2 * number, axis=1) for number in range(8)]
    tracker = Tracker("general")
    tracker.init(frames[0], (5, 5, 10, 10), time_s=0.0)
    for number, frame in enumerate(frames[1:], start=1):
        with pytest.warns(InputNotice, match="time_s counts seconds"):
            tracker.update(frame, time_s=40.0 * number)
