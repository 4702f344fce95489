"""Pieces carried out side by side, and results as if they had not been."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.runtime.executors.threads import Threads


@pytest.fixture(params=[1, 2, 5])
def pool(request):
    pool = Threads(request.param)
    yield pool
    pool.close()


def test_results_come_in_the_order_of_the_pieces(pool):
    for _ in range(50):
        assert pool.each(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert pool.each(abs, []) == []


def test_two_pieces_run_at_the_same_time_and_one_stays_with_its_caller():
    pool = Threads(2)
    meeting = threading.Barrier(2, timeout=5)
    assert sorted(pool.each(lambda n: meeting.wait(), [0, 1])) == [0, 1]
    assert pool.each(lambda n: threading.get_ident(), [0]) == [threading.get_ident()]
    pool.close()


def test_the_first_piece_s_error_is_raised_when_all_are_done(pool):
    done = []

    def work(n):
        done.append(n)
        if n in (2, 4):
            raise ValueError(n)

    with pytest.raises(ValueError, match="2"):
        pool.each(work, range(6)) if pool._helpers else pool.each(work, [2])
    assert not pool._helpers or sorted(done) == list(range(6))
    assert pool.each(abs, [-1, -2]) == [1, 2]


def test_pieces_may_have_pieces_of_their_own(pool):
    sums = pool.each(lambda n: sum(pool.each(lambda m: m * n, range(10))), range(10))
    assert sums == [45 * n for n in range(10)]


def test_an_interruption_of_the_caller_drops_what_nobody_began():
    pool = Threads(2)
    held, begun = threading.Event(), []

    def work(n):
        begun.append(n)
        if threading.current_thread() is threading.main_thread():
            raise KeyboardInterrupt
        held.wait(5)

    with pytest.raises(KeyboardInterrupt):
        pool.each(work, range(100))
    held.set()
    assert len(begun) <= 2
    pool.close()


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
