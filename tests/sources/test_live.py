"""A live source without hardware: the newest picture wins, a stall is waited out, times are true."""

from __future__ import annotations

import threading
import time
from itertools import pairwise

import numpy as np
import pytest

from bayesnet_track.journal.events.runs import FramesDropped, FramesMissing, SourceDamaged, SourceStalled
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.frames import Source
from bayesnet_track.sources.live import LiveReader, _Drops
from bayesnet_track.sources.timing import Dropped, Picture

INTERVAL_S = 0.01


class Feed:
    """Gives so many pictures, one an interval, then ends, breaks, or hangs until it is released."""

    def __init__(self, pictures, ending="ends", value=0):
        self.pictures, self.ending, self.value = pictures, ending, value
        self.released, self.given, self.closed = threading.Event(), [], False

    def __iter__(self):
        for _ in range(self.pictures):
            time.sleep(INTERVAL_S)
            self.given.append(time.monotonic())
            yield np.full((8, 10, 3), self.value, np.uint8), True
        if self.ending == "hangs":
            self.released.wait(5.0)
        if self.ending == "breaks":
            raise OSError("the cable is out")

    def close(self):
        self.closed = True


def opened(*feeds, **settings):
    """A source whose connections are these feeds in turn; an exception is one that cannot be made."""
    left = list(feeds)

    def connect():
        feed = left.pop(0) if left else OSError("nobody answers")
        if isinstance(feed, Exception):
            raise feed
        return feed

    settings = {"stall_s": 0.08, "connect_s": 0.5, "pause_s": 0.02, "give_up_s": 0.4, **settings}
    return Source("live", LiveReader(connect, INTERVAL_S, **settings), None, None, "stop")


def test_a_slow_tracker_gets_the_newest_picture_and_the_rest_is_counted():
    """It takes about five times as long as the camera; no picture that it gets has waited."""
    feed, ages, items = Feed(60), [], []
    with opened(feed, give_up_s=0.0) as source:
        for item in source:
            items.append(item)
            if isinstance(item, Frame):
                ages.append(time.monotonic() - feed.given[0] - item.time_s)
                time.sleep(5 * INTERVAL_S)
    frames = [item for item in items if isinstance(item, Frame)]
    assert 5 <= len(frames) <= 25
    assert frames[-1].index == 59, "the index counts every picture that came"
    dropped = [item.dropped for item in items if isinstance(item, FramesDropped)]
    assert dropped and sum(dropped) <= 60 - len(frames)
    assert not [item for item in items if isinstance(item, FramesMissing)], "dropped ones are not missing"
    # The first was read when the source was opened; a busy machine may hold the thread up once.
    assert np.median(ages[1:]) < 2 * INTERVAL_S
    for before, after in pairwise(frames):
        assert after.time == pytest.approx(after.time_s / INTERVAL_S) and after.time > before.time


def test_a_stall_is_told_and_the_source_connected_to_anew():
    hanging, second = Feed(3, "hangs"), Feed(3, "breaks", 7)
    items = list(opened(hanging, OSError("no route"), second))
    hanging.released.set()
    kinds = [type(item).__name__ for item in items]
    assert kinds[:3] == ["Frame"] * 3
    stalled = [item for item in items if isinstance(item, SourceStalled)]
    assert [(one.frame, one.attempt) for one in stalled[:3]] == [(3, 1), (3, 2), (6, 1)]
    assert stalled[0].reason == "no picture for 0.08 s" and stalled[0].seconds >= 0.08
    assert stalled[1].reason == "no route" and stalled[2].reason == "the cable is out"

    frames = [item for item in items if isinstance(item, Frame)]
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4, 5]
    assert [frame.image[0, 0, 0] for frame in frames] == [0, 0, 0, 7, 7, 7]
    # The gap has its true length: predicted over, and told.
    gap = frames[3].time_s - frames[2].time_s
    assert gap == pytest.approx(second.given[0] - hanging.given[2], abs=0.005)
    (missing,) = (item for item in items if isinstance(item, FramesMissing) and item.frame == 3)
    assert missing.missing == pytest.approx(gap / INTERVAL_S - 1.0)
    assert isinstance(items[-1], SourceDamaged) and "no picture for" in items[-1].reason
    assert second.closed


def test_the_pauses_between_attempts_double():
    moments = []

    def connect():
        moments.append(time.monotonic())
        raise OSError("nobody answers")

    reader = LiveReader(connect, INTERVAL_S, Feed(1), stall_s=0.05, pause_s=0.02, give_up_s=0.5)
    list(reader)
    pauses = np.diff(moments)
    assert len(pauses) >= 3
    assert all(pause >= 0.9 * 0.02 * 2**n for n, pause in enumerate(pauses))


def test_closing_ends_a_wait():
    feed = Feed(1, "hangs")
    reader = LiveReader(lambda: feed, INTERVAL_S, stall_s=30.0)
    items = iter(reader)
    next(items)
    threading.Timer(0.05, reader.close).start()
    began = time.monotonic()
    list(items)
    assert time.monotonic() - began < 2.0
    feed.released.set()


def test_two_eyes_are_paired_by_what_is_newest():
    """Each drops pictures for itself: still one pair comes after another."""
    from bayesnet_track.observation.planes import RightEye
    from bayesnet_track.sources.stereo_source import DepthReader

    def completer(index, second, image):
        return image, RightEye(second.pixels()[0], None)

    eyes = [LiveReader(lambda: Feed(30), INTERVAL_S, connect_s=0.2, give_up_s=0.0) for _ in range(2)]
    reader, pairs = DepthReader("pair", eyes[0], completer, eyes[1]), []
    for item in reader:
        if isinstance(item, Picture):
            pairs.append(item.index)
            time.sleep(3 * INTERVAL_S)
        elif not isinstance(item, Dropped):
            break
    reader.close()
    assert len(pairs) > 3 and pairs == list(range(len(pairs)))


def test_drops_are_told_seldom():
    drops = _Drops()
    counts = [(n, drops.take_due(n / 10.0, 1)) for n in range(1200)]
    lines = [(n, count) for n, count in counts if count]
    assert [n for n, _ in lines[:5]] == [0, 10, 30, 70, 150]
    assert sum(count for _, count in lines) == lines[-1][0] + 1


def test_no_connection_outlasts_a_reader_that_is_closed_in_another_thread():
    """It is closed while the pause before a new connection is waited for."""
    closed = threading.Event()
    late = Feed(10_000)
    late.close = closed.set
    connections = [OSError("away"), OSError("still away"), late]

    def connect():
        one = connections.pop(0)
        if isinstance(one, Exception):
            raise one
        return one

    reader = LiveReader(connect, INTERVAL_S, stall_s=0.08, connect_s=0.5, pause_s=5.0, give_up_s=60.0)
    threading.Timer(0.15, reader.close).start()
    assert len(list(reader)) == 2
    assert len(connections) == 1 or closed.wait(1.0)
