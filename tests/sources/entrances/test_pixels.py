"""Frames with transparent pixels or values that are not finite, and arrays that are no frames as they are."""

import warnings
from types import SimpleNamespace

import av
import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, Tracker
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.levels import explain_pixels
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.sources import open_source

BOX = (20, 12, 16, 16)
RGBA = np.full((48, 64, 4), 200, np.uint8)
RGBA[..., 3] = 255
RGBA[:20, :20, 3] = 100
RGBA[30:, 30:, 3] = 0


def movie(path, codec, pix):
    """Three frames of RGBA in a codec that keeps the alpha."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, pix
        for _ in range(3):
            for packet in stream.encode(av.VideoFrame.from_ndarray(RGBA, format="rgba").reformat(format=pix)):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


@pytest.mark.parametrize("value_range", [None, True])
@pytest.mark.parametrize(
    ("codec", "pix"), [("qtrle", "argb"), ("prores_ks", "yuva444p10le"), ("ffv1", "bgra")]
)
def test_a_video_with_alpha_is_laid_over_black_as_an_image_is(tmp_path, codec, pix, value_range):
    path = movie(tmp_path / "a.mov" if codec != "ffv1" else tmp_path / "a.mkv", codec, pix)
    limits = (0, 65535 if "10" in pix else 255) if value_range else None
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", InputNotice)
        with open_source(str(path), value_range=limits) as source:
            frames = [one.image for one in source if isinstance(one, Frame)]
    assert len(frames) == 3
    for image in frames:
        assert abs(image[5, 5].astype(int) - 78).max() <= 2
        assert image[40, 40].tolist() == [0, 0, 0] and abs(image[5, 50].astype(int) - 200).max() <= 2
    texts = [str(one.message) for one in said if "transparent" in str(one.message)]
    assert len(texts) == 1 and "of 3072 pixels of a frame are transparent" in texts[0]
    assert int(texts[0].split(" of ")[0].split()[-1]) == pytest.approx(20 * 20 + 18 * 34, rel=0.05)


def test_alpha_that_cannot_be_decoded_is_said(tmp_path):
    path = movie(tmp_path / "a.webm", "libvpx-vp9", "yuva420p")
    with pytest.warns(InputNotice, match="its alpha channel cannot be decoded here"), open_source(str(path)):
        pass


def scene(kind=np.float32):
    """A textured square on a dark ground."""
    image = np.random.default_rng(0).integers(20, 60, (48, 64)).astype(kind)
    image[12:28, 20:36] += np.random.default_rng(1).integers(80, 160, (16, 16)).astype(kind)
    return image


def test_values_that_are_not_finite_are_said_once_when_they_come():
    tracker = Tracker("general", value_range=(0, 255))
    image, broken = scene(), scene()
    broken[:4, :5], broken[10, 10] = np.nan, np.inf
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", InputNotice)
        tracker.init(image, BOX)
        tracker.update(broken)
        tracker.update(broken)
    assert [str(one.message) for one in said] == [
        "frame 0: 21 of 3072 values of a frame are not finite (20 NaN): NaN and -inf become black, inf white"
    ]


MASKED = np.ma.masked_less(scene(np.uint8), 25)
DETECTIONS = SimpleNamespace(xyxy=np.array([[20.0, 12, 36, 28]]), confidence=np.array([0.9]))
NO_FRAMES = [
    (MASKED, f"a masked array, {np.ma.count_masked(MASKED)} of 3072 values masked; give"),
    (scene(np.uint8) > 40, r"a mask of True and False: frame.astype\(numpy.uint8\) \* 255"),
    (
        np.dstack([scene(np.uint8)] * 3).transpose(2, 0, 1),
        r"channels stand first, .* frame.transpose\(1, 2, 0\)",
    ),
    (np.stack([np.dstack([scene(np.uint8)] * 3)] * 5), r"5 images: give them one by one, frame\[0\] first"),
    (scene(np.int64), r"0 to 255 are black to white, frame.astype\(numpy.uint8\)"),
    (scene(np.float64) / 255, r"need a range: value_range=\(0, 1\)"),
    (np.dstack([scene(np.uint8)] * 2), r"two channels: frame\[..., 0\]"),
    (np.dstack([scene(np.uint8)] * 5), "takes three channels, blue, green and red, of several"),
    (scene(np.complex64), r"frame.astype\(numpy.uint8\) makes 8 bits"),
    (np.zeros((0, 64, 3), np.uint8), "it holds no pixel"),
]


@pytest.mark.parametrize(("frame", "message"), NO_FRAMES, ids=[message[:30] for _, message in NO_FRAMES])
def test_what_is_no_frame_is_refused_with_what_makes_it_one(frame, message):
    tracker = Tracker("general")
    with pytest.raises(ValueError, match=message):
        tracker.init(frame, BOX)
    tracker.init(scene(np.uint8), BOX)
    with pytest.raises(ValueError, match=message):
        tracker.update(frame)
    assert tracker.update(scene(np.uint8))[0]
    with pytest.raises(ValueError, match=message):
        DetectionsTracker("kalman_detections").update(DETECTIONS, frame)


def test_a_masked_array_of_which_nothing_is_masked_is_a_frame():
    tracker = Tracker("general")
    tracker.init(np.ma.asarray(scene(np.uint8)), BOX)
    assert tracker.update(np.ma.asarray(scene(np.uint8)))[0]


@pytest.mark.parametrize(
    "box",
    [
        (True, True, 20, 20),
        [20, 12, np.True_, 16],
        np.array([True] * 4),
        np.ma.masked_equal([20, 12, 16, 17], 17),
        ["20", "12", "16", "16"],
        (20 + 1j, 12, 16, 16),
    ],
)
def test_a_start_box_of_other_than_four_numbers_is_refused(box):
    with pytest.raises(ValueError, match="four finite numbers x,y,w,h are needed"):
        Tracker("general").init(scene(np.uint8), box)


def test_numbers_beyond_8_bits_are_not_taken_for_them():
    assert explain_pixels(scene(np.int64) + 300, True).startswith("; values of another type need a range: ")


def test_floats_up_to_255_may_be_of_8_bits():
    image = np.linspace(17.0, 240.0, 48 * 64 * 3).reshape(48, 64, 3)
    advice = "value_range=(17, 240), or, where 0 to 255 are black to white, frame.astype(numpy.uint8)"
    assert explain_pixels(image, True).endswith(advice)
    assert explain_pixels(image / 255, True).endswith("value_range=(0, 1)")
