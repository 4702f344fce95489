"""What every registered detector keeps to, whatever it sees."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track.observation.detector import NOTHING, Detector, DetectorParameters, installed_detectors
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.sources.scenes import make_scene

NAMES = sorted(installed_detectors())
TEN = 10


@pytest.fixture
def build(bench, person_model, network):
    def make(name, **more):
        needed = {
            "color_backprojection": {"hue_deg": 30},
            "contour_shape": {"model": person_model},
            "background": {"warm_up_frames": 3},
            "onnx": {"input_width": 32, "input_height": 32},
            "stereo_blobs": {"camera_height_m": 1.2, "max_depth_m": 6},
        }.get(name, {})
        if name == "onnx":
            needed["model"] = network()
        return bench.made(name, **{**needed, **more})

    return make


@pytest.fixture
def scene(bench):
    """Frames in which the detector of this name finds something."""

    def frames(name, end=TEN):
        kind = {"stereo_blobs": "person_stereo", "contour_shape": "person_and_board"}.get(name, "two_squares")
        return bench.frames(make_scene(kind, 0), 3 if name == "stereo_blobs" else end)

    return frames


def same(one, other):
    assert len(one) == len(other)
    for left, right in zip(one, other, strict=True):
        assert np.array_equal(left.boxes, right.boxes) and np.array_equal(left.scores, right.scores)
        assert left.labels == right.labels


def test_the_built_in_ones_are_there():
    assert NAMES == [
        "background",
        "color_backprojection",
        "contour_shape",
        "gray_level",
        "motion",
        "onnx",
        "stereo_blobs",
    ]


@pytest.mark.parametrize("name", NAMES)
def test_a_declaration_says_what_a_person_needs(name):
    declaration = installed_detectors()[name]
    assert declaration.name == name and declaration.summary.endswith(".") and declaration.cost_ms > 0
    assert issubclass(declaration.parameters, DetectorParameters)
    for key, field in declaration.parameters.model_fields.items():
        assert field.description and field.description.endswith("."), key


@pytest.mark.parametrize("name", NAMES)
def test_detections_are_ordered_bounded_and_inside(name, build, scene, bench):
    detector = build(name)
    assert isinstance(detector, Detector)
    frames = scene(name)
    found, _ = bench.run(detector, frames)
    assert sum(map(len, found)) > 0
    for detections, frame in zip(found, frames, strict=True):
        assert detections.boxes.shape == (len(detections), 4) and detections.boxes.dtype == np.float64
        assert len(detections.labels) == len(detections.scores) == len(detections) <= 32
        assert (np.diff(detections.scores) <= 0).all()
        assert ((detections.scores >= 0.2) & (detections.scores <= 1)).all()
        low = detections.boxes[:, :2] - detections.boxes[:, 2:] / 2
        high = detections.boxes[:, :2] + detections.boxes[:, 2:] / 2
        assert (low < [frame.width, frame.height]).all() and (high > -0.5).all()


@pytest.mark.parametrize("name", NAMES)
def test_stored_state_goes_on_to_the_same_bits(name, build, scene, bench, tmp_path):
    frames = scene(name)
    half = len(frames) // 2
    whole, last = bench.run(build(name), frames)
    _, state = bench.run(build(name), frames[:half])
    np.savez(tmp_path / "state.npz", **state)
    with np.load(tmp_path / "state.npz", allow_pickle=False) as stored:
        read = {key: stored[key] for key in stored.files}
    assert {key: array.dtype for key, array in read.items()} == {key: a.dtype for key, a in state.items()}
    detector, rest, previous = build(name), [], frames[half - 1]
    for frame in frames[half:]:
        for array in read.values():
            array.flags.writeable = False  # a detector writes to no state
        detections, read = detector.detect(FramePair(frame, previous), read)
        read = {key: np.array(array) for key, array in read.items()}
        rest.append(detections)
        previous = frame
    same(rest, whole[half:])
    assert all(np.array_equal(read[key], last[key]) for key in last)


@pytest.mark.parametrize("name", NAMES)
def test_one_thread_or_two_give_the_same_bits(name, build, scene, bench):
    import cv2

    before, runs = cv2.getNumThreads(), []
    try:
        for threads in (1, 2):
            cv2.setNumThreads(threads)
            runs.append(bench.run(build(name), scene(name, 6))[0])
    finally:
        cv2.setNumThreads(before)
    same(*runs)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [128, *(pytest.param(v, marks=pytest.mark.slow) for v in (0, 255))])
def test_a_constant_picture_holds_nothing(name, value, build, scene, bench):
    frames = [replace(frame, image=np.full_like(frame.image, value)) for frame in scene(name, 5)]
    if name == "stereo_blobs":
        flat = np.full_like(frames[0].image, value)
        frames = [replace(frame, depth=replace(frame.depth, image=flat)) for frame in frames]
    found, _ = bench.run(build(name, min_score=0.95 if name == "onnx" else 0.2), frames)
    # the network of these tests calls what is bright a target
    assert all(len(detections) == 0 for detections in found) or (name == "onnx" and value == 255)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "stereo_blobs"])
@pytest.mark.parametrize("size", [(1, 1), (2, 40), (15, 17), (64, 33)])
def test_any_size_of_frame_and_a_change_of_size_are_borne(name, size, build, bench):
    rng = np.random.default_rng(0)
    sizes = [size, size, (48, 64), (48, 64), size]
    images = [rng.integers(0, 256, (*one, 3)) for one in sizes]
    for detections in bench.run(build(name), bench.pictures(images))[0]:
        assert np.isfinite(detections.boxes).all()


@pytest.mark.parametrize("name", [name for name in NAMES if name != "stereo_blobs"])
def test_a_picture_of_targets_everywhere_does_not_hang_and_stays_within_the_count(name, build, bench):
    rng = np.random.default_rng(1)
    board = np.kron(rng.integers(0, 2, (120, 160)) * 255, np.ones((4, 4)))
    orange = np.where(board[..., None] > 0, [30, 135, 240], [200, 60, 20])
    moved = np.roll(orange, (3, 4), axis=(0, 1))
    most = {"min_score": 0.0, "min_area_px": 4, "max_overlap": 1.0, "max_count": 50, "max_area_share": 1.0}
    if name not in ("onnx", "contour_shape"):
        most |= {"join_px": 0, **({} if name == "stereo_blobs" else {"clean_px": 0})}
    detector = build(name, **most)
    frames = bench.pictures([orange, moved, orange, moved, orange, moved])
    bench.run(detector, frames[:2])  # compiles
    began = time.process_time()
    found, _ = bench.run(detector, frames)
    assert max(map(len, found)) <= 50
    # Six frames of 640x480 take some 0.1 s each; what grows with pairs of regions would take minutes.
    assert time.process_time() - began < 60.0


@pytest.mark.slow
def test_the_first_frame_is_enough_for_those_that_need_one_frame_only(build, scene, bench):
    found = {name: bench.run(build(name), scene(name, 1)[:1])[0][0] for name in NAMES}
    assert {name for name in NAMES if len(found[name]) == 0} == {"background", "motion"}


def test_a_source_that_it_is_blind_in_is_refused_by_the_declaration(bench):
    from bayesnet_track.observation.detector import DetectorError

    kinds = installed_detectors()
    with pytest.raises(DetectorError, match="needs colour, and the source is gray"):
        kinds["color_backprojection"].check_source(has_color=False, has_depth=True)
    with pytest.raises(DetectorError, match="needs depth, and the source is one eye"):
        kinds["stereo_blobs"].check_source(has_color=True, has_depth=False)
    for declaration in kinds.values():
        declaration.check_source(has_color=True, has_depth=True)
    gray = Frame(0, 0.0, make_scene("two_squares", 0).frames[0], has_color=False)
    detector = bench.made("color_backprojection", hue_deg=30)
    assert detector.detect(FramePair(gray, None), detector.start())[0] is NOTHING
