"""The tracker with OpenCV's `init` and `update`: its values, its errors, its manners in a host process."""

import copy
import json
import subprocess
import sys
import threading

import cv2
import numpy as np
import pytest
import yaml

from bayesnet_track import Tracker, load_graph
from bayesnet_track.engine.lines import Lines
from bayesnet_track.graphs import find_graph
from bayesnet_track.journal.events.lives import TargetDied
from bayesnet_track.runtime import tracker as module
from bayesnet_track.sources.scenes import make_scene

SCENE = make_scene("two_squares")
BOX = SCENE.start_box


def frames(count, first=1):
    return [SCENE.frames[index] for index in range(first, first + count)]


def started(graph="two_squares", box=BOX, seed=0):
    tracker = Tracker(graph, seed)
    tracker.init(SCENE.frames[0], box)
    return tracker


def follow(tracker, pictures):
    return [(*tracker.update(picture), tracker.score) for picture in pictures]


# ------------------------------------------------------------------------------------ what it gives


def test_it_follows_and_gives_what_opencv_gives():
    tracker = started()
    for index in range(1, 12):
        ok, box = tracker.update(SCENE.frames[index])
        assert ok is True
        assert isinstance(box, tuple) and [type(value) for value in box] == [float] * 4
        assert np.abs(np.array(box[:2]) - SCENE.truth[index, :2]).max() < 15
        assert 0 <= tracker.score <= 1
        assert tracker.metrics.frame == index


def test_box_and_status_are_those_of_the_metrics_and_do_not_wait_for_them(monkeypatch):
    tracker = started()
    with monkeypatch.context() as changed:
        changed.setattr(Lines, "_lines", lambda _: pytest.fail("metrics were made"))
        ok, box = tracker.update(SCENE.frames[1])
        status = tracker.status
    assert (ok, box, status) == (True, tuple(tracker.metrics.xywh), tracker.metrics.status)


def test_init_returns_nothing_and_tells_the_first_frame():
    tracker = Tracker("two_squares")
    assert tracker.init(SCENE.frames[0], BOX) is None
    assert tracker.score == 1.0
    assert tracker.metrics.centre_box == (270.0, 190.0, 40.0, 40.0)
    assert [type(event).__name__ for event in tracker.events] == ["TargetStarted"]


def test_its_box_in_each_convention():
    tracker = started()
    assert tracker.xywh.tolist() == list(tracker.metrics.xywh) == list(BOX)
    assert tracker.xyxy.tolist() == [BOX[0], BOX[1], BOX[0] + BOX[2], BOX[1] + BOX[3]]
    assert tracker.cxcywh.tolist() == list(tracker.metrics.centre_box)
    with pytest.raises(AttributeError, match=r"Tracker has no `box`.*use \.xywh"):
        _ = tracker.box


def test_it_shows_what_matters_and_draws_on_a_copy():
    assert repr(Tracker("two_squares")) == "<Tracker 'two_squares': not started, call init(frame, box)>"
    tracker = started()
    assert repr(tracker).startswith("<Tracker 'two_squares', 1 target: <target 1 in frame 0: tracking, score")
    before = SCENE.frames[0].copy()
    drawn = tracker.plot(SCENE.frames[0])
    assert np.array_equal(SCENE.frames[0], before) and drawn.shape == before.shape
    assert (drawn != before).any()


@pytest.mark.parametrize("kind", ["uint16", "gray", "gray channel", "alpha"])
def test_it_draws_on_every_kind_of_frame_that_it_takes(kind):
    gray = SCENE.frames[0][..., 1]
    frame, same = {
        "uint16": (SCENE.frames[0].astype(np.uint16) * 257, SCENE.frames[0]),
        "gray": (gray, np.stack([gray] * 3, axis=2)),
        "gray channel": (gray[..., None], np.stack([gray] * 3, axis=2)),
        "alpha": (np.dstack([SCENE.frames[0], np.full_like(gray, 255)]), SCENE.frames[0]),
    }[kind]
    tracker = started("general")
    np.testing.assert_array_equal(tracker.plot(frame), tracker.plot(same))
    with pytest.raises(ValueError, match="not NoneType; could the image be read"):
        tracker.plot(None)


@pytest.mark.parametrize(
    "box",
    [
        (250, 170, 40, 40),
        [250, 170, 40, 40],
        np.array([250, 170, 40, 40]),
        np.array([250, 170, 40, 40], np.float32),
        tuple(np.int64(v) for v in (250, 170, 40, 40)),
        (250.0, 170.0, 40.0, 40.0),
    ],
)
def test_boxes_of_any_kind_of_number(box):
    assert follow(started(box=box), frames(2)) == follow(started(box=(250, 170, 40, 40)), frames(2))


def test_the_graph_may_be_a_name_a_path_or_python(tmp_path):
    checked = load_graph("two_squares")
    path = tmp_path / "copy.yaml"
    path.write_text(checked.text)
    wanted = follow(started(), frames(2))
    for graph in (path, str(path), checked, checked.spec):
        assert follow(started(graph), frames(2)) == wanted


def test_the_default_graph_is_general():
    tracker = Tracker()
    tracker.init(SCENE.frames[0], BOX)
    assert set(tracker.metrics.active) == {"color", "filter"}


@pytest.mark.parametrize(
    "box", [(-20, -20, 40, 40), (300, 220, 40, 40), (-500, 100, 501, 40), (0, 0, 320, 240)]
)
def test_a_box_partly_outside_or_as_large_as_the_frame(box):
    tracker = started("general", box)
    for ok, found, score in follow(tracker, frames(3)):
        assert isinstance(ok, bool) and np.isfinite(found).all() and 0 <= score <= 1


def test_a_box_of_one_pixel():
    tracker = started("general", (100, 100, 1, 1))
    assert np.isfinite([box for _, box, _ in follow(tracker, frames(3))]).all()


@pytest.mark.parametrize("shape", [(240, 320), (240, 320, 1)])
def test_gray_frames(shape):
    rng = np.random.default_rng(3)
    ground = rng.integers(60, 120, (240, 320)).astype(np.uint8)
    target = rng.integers(0, 255, (30, 30)).astype(np.uint8)
    tracker = Tracker("general")
    for step in range(10):
        picture = ground.copy()
        picture[100:130, 100 + 3 * step : 130 + 3 * step] = target
        if step == 0:
            tracker.init(picture.reshape(shape), (100, 100, 30, 30))
        else:
            ok, box = tracker.update(picture.reshape(shape))
    assert ok and np.abs(np.array(box[:2]) - (127, 100)).max() < 6


def test_other_kinds_of_picture_are_brought_to_8_bit_bgr():
    eight = follow(started(), frames(2))
    sixteen = Tracker("two_squares")
    sixteen.init(SCENE.frames[0].astype(np.uint16) * 257, BOX)
    assert follow(sixteen, [picture.astype(np.uint16) * 257 for picture in frames(2)]) == eight
    flipped = Tracker("two_squares")  # views, as slices and other libraries give them
    flipped.init(SCENE.frames[0][:, ::-1].copy()[:, ::-1], BOX)
    assert follow(flipped, [np.asfortranarray(picture) for picture in frames(2)]) == eight


def test_the_caller_may_reuse_its_buffer():
    wanted = follow(started(), frames(6))
    buffer, tracker = SCENE.frames[0].copy(), Tracker("two_squares")
    tracker.init(buffer, BOX)
    found = []
    for picture in frames(6):
        buffer[:] = picture
        found += follow(tracker, [buffer])
        buffer[:] = 0
    assert found == wanted


def test_frames_of_a_caller_that_keeps_them_are_not_copied(monkeypatch):
    wanted, seen, own = follow(started(), frames(6)), [], module.step
    monkeypatch.setattr(module, "step", lambda *args: seen.append(args[2].image) or own(*args))
    tracker, given = Tracker("two_squares", copy_frames=False), frames(6)
    tracker.init(SCENE.frames[0], BOX)
    assert follow(tracker, given) == wanted
    assert all(np.shares_memory(one, other) for one, other in zip(seen, given, strict=True))
    tracker = started()
    follow(tracker, given)
    assert not any(np.shares_memory(one, other) for one, other in zip(seen[6:], given, strict=True))


def test_the_callers_frame_is_not_written_to():
    picture = SCENE.frames[1].copy()
    picture.setflags(write=False)
    follow(started(), [picture])
    np.testing.assert_array_equal(picture, SCENE.frames[1])


def test_init_again_starts_anew():
    tracker = started()
    follow(tracker, frames(5))
    tracker.init(SCENE.frames[0], BOX)
    assert follow(tracker, frames(3)) == follow(started(), frames(3))
    small = np.ascontiguousarray(SCENE.frames[0][100:, 200:])
    tracker.init(small, (50.5, 70.5, 40, 40))  # a video of another size
    assert tracker.update(small)[0]


# ------------------------------------------------------------------------------------ errors


LIMIT = "at most 10 times the 320x240 frame is allowed, 3200x2400 px"


@pytest.mark.parametrize(
    ("box", "message"),
    [
        ((10, 10, 0, 5), "start box 10,10,0,5: width and height must be at least 1 px"),
        ((10, 10, 5, -5), "start box 10,10,5,-5: width and height must be at least 1 px"),
        (
            (1, 1, 1e308, 1e308),
            f"start box 1,1,1e+308,1e+308: {LIMIT}",
        ),
        (
            (-5, 1, 1e100, 9),
            f"start box -5,1,1e+100,9: {LIMIT}",
        ),
        ((320, 10, 5, 5), "start box 320,10,5,5 lies outside the 320x240 frame; x,y is the top-left corner"),
        (
            (-50, 10, 50, 5),
            "start box -50,10,50,5 lies outside the 320x240 frame; x,y is the top-left corner",
        ),
        ((1, 2, 3), "start box (1, 2, 3): four finite numbers x,y,w,h are needed"),
        ((1, 2, 3, float("nan")), "start box (1, 2, 3, nan): four finite numbers x,y,w,h are needed"),
        ((1, 2, 3, 1e400), "start box (1, 2, 3, inf): four finite numbers x,y,w,h are needed"),
        ("1,2,3,4", "start box '1,2,3,4': four finite numbers x,y,w,h are needed"),
        (None, "no start box is given; at least one is needed, or `birth` in the graph"),
        ([[1, 2, 3, 4]], "start box [[1, 2, 3, 4]]: four finite numbers x,y,w,h are needed"),
    ],
)
def test_boxes_that_are_refused(box, message):
    with pytest.raises(ValueError) as refused:
        Tracker("two_squares").init(SCENE.frames[0], box)
    assert str(refused.value) == message


def test_a_box_of_endless_digits_is_refused():
    with pytest.raises(ValueError, match="four finite numbers x,y,w,h are needed"):
        Tracker("two_squares").init(SCENE.frames[0], (1, 1, 10**400, 9))


def test_a_frame_in_which_no_agent_can_start_is_refused_and_the_tracker_stays_as_it_was():
    graph = yaml.safe_load(find_graph("two_squares").read_text())
    nodes = graph["targets"]["square"]["nodes"]
    del nodes["motion"], nodes["square"]["adapt"]
    tracker, gray = Tracker(load_graph(graph)), np.ascontiguousarray(SCENE.frames[0][..., 0])
    tracker.init(SCENE.frames[0], SCENE.start_box)
    with pytest.raises(ValueError, match="target 1: color: needs colour, and the source is gray"):
        tracker.init(gray, SCENE.start_box)
    assert tracker.update(SCENE.frames[1])[0]
    both = Tracker("two_squares")
    both.init(gray, SCENE.start_box)
    assert both.update(gray)[0], "motion can start: the run goes on without color"


def test_before_init():
    tracker = Tracker("two_squares")
    with pytest.raises(RuntimeError, match=r"call init\(frame, box\) before update\(frame\)"):
        tracker.update(SCENE.frames[0])
    with pytest.raises(RuntimeError, match=r"call init\(frame, box\) first"):
        _ = tracker.score
    assert tracker.events == ()


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (None, "a frame is an array of pixels, not NoneType; could the image be read?"),
        ([[1, 2], [3, 4]], "a frame is an array of pixels, not list; could the image be read?"),
        (cv2.UMat(np.zeros((240, 320, 3), np.uint8)), r"not UMat; frame.get\(\) is one"),
        (memoryview(b"1234"), "not memoryview; could the image be read?"),
        (
            np.zeros((240, 320, 3)),
            r"float64 values of shape \(240, 320, 3\); allowed: 8 or 16 bit, 1, 3 or 4",
        ),
        (np.zeros((240, 320, 2), np.uint8), r"uint8 values of shape \(240, 320, 2\); allowed"),
        (np.zeros((0, 320, 3), np.uint8), r"uint8 values of shape \(0, 320, 3\); allowed"),
        (np.array(3, np.uint8), r"uint8 values of shape \(\); allowed"),
    ],
)
def test_frames_that_are_no_pictures(frame, message):
    with pytest.raises(ValueError, match=message):
        Tracker("two_squares").init(frame, BOX)
    tracker = started()
    with pytest.raises(ValueError, match=message):
        tracker.update(frame)
    assert follow(tracker, frames(2)) == follow(started(), frames(2))  # as if it had not been called


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p[:200], "frame 1 is 320x200 colour, the frames before it are 320x240 colour; "),
        (lambda p: p[:, :, 0], "frame 1 is 320x240 gray, the frames before it are 320x240 colour; "),
    ],
)
def test_a_frame_of_another_size_is_refused_and_changes_nothing(change, message):
    tracker = started()
    with pytest.raises(ValueError) as refused:
        tracker.update(change(SCENE.frames[1]))
    assert str(refused.value) == message + "bring it to their size and channels, or call init again"
    assert follow(tracker, frames(2)) == follow(started(), frames(2))


# ------------------------------------------------------------------------------------ being lost


@pytest.mark.slow
def test_black_frames_are_never_a_confident_box():
    rng = np.random.default_rng(1)
    pictures = [rng.integers(40, 90, (240, 320, 3), dtype=np.uint8) for _ in range(4)]
    for step, picture in enumerate(pictures):
        picture[100:140, 100 + 2 * step : 140 + 2 * step] = (40, 120, 250)
    tracker = Tracker("general")
    tracker.init(pictures[0], (100, 100, 40, 40))
    seen = follow(tracker, pictures[1:])
    assert all(ok for ok, *_ in seen)
    dark = follow(tracker, [np.zeros_like(pictures[0])] * 80)
    assert not any(ok for ok, *_ in dark[5:])
    assert max(score for *_, score in dark) < 0.2 < 0.3 < min(score for *_, score in seen)
    assert tracker.metrics.learn_rate == 0
    uncertainty = tracker.metrics.ud_px2
    assert uncertainty > 10 * 40 * 40 / 4  # a good part of the frame, not of the box
    # Light again, at the same place: it is found.
    again = follow(tracker, [pictures[-1]] * 25)
    assert again[-1][0] and np.abs(np.array(again[-1][1][:2]) - (106, 100)).max() < 10


# ------------------------------------------------------------------------------------ targets that end


@pytest.fixture(scope="module")
def two_that_end():
    """The frames' trackers, of two squares: the first ends in frame 7, the second in frame 11."""
    node = {"motion": {"random_walk": {"sd_px": {"x": 2, "y": 2}}}, "belief": {"particles": {"size": 100}}}
    birth = {"detector": {"gray_level": {"min_area_px": 100}}, "confirm": {"hits": 2, "of": 2}}
    nodes = {"s": node, "a": {"parent": "s", "agent": "intensity"}}
    kind = {"birth": birth, "death": {"unseen_frames": 3}, "nodes": nodes}
    tracker = Tracker(load_graph({"name": "two_that_end", "targets": {"square": kind}}))
    cells = np.kron(np.random.default_rng(0).integers(150, 255, (5, 5)), np.ones((4, 4))).astype(np.uint8)
    after = []
    for index in range(13):
        picture = np.full((90, 160), 40, np.uint8)
        for left, last in ((20, 4), (100, 8)):
            if index <= last:
                picture[30:50, left : left + 20] = cells
        if index == 0:
            tracker.init(picture)
        else:
            tracker.update(picture)
        after.append(copy.copy(tracker))
    return after


def test_all_values_are_of_the_same_target_where_the_first_one_ends(two_that_end):
    at_the_end = two_that_end[7]
    ended, live = at_the_end.targets
    assert any(isinstance(event, TargetDied) and event.target == ended.target for event in at_the_end.events)
    assert at_the_end.metrics is live and at_the_end.score == at_the_end.getTrackingScore() == live.score
    assert at_the_end.centre_box == live.centre_box and at_the_end.status == "tracking"
    assert live.score > 0.5 > ended.score


def test_the_score_is_0_where_the_only_target_ends(two_that_end):
    for tracker in two_that_end[11:]:
        assert tracker.score == tracker.getTrackingScore() == 0.0 and tracker.status == "lost"
        with pytest.raises(RuntimeError, match="no target is live after the last frame"):
            _ = tracker.metrics
    assert len(two_that_end[11].targets) == 1


def test_detections_of_a_target_that_ended_keep_its_class(two_that_end):
    for index, count in ((6, 2), (7, 2), (8, 1), (11, 1), (12, 0)):
        found = two_that_end[index].detections(lost=True)
        assert found.data["class_name"].tolist() == ["square"] * count


# ------------------------------------------------------------------------------------ several of them


def test_two_trackers_in_turn_do_not_affect_each_other():
    other_box = tuple(SCENE.others[0][0])
    alone = follow(started(), frames(8)), follow(started("general", other_box), frames(8))
    first, second = started(), started("general", other_box)
    together = [], []
    for picture in frames(8):
        together[0].extend(follow(first, [picture]))
        together[1].extend(follow(second, [picture]))
    assert together == alone


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy])
def test_a_copy_goes_on_by_itself(way):
    wanted = follow(started(), frames(6))
    tracker = started()
    follow(tracker, frames(3))
    other = way(tracker)
    assert follow(other, frames(3, 4)) == wanted[3:]
    tracker.init(SCENE.frames[0], tuple(SCENE.others[0][0]))
    assert tuple(other.xywh) == wanted[-1][1]
    assert follow(started(), frames(6)) == wanted
    unstarted = way(Tracker("two_squares"))
    unstarted.init(SCENE.frames[0], BOX)
    assert follow(unstarted, frames(6)) == wanted


def test_two_threads_give_what_one_gives():
    pictures = frames(10)
    alone = [follow(started(seed=seed), pictures) for seed in (0, 1)]
    found = [None, None]

    def work(seed):
        found[seed] = follow(started(seed=seed), pictures)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == alone


def test_seeds_matter():
    assert follow(started(seed=0), frames(3)) != follow(started(seed=1), frames(3))


# ------------------------------------------------------------------------------------ manners

HOST = """
import json, locale, logging, os, random, signal, sys, threading, warnings
import av, cv2, numba, numpy as np, pydantic  # what these change when imported is theirs

def state():
    return {
        "environment": dict(os.environ),
        "folder": os.getcwd(),
        "random": random.getstate(),
        "numpy random": [str(part) for part in np.random.get_state()],
        "numpy errors": np.geterr(),
        "numpy print": {k: str(v) for k, v in np.get_printoptions().items()},
        "opencv threads": cv2.getNumThreads(),
        "opencv optimised": cv2.useOptimized(),
        "numba threads": numba.get_num_threads(),
        "signals": [str(signal.getsignal(n)) for n in signal.valid_signals() if n not in (9, 19, 32, 33)],
        "warnings": [str(f) for f in warnings.filters],
        "logging": [logging.root.level, [str(h) for h in logging.root.handlers], logging.root.disabled,
                    logging.getLevelName(20)],
        "av log level": av.logging.get_level(),
        "locale": locale.setlocale(locale.LC_ALL),
        "hooks": [str(sys.excepthook), str(threading.excepthook), str(sys.displayhook), str(sys.stdout)],
        "recursion": sys.getrecursionlimit(),
        "switch": sys.getswitchinterval(),
        "threads": threading.active_count(),
        "path": list(sys.path),
        "umask": [os.umask(0o22), os.umask(0o22)][0],
    }

before = state()
import tempfile
from bayesnet_track import Tracker, track
from bayesnet_track.cli.main import main
from bayesnet_track.sources.scenes import make_scene

scene = make_scene("two_squares")
tracker = Tracker("general")
tracker.init(scene.frames[0], scene.start_box)
for index in range(1, 4):
    tracker.update(scene.frames[index])
with tempfile.TemporaryDirectory() as folder:
    main(["demo", "--end", "3", "--quiet", "--out", folder + "/run"])
    video = folder + "/run/video.mkv"
    for result in track("two_squares", video, scene.start_box, out=folder + "/again", video=True):
        pass
after = state()
changed = {name: [str(before[name]), str(after[name])] for name in before if before[name] != after[name]}
print(json.dumps(changed))
"""


@pytest.mark.slow
def test_a_host_process_is_left_as_it_was():
    done = subprocess.run([sys.executable, "-c", HOST], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == {}
    assert done.stderr == ""


# ------------------------------------------------------------------------------------ in OpenCV's harness


def test_with_whole_pixels_opencv_draws_what_update_gives():
    start = tuple(np.int32(value) for value in BOX)
    tracker, exact = Tracker("two_squares", whole_px=True), started(box=start)
    assert tracker.init(SCENE.frames[0], start) is None
    for picture in frames(3):
        ok, box = tracker.update(picture)
        exact.update(picture)
        assert type(ok) is bool and type(box) is tuple and [type(value) for value in box] == [int] * 4
        assert np.abs(np.array(box) - exact.xywh).max() <= 0.5
        assert cv2.rectangle(picture.copy(), box, (0, 0, 255)).shape == picture.shape
    assert tracker.getTrackingScore() == tracker.score == exact.score
