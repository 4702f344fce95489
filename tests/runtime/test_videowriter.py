"""The annotated video: readable, whole, and still readable after kill -9 and on a full disk."""

import signal
import subprocess
import sys

import av
import numpy as np
import pytest

from bayesnet_track.journal.writer import OutputError
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.recording.videowriter import VideoWriter, remux
from bayesnet_track.sources.sources import open_source

NAMES = ["v.mkv", "v.mp4"]


def picture(number):
    image = np.zeros((49, 65, 3), np.uint8)
    image[:, :, 2] = 6 * number
    return image


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("codecs", ["as installed", "without libx264"])
def test_what_is_written_can_be_read(tmp_path, name, codecs, monkeypatch):
    if codecs == "without libx264":
        monkeypatch.setattr(av, "codecs_available", frozenset({"mpeg4"}))
    with VideoWriter(tmp_path / name, 65, 49, 1 / 30) as writer:
        for number in range(40):
            writer.write(picture(number))
    with av.open(str(tmp_path / name)) as container:
        expected = "mpeg4" if codecs == "without libx264" else "h264"
        assert container.streams.video[0].codec_context.name == expected
    with open_source(str(tmp_path / name)) as source:
        frames = [item for item in source if isinstance(item, Frame)]
    assert [f.time for f in frames] == [float(n) for n in range(40)]
    # An odd size loses its last row and column.
    assert (source.width, source.height) == (64, 48)
    assert source.frame_interval_s == pytest.approx(1 / 30)
    assert source.end_reason == "end_of_source"
    red = [f.image[..., 2].mean() for f in frames]
    # Lossy, in limited range: a few gray levels.
    assert np.allclose(red, 6.0 * np.arange(40), atol=8)


def test_an_mp4_is_in_fragments_until_it_is_finished(tmp_path):
    path = tmp_path / "v.mp4"
    writer = VideoWriter(path, 65, 49, 1 / 25)
    for number in range(40):
        writer.write(picture(number))
    assert b"moof" in path.read_bytes()  # the first fragment is there to be read
    writer.finish()
    if av.__version__.startswith(("14.0", "14.1")):
        pytest.skip("these cannot copy a stream")
    data = path.read_bytes()
    assert (
        b"moof" not in data and data.count(b"moov") == 1 and [p.name for p in tmp_path.iterdir()] == ["v.mp4"]
    )
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.frames == 40 and stream.average_rate == 25
        assert [frame.pts * stream.time_base * 25 for frame in container.decode(stream)] == list(range(40))


def test_an_mp4_that_cannot_be_read_stays_as_it_is(tmp_path):
    path = tmp_path / "v.mp4"
    path.write_bytes(b"no video")
    with pytest.raises(av.error.InvalidDataError):
        remux(path)
    assert path.read_bytes() == b"no video" and len(list(tmp_path.iterdir())) == 1


def test_a_writer_without_frames_closes_twice(tmp_path):
    writer = VideoWriter(tmp_path / "v.mkv", 64, 48, 0.04)
    writer.close()
    writer.close()
    assert {file.name for file in tmp_path.iterdir()} <= {"v.mkv"}
    with pytest.raises(av.FFmpegError):  # no picture was ever in it
        av.open(str(tmp_path / "v.mkv"))


@pytest.mark.parametrize(
    ("name", "size", "words"), [("v.avi", (64, 48), "written as .mkv or .mp4"), ("v.mkv", (1, 9), "2x2")]
)
def test_what_cannot_be_written_is_refused(tmp_path, name, size, words):
    with pytest.raises(OutputError, match=words):
        VideoWriter(tmp_path / name, *size, 0.04)


def test_a_missing_folder_is_a_clear_error(tmp_path):
    with pytest.raises(OutputError, match="cannot write the video: No such file"):
        VideoWriter(tmp_path / "none" / "v.mkv", 64, 48, 0.04)


def test_a_picture_that_is_none_is_a_clear_error(tmp_path):
    writer = VideoWriter(tmp_path / "v.mkv", 64, 48, 0.04)
    with pytest.raises(OutputError, match="cannot write the video"):
        writer.write(np.zeros((48, 64), np.float64))
    writer.close()


CHILD = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from bayesnet_track.journal.writer import OutputError
from bayesnet_track.runtime.recording.videowriter import VideoWriter
limit = int(sys.argv[2])
if limit:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
rng = np.random.default_rng(3)
writer = VideoWriter(Path(sys.argv[1]), 64, 48, 1 / 25)
try:
    for number in range(100_000):
        writer.write(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
        print(number, flush=True)
    writer.close()
except OutputError as error:
    print(error, flush=True)
"""


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_writer_leaves_a_readable_file(tmp_path, name):
    path = tmp_path / name
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(path), "0"], stdout=subprocess.PIPE, text=True)
    written = 0
    while written < 200:
        written = int(child.stdout.readline())
    child.kill()
    child.stdout.close()
    assert child.wait() == -signal.SIGKILL
    with open_source(str(path)) as source:
        frames = sum(isinstance(item, Frame) for item in source)
    # A cluster or fragment is one second, 25 frames: at most the open one and one in flight are lost.
    assert frames >= 200 - 2 * 25


@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_is_a_clear_error(tmp_path, name):
    child = subprocess.run(
        [sys.executable, "-c", CHILD, str(tmp_path / name), "100000"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert child.returncode == 0, child.stderr
    assert "cannot write the video: " in child.stdout.splitlines()[-1]
    with open_source(str(tmp_path / name)) as source:
        assert sum(isinstance(item, Frame) for item in source) > 5
