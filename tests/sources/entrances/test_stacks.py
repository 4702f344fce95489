"""Files of several images: every one is a frame, or the file is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.runs import FrameSizeChanged, FramesMissing, SourceDamaged
from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources import images
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.images import read_image
from bayesnet_track.sources.sources import SourceError, open_source
from bayesnet_track.sources.stereo_source import open_stereo_source

SHADES = (10, 60, 110, 160, 210)


def coloured(dtype=np.uint8, shape=(24, 32, 3)):
    """One for each shade, with a corner that is black."""
    scale = 257 if dtype == np.uint16 else 1
    found = [np.full(shape, scale * shade, dtype) for shade in SHADES]
    for image in found:
        image[:4, :4] = 0
    return found


def write_netpbm(path, frames):
    path.write_bytes(b"".join(cv2.imencode(".ppm", frame)[1].tobytes() for frame in frames))


def write_animation(path, frames, milliseconds=(40, 40, 40, 40, 40)):
    if not hasattr(cv2, "Animation"):
        pytest.skip("this OpenCV writes no animations")
    animation = cv2.Animation()
    animation.frames, animation.durations = frames, np.array(milliseconds)
    assert cv2.imwriteanimation(str(path), animation, [cv2.IMWRITE_WEBP_QUALITY, 101])


def write(folder, name, dtype=np.uint8, shape=(24, 32, 3)):
    path, frames = folder / name, coloured(dtype, shape)
    if path.suffix == ".ppm":
        write_netpbm(path, frames)
    elif path.suffix == ".tif":
        assert cv2.imwritemulti(str(path), frames)
    else:
        write_animation(path, frames)
    return path


def read(source, **settings):
    with open_source(str(source), **settings) as opened:
        items = list(opened)
    return [item for item in items if isinstance(item, Frame)], [i for i in items if not isinstance(i, Frame)]


@pytest.mark.parametrize(
    ("name", "dtype", "shape"),
    [
        ("a.tif", np.uint8, (24, 32, 3)),
        ("a.tif", np.uint16, (24, 32)),
        ("a.tif", np.uint16, (24, 32, 3)),
        ("a.ppm", np.uint8, (24, 32, 3)),
        ("a.webp", np.uint8, (24, 32, 3)),
        ("a.png", np.uint8, (24, 32, 3)),
        ("a.gif", np.uint8, (24, 32, 3)),
    ],
)
def test_every_image_of_a_file_is_a_frame(tmp_path, name, dtype, shape):
    frames, events = read(write(tmp_path, name, dtype, shape))
    tolerance = 61 if name == "a.gif" else 0  # OpenCV gives it few colours
    assert [int(frame.image[12, 16, 0]) for frame in frames] == pytest.approx(SHADES, abs=tolerance)
    assert all(int(frame.image[0, 0, 0]) == 0 for frame in frames)
    assert frames[0].has_color == (len(shape) == 3)
    assert events == []


def test_a_page_of_another_size_changes_the_frames(tmp_path):
    frames = coloured()
    frames[3] = frames[3][:, :20]
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), frames)
    found, events = read(tmp_path / "a.tif")
    assert len(found) == 3 and isinstance(events[0], FrameSizeChanged)


def test_start_end_and_stride_count_pages(tmp_path):
    path = write(tmp_path, "a.tif")
    assert [int(f.image[12, 16, 0]) for f in read(path, start=1, end=5, stride=2)[0]] == [60, 160]


@pytest.mark.parametrize("name", ["a.webp", "a.png"])
def test_an_animation_has_its_own_clock(tmp_path, name):
    write_animation(tmp_path / name, coloured(), (40, 40, 120, 40, 40))
    found, events = read(tmp_path / name)
    assert [frame.time_s for frame in found] == pytest.approx([0, 0.04, 0.08, 0.2, 0.24])
    assert events == [FramesMissing(3, pytest.approx(2.0))]


def test_a_stack_beside_other_images_is_said(tmp_path):
    write(tmp_path, "1.tif")
    assert cv2.imwrite(str(tmp_path / "2.tif"), coloured()[0])
    found, events = read(tmp_path)
    assert len(found) == 1 and isinstance(events[0], SourceDamaged)
    assert "1.tif: 5 images in one TIFF file" in events[0].reason


def test_an_animated_webp_is_refused_where_opencv_reads_one_frame_of_it(tmp_path, monkeypatch):
    path = write(tmp_path, "a.webp")
    monkeypatch.delattr(cv2, "imdecodeanimation")
    with pytest.raises(SourceError, match="5 frames of an animated WebP"):
        open_source(str(path))


def test_a_stack_that_is_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(images, "MOST_BYTES", 1000)
    with pytest.raises(SourceError, match="allowed: 0 MB"):
        open_source(str(write(tmp_path, "a.tif")))


def test_a_damaged_page_keeps_its_number(tmp_path):
    path = write(tmp_path, "a.tif")
    data = bytearray(path.read_bytes())
    places = images.stack_of(path)._pages.places
    data[places[2] + 2 : places[2] + 60] = b"\xff" * 58
    path.write_bytes(data)
    found, events = read(path)
    assert [frame.index for frame in found] == [0, 1, 3, 4]
    assert [event for event in events if isinstance(event, SourceDamaged)] == [
        SourceDamaged(2, "a.tif, page 3: not a readable image")
    ]


def test_an_image_alone_is_not_one_of_several(tmp_path):
    with pytest.raises(PictureError, match=r"a\.tif: 5 images in one TIFF file"):
        read_image(write(tmp_path, "a.tif"))


def test_depth_is_not_a_stack(tmp_path):
    write(tmp_path, "a.tif")
    write(tmp_path, "depth.tif", np.uint16, (24, 32))
    with pytest.raises(SourceError, match=r"depth\.tif: 5 images in one TIFF file"):
        open_stereo_source(str(tmp_path / "a.tif"), depth=str(tmp_path / "depth.tif"))


@pytest.mark.parametrize(
    "names",
    [
        ("left_{}.png", "right_{}.png"),
        ("{}.png", "{}_mask.png"),
        ("{}.png", "{}.jpg"),
    ],
)
def test_two_sequences_in_a_folder_are_refused_and_both_are_named(tmp_path, names):
    for number in range(1, 4):
        for name in names:
            assert cv2.imwrite(str(tmp_path / name.format(number)), coloured()[number])
    with pytest.raises(SourceError) as caught:
        open_source(str(tmp_path))
    assert all(name.format("*") in str(caught.value) for name in names)
    assert len(read(tmp_path / names[0].format("[1-3]"))[0]) == 3
    with pytest.warns(InputNotice, match="2 sequences with the same numbers are read one after the other"):
        assert len(read(tmp_path / "*")[0]) == 6


def test_names_with_the_time_of_day_are_one_sequence(tmp_path):
    for minute in (1, 2):
        for second in (10, 20, 30):
            assert cv2.imwrite(str(tmp_path / f"12-0{minute}-{second}.png"), coloured()[0])
    with pytest.warns(InputNotice, match="2 sequences"):
        assert len(read(tmp_path)[0]) == 6


def test_numbers_that_meet_by_chance_are_no_second_sequence():
    names = [f"a{number}.png" for number in range(1, 11)] + [f"b{number}.png" for number in range(10, 21)]
    assert images.overlapping_sequences([Path(name) for name in names]) == {}


def test_names_that_go_on_with_another_text_are_one_sequence(tmp_path, recwarn):
    for name in ("a_1", "a_2", "a_3", "b_4", "b_5", "b_6", "cover"):
        assert cv2.imwrite(str(tmp_path / f"{name}.png"), coloured()[0])
    assert len(read(tmp_path)[0]) == 7
    assert not recwarn.list


def test_images_of_a_format_that_is_not_read_are_said(tmp_path):
    assert cv2.imwrite(str(tmp_path / "1.png"), coloured()[0])
    for number in range(2, 4):
        (tmp_path / f"{number}.HEIC").write_bytes(b"x")
    with pytest.warns(InputNotice, match=r"2\.HEIC, 3\.HEIC"):
        assert len(read(tmp_path)[0]) == 1


def test_a_stack_is_tracked_to_its_end(tmp_path):
    texture = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), [np.roll(texture, n, axis=1) for n in range(5)])
    command = ["run", "two_squares", "--source", str(tmp_path / "a.tif"), "--init", "20,20,20,20"]
    assert main([*command, "--out", str(tmp_path / "run"), "-q"]) == 0
    assert len((tmp_path / "run" / "tracks.txt").read_text().splitlines()) == 5
