"""The size of an image from its header, before it is decoded; what is too large is refused everywhere."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.observation.detector import DetectorError, installed_detectors
from bayesnet_track.observation.image_files import MAX_BYTES, MAX_PIXELS, PictureError, declared_size
from bayesnet_track.sources.images import read_image
from bayesnet_track.sources.stereo_source import read_depth_points

ENCODED = [
    (".jpg", []),
    (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    (".png", []),
    (".bmp", []),
    (".tif", []),
    (".webp", [cv2.IMWRITE_WEBP_QUALITY, 80]),
    (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]),
    (".pgm", []),
    (".pbm", []),
    (".pam", []),
    (".jp2", []),
]


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height):
    """A PNG of no pixels that says how many it has."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("suffix", "settings"), ENCODED)
def test_the_size_that_a_decoder_finds_is_declared(suffix, settings):
    image = np.random.default_rng(0).integers(0, 255, (37, 53), dtype=np.uint8)
    data = cv2.imencode(suffix, image, settings)[1]
    assert cv2.imdecode(data, cv2.IMREAD_UNCHANGED).shape[:2] == (37, 53)
    assert declared_size(data.tobytes()) == (53, 37)
    for length in range(40):
        declared_size(data.tobytes()[:length])  # a header that is cut off raises nothing


def test_other_headers():
    ppm = b"P6\n# made by nobody\n640 480\n255\n"
    assert declared_size(ppm) == (640, 480)
    top_down = b"BM" + bytes(12) + struct.pack("<Iii", 40, 70, -50) + bytes(20)
    assert declared_size(top_down) == (70, 50)
    extended = b"RIFF" + bytes(4) + b"WEBPVP8X" + bytes(8) + bytes([0x1F, 0x4E, 0, 0x0F, 0x27, 0])
    assert declared_size(extended) == (20000, 10000)
    tile = struct.pack(">HHIHH", 322, 3, 1, 60000, 0)
    entries = [struct.pack(">HHIHH", tag, 3, 1, 9, 0) for tag in (256, 257)]
    tiff = b"MM\0*" + struct.pack(">IH", 8, 3) + b"".join(entries) + tile
    assert declared_size(tiff) == (60000, 9), "a decoder makes room for a whole tile"
    assert declared_size(b"GIF89a" + bytes(20)) is None


def test_a_picture_of_as_many_pixels_as_a_video_may_have_is_not_too_large(tmp_path):
    """Refused for what it lacks, its pixels; one row more is refused for its size."""
    for height, reason in (
        (4096, "readable|incorrect"),
        (4097, "32768x4097 px; allowed: 134,217,728"),
    ):
        (tmp_path / "a.png").write_bytes(png(MAX_PIXELS // 4096, height))
        with pytest.raises(PictureError, match=reason):
            read_image(tmp_path / "a.png")


def test_a_small_file_of_many_pixels_is_refused_wherever_images_are_read(tmp_path, capsys):
    """20000x20000 px took 2.4 GB; nothing of it may be decoded."""
    folder = tmp_path / "s"
    folder.mkdir()
    bad = folder / "0.png"
    bad.write_bytes(png(20000, 20000))
    said = "0.png: 20000x20000 px; allowed: 134,217,728 pixels"
    with pytest.raises(PictureError, match=said):
        read_depth_points(bad, None)
    declared = installed_detectors()["color_backprojection"]
    with pytest.raises(DetectorError, match=said):
        declared.make(declared.parameters(picture=str(bad)))
    run = ["run", "general", "--source", str(folder), "--init", "1,1,9,9", "--out", str(tmp_path / "run")]
    assert main(run) == 4 and said in capsys.readouterr().err
    assert main(["learn-shape", "--masks", str(folder), str(tmp_path / "m.npz")]) == 2
    assert said in capsys.readouterr().err
    pair = [str(folder), str(folder), "--board", "9x6", "--square", "0.1"]
    assert main(["calibrate", "stereo", *pair, "--out", str(tmp_path / "c.yml")]) == 4
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("name", ["0.png", "0.npy"])
def test_a_sparse_file_of_gigabytes_is_not_read(tmp_path, name):
    path = tmp_path / name
    with path.open("wb") as file:
        if name == "0.npy":
            np.lib.format.write_array_header_2_0(
                file, {"descr": "<f4", "fortran_order": False, "shape": (50000, 50000)}
            )
        else:
            file.write(png(9, 9))
        file.truncate(10 << 30)
    with pytest.raises(PictureError, match=f"at most {MAX_BYTES >> 20} MB|50000x50000 px"):
        read_depth_points(path, None)


def test_large_pictures_are_converted_in_bands(tmp_path):
    """The same as all at once, of 16 bit with alpha, which needs the most steps."""
    image = np.random.default_rng(0).integers(0, 65536, (600, 7, 4), dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    eight = np.round(image / 257).astype(np.int64)
    whole = (eight[..., :3] * eight[..., 3:] + 127) // 255
    found, has_color = read_image(tmp_path / "a.png")
    assert has_color
    np.testing.assert_array_equal(found, whole)
