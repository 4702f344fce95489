"""Pictures come at a limited rate and within a budget; whoever offers one never waits."""

import threading
import time

import cv2
import numpy as np
import pytest

from bayesnet_track.runtime.live_view import feed
from bayesnet_track.runtime.live_view.feed import Thumbnails, encode_jpeg

NOISE = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)


def wait(condition):
    end = time.monotonic() + 60.0  # far more than a busy machine needs
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


@pytest.fixture
def made():
    made = []
    yield lambda *args, **more: made.append(Thumbnails(*args, **more)) or made[-1]
    for one in made:
        one.close()


def test_a_frame_without_a_picture_has_that_of_the_one_before(made):
    shelf = made(per_second=1e9)
    assert shelf.of(5) is None and shelf.newest == -1
    for frame in (3, 7):
        shelf.offer(frame, NOISE)
        wait(lambda frame=frame: shelf.newest == frame)
    assert [shelf.of(frame)[0] for frame in (0, 3, 6, 7, 99)] == [3, 3, 3, 7, 7]
    assert cv2.imdecode(np.frombuffer(shelf.of(3)[1], np.uint8), 1).shape == NOISE.shape


def test_few_are_taken_but_those_that_must_be(made):
    shelf = made(per_second=0.001)
    for frame in range(50):
        shelf.offer(frame, NOISE, must=frame == 30)
    wait(lambda: shelf.newest == 30)
    assert [shelf.of(frame)[0] for frame in (29, 49)] == [0, 30]


def test_the_budget_thins_what_is_old_and_spares_what_must_be(made):
    size = len(encode_jpeg(NOISE))
    shelf = made(budget=20 * size, per_second=1e9)
    for frame in range(200):
        shelf.offer(frame, NOISE, must=frame == 9)
        wait(lambda frame=frame: shelf.newest == frame)
    kept = {shelf.of(frame)[0] for frame in range(200)}
    assert len(kept) <= 20 and 9 in kept
    # The newest half is whole.
    assert {195, 196, 197, 198, 199} <= kept


def test_an_encoder_that_hangs_holds_up_nobody(made, monkeypatch):
    gate = threading.Event()
    monkeypatch.setattr(feed, "encode_jpeg", lambda image: gate.wait(60) and b"x")
    shelf = made(per_second=1e9)
    began = time.monotonic()
    for frame in range(10_000):
        shelf.offer(frame, NOISE)
    assert time.monotonic() - began < 1.0
    assert len(shelf._waiting) == feed.WAITING
    gate.set()


def test_a_large_picture_is_made_small():
    data = encode_jpeg(np.zeros((1080, 1920, 3), np.uint8))
    rows, columns = cv2.imdecode(np.frombuffer(data, np.uint8), 1).shape[:2]
    assert abs(rows * columns - 640 * 480) < 2000 and abs(columns / rows - 16 / 9) < 0.01
