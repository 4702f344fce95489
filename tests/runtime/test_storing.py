"""Trackers that are stored and copied: what comes of it goes on with the same bytes, or is refused."""

from __future__ import annotations

import copy
import hashlib
import pickle
import subprocess
import sys
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track import CueDeclaration, DetectionsTracker, Start, Tracker, load_graph
from bayesnet_track.belief.motion.formulas import FunctionMotion
from bayesnet_track.engine.starts import has_births
from bayesnet_track.graphs import graph_names
from bayesnet_track.journal.codec import to_json
from bayesnet_track.runtime import storing
from bayesnet_track.runtime.storing import Storable, StoredError, stored_classes
from bayesnet_track.sources.frames import Frame
from bayesnet_track.sources.scenes import make_scene, scene_names
from bayesnet_track.sources.scenes.library import SceneSource

OF_DETECTIONS = ("kalman_detections", "jpda", "sort", "bytetrack", "oc_sort", "people_detections")
NOT_HERE = {"deep", "people", "radar_crowd", "street"}  # these need files that are not shipped, or sensors
OF_IMAGES = tuple(sorted({*graph_names()} - NOT_HERE - {*OF_DETECTIONS}))
FAST = ("two_squares", "general", "kalman_ball", "orange_and_gray_detected", "road_mask")
SCENES = {
    "kalman_ball": "flying_ball",
    "hidden_ball": "flying_ball",
    "person_shape": "person_and_board",
    "orange_and_gray_detected": "orange_and_gray",
}
SCENE = make_scene("two_squares")


def lines(tracker):
    """All that was measured and decided in the last frame, as text."""
    events = tracker.events if isinstance(tracker, Tracker) else ()
    return [to_json(one) for one in (*tracker.targets, *events)]


def through_file(tracker, tmp_path):
    tracker.save(tmp_path / "tracker.bin")
    return type(tracker).load(tmp_path / "tracker.bin")


WAYS = {
    "pickle": lambda tracker, _: pickle.loads(pickle.dumps(tracker)),
    "file": through_file,
    "copy": lambda tracker, _: copy.copy(tracker),
    "deepcopy": lambda tracker, _: copy.deepcopy(tracker),
}


# ------------------------------------------------------------------------------- going on


@pytest.mark.parametrize(
    "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in OF_IMAGES]
)
def test_every_graph_goes_on_from_bytes(name, tmp_path):
    graph = load_graph(name)
    scene = SCENES.get(name, name if name in scene_names() else "two_squares")
    source = SceneSource.named(scene, 0, 7)
    box = None if has_births(graph) else Start(source.scene.start_box, next(iter(graph.targets)))
    frames = [one for one in source if isinstance(one, Frame)]
    straight, stored = Tracker(graph, 3, fps=25), None
    straight.init(frames[0].image, box, depth=frames[0].depth, time_s=0.0)
    stored = through_file(straight, tmp_path)
    assert lines(stored) == lines(straight) and repr(stored) == repr(straight)
    for number, frame in enumerate(frames[1:], 1):
        for one in (straight, stored):
            one.update(frame.image, depth=frame.depth, time_s=number * 0.04 + 0.01 * (number > 3))
        assert lines(stored) == lines(straight)
        stored = pickle.loads(pickle.dumps(stored)) if number % 2 else through_file(stored, tmp_path)
        assert lines(stored) == lines(straight)
    assert number == 6


def crowd(frame, seed=0):
    """Twenty people who walk, some of whom are not detected."""
    noise = np.random.default_rng([seed, frame])
    left = 30.0 * (np.arange(20) % 10) * 2 + 2 * frame + noise.normal(0, 1, 20)
    top = 200.0 * (np.arange(20) // 10) + noise.normal(0, 1, 20)
    boxes = np.stack([left, top, left + 40, top + 100], axis=1)[noise.random(20) < 0.9]
    return SimpleNamespace(xyxy=boxes, confidence=np.full(len(boxes), 0.9))


def image(frame):
    return np.random.default_rng(frame).integers(0, 255, (420, 700, 3), np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "way"),
    [*((name, "file") for name in OF_DETECTIONS), *(("jpda", way) for way in WAYS if way != "file")],
)
def test_a_crowd_goes_on(name, way, tmp_path):
    looks = name == "people_detections"
    straight = DetectionsTracker(name, size=(700, 420), seed=2, fps=25)
    other = WAYS[way](straight, tmp_path)
    assert repr(other) == repr(straight)
    for frame in range(9):
        found = []
        for one in (straight, other):
            given = (crowd(frame), image(frame)) if looks else (crowd(frame),)
            found.append(one.update(*given, time_s=frame * 0.04).tracker_id.tolist())
        assert found[0] == found[1] and lines(other) == lines(straight)
        if frame % 3 == 2:
            other = WAYS[way](other, tmp_path)
    assert len(set(found[0])) > 10


IN_ANOTHER_PROCESS = """
import pickle, sys
sys.path.insert(0, {tests!r})
from test_storing import SCENE, crowd, lines
from bayesnet_track import DetectionsTracker
with open("pickled", "rb") as file:
    of_images = pickle.load(file)
of_detections = DetectionsTracker.load("saved")
for frame in range(5, 9):
    of_images.update(SCENE.frames[frame])
    of_detections.update(crowd(frame))
print("\\n".join((*lines(of_images), *lines(of_detections))))
"""


@pytest.mark.slow
def test_they_go_on_in_another_process(tmp_path):
    """One that was pickled, and one that was saved."""
    of_images, of_detections = Tracker("two_squares", 1), DetectionsTracker("jpda", size=(700, 420))
    of_images.init(SCENE.frames[0], SCENE.start_box)
    for frame in range(9):
        if frame == 5:
            (tmp_path / "pickled").write_bytes(pickle.dumps(of_images))
            of_detections.save(tmp_path / "saved")
        if frame:
            of_images.update(SCENE.frames[frame])
        of_detections.update(crowd(frame))
    code = IN_ANOTHER_PROCESS.format(tests=str(Path(__file__).parent))
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines() == [*lines(of_images), *lines(of_detections)]


def test_copies_go_on_by_themselves():
    tracker = DetectionsTracker(size=(700, 420))
    for frame in range(4):
        tracker.update(crowd(frame))
    before, other = lines(tracker), copy.copy(tracker)
    other.update(SimpleNamespace(xyxy=np.empty((0, 4))))
    assert lines(tracker) == before != lines(other)
    assert tracker.update(crowd(4)).tracker_id.max() > 0


def test_options_are_kept():
    tracker = Tracker(
        "two_squares", np.int64(7), whole_px=True, max_side=np.int32(64), copy_frames=False, fps=50
    )
    again = pickle.loads(pickle.dumps(tracker))
    for one in (tracker, again):
        one.init(SCENE.frames[0], SCENE.start_box)
    for frame in range(1, 4):
        assert again.update(SCENE.frames[frame]) == tracker.update(SCENE.frames[frame])
    assert again.metrics.time_s == 0.06 and type(again.update(SCENE.frames[4])[1][0]) is int


def test_a_range_of_values_goes_on_and_is_not_talked_of_again(recwarn):
    thermal = [SCENE.frames[number][..., 0].astype(np.uint16) // 4 + 8000 for number in range(4)]
    graph = graph_with("template")
    tracker = Tracker(graph, value_range=(8000, 8063))
    tracker.init(thermal[0], SCENE.start_box)
    again = pickle.loads(pickle.dumps(tracker))
    recwarn.clear()
    for frame in thermal[1:]:
        assert again.update(frame) == tracker.update(frame)
    assert not recwarn
    with pytest.raises(ValueError, match="uint8 values, and a range that counts those of uint16"):
        again.update(SCENE.frames[4])


def test_attributes_of_a_subclass_are_kept():
    tracker = Named("sort", size=(64, 48))
    tracker.camera = "north"
    again = pickle.loads(pickle.dumps(tracker))
    assert type(again) is Named and again.camera == "north"


class Named(DetectionsTracker):
    camera = ""


# ------------------------------------------------------------------------------- what is stored


def test_a_crowd_is_small_and_holds_no_blank_frame(tmp_path):
    tracker = DetectionsTracker("sort")  # 1920 x 1080
    assert len(pickle.dumps(tracker)) < 5_000
    for frame in range(5):
        tracker.update(crowd(frame))
    assert len(pickle.dumps(tracker)) < 60_000
    tracker.update(crowd(5), np.random.default_rng(0).integers(0, 255, (1080, 1920, 3), np.uint8))
    assert len(pickle.dumps(tracker)) < 60_000  # pixels that nobody looks at


def test_every_class_of_a_stored_tracker_has_its_own_name():
    names = [kind.__name__ for kind in stored_classes()]
    assert len(names) == len(set(names)) and {"State", "Standing", "FrameMetrics", "TargetDied"} <= {*names}
    assert issubclass(Tracker, Storable) and issubclass(DetectionsTracker, Storable)


# ------------------------------------------------------------------------------- what is refused


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    tracker = DetectionsTracker("sort", size=(700, 420))
    for frame in range(4):
        tracker.update(crowd(frame))
    path = tmp_path_factory.mktemp("stored") / "tracker"
    tracker.save(path)
    return path


@pytest.mark.parametrize("cut", [0, 10, 100, -1])
def test_a_cut_file_is_refused(stored, tmp_path, cut):
    (tmp_path / "cut").write_bytes(stored.read_bytes()[:cut])
    with pytest.raises(StoredError, match=r"damaged|no stored tracker|stored in"):
        DetectionsTracker.load(tmp_path / "cut")


def test_a_flipped_bit_is_refused_wherever_it_is(stored, tmp_path):
    data = stored.read_bytes()
    for place in np.linspace(0, len(data) - 1, 40).astype(int):
        damaged = bytearray(data)
        damaged[place] ^= 4
        (tmp_path / "flipped").write_bytes(damaged)
        with pytest.raises(StoredError):
            DetectionsTracker.load(tmp_path / "flipped")


def resealed(data, change):
    """The bytes with another content and a seal that fits."""
    first, _, content = data.split(b"\n", 2)
    content = zlib.compress(change(zlib.decompress(content)))
    return b"\n".join((first, hashlib.sha256(content).hexdigest().encode(), content))


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content.replace(b'"TargetNet"', b'"os.system"'),
        lambda content: content[:-1],
        lambda content: b"[]\n" + content,
        lambda content: b"",
        lambda content: content.replace(b'"masks": ', b'"masks": 1'),
    ],
)
def test_bytes_that_say_something_else_make_nothing(stored, tmp_path, change):
    (tmp_path / "other").write_bytes(resealed(stored.read_bytes(), change))
    with pytest.raises(StoredError):
        DetectionsTracker.load(tmp_path / "other")


def test_another_version_is_refused_with_both_named(stored, tmp_path, monkeypatch):
    data = stored.read_bytes()
    here = data.split(b"\n")[0].decode().split("tracker ", 1)[1]
    (tmp_path / "old").write_bytes(data.replace(b"format 2.", b"format 1.", 1))
    old = here.replace("format 2", "format 1")
    with pytest.raises(StoredError, match=rf"stored in {old}, and this is {here}:"):
        DetectionsTracker.load(tmp_path / "old")
    pickled = pickle.dumps(DetectionsTracker("sort"))
    monkeypatch.setattr(storing, "FORMAT", 3)
    with pytest.raises(StoredError, match=r"stored in format 2\..* and this is format 3\."):
        pickle.loads(pickled)


def test_another_graph_kind_or_file_is_refused(stored, tmp_path):
    assert lines(DetectionsTracker.load(stored, "sort")) == lines(DetectionsTracker.load(stored))
    with pytest.raises(StoredError, match=r"stored with another graph: SHA-256 .* jpda, which is given"):
        DetectionsTracker.load(stored, "jpda")
    with pytest.raises(StoredError, match="a DetectionsTracker was stored, and a Tracker is asked for"):
        Tracker.load(stored)
    with pytest.raises(StoredError, match="no stored tracker"):
        DetectionsTracker.load(__file__)
    with pytest.raises(FileNotFoundError):
        DetectionsTracker.load(tmp_path / "nothing")


def graph_with(agent):
    """One target with this agent."""
    motion = {"random_walk": {"sd_px": {"x": 3, "y": 3}}}
    nodes = {"thing": {"motion": motion, "fuse": "product"}, "one": {"parent": "thing", "agent": agent}}
    nodes["other"] = {"parent": "thing", "agent": "intensity"}
    return {"name": "own", "targets": {"thing": {"nodes": nodes}}}


def constant_cue():
    class Constant:
        needs = ()

        def learn(self, planes, box):
            return {"level": np.array(1.0)}

        def log_likelihood(self, planes, hypotheses, reference):
            return np.full(len(hypotheses), -float(reference["level"]))

    return CueDeclaration("constant", make=Constant)


NOT_STORED = {
    r"its motion is a model of one's own": lambda: Tracker(
        "two_squares", motion=FunctionMotion(("x", "y", "w", "h"), lambda states, dt: states, np.eye(4))
    ),
    r"its cues constant are one's own": lambda: Tracker(graph_with("constant"), cues=[constant_cue()]),
    r"its agents one keep what cannot be read": lambda: Tracker(
        graph_with({"opencv_tracker": {"tracker": "MIL"}})
    ),
}


@pytest.mark.parametrize("reason", NOT_STORED)
def test_what_cannot_be_stored_is_named(tmp_path, reason):
    own = NOT_STORED[reason]()
    for _ in range(2):
        with pytest.raises(StoredError, match=f"this tracker cannot be stored: {reason}"):
            own.save(tmp_path / "own")
        with pytest.raises(TypeError, match=rf"a Tracker that cannot be pickled: .* {reason}"):
            pickle.dumps(own)
        assert not (tmp_path / "own").exists() and repr(copy.deepcopy(own)) == repr(own)
        own.init(SCENE.frames[0], SCENE.start_box)
