"""Folders, globs and single images: order, times, gray, alpha, 16 bit, damage, and every refusal."""

import time
from itertools import islice, pairwise

import cv2
import numpy as np
import pytest

from bayesnet_track.journal.events.runs import FrameSizeChanged, FramesMissing, SourceDamaged
from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.levels import to_bgr
from bayesnet_track.sources.paths import depth_files
from bayesnet_track.sources.sources import SourceError, open_source


def save(folder, names, image=None):
    """Images whose red channel says their place in `names`."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        one = np.full((20, 30, 3), (10, 20, number), np.uint8) if image is None else image
        assert cv2.imwrite(str(folder / name), one)
    return folder


def read(source_text, **settings):
    with open_source(str(source_text), **settings) as source:
        items = list(source)
    return source, [i for i in items if isinstance(i, Frame)], [i for i in items if not isinstance(i, Frame)]


def test_images_come_in_natural_order_with_times_0_1_2(tmp_path):
    names = [f"f{n}.png" for n in (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11)]
    source, frames, events = read(save(tmp_path / "s", names))
    assert [f.image[0, 0].tolist() for f in frames] == [[10, 20, n] for n in range(11)]
    assert [f.time for f in frames] == [float(n) for n in range(11)]
    assert [f.time_s for f in frames] == [n / 25 for n in range(11)]
    assert events == []
    assert (source.width, source.height, source.has_color, source.declared_frames) == (30, 20, True, 11)
    assert source.end_reason == "end_of_source"


@pytest.mark.parametrize("below", ["img", "img1"])
def test_a_sequence_folder_is_its_images(tmp_path, below):
    save(tmp_path / "Car" / below, ["0001.png", "0002.png"])
    (tmp_path / "Car" / "groundtruth.txt").write_text("1,2,3,4\n")
    assert len(read(tmp_path / "Car")[1]) == 2


def test_a_glob_takes_what_it_matches(tmp_path):
    folder = save(tmp_path, ["a1.png", "a2.png", "b1.png"])
    assert len(read(folder / "a*.png")[1]) == 2


def test_one_image_is_a_source_of_one_frame(tmp_path):
    assert len(read(save(tmp_path, ["x.png"]) / "x.png")[1]) == 1


def test_a_gap_in_the_numbers_is_missing_frames(tmp_path):
    source, frames, events = read(save(tmp_path / "s", ["00001.png", "00002.png", "00007.png", "00008.png"]))
    assert [f.time for f in frames] == [0.0, 1.0, 6.0, 7.0]
    assert [f.index for f in frames] == [0, 1, 2, 3]
    assert events == [FramesMissing(2, 4.0)]
    assert source.end_reason == "end_of_source"


def test_numbers_with_a_regular_step_are_no_gap(tmp_path):
    _, frames, events = read(save(tmp_path / "s", [f"{n:05d}.png" for n in range(0, 50, 10)]))
    assert [f.time for f in frames] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert events == []


@pytest.mark.parametrize("names", [["a.png", "b.png", "d.png"], ["a1.png", "b9.png"], ["1.png", "01.png"]])
def test_names_that_are_no_series_have_times_0_1_2(tmp_path, names):
    _, frames, events = read(save(tmp_path / "s", names))
    assert [f.time for f in frames] == [float(n) for n in range(len(names))]
    assert events == []


@pytest.mark.parametrize(
    ("folder", "names"),
    [
        ("s", ["1²0.jpg", "2²0.jpg", "10²0.jpg"]),
        ("²3²", ["1.jpg", "2.jpg", "10.jpg"]),
        ("³", ["٣.jpg", "٤.jpg", "١٠.jpg"]),
    ],
)
def test_superscripts_are_no_numbers_and_digits_of_any_script_are(tmp_path, folder, names):
    for number, name in enumerate(names):
        save(tmp_path / folder, [name], np.full((20, 30, 3), 100 * number, np.uint8))
    source, frames, _ = read(tmp_path / folder)
    assert source.end_reason == "end_of_source"
    assert [round(float(f.image.mean()), -2) for f in frames] == [0, 100, 200]


@pytest.mark.parametrize("content", [b"", b"no image", None], ids=["empty", "text", "cut off"])
@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp"])
def test_a_damaged_image_keeps_its_number_and_the_rest_goes_on(tmp_path, content, suffix):
    noise = np.random.default_rng(1).integers(0, 255, (40, 50, 3), dtype=np.uint8)
    folder = save(tmp_path / "s", [f"{n}.{suffix}" for n in range(5)], noise)
    bad = folder / f"2.{suffix}"
    whole = bad.read_bytes()
    bad.write_bytes(whole[: len(whole) // 2] if content is None else content)
    source, frames, events = read(folder)
    assert [f.index for f in frames] == [0, 1, 3, 4]
    assert [f.time for f in frames] == [0.0, 1.0, 3.0, 4.0]
    assert [type(e) for e in events] == [SourceDamaged, FramesMissing]
    assert events[0].frame == 2
    assert f"2.{suffix}: " in events[0].reason
    assert events[1] == FramesMissing(3, 1.0)
    assert source.end_reason == "source_damaged"
    assert source.frames == 4


@pytest.mark.parametrize("pattern", ["", "*.png"])
def test_a_broken_link_keeps_its_number(tmp_path, pattern):
    folder = save(tmp_path / "s", [f"{n}.png" for n in range(5)])
    (folder / "2.png").unlink()
    (folder / "2.png").symlink_to(tmp_path / "gone.png")
    (folder / "9.png").mkdir()
    source, frames, events = read(folder / pattern)
    assert ([f.index for f in frames], source.declared_frames) == ([0, 1, 3, 4], 5)
    assert events == [SourceDamaged(2, "2.png: No such file or directory"), FramesMissing(3, 1.0)]
    before = source.origin.marked()
    assert before.changes() == ()
    (folder / "2.png").unlink()
    save(folder, ["2.png"])
    assert before.changes()


def test_a_damaged_first_image_is_told_before_the_first_frame(tmp_path):
    folder = save(tmp_path / "s", ["0.png", "1.png"])
    (folder / "0.png").write_bytes(b"")
    _, frames, events = read(folder)
    assert [f.index for f in frames] == [1]
    assert events == [SourceDamaged(0, "0.png: not a readable image")]


def test_a_damaged_image_before_the_start_is_not_looked_at(tmp_path):
    folder = save(tmp_path / "s", ["0.png", "1.png", "2.png"])
    (folder / "0.png").write_bytes(b"")
    source, frames, events = read(folder, start=1)
    assert ([f.index for f in frames], events, source.end_reason) == ([1, 2], [], "end_of_source")


@pytest.mark.parametrize("on_resize", ["stop", "rescale"])
@pytest.mark.parametrize("changed", [(np.zeros((24, 36, 3)), 36, 24), (np.zeros((20, 30)), 30, 20)])
def test_a_change_of_size_or_channels(tmp_path, on_resize, changed):
    image, width, height = changed
    folder = save(tmp_path / "s", [f"{n}.png" for n in range(6)])
    for number in (3, 4):
        cv2.imwrite(str(folder / f"{number}.png"), image.astype(np.uint8))
    source, frames, events = read(folder, on_resize=on_resize)
    there = FrameSizeChanged(3, width, height, on_resize)
    if on_resize == "stop":
        assert (len(frames), events, source.end_reason) == (3, [there], "frame_size_changed")
    else:
        # Told once for each change: there and back again.
        assert events == [there, FrameSizeChanged(5, 30, 20, "rescale")]
        assert {f.image.shape for f in frames} == {(20, 30, 3)}
        assert (len(frames), source.end_reason) == (6, "end_of_source")


def test_a_gray_image_has_no_color(tmp_path):
    gray = np.arange(600, dtype=np.uint8).reshape(20, 30)
    source, frames, _ = read(save(tmp_path / "s", ["0.png"], gray))
    assert not source.has_color
    assert np.array_equal(frames[0].image, np.repeat(gray[..., None], 3, axis=2))


def test_a_sixteen_bit_image_is_scaled_by_257(tmp_path):
    deep = np.zeros((20, 30, 3), np.uint16)
    deep[0, :5, 0] = (0, 128, 129, 32896, 65535)
    _, frames, _ = read(save(tmp_path / "s", ["0.png"], deep))
    assert frames[0].image[0, :5, 0].tolist() == [0, 0, 1, 128, 255]


def test_sixteen_bit_rounding_is_the_nearest_of_257ths():
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    expected = np.round(every / 257.0).astype(np.uint8)
    image, has_color = to_bgr(every)
    assert np.array_equal(image[..., 1], expected)
    assert not has_color


def test_alpha_is_laid_over_black(tmp_path):
    clear = np.zeros((20, 30, 4), np.uint8)
    clear[...] = (200, 100, 50, 0)
    clear[:, 10:20, 3] = 128
    clear[:, 20:, 3] = 255
    source, frames, _ = read(save(tmp_path / "s", ["0.png"], clear))
    image = frames[0].image
    assert source.has_color
    assert image[0, 0].tolist() == [0, 0, 0]
    assert image[0, 15].tolist() == [round(c * 128 / 255) for c in (200, 100, 50)]
    assert image[0, 25].tolist() == [200, 100, 50]


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 4), np.float32),
        np.zeros((4, 4, 2), np.uint8),
        np.zeros((0, 4), np.uint8),
        np.zeros(4, np.uint8),
    ],
)
def test_other_pixels_are_refused(image):
    with pytest.raises(PictureError, match="allowed: 8 or 16 bit"):
        to_bgr(image)


def refusal(text, **settings):
    with pytest.raises(SourceError) as caught:
        open_source(str(text), **settings)
    error = caught.value
    assert repr(str(text)) in str(error)
    assert all((error.found, error.allowed, error.mend))
    return str(error)


def test_a_missing_file_names_the_nearest(tmp_path):
    save(tmp_path, ["walking.png"])
    assert f"did you mean {str(tmp_path / 'walking.png')!r}?" in refusal(tmp_path / "wakling.png")
    (tmp_path / "couple.yaml").write_text("no source")
    (tmp_path / "couples").mkdir()
    assert "did you mean" not in refusal(tmp_path / "couple.mp4")
    save(tmp_path / "couples", ["1.png"])
    assert f"did you mean {str(tmp_path / 'couples')!r}?" in refusal(tmp_path / "couple.mp4")
    assert "does not exist either" in refusal(tmp_path / "none" / "x.mp4")


def test_a_folder_without_images_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    assert "the folder holds no image (1 entries)" in refusal(tmp_path)


def test_a_glob_without_images_is_refused(tmp_path):
    assert "matches 0 files" in refusal(tmp_path / "*.png")


def test_a_text_file_is_no_video(tmp_path):
    (tmp_path / "a.mp4").write_text("hello")
    assert "not a readable video" in refusal(tmp_path / "a.mp4")


def test_images_none_of_which_can_be_read_are_refused(tmp_path):
    (tmp_path / "1.png").write_bytes(b"x")
    assert "no frame can be read (1.png: not a readable image)" in refusal(tmp_path)


def test_no_camera_is_a_clear_error(monkeypatch):
    class NoCamera:
        def __init__(self, index):
            self.index = index

        def isOpened(self):
            return False

    monkeypatch.setattr(cv2, "VideoCapture", NoCamera)
    assert "no camera with this index" in refusal("7")


def test_a_camera_gives_frames_at_the_times_of_arrival(monkeypatch):
    """It declares 10 a second and gives one every 20 ms."""

    class Camera:
        def __init__(self, index):
            self.index = index

        def isOpened(self):
            return True

        def get(self, what):
            return 10.0

        def read(self):
            time.sleep(0.02)
            return True, np.zeros((20, 30, 3), np.uint8)

        def release(self):
            pass

    monkeypatch.setattr(cv2, "VideoCapture", Camera)
    began = time.monotonic()
    with open_source("0") as source:
        frames = [item for item in islice(source, 8) if isinstance(item, Frame)]
        lasted = time.monotonic() - began
    assert frames[0].time == 0.0 and frames[-1].time_s <= lasted
    assert [frame.time for frame in frames] == pytest.approx([frame.time_s / 0.1 for frame in frames])
    assert all(b.time_s - a.time_s >= 0.02 for a, b in pairwise(frames))
    assert (source.declared_frames, source.frame_interval_s, source.end_reason) == (
        None,
        0.1,
        "end_of_source",
    )


PROBES = [
    "concat:{0}|{0}",
    "subfile,,start,0,end,9,,:{0}",
    "file:{0}",
    "FILE:{0}",
    "pipe:0",
    "data:video/mp4;base64,AAAA",
    "crypto:{0}",
    "async:{0}",
    "cache:file:{0}",
    "hls+file:{0}",
    "concatf:{0}",
    "tcp://127.0.0.1:1",
    "ftp://127.0.0.1/x",
    "tee:{0}",
    "fd:",
    "unix:/tmp/x",
]


@pytest.mark.parametrize("allow_network", [False, True])
@pytest.mark.parametrize("probe", PROBES)
def test_protocols_are_refused_even_with_the_network(tmp_path, probe, allow_network):
    save(tmp_path, ["1.png"])
    assert "is refused" in refusal(probe.format(tmp_path / "1.png"), allow_network=allow_network)


@pytest.mark.parametrize("url", ["http://localhost:1/x.mp4", "https://localhost:1/x", "rtsp://localhost:1/x"])
def test_the_network_is_refused_unless_allowed(url):
    assert "it is on the network" in refusal(url)


def test_an_allowed_url_that_nobody_answers_is_a_clear_error():
    assert "at this address: Connection refused" in refusal("http://127.0.0.1:1/x.mp4", allow_network=True)


def test_an_allowed_url_is_read(whole_videos):
    import functools
    import http.server
    import threading

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    path = whole_videos["start.mp4"]
    handler = functools.partial(Quiet, directory=str(path.parent))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            source, frames, events = read(
                f"http://127.0.0.1:{server.server_port}/{path.name}", allow_network=True
            )
        finally:
            server.shutdown()
    assert (len(frames), events, source.end_reason) == (40, [], "end_of_source")


@pytest.mark.parametrize("text", ["", "a\0b"])
def test_an_empty_name_is_refused(text):
    assert "it is empty or holds a NUL" in refusal(text)


def test_a_file_whose_name_has_a_colon_opens_with_a_path(tmp_path, monkeypatch, whole_videos):
    name = "concat:x.mp4"
    (tmp_path / name).write_bytes(whole_videos["start.mp4"].read_bytes())
    monkeypatch.chdir(tmp_path)
    assert "give a plain path (./ in front" in refusal(name)
    assert len(read(f"./{name}")[1]) == 40


def test_a_fifo_is_refused_at_once(tmp_path):
    import os

    os.mkfifo(tmp_path / "pipe.mp4")
    assert "neither a regular file nor a folder" in refusal(tmp_path / "pipe.mp4")


def test_a_file_that_may_not_be_read_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a.mp4").write_bytes(b"x")
    monkeypatch.setattr("os.access", lambda *_: False)
    assert "permission denied" in refusal(tmp_path / "a.mp4")


def test_a_source_closes_twice_and_ends(tmp_path):
    source = open_source(str(save(tmp_path / "s", ["1.png", "2.png"])))
    next(source)
    source.close()
    source.close()
    assert list(source) == []


@pytest.mark.parametrize("digits", [10, 19, 5000])
def test_no_camera_has_such_a_number(digits):
    assert "no camera with this index" in refusal("9" * digits)


def test_a_name_that_is_too_long_is_a_clear_error():
    with pytest.raises(SourceError, match="File name too long"):
        depth_files("x" * 5000)
