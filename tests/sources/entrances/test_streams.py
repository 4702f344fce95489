"""What of a video file is not read, or not shown as a player shows it."""

import struct
import warnings
from fractions import Fraction

import av
import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.sources import open_source
from bayesnet_track.sources.video import explain_stream

ONE, UNIT = 1 << 16, 1 << 30
STRAIGHT = (ONE, 0, 0, 0, ONE, 0, 0, 0, UNIT)


def write(path, sizes=((64, 48),), aspect=None, matrix=None):
    """A video with a stream of each size, whose frames have the brightness of its number."""
    with av.open(str(path), "w") as container:
        streams = [container.add_stream("mpeg4", rate=25) for _ in sizes]
        for stream, (width, height) in zip(streams, sizes, strict=True):
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            if aspect is not None:
                stream.codec_context.sample_aspect_ratio = aspect
        for number, (stream, (width, height)) in enumerate(zip(streams, sizes, strict=True)):
            for n in range(3):
                image = np.full((height, width, 3), 50 + 100 * number, np.uint8)
                frame = av.VideoFrame.from_ndarray(image, format="bgr24")
                frame.pts, frame.time_base = n, Fraction(1, 25)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    if matrix is not None:
        data = path.read_bytes()
        header, before = data.index(b"tkhd"), struct.pack(">9i", *STRAIGHT)
        assert before in data[header:]
        path.write_bytes(data[:header] + data[header:].replace(before, struct.pack(">9i", *matrix), 1))
    return path


def read(path, **settings):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with open_source(str(path), **settings) as source:
            frames = [item for item in source if isinstance(item, Frame)]
    return frames, [str(one.message) for one in caught if one.category is InputNotice]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"sizes": ((64, 48), (32, 32))}, "2 video streams, 64x48, 32x32; the first one is read"),
        ({"aspect": Fraction(16, 15)}, "shows its 64x48 px at 68x48"),
        ({"matrix": (-ONE, 0, 0, 0, ONE, 0, 0, 0, UNIT)}, "a player shows it mirrored"),
        ({"matrix": (46341, 46341, 0, -46341, 46341, 0, 0, 0, UNIT)}, "a player turns it by 45 degrees"),
    ],
)
def test_what_differs_from_what_a_player_shows_is_said_once(tmp_path, settings, said):
    path = write(tmp_path / "a.mp4", **settings)
    frames, notices = read(path)
    assert len(notices) == 1 and said in notices[0] and str(path) in notices[0]
    assert len(frames) == 3 and abs(int(frames[0].image.mean()) - 50) < 5


@pytest.mark.parametrize(
    "matrix", [None, (0, -ONE, 0, ONE, 0, 0, 0, 0, UNIT), (-ONE, 0, 0, 0, -ONE, 0, 0, 0, UNIT)]
)
def test_nothing_is_said_of_a_plain_video_or_one_that_is_turned_by_quarters(tmp_path, matrix):
    assert read(write(tmp_path / "a.mp4", matrix=matrix))[1] == []


def test_square_pixels_by_their_words_are_square(tmp_path):
    with av.open(str(write(tmp_path / "a.mp4", aspect=Fraction(1, 1)))) as container:
        assert list(explain_stream(container, container.streams.video[0])) == []
