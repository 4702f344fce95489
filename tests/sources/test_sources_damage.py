"""Truncated and damaged videos: reported, never a crash, never a hang."""

import time

import av
import numpy as np
import pytest
from scipy.stats import binom

from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.runs import FramesMissing, SourceDamaged
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.frames import Source
from bayesnet_track.sources.sources import SourceError, open_source
from bayesnet_track.sources.timing import Damage, Picture

CONTAINERS = ["plain.mp4", "start.mp4", "xvid.avi", "h264.mkv"]
FRAMES = 40
HANG_S = 120.0
"""Far more than a busy machine needs for one small file."""


def outcome(path):
    """(frames, end reason, reported damage), or None when it cannot be opened. Times must grow."""
    began = time.perf_counter()
    last = -np.inf
    damage = []
    try:
        with open_source(str(path)) as source:
            for item in source:
                if isinstance(item, Frame):
                    assert item.time > last
                    assert item.image.shape == (source.height, source.width, 3)
                    last = item.time
                elif isinstance(item, SourceDamaged):
                    damage.append(item.reason)
                elif isinstance(item, FramesMissing):
                    damage.append("frames are missing")
        return source.frames, source.end_reason, damage
    except SourceError:
        return None
    finally:
        assert time.perf_counter() - began < HANG_S


@pytest.mark.parametrize("name", CONTAINERS)
def test_a_whole_file_is_complete(whole_videos, name):
    assert outcome(whole_videos[name]) == (FRAMES, "end_of_source", [])


@pytest.mark.parametrize("name", CONTAINERS)
def test_a_truncated_file_is_always_reported(whole_videos, tmp_path, name):
    data = whole_videos[name].read_bytes()
    cut = tmp_path / name
    truncated = 0
    for part in range(1, 51):
        cut.write_bytes(data[: len(data) * part // 51])
        found = outcome(cut)
        if found is None:
            continue
        frames, reason, damage = found
        # A cut behind the last frame (in the index) takes nothing away.
        if frames < FRAMES:
            truncated += 1
            assert reason == "source_truncated"
            assert f" of {FRAMES} frames" in damage[-1]
    # An MP4 with its index at the end cannot be opened at all once it is cut.
    assert truncated == 0 if name == "plain.mp4" else truncated >= 10


def damaged(data, seed):
    """`data` with 1 to 40 bytes changed, or a piece cut out of its middle."""
    rng = np.random.default_rng([77, seed])
    bytes_ = np.frombuffer(data, np.uint8).copy()
    if seed % 4 == 3:
        low, high = sorted(rng.integers(0, len(bytes_), 2))
        return np.delete(bytes_, slice(low, min(high, low + len(bytes_) // 4))).tobytes()
    where = rng.integers(0, len(bytes_), rng.integers(1, 41))
    bytes_[where] = rng.integers(0, 256, len(where))
    return bytes_.tobytes()


SHORT_AND_SILENT = 0.003
"""Share of the damaged files that open and lack frames without a word: 2 of 4,920, one frame each, where
the damage fell on what declares the length.
"""

LEAST_OPENED = 0.25
"""Share of the damaged files that open at least, whatever encoder wrote the original: .28 to .92 of 200."""


def check_damaged(original, path, seeds):
    """None crashes or hangs, and hardly any ends early and says nothing."""
    data = original.read_bytes()
    outcomes = []
    for seed in seeds:
        path.write_bytes(damaged(data, seed))
        outcomes.append(outcome(path))
    opened = [found for found in outcomes if found is not None]
    silent = [
        frames
        for frames, reason, damage in opened
        if reason == "end_of_source" and frames < FRAMES and not damage
    ]
    assert len(opened) >= binom.ppf(1e-4, len(outcomes), LEAST_OPENED)
    assert any(damage for _, _, damage in opened)
    assert len(silent) <= binom.ppf(0.999, len(opened), SHORT_AND_SILENT)
    assert all(FRAMES - frames <= 2 for frames in silent)


@pytest.mark.parametrize("name", CONTAINERS)
def test_damaged_files_neither_crash_nor_hang_nor_end_early_in_silence(whole_videos, tmp_path, name):
    check_damaged(whole_videos[name], tmp_path / name, range(40))


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTAINERS)
def test_a_thousand_damaged_files_neither_crash_nor_hang_nor_end_early_in_silence(
    whole_videos, tmp_path, name
):
    check_damaged(whole_videos[name], tmp_path / name, range(1000))


@pytest.mark.parametrize("name", ["start.mp4", "xvid.avi", "h264.mkv"])
def test_a_frame_wiped_out_is_reported(whole_videos, tmp_path, name):
    data = bytearray(whole_videos[name].read_bytes())
    with av.open(str(whole_videos[name])) as container:
        middle = [packet.pos for packet in container.demux(video=0) if packet.size][20]
    data[middle : middle + 150] = bytes(150)
    path = tmp_path / name
    path.write_bytes(data)
    frames, reason, damage = outcome(path)
    assert reason != "end_of_source"
    assert damage
    assert frames > 0


class Complaining:
    """A reader that says two things of damage again and again between its pictures."""

    declared_frames, frame_interval_s, gap_from = None, 0.04, 1.5

    def __iter__(self):
        grey = np.zeros((20, 30, 3), np.uint8)
        for index in (0, 6, 7):
            yield Picture(index, float(index), 0.04 * index, lambda: (grey, True))
            if index == 0:
                for lost in range(1, 6):
                    yield Damage(lost, "a packet is cut off or damaged")
                    yield Damage(lost, "the decoder refused a frame")
            if index == 6:
                yield Damage(7, "the decoder refused a frame")
        yield from [Damage(8, "the container is damaged: Input/output error")] * 50

    def close(self):
        pass


def test_damage_that_is_repeated_before_the_next_frame_is_one_event():
    events = [
        item for item in Source("x", Complaining(), None, None, "stop") if isinstance(item, SourceDamaged)
    ]
    assert events == [
        SourceDamaged(1, "a packet is cut off or damaged", 5, 5),
        SourceDamaged(1, "the decoder refused a frame", 5, 5),
        SourceDamaged(7, "the decoder refused a frame"),
        SourceDamaged(8, "the container is damaged: Input/output error", 50, 8),
    ]
    assert [event.describe() for event in events[1:]] == [
        "the source is damaged, 5 times up to frame 5: the decoder refused a frame",
        "the source is damaged: the decoder refused a frame",
        "the source is damaged, 50 times: the container is damaged: Input/output error",
    ]
    for event in events:
        assert from_json(to_json(event)) == event
    assert from_json('{"event": "source_damaged", "frame": 1, "reason": "x"}') == SourceDamaged(1, "x")
