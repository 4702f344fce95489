"""How many images a file holds, and that a file of several is refused where one is read."""

import struct

import cv2
import numpy as np
import pytest

from bayesnet_track.observation.image_files import PictureError, pages_of, read_mask, read_pixels
from bayesnet_track.sources.stereo_source import read_depth_points

GRAY = [np.full((4, 6), value, np.uint8) for value in (10, 20, 30)]


def tiff(directories, description=b"", order="<"):
    """A TIFF of directories without pixels: of each its tag 254, None for none."""
    text = description + b"\0"
    data = bytearray(b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8 + len(text)) + text
    for number, subfile in enumerate(directories):
        entries = [struct.pack(f"{order}HHII", 270, 2, len(text), 8)]
        if subfile is not None:
            entries.insert(0, struct.pack(f"{order}HHII", 254, 4, 1, subfile))
        following = len(data) + 2 + 12 * len(entries) + 4 if number < len(directories) - 1 else 0
        data += (
            struct.pack(f"{order}H", len(entries)) + b"".join(entries) + struct.pack(f"{order}I", following)
        )
    return bytes(data)


@pytest.mark.parametrize("order", "<>")
def test_thumbnails_and_masks_of_a_tiff_are_no_images_of_their_own(order):
    assert len(pages_of("a", tiff([0, 0, None], order=order))) == 3
    assert pages_of("a", tiff([0, 1, 4, 5], order=order)) is None


def test_directories_in_a_ring_end():
    ring = bytearray(tiff([0, 0]))
    ring[-4:] = ring[4:8]
    assert len(pages_of("a", bytes(ring))) == 2
    assert len(pages_of("a", bytes(ring[:-1]))) == 2  # cut off behind the last entry


@pytest.mark.parametrize(
    ("pages", "description", "reason"),
    [
        (1, b"ImageJ=1.53\nimages=30\nframes=30\n", "images=30, and it has 1 pages"),
        (6, b"ImageJ=1.53\nimages=6\nchannels=2\nframes=3\n", "6 pages are 2 channels, 3 times"),
        (6, b'<OME><Pixels SizeC="1" SizeT="3" SizeZ="2"/></OME>', "6 pages are 2 slices, 3 times"),
        (3, b"ImageJ=1.53\nimages=3\nchannels=3\n", "3 pages are 3 channels"),
    ],
)
def test_a_stack_of_more_axes_than_time_fits_two_readings(pages, description, reason):
    with pytest.raises(PictureError, match=f"a.tif: .*{reason}"):
        pages_of("a.tif", tiff([0] * pages, description))


@pytest.mark.parametrize("axis", [b"slices", b"frames"])
def test_a_stack_along_one_axis_is_a_sequence(axis):
    assert len(pages_of("a", tiff([0] * 6, b"ImageJ=1.53\nimages=6\n" + axis + b"=6\n"))) == 6


def test_netpbm_images_one_behind_the_other():
    one = b"P5 # made by nobody\n6 4\n255\n" + GRAY[0].tobytes()
    deep = b"P6\n6 4\n65535\n" + bytes(6 * 4 * 3 * 2)
    bits = b"P4\n9 4\n" + bytes(8)
    assert pages_of("a", one + deep + bits + one).places == (
        0,
        len(one),
        len(one + deep),
        len(one + deep + bits),
    )
    assert pages_of("a", one) is None
    assert pages_of("a", one + b"trailing text") is None
    assert pages_of("a", one[:-1]) is None


def test_a_file_of_several_images_is_refused_where_one_is_needed(tmp_path):
    path = tmp_path / "a.tif"
    assert cv2.imwritemulti(str(path), GRAY)
    for read in (read_pixels, read_mask, lambda path: read_depth_points(path, None)):
        with pytest.raises(PictureError, match=r"a.tif: 3 images in one TIFF file; allowed here: one image"):
            read(path)
