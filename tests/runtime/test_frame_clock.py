"""Times of frames from Python: the same motion at any rate is the same motion, and nothing else is a time."""

from __future__ import annotations

import math
from fractions import Fraction
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml

from bayesnet_track import DetectionsTracker, Tracker, load_graph, track
from bayesnet_track.runtime.frame_clock import ASSUMED_FPS, FrameClock
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.images import IMAGE_INTERVAL_S
from bayesnet_track.sources.sources import open_source

FPS = 25.0
SPEED = 60.0
"""px per second."""


def detected(x=None):
    boxes = np.empty((0, 4)) if x is None else np.array([[x, 100.0, x + 40, 180]])
    return SimpleNamespace(xyxy=boxes, confidence=np.ones(len(boxes)))


def patient(name, belief=None, motion=None):
    """The graph, with targets that outlast a gap of many frames."""
    plain = yaml.safe_load(load_graph(name).text)
    plate = plain["targets"]["target"]
    node = plate["nodes"]["target"]
    if "existence" in plate:
        plate["existence"] |= {"end": 1e-9, "confirm": 0.6, "detection": 0.5}
    else:
        plate["death"]["unseen_frames"] = 1000
    node |= {} if belief is None else {"belief": belief}
    node |= {} if motion is None else {"motion": motion}
    return plain


CELLS = {"cell_px": 4, "velocity_cells": 9, "velocity_cell_px": 1}
ON_CELLS = {
    "constant_velocity": {"sd_px": {"x": 1, "y": 1}, "sd_velocity_px": 0.7, "start_velocity_sd_px": 3}
}
GRAPHS = {
    "kalman_detections": (patient("kalman_detections"), 1, 1e-9, 1e-9),
    "jpda": (patient("jpda"), 1, 1e-9, 1e-9),
    # 1000 particles, two seeds: a variance has a sampling error of sqrt(2 / 2000), a speed of 1 px/s.
    "particles": (patient("kalman_detections", {"particles": {"size": 1000}}), 2, 0.06, 0.1),
    # Cells of 4 px and velocities in steps of 1 px per frame are as wrong as that.
    "grid": (patient("kalman_detections", {"grid": CELLS}, ON_CELLS), 1, 0.12, 0.2),
}
GAPS = [[0.4], [0.04] * 10, [0.02] * 20, [0.1, 0.05, 0.13, 0.12], [0.01, 0.19, 0.2]]


def coasted(graph, seed, gap):
    """Speed in px/s and growth of the variance in px² of a target that is not detected for 0.4 s."""
    tracker = DetectionsTracker(graph, size=(400, 300), seed=seed, fps=FPS)
    for frame in range(20):
        tracker.update(detected(20 + SPEED * frame / FPS), time_s=frame / FPS)
    (before,) = tracker.targets
    for time in 19 / FPS + np.cumsum(gap):
        tracker.update(detected(), time_s=float(time))
    (after,) = tracker.targets
    assert after.time_s == pytest.approx(19 / FPS + 0.4)
    moved = after.centre_box[0] - before.centre_box[0]
    return moved / 0.4, after.sd[0] ** 2 - before.sd[0] ** 2


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "particles" else name for name in GRAPHS]
)
def test_a_gap_is_as_long_as_it_is_in_however_many_frames(name):
    graph, seeds, speed_error, noise_error = GRAPHS[name]
    found = np.array([np.mean([coasted(graph, seed, gap) for seed in range(seeds)], axis=0) for gap in GAPS])
    speeds, noises = found.T
    assert speeds == pytest.approx(SPEED, rel=max(speed_error, 0.001))
    assert speeds == pytest.approx(speeds[0], rel=speed_error)
    assert noises == pytest.approx(noises[0], rel=noise_error) and noises[0] > 100


def moments(rate, seed, seconds=1.6):
    """Times from 0 on: `rate` frames a second, or irregular ones without."""
    if rate is not None:
        return np.arange(int(seconds * rate)) / rate
    times = np.cumsum(np.random.default_rng(seed).uniform(0.01, 0.08, 200))
    return np.concatenate([[0.0], times[times < seconds]])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kalman_detections", "jpda", "sort", "oc_sort", "bytetrack"])
@pytest.mark.parametrize("rate", [25.0, 50.0, None])
def test_detections_at_any_rate_give_one_track_with_their_speed(name, rate):
    errors, ids = [], set()
    for seed in range(3):
        noise = np.random.default_rng(seed)
        tracker = DetectionsTracker(name, size=(400, 300), fps=FPS)
        for time in moments(rate, seed):
            x = 20 + SPEED * time
            found = tracker.update(detected(x + noise.normal(0, 1)), time_s=time)
        ids |= {tuple(found.tracker_id)}
        errors.append(tracker.targets[0].centre_box[0] - (x + 20))
    assert ids == {(1,)}
    assert np.abs(errors).max() < 4  # detections have an sd of 1 px


def speed_after(gap):
    """Speed in px/s that `oc_sort` finds for a person who slows down to 20 px/s while nobody sees it."""
    tracker, last, back = DetectionsTracker("oc_sort", size=(640, 300), fps=FPS), 19 / FPS, 19 / FPS + 0.4
    for frame in range(20):
        tracker.update(detected(100 + SPEED * frame / FPS), time_s=frame / FPS)
    for time in last + np.cumsum(gap):
        tracker.update(detected(), time_s=float(time))
    tracker.update(detected(100 + SPEED * last + 8), time_s=back)
    (before,) = tracker.targets
    tracker.update(detected(), time_s=back + 0.04)
    (after,) = tracker.targets
    return (after.centre_box[0] - before.centre_box[0]) / 0.04


def test_a_gap_is_filtered_anew_over_its_true_time():
    usual = speed_after([0.04] * 9)
    assert 20 < usual < 40
    for gap in ([0.02] * 18, [0.04, 0.04, 0.28], [0.06, 0.27, 0.03]):
        assert speed_after(gap) == pytest.approx(usual, rel=1e-6)


def test_frames_that_are_left_out_cost_no_identity():
    kept = [frame for frame in range(60) if not (20 <= frame < 29 or 40 <= frame < 49)]
    ids = {}
    for timed in (True, False):
        tracker = DetectionsTracker("kalman_detections", size=(1920, 1080), fps=FPS)
        for frame in kept:
            found = tracker.update(detected(20 + 12 * frame), time_s=frame / FPS if timed else None)
            ids.setdefault(timed, set()).update(found.tracker_id.tolist())
    assert ids == {True: {-1, 1}, False: {-1, 1, 2, 3}}


# ----------------------------------------------------------------------------------- in images

SIZE = (160, 120)
GROUND = cv2.GaussianBlur(np.random.default_rng(0).integers(40, 120, (120, 160, 3), np.uint8), (0, 0), 1.5)
SQUARE = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (24, 24, 3), np.uint8), (0, 0), 1.0)
SQUARE[..., 2] = 230
BOX = (20, 40, 24, 24)
FAST = 50.0


def picture(time):
    """A square that moves by `FAST` px/s, between pixels, too."""
    place = np.array([[1, 0, 20 + FAST * time], [0, 1, 40 + 10 * time]], np.float32)
    cover = cv2.warpAffine(np.ones((24, 24), np.float32), place, SIZE)[..., None]
    return (GROUND * (1 - cover) + cv2.warpAffine(SQUARE, place, SIZE) * cover).astype(np.uint8)


def seen(graph, rate, seed):
    """Speed in px/s, sd in px of where it will be 0.2 s later, and root mean square error in px."""
    tracker, times = Tracker(graph, seed, fps=FPS), moments(rate, seed, 1.2)
    tracker.init(picture(0.0), BOX, time_s=0.0)
    errors = []
    for time in times[1:]:
        tracker.update(picture(time), time_s=time)
        errors.append(tracker.xywh[0] - 20 - FAST * time)
    ahead = tracker.predict(5)[-1]
    return (
        (ahead.xywh[0] - tracker.xywh[0]) / 5 * FPS,
        ahead.sd[0],
        np.sqrt(np.mean(np.square(errors))),
    )


@pytest.mark.parametrize(
    ("graph", "seeds"),
    [("two_squares_velocity", 2), pytest.param("grid_displacement", 1, marks=pytest.mark.slow)],
)
def test_a_target_in_images_has_its_speed_at_any_rate(graph, seeds):
    found = np.array(
        [np.mean([seen(graph, rate, seed) for seed in range(seeds)], axis=0) for rate in (25.0, 50.0, None)]
    )
    assert found[:, 0] == pytest.approx(FAST, rel=0.15)
    assert found[:, 1] == pytest.approx(found[0, 1], rel=0.3)  # the noise per second; evidence differs
    assert (found[:, 2] < 3).all()


@pytest.mark.parametrize("graph", ["two_squares", "general"])
def test_a_tracker_gives_what_track_gives_for_a_video_with_these_times(tmp_path, graph):
    path = tmp_path / "irregular.mkv"
    write_video(path, [0, 40, 80, 120, 240, 280, 310, 400, 440, 480, 520, 560])  # ms
    expected = [(one.targets[0].time_s, *one.targets[0].centre_box) for one in track(graph, path, BOX)]
    source = open_source(str(path))
    tracker, found = Tracker(graph, fps=1 / source.frame_interval_s), []
    for frame in source:
        if hasattr(frame, "image"):  # what is missing between frames is said there, too
            if found:
                tracker.update(frame.image, time_s=frame.time_s)
            else:
                tracker.init(frame.image, BOX, time_s=frame.time_s)
            found.append((tracker.metrics.time_s, *tracker.metrics.centre_box))
    assert len(found) == 12 and found[-1][0] == pytest.approx(0.56)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("graph", ["kalman_detections", "jpda"])
def test_a_detections_tracker_gives_what_track_gives(tmp_path, graph):
    path, times = tmp_path / "irregular.mkv", [0, 40, 80, 120, 240, 280, 310, 400, 440, 480, 520, 560]
    write_video(path, times)
    boxes = [(20 + FAST * time / 1000, 40 + time / 100) for time in times]
    lines = [f"{number},-1,{x},{y},24,24,0.9\n" for number, (x, y) in enumerate(boxes, 1)]
    (tmp_path / "det.txt").write_text("".join(lines))
    expected = [
        [(one.target, one.time_s, *one.centre_box, *one.sd) for one in result.targets]
        for result in track(graph, path, detections=tmp_path / "det.txt")
    ]
    tracker, found = DetectionsTracker(graph, size=SIZE, fps=1 / open_source(str(path)).frame_interval_s), []
    for time, (x, y) in zip(times, boxes, strict=True):
        given = SimpleNamespace(xyxy=[[x, y, x + 24, y + 24]], confidence=[0.9])
        tracker.update(given, time_s=time / 1000)
        found.append([(one.target, one.time_s, *one.centre_box, *one.sd) for one in tracker.targets])
    assert [len(one) for one in found] == [len(one) for one in expected] and len(found[-1]) == 1
    for one, other in zip(found, expected, strict=True):
        assert [line[0] for line in one] == [line[0] for line in other]
        np.testing.assert_allclose(
            [line[1:] for line in one], [line[1:] for line in other], rtol=0, atol=1e-9
        )


def write_video(path, times):
    import av

    with av.open(str(path), "w") as file:
        stream = file.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "bgr0"
        stream.codec_context.time_base = Fraction(1, 1000)
        for time in times:
            frame = av.VideoFrame.from_ndarray(picture(time / 1000), format="bgr24").reformat(format="bgr0")
            frame.pts, frame.time_base = time, Fraction(1, 1000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


# ------------------------------------------------------------------------------------ what is a time


def both(fps=None):
    """Ways to hand over a frame at a time, to each tracker, which is started with the first."""
    tracker, other, started = Tracker("two_squares", fps=fps), DetectionsTracker(size=SIZE, fps=fps), []

    def of_images(**time):
        call = tracker.update if started else lambda image, **time: tracker.init(image, BOX, **time)
        call(picture(0), **time)
        started.append(True)
        return tracker.metrics.time_s

    def of_detections(**time):
        other.update(detected(20), **time)
        return other.targets[0].time_s if other.targets else None

    return of_images, of_detections


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("time", [2.0, 1.5, 0.0])
def test_a_time_that_is_not_later_is_refused_and_changes_nothing(which, time):
    give, same = both()[which], both()[which]
    for one in (1.0, 2.0):
        give(time_s=one), same(time_s=one)
    with pytest.raises(
        ValueError, match=rf"frame 2 at time_s={time} is not later.* at 2\.0; .*(init|reset)\("
    ):
        give(time_s=time)
    for one in (2.5, 3.0, 3.5):
        assert give(time_s=one) == same(time_s=one)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize(
    "time", [math.nan, math.inf, -0.1, 1.7e12, "0.1", True, np.datetime64("now"), [1, 2]]
)
def test_what_is_no_time_is_refused(which, time):
    give = both()[which]
    for _ in range(2):  # the first frame, too
        with pytest.raises(ValueError, match="the time of a frame in seconds, a number from 0"):
            give(time_s=time)
    give(time_s=np.float32(0.5))


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("first", [{"time_s": 0.0}, {}])
def test_times_of_some_frames_only_are_refused(which, first):
    give = both()[which]
    give(**first)
    with pytest.raises(
        ValueError, match=r"frame 1 comes with(out)? time_s and the frames before it with(out)?;"
    ):
        give(**({} if first else {"time_s": 1.0}))
    give(**({"time_s": 1.0} if first else {}))


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("name", ["timestamp", "time", "dt"])
def test_another_name_for_the_time_is_answered_by_its_name(which, name):
    with pytest.raises(
        TypeError, match=rf"no argument '{name}'; the time of a frame, in seconds, is time_s="
    ):
        both()[which](**{name: 0.1})


def test_milliseconds_given_as_seconds_are_noticed():
    tracker = DetectionsTracker(size=SIZE, fps=25)
    tracker.update(detected(20), time_s=0)
    with pytest.warns(
        InputNotice, match="frame 1 comes 40 s after .* 1000 intervals .* time_s counts seconds"
    ):
        tracker.update(detected(20), time_s=40)


def test_a_step_that_leaves_nothing_of_a_belief_is_refused():
    tracker = DetectionsTracker("sort", size=SIZE, fps=1e6)
    for time in (0.0, 0.1, 0.2):
        tracker.update(detected(20), time_s=time)
    with pytest.raises(
        ValueError, match=r"more than 1e\+10 intervals of 1e\+06 frames a second .* reset\(\)"
    ):
        tracker.update(detected(20), time_s=1e6)
    assert tracker.update(detected(20), time_s=0.3).tracker_id.tolist() == [1]


@pytest.mark.parametrize("fps", [0, -25, math.nan, math.inf, "25", True, 1e300, 1e-300])
def test_what_is_no_rate_is_refused(fps):
    for make in (Tracker, DetectionsTracker):
        with pytest.raises(ValueError, match="nominal frames a second, a number from"):
            make(fps=fps)


def test_without_times_frames_come_at_the_nominal_rate():
    tracker = Tracker("two_squares", fps=50)
    tracker.init(picture(0), BOX)
    tracker.update(picture(0))
    assert tracker.metrics.time_s == 0.02
    np.testing.assert_array_equal(tracker.detections().data["time_s"], [0.02])
    clockless = Tracker("two_squares")
    clockless.init(picture(0), BOX)
    assert math.isnan(clockless.metrics.time_s) and ASSUMED_FPS == 1 / IMAGE_INTERVAL_S


@pytest.mark.parametrize("origin", [0.0, 1e6, 1.7e9])
@pytest.mark.parametrize("rate", [24000 / 1001, 25.0, 30.0, 1000.0])
def test_times_at_the_nominal_rate_are_whole_intervals_from_any_origin(origin, rate):
    clock = FrameClock.of_rate(rate)
    for frame in range(500):
        clock = clock.tick(origin + frame / rate, "")
        assert clock.time == frame


def test_times_that_are_closer_than_rounding_still_go_on_or_are_refused():
    clock = FrameClock.of_rate(25).tick(0.0, "")
    after = clock.tick(5e-324, "") if 5e-324 * 25 > 0 else clock
    assert after.time > clock.time
    with pytest.raises(ValueError, match="not later"):
        FrameClock.of_rate(25).tick(1.0, "").tick(math.nextafter(1.0, 0.0), "")


def test_another_video_may_have_other_times():
    tracker = DetectionsTracker(size=SIZE)
    tracker.update(detected(20), time_s=1000.0)
    tracker.reset()
    tracker.update(detected(20), time_s=0.0)
    tracker.reset()
    tracker.update(detected(20))
    other = Tracker("two_squares")
    other.init(picture(0), BOX, time_s=9.0)
    other.init(picture(0), BOX)
    other.update(picture(0))
    assert math.isnan(other.metrics.time_s)
