"""How values become 8 bits, and what is said where gray levels are lost."""

import warnings

import av
import cv2
import numpy as np
import pytest

from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.levels import explain_loss, to_bgr, value_range_of
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.sources import SourceError, open_source

RAMP = np.tile(np.arange(64, dtype=np.uint16), (48, 1))
"""64 columns, each a level more than the one before it."""
COLUMNS = np.rint(255 * np.arange(64) / 63).astype(np.uint8)


def write_video(path, frames, pix_fmt, codec="ffv1"):
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pix_fmt
        for values in frames:
            frame = av.VideoFrame(stream.width, stream.height, pix_fmt)
            bytes_of = values.astype(
                values.dtype.newbyteorder(">" if pix_fmt.endswith("be") else "<")
            ).tobytes()
            frame.planes[0].update(bytes_of)
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


def said(source, **settings):
    """The frames of a source, and the notices on the way."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with open_source(str(source), **settings) as opened:
            frames = [item for item in opened if isinstance(item, Frame)]
    return frames, [str(one.message) for one in caught if one.category is InputNotice]


def write(folder, name, values):
    path = folder / name
    if path.suffix == ".tif":
        assert cv2.imwritemulti(str(path), [values, values])
        return path
    if path.suffix == ".mkv":
        return write_video(path, [values, values], "gray16le")
    path.mkdir()
    for number in range(2):
        assert cv2.imwrite(str(path / f"{number}.png"), values)
    return path


@pytest.mark.parametrize("name", ["a.tif", "a.mkv", "a"])
def test_few_levels_of_16_bits_are_said_once_with_the_range_that_keeps_them(tmp_path, name):
    source = write(tmp_path, name, RAMP + 8000)
    frames, notices = said(source)
    assert len(np.unique(frames[0].image)) == 1
    assert len(notices) == 1 and str(source) in notices[0]
    assert "lie in 8000..8063, 64 levels, of which 1 is left in 8 bits" in notices[0]
    assert "value_range=(8000, 8063)" in notices[0]
    frames, notices = said(source, value_range=(8000, 8063))
    assert notices == []
    assert [(frame.image[5, :, 0] == COLUMNS).all() for frame in frames] == [True, True]
    assert not frames[0].has_color


@pytest.mark.parametrize(("pix_fmt", "low"), [("gray10le", 200), ("gray12le", 2000), ("gray16le", 40000)])
def test_a_range_of_a_gray_video_counts_the_values_of_the_file(tmp_path, pix_fmt, low):
    frames, _ = said(write_video(tmp_path / "a.mkv", [RAMP + low], pix_fmt), value_range=(low, low + 63))
    assert (frames[0].image[5, :, 2] == COLUMNS).all()


def test_a_range_stretches_8_bits_too(tmp_path):
    path = tmp_path / "a.png"
    assert cv2.imwrite(str(path), (RAMP + 100).astype(np.uint8))
    assert (said(path, value_range=(100, 163))[0][0].image[0, :, 0] == COLUMNS).all()
    video = write_video(tmp_path / "a.mkv", [(RAMP + 100).astype(np.uint8)], "gray")
    assert (said(video, value_range=(100, 163))[0][0].image[0, :, 0] == COLUMNS).all()


def test_a_range_of_a_colour_video_holds_for_each_channel(tmp_path):
    colour = np.stack([RAMP, RAMP + 50, RAMP + 100], axis=2).astype(np.uint8)
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width, stream.pix_fmt = 48, 64, "bgr0"
        for packet in (*stream.encode(av.VideoFrame.from_ndarray(colour, format="bgr24")), *stream.encode()):
            container.mux(packet)
    frame = said(tmp_path / "a.mkv", value_range=(50, 113))[0][0]
    assert (frame.image[5, :, 1] == COLUMNS).all() and frame.has_color
    assert (frame.image == to_bgr(colour, (50, 113))[0]).all()


def test_a_range_is_per_channel_and_leaves_alpha_alone():
    deep = np.dstack([RAMP + 8000] * 3 + [np.full(RAMP.shape, 65535, np.uint16)])
    assert (to_bgr(deep, (8000, 8063))[0] == COLUMNS[:, None]).all()


def test_values_that_are_no_numbers_become_black():
    values = np.array([[20.0, 30.0, 40.0, np.nan, np.inf, -np.inf]], np.float32)
    assert to_bgr(values, (20, 40))[0][0, :, 0].tolist() == [0, 128, 255, 0, 255, 0]


@pytest.mark.parametrize("dtype", [np.float32, np.int16, np.uint32, np.float64])
def test_other_types_need_a_range_and_the_refusal_gives_one(tmp_path, dtype):
    values = (RAMP + 20).astype(dtype)
    with pytest.raises(PictureError, match=r"need a range: value_range=\(20, 83\)"):
        to_bgr(values)
    assert (to_bgr(values, (20, 83))[0][..., 0] == COLUMNS).all()


def test_the_refusal_of_a_long_stack_is_short(tmp_path):
    frames = [np.full((8, 8), number, np.float32) for number in range(40)]
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), frames)
    with pytest.raises(SourceError, match=r"value_range=\(0, 1\).*; and 39 more") as caught:
        open_source(str(tmp_path / "a.tif"))
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    "values",
    [
        RAMP * 1040,  # all of the range
        (RAMP // 32) * 65535,  # two levels, which stay two
        np.full((4, 4), 8000, np.uint16),  # one level: no range would show more
        np.repeat(np.arange(256, dtype=np.uint16) * 257, 4),  # 8 bits, written as 16
    ],
)
def test_nothing_is_said_where_no_level_is_lost(values):
    assert explain_loss(values, to_bgr(np.atleast_2d(values))[0]) is None


def test_a_broken_pixel_does_not_widen_the_range_that_is_given():
    values = np.tile(RAMP + 8000, (10, 10))
    values[0, :2] = 0, 65535
    reason = explain_loss(values, to_bgr(values)[0])
    assert "lie in 0..65535" in reason and "value_range=(8000, 8063)" in reason


@pytest.mark.parametrize(
    ("value_range", "reason"),
    [
        ((0, 100), "100 % of the values of the first frame lie outside of the range 0..100"),
        ((8040, 9000), "62 % of the values of the first frame lie outside"),
        ((0, 65535), "64 levels, of which 1 is left"),
    ],
)
def test_a_range_that_does_not_fit_is_said(tmp_path, value_range, reason):
    _, notices = said(write(tmp_path, "a", RAMP + 8000), value_range=value_range)
    assert len(notices) == 1 and reason in notices[0] and "8000..8063" in notices[0]


@pytest.mark.parametrize("given", [(1,), (2, 1), (1, 1), (0, float("nan")), "ab", 5, (1, 2, 3)])
def test_what_is_no_range_is_refused(tmp_path, given):
    with pytest.raises(ValueError, match="two finite numbers are needed"):
        value_range_of(given)
    with pytest.raises(SourceError, match="value range"):
        open_source(str(write(tmp_path, "a", RAMP)), value_range=given)
