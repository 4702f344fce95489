"""Decoded frames: nothing of them stays, and a folder without room is said before it is full."""

import os
import subprocess
import sys
import tempfile
import time
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track.journal.writer import OutputError
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.annotation import frame_store
from bayesnet_track.runtime.annotation.frame_store import FrameStore


class Noise:
    """Frames of 60 x 80 px that hardly get smaller: about 15 kB each."""

    def __init__(self, frames):
        self.expected_frames = frames

    def __iter__(self):
        for number in range(self.expected_frames):
            image = np.random.default_rng(number).integers(0, 255, (60, 80, 3), dtype=np.uint8)
            yield Frame(number, number * 0.04, image)


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """An empty folder for temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_frames_have_no_name_in_the_folder_and_can_be_read_from_several_threads(temporary):
    from concurrent.futures import ThreadPoolExecutor

    with FrameStore.of(Noise(100), "noise", 0.04) as store, ThreadPoolExecutor(4) as pool:
        if os.name == "posix":
            assert list(temporary.iterdir()) == []
        order = np.random.default_rng(0).permutation(np.repeat(np.arange(100), 3)).tolist()
        for number, image in zip(order, pool.map(store.image, order), strict=True):
            expected = np.random.default_rng(number).integers(0, 255, (60, 80, 3), dtype=np.uint8)
            assert np.array_equal(image, expected)
    assert list(temporary.iterdir()) == []


def test_a_video_that_will_not_fit_is_refused_before_the_folder_is_full(temporary, monkeypatch):
    monkeypatch.setattr(frame_store.shutil, "disk_usage", lambda path: SimpleNamespace(free=1_000_000))
    with FrameStore.of(Noise(60), "small.mp4", 0.04) as store:
        assert len(store) == 60
    seen = []
    with pytest.raises(OutputError) as refused:
        FrameStore.of(Noise(1000), "large.mp4", 0.04, seen.append)
    assert len(seen) < 20
    assert str(refused.value) == (
        f"{temporary}: too little room, 1 MB free (decoded frames of large.mp4): all 1000 frames need about "
        "15 MB, the first 16 frames take 1 MB; make room there, or set TMPDIR to a folder that has room"
    )


@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
def test_a_folder_that_gets_full_while_it_decodes_is_named_with_what_is_needed(temporary):
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, before[1]))
    try:
        with pytest.raises(OutputError) as refused:
            FrameStore.of(Noise(50), "large.mp4", 0.04)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    said = str(refused.value)
    assert said.startswith(f"{temporary}: File too large, ") and "all 50 frames need about 1 MB" in said


RUN = """
import sys, time
from bayesnet_track.runtime.annotation.frame_store import FrameStore
sys.path.insert(0, sys.argv[1])
from test_frame_store import Noise
with FrameStore.of(Noise(20), "noise", 0.04) as store:
    print("ready", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(os.name != "posix", reason="sends signals")
@pytest.mark.parametrize("name", ["SIGHUP", "SIGTERM", "SIGKILL"])
def test_nothing_stays_of_a_process_that_is_ended(temporary, name):
    import signal

    folder = os.path.dirname(__file__)  # noqa: PTH120
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, folder],
        stdout=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    assert process.stdout.readline() == b"ready\n"
    process.send_signal(getattr(signal, name))
    process.wait(20)
    time.sleep(0.05)
    assert [one for one in temporary.iterdir() if "frames" in one.name] == []
