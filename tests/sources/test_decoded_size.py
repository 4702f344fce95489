"""Pixels of a video, made directly in the size that is tracked in, and runs on them."""

from __future__ import annotations

import itertools
import pickle
import struct
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from bayesnet_track import Start, track
from bayesnet_track.journal.events.runs import SourceDamaged
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.checkpoints.standing import verify
from bayesnet_track.sources import decoding
from bayesnet_track.sources.frames import DecodedFrame
from bayesnet_track.sources.sources import open_source

WIDTH, HEIGHT, FRAMES = 322, 242, 9
MAX_SIDE = 107
SMALL = (107, 80)
LEVELS = 1.5
"""By how much a pixel may differ in the mean: averages before and after the change of colour space."""


def painted(index: int) -> np.ndarray:
    """A smooth image of saturated colours with a square that moves."""
    down, across = np.mgrid[:HEIGHT, :WIDTH]
    image = np.stack([across * 255 / WIDTH, down * 255 / HEIGHT, 255 - across * 255 / WIDTH], axis=-1)
    image[90:150, 60 + 6 * index : 120 + 6 * index] = (40, 220, 200)
    return image.astype(np.uint8)


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("videos")
    kinds = {
        "color.mkv": ("yuv420p", "libx264"),
        "turned.mp4": ("yuv420p", "mpeg4"),
        "gray.mkv": ("gray", "ffv1"),
        "deep_gray.mkv": ("gray16le", "ffv1"),
        "clear.mkv": ("bgra", "ffv1"),
        "deep.mkv": ("yuv420p10le", "ffv1"),
    }
    for name, (pixels, codec) in kinds.items():
        with av.open(str(folder / name), "w") as container:
            stream = container.add_stream(codec, rate=25)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, pixels
            for index in range(FRAMES):
                frame = av.VideoFrame.from_ndarray(painted(index), format="bgr24").reformat(format=pixels)
                frame.pts, frame.time_base = index, Fraction(1, 25)
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
    _turn(folder / "turned.mp4")
    return folder


def _turn(path: Path) -> None:
    """Have a player show it by a quarter turn: the matrix in the track's header."""
    one, unit = 1 << 16, 1 << 30
    straight = struct.pack(">9i", one, 0, 0, 0, one, 0, 0, 0, unit)
    turned = struct.pack(">9i", 0, -one, 0, one, 0, 0, 0, 0, unit)
    stored = path.read_bytes()
    header = stored.index(b"tkhd")
    path.write_bytes(stored[:header] + stored[header:].replace(straight, turned, 1))


def frames(path: Path, tracked: tuple[int, int] | None = None) -> list[Frame]:
    with open_source(str(path)) as source:
        source.tracked = tracked
        return [item for item in source if isinstance(item, Frame)]


@pytest.mark.parametrize("name", ["color.mkv", "turned.mp4", "gray.mkv", "deep.mkv"])
def test_smaller_pixels_are_means_over_areas_in_place_and_colour(videos: Path, name: str) -> None:
    size = SMALL[::-1] if name == "turned.mp4" else SMALL
    plain = frames(videos / name)
    for frame, whole in zip(frames(videos / name, size), plain, strict=True):
        assert isinstance(frame, DecodedFrame) and (frame.width, frame.height) == (whole.width, whole.height)
        found = frame.smaller(size)
        assert (found is not None and "image" not in vars(frame)) or frame.index == 0
        known = cv2.resize(whole.image, size, interpolation=cv2.INTER_AREA).astype(float)
        assert found.shape == known.shape and not found.flags.writeable
        assert abs(found - known).mean() < LEVELS
        shift, _ = cv2.phaseCorrelate(*(cv2.Laplacian(one[..., 1] * 1.0, -1) for one in (known, found)))
        assert np.hypot(*shift) < 0.2  # another convention of pixel centres would be .33
        np.testing.assert_array_equal(frame.image, whole.image)  # and is there for who asks for it
        assert frame.has_color == whole.has_color == (name != "gray.mkv")


@pytest.mark.parametrize("name", ["deep_gray.mkv", "clear.mkv"])
def test_values_that_are_looked_at_one_by_one_are_made_whole(videos: Path, name: str) -> None:
    found, plain = frames(videos / name, SMALL), frames(videos / name)
    assert all(type(frame) is Frame for frame in found)
    np.testing.assert_array_equal(found[-1].image, plain[-1].image)


def test_a_frame_is_sent_and_changed_as_every_other(videos: Path) -> None:
    frame = frames(videos / "color.mkv", SMALL)[3]
    again = pickle.loads(pickle.dumps(frame))
    np.testing.assert_array_equal(again.image, frame.image)
    assert (again.index, again.time, again.stride) == (3, 3.0, 1)
    other = replace(frame, image=np.zeros((4, 5, 3), np.uint8))
    assert (other.width, other.height) == (5, 4)


def begun(videos: Path, out: Path, count: int | None = None) -> Path:
    start = Start((60, 90, 60, 60))
    results = track("general", videos / "color.mkv", [start], out=out, max_side=MAX_SIDE)
    for _ in itertools.islice(results, count):
        pass
    results.close()
    return out


def test_a_run_goes_on_to_the_same_bytes_and_does_not_make_whole_images(
    videos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = begun(videos, tmp_path / "whole")
    stopped = begun(videos, tmp_path / "stopped", 4)
    for _ in resume(stopped):
        pass
    for file in ("journal.jsonl", "frames.npy.gz", "tracks.txt", "run.json"):
        assert (stopped / file).read_bytes() == (whole / file).read_bytes(), file
    made, real = [], decoding.pixels_of
    monkeypatch.setattr(decoding, "pixels_of", lambda *given: made.append(1) or real(*given))
    for _ in track("general", videos / "color.mkv", [Start((60, 90, 60, 60))], max_side=MAX_SIDE):
        pass
    assert len(made) == 1  # a source looks at its first frame when it is opened
    assert verify(whole).status == "verified"


def test_the_way_a_source_is_read_does_not_change_results(videos: Path) -> None:
    """A source whose images were made before the run is asked for the same smaller pixels."""
    boxes = []
    for touch in (False, True):
        with open_source(str(videos / "color.mkv")) as source:
            results = track("general", source, [Start((60, 90, 60, 60))], max_side=MAX_SIDE)
            found = []
            for result in results:
                found.append(tuple(result.targets[0].xywh))
                assert not touch or result.frame.image.shape == (HEIGHT, WIDTH, 3)
        boxes.append(found)
    assert boxes[0] == boxes[1] and len(boxes[0]) == FRAMES


@pytest.mark.parametrize("kind", ["open-gop=1:bframes=3", "intra-refresh=1:bframes=0"])
@pytest.mark.parametrize("asked", [range(0, 40), range(3, 40, 7), (1, 2, 25, 24, 0, 39)])
def test_pictures_that_are_decoded_on_request_are_those_of_all(
    tmp_path: Path, asked: tuple[int, ...], kind: str
) -> None:
    """Of an open group the first pictures refer to the group before; a refresh in stripes begins no group."""
    path = tmp_path / "groups.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.options = {"x264-params": f"keyint=10:min-keyint=10:b-adapt=0:scenecut=0:{kind}"}
        for index in range(40):
            image = np.roll(painted(0)[:48, :64], 3 * index, axis=1)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode())
    frames = [frame for frame in open_source(str(path), lazy=True) if isinstance(frame, Frame)]
    for index in asked:
        assert frames[index].is_readable
    later = frames[1:]  # the first one is decoded when the source is opened
    assert [isinstance(frame, DecodedFrame) and frame.is_made for frame in later] == [
        index in asked for index in range(1, 40)
    ]
    decoded = [frame for frame in open_source(str(path)) if isinstance(frame, Frame)]
    assert [frame.time_s for frame in frames] == [frame.time_s for frame in decoded]
    for index in asked:
        assert np.array_equal(frames[index].image, decoded[index].image)


def test_an_image_that_cannot_be_decoded_is_told_of_when_it_is_asked_for(tmp_path: Path) -> None:
    for index in range(5):
        cv2.imwrite(str(tmp_path / f"{index}.png"), painted(index))
    (tmp_path / "1.png").write_bytes(b"")
    (tmp_path / "2.png").write_bytes(b"")
    cv2.imwrite(str(tmp_path / "4.png"), painted(4)[:100])
    asked, items = (0, 2, 3, 4), []
    source = open_source(str(tmp_path), lazy=True)
    for item in source:
        if isinstance(item, Frame) and item.index in asked:
            items.append((item.index, all([item.is_readable, item.is_readable])))  # told of once
        else:
            items.append(item)
    assert [item for item in items if isinstance(item, tuple)] == [
        (0, True),
        (2, False),
        (3, True),
        (4, False),
    ]
    told = [item for item in items if isinstance(item, SourceDamaged)]
    assert [(event.frame, event.times) for event in told] == [(2, 1), (4, 1)]
    assert "322x100 px, and the first one 322x242" in told[1].reason
    assert source.end_reason == "source_damaged"
