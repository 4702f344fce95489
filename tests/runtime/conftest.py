"""Tiny videos for the tests of this folder."""

from fractions import Fraction

import av
import numpy as np
import pytest

FRAGMENTED = {"movflags": "frag_keyframe+empty_moov+default_base_moof"}


def picture(number, size):
    """A gray ramp with a bright square that moves: columns 2 n .. 2 n + 9."""
    width, height = size
    image = np.repeat(np.linspace(0, 120, width).astype(np.uint8)[None, :, None], height, axis=0)
    image = np.repeat(image, 3, axis=2)
    image[5:15, 2 * number % width : 2 * number % width + 10] = (40, 120, 250)
    return image


def write_video(path, codec="mpeg4", frames=40, size=(64, 48), rate=25, pix="yuv420p", **more):
    """Write `frames` pictures; returns the path.

    `stamps` are the pictures' times in intervals (default 0, 1, 2, ...), `options` those of the container,
    `then` a second size that half of the pictures have, `gop` the distance of key frames.
    """
    stamps = more.get("stamps") or list(range(frames))
    interval = 1 / Fraction(rate)
    with av.open(str(path), "w", options=more.get("options", {})) as container:
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height = size
        stream.pix_fmt = pix
        stream.codec_context.time_base = interval / more.get("fine", 1)
        stream.codec_context.gop_size = more.get("gop", 10)
        encoders = [(size, stream)]
        if "then" in more:
            second = av.CodecContext.create(codec, "w")
            second.width, second.height = more["then"]
            second.pix_fmt, second.framerate, second.time_base = pix, Fraction(rate), interval
            encoders.append((more["then"], second))
        done = 0
        for part, (part_size, encoder) in zip(np.array_split(stamps, len(encoders)), encoders, strict=True):
            for stamp in part:
                frame = av.VideoFrame.from_ndarray(picture(done, part_size), format="bgr24")
                frame.pts, frame.time_base = (
                    round(stamp * more.get("fine", 1)),
                    interval / more.get("fine", 1),
                )
                for packet in encoder.encode(frame):
                    packet.stream = stream
                    container.mux(packet)
                done += 1
            for packet in encoder.encode():
                packet.stream = stream
                container.mux(packet)
    return path


@pytest.fixture
def make_video(tmp_path):
    """Writes a video of this name into the test's folder; settings as in `write_video`."""

    def make(name, **settings):
        return write_video(tmp_path / name, **settings)

    return make


@pytest.fixture(scope="session")
def whole_videos(tmp_path_factory):
    """One whole video of 40 frames per container: name -> path."""
    folder = tmp_path_factory.mktemp("videos")
    start = {"movflags": "faststart"}
    return {
        "plain.mp4": write_video(folder / "plain.mp4", "libx264"),
        "start.mp4": write_video(folder / "start.mp4", "libx264", options=start),
        "xvid.avi": write_video(folder / "xvid.avi", "mpeg4"),
        "h264.mkv": write_video(folder / "h264.mkv", "libx264"),
    }
