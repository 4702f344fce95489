"""Decoding in a process of its own: the same frames, and what goes wrong there stays there."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.sources import SourceDamaged
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.frames import Source
from bayesnet_track.sources.isolated import IsolatedReader
from bayesnet_track.sources.sandbox import Limits
from bayesnet_track.sources.sources import SourceError, open_source


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


HOSTILE = """
import os
import sys
sys.path[:] = {path!r}
import numpy as np
from bayesnet_track.sources import decoding
from bayesnet_track.sources.readers import Picture

class Hostile:
    declared_frames, frame_interval_s, gap_from = 5, 0.04, 1.5

    def __iter__(self):
        for index in range(3):
            yield Picture(index, float(index), index * 0.04, lambda: (np.zeros((48, 64, 3), np.uint8), True))
        {deed}

    def close(self):
        pass

def tell(answers, message, tell=decoding._send):
    global pipe
    pipe = answers
    tell(answers, message)

decoding._load_libraries, decoding._send = lambda: None, tell
decoding.serve(lambda job: Hostile())
"""


def hostile(deed, picture_s=5.0):
    """A source whose decoder does this after three pictures."""
    limits = Limits(memory_bytes=256 << 20, picture_s=picture_s)
    command = [sys.executable, "-c", HOSTILE.format(path=sys.path, deed=deed)]
    return Source("hostile", IsolatedReader("hostile", limits=limits, command=command), None, None, "stop")


def items(source):
    try:
        opened = source()
    except SourceError as error:
        return str(error), None
    with opened as source:
        return [
            (item.index, item.time, item.time_s, item.has_color, item.image.tobytes())
            if isinstance(item, Frame)
            else item
            for item in source
        ], source.end_reason


@pytest.mark.parametrize("name", ["h264.mkv", slow("plain.mp4"), slow("xvid.avi")])
def test_the_same_frames_as_without(whole_videos, tmp_path, name):
    cut = tmp_path / name
    data = bytearray(whole_videos[name].read_bytes())
    data[3000:3400] = bytes(400)
    cut.write_bytes(data)
    whole = str(whole_videos[name])
    assert items(lambda: open_source(whole, 2, 31, isolate_decoder=True)) == items(
        lambda: open_source(whole, 2, 31)
    )
    # What older decoders put where blocks are lost is not the same each time: all but the pixels is compared.
    frames, reason = items(lambda: open_source(str(cut), 2, 31))
    alone = [one[:-1] if isinstance(one, tuple) else one for one in frames]
    frames, again = items(lambda: open_source(str(cut), 2, 31, isolate_decoder=True))
    assert [one[:-1] if isinstance(one, tuple) else one for one in frames] == alone and again == reason


def test_the_same_images_as_without(tmp_path):
    import cv2

    rng = np.random.default_rng(3)
    for n in range(4):
        cv2.imwrite(str(tmp_path / f"{n}.png"), rng.integers(0, 256, (48, 64, 3), np.uint8))
    (tmp_path / "4.png").write_bytes(b"none")
    alone = items(lambda: open_source(str(tmp_path)))
    assert items(lambda: open_source(str(tmp_path), isolate_decoder=True)) == alone
    assert alone[1] == "source_damaged" and len(alone[0]) == 5


@pytest.mark.parametrize(
    ("deed", "said"),
    [
        ("__import__('ctypes').string_at(0)", "the decoder crashed (SIGSEGV)"),
        slow("os.abort()", "the decoder crashed (SIGABRT)"),
        slow("os._exit(7)", "the decoder ended early (exit code 7)"),
        ("hoard = bytearray(1 << 30)", "the decoder took more than 256 MB of memory"),
        ("open('/dev/null')", "the decoder failed: OSError: [Errno 24] Too many open files"),
        slow("__import__('socket').socket()", "the decoder failed: OSError: [Errno 24] Too many open files"),
        slow("raise ZeroDivisionError", "the decoder failed: ZeroDivisionError"),
    ],
)
def test_what_a_decoder_does_ends_its_source_only(deed, said):
    if "open('" in deed or "socket" in deed:  # the one file that may be open is the video
        deed = f"mine = os.open('/dev/null', 0); {deed}"
    source = hostile(deed)
    frames, reason = items(lambda: source)
    assert [frame[0] for frame in frames[:3]] == [0, 1, 2]
    assert isinstance(frames[-1], SourceDamaged) and frames[-1].frame == 3
    assert said in frames[-1].reason and reason == "source_damaged"
    assert source._reader._process.poll() is not None


def test_a_decoder_that_hangs_is_left():
    began = time.monotonic()
    frames, _ = items(lambda: hostile("__import__('time').sleep(600)", picture_s=0.5))
    assert frames[-1] == SourceDamaged(3, "the decoder hung: no picture in 0.5 s")
    assert time.monotonic() - began < 60


@pytest.mark.slow
def test_time_on_the_processor_is_limited_where_nobody_waits():
    """A decoder whose parent is stopped or gone does not go on for ever."""
    source = hostile("\n        while True: pass", picture_s=0.5)
    process = source._reader._process
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    frames, _ = items(lambda: source)
    assert frames[-1].reason == "the decoder took more than 0.5 s of CPU time for a picture"


def test_nothing_can_be_written(tmp_path):
    with hostile(f"open({str(tmp_path / 'new')!r}, 'wb', 0).write(b'x' * 100000)") as source:
        assert "File too large" in list(source)[-1].reason


@pytest.mark.parametrize(
    "lie",
    [
        "b'no json' + bytes([10])",
        slow("b'[1]' + bytes([10])"),
        slow("b'{}' + bytes([10])"),
        "b'[' * 60000 + bytes([10])",
        'b\'{"is": "damage", "index": Infinity, "reason": ""}\' + bytes([10])',
        slow("bytes(60000)); os.write(pipe, bytes(60000)); os.write(pipe, bytes(60000)"),
        'b\'{"is": "picture", "index": 3, "time": 3.0, "time_s": 1.0, "has_color": true, '
        '"slot": 0, "height": 1000000, "width": 1000000}\' + bytes([10])',
        'b\'{"is": "picture", "index": "x", "time": 3.0, "time_s": 1.0, "slot": 99}\' + bytes([10])',
    ],
)
def test_a_decoder_that_lies_is_not_believed(lie):
    with hostile(f"os.write(pipe, {lie}); os._exit(0)") as source:
        last = list(source)[-1]
    assert isinstance(last, SourceDamaged) and "makes no sense" in last.reason


def test_a_crash_while_opening_is_a_clear_error():
    command = [sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"]
    with pytest.raises(SourceError, match=r"the decoder crashed \(SIGSEGV\)"):
        IsolatedReader("bad.mp4", command=command)


def test_what_is_no_video_is_refused_as_without(tmp_path):
    path = tmp_path / "none.mp4"
    path.write_bytes(b"no video at all" * 100)
    said = []
    for isolate in (False, True):
        with pytest.raises(SourceError) as error:
            open_source(str(path), isolate_decoder=isolate)
        said.append(str(error.value))
    assert said[0] == said[1]


@pytest.mark.slow
def test_a_source_that_is_left_early_leaves_no_process_and_no_file(whole_videos):
    before = len(list(Path("/dev/fd").iterdir()))
    for _ in range(3):
        with open_source(str(whole_videos["h264.mkv"]), isolate_decoder=True) as source:
            next(source)
            process = source._reader._process
        assert process.returncode is not None
    assert len(list(Path("/dev/fd").iterdir())) == before


def test_a_camera_is_not_isolated():
    with pytest.raises(SourceError, match="a camera decodes no file"):
        open_source("0", isolate_decoder=True)


@pytest.mark.slow
def test_the_command_line_takes_it(whole_videos, tmp_path):
    line = ["run", "two_squares", "--source", str(whole_videos["xvid.avi"]), "--init", "10,10,20,20"]
    line += ["--quiet", "--end", "3"]
    assert main([*line, "--out", str(tmp_path / "a")]) == 0
    assert main([*line, "--out", str(tmp_path / "b"), "--isolate-decoder"]) == 0
    for name in ("journal.jsonl", "frames.jsonl", "tracks.txt"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
