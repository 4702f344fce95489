"""Planes that several threads ask for at once, as those of one process that tracks several videos."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region


class Slow:
    """A plane made slowly from another, that counts how often it was made."""

    margin, is_points = 0, False

    def __init__(self, *inputs):
        self.inputs, self.made = inputs, []

    def compute(self, frames, inputs, region):
        self.made.append(region)
        threading.Event().wait(0.01)
        base = np.arange(120.0)[None, region.x0 : region.x1] + np.arange(100.0)[region.y0 : region.y1, None]
        return base + sum(inputs)


def test_a_plane_that_several_threads_ask_for_is_made_once_and_right():
    below = Slow()
    left, right = Slow(below), Slow(below)
    cache = PlaneCache(FramePair(Frame(0, 0.0, np.zeros((100, 120, 3), np.uint8)), None))
    region = Region(10, 20, 50, 60)
    with ThreadPoolExecutor(8) as threads:
        asked = [threads.submit(cache.planes, [plane], region) for plane in (left, right) * 8]
        got = [one.result() for one in asked]
    assert [len(plane.made) for plane in (below, left, right)] == [1, 1, 1]
    expected = 2 * (np.arange(10.0, 50)[None] + np.arange(20.0, 60)[:, None])
    for one in got:
        assert all(np.array_equal(values, expected) for values in one.values.values())
