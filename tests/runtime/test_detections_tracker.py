"""Detections of a pipeline get identities: the `update` of Roboflow's `trackers`, by a graph."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bayesnet_track import DetectionsTracker, load_graph
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.runtime.detections_tracker import NO_TARGET, owners
from bayesnet_track.runtime.frame_clock import image_users
from bayesnet_track.sources.entrances.notices import InputNotice


def crossing(frame, order=(0, 1)):
    """Two people who walk past each other, in another order in every other frame."""
    boxes = np.array(
        [[20 + 8 * frame, 100, 60 + 8 * frame, 200], [500 - 8 * frame, 110, 540 - 8 * frame, 210]]
    )
    return SimpleNamespace(
        xyxy=boxes[list(order)].astype(float), confidence=np.array([0.9, 0.8]), tracker_id=None
    )


def test_identities_stay_through_a_crossing_and_another_order():
    tracker, seen = DetectionsTracker(size=(640, 480)), []
    for frame in range(50):
        order = (0, 1) if frame % 2 else (1, 0)
        given = crossing(frame, order)
        marked = tracker.update(given)
        assert given.tracker_id is None and marked.tracker_id.dtype == np.int64
        seen.append(marked.tracker_id[list(order)])
    assert (seen[0] == NO_TARGET).all()  # not confirmed yet
    assert {tuple(ids) for ids in seen[5:]} == {tuple(seen[-1])} and len(set(seen[-1])) == 2
    assert [one.target for one in tracker.targets] == sorted(map(str, seen[-1]))
    tracker.reset()
    assert (tracker.update(crossing(0)).tracker_id == NO_TARGET).all()


def test_frames_without_detections_and_without_confidence():
    tracker = DetectionsTracker(size=(640, 480))
    empty = SimpleNamespace(xyxy=np.empty((0, 4)), confidence=None)
    assert tracker.update(empty).tracker_id.shape == (0,)
    for frame in range(6):
        found = tracker.update(SimpleNamespace(xyxy=crossing(frame).xyxy)).tracker_id
    assert (found > 0).all()


TWO = [[20, 100, 60, 200], [300, 100, 360, 200]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"confidence": [0.9]}, r"confidence of shape (1,) for 2 boxes; allowed: (2,)"),
        ({"confidence": 0.9}, r"confidence of shape () for 2 boxes; allowed: (2,)"),
        ({"confidence": [[0.9], [0.8]]}, r"confidence of shape (2, 1) for 2 boxes; allowed: (2,)"),
        ({"xyxy": TWO[:1], "confidence": []}, r"confidence of shape (0,) for 1 box; allowed: (1,)"),
        ({"xyxy": [], "confidence": [0.9]}, r"confidence of shape (1,) for 0 boxes; allowed: (0,)"),
        ({"data": {"class_name": ["car"]}}, r'data["class_name"] of shape (1,) for 2 boxes; allowed: (2,)'),
        ({"data": {"class_name": "ab"}}, r'data["class_name"] of shape () for 2 boxes; allowed: (2,)'),
        ({"xyxy": TWO[0] + TWO[1]}, r"xyxy of shape (8,); allowed: (n, 4)"),
        ({"xyxy": [[20, 100], [60, 200]]}, r"xyxy of shape (2, 2); allowed: (n, 4)"),
        ({"xyxy": [TWO]}, r"xyxy of shape (1, 2, 4); allowed: (n, 4)"),
        ({"xyxy": [["left"] * 4] * 2}, r"xyxy holds something else than real numbers: texts"),
        ({"xyxy": np.array(TWO) * 1j}, r"xyxy holds something else than real numbers: complex numbers"),
        ({"xyxy": [[1, 2, 3, 4], [5, 6]]}, r"xyxy holds something else than real numbers"),
        ({"xyxy": None}, r"xyxy of shape (); allowed: (n, 4)"),
        ({"confidence": ["high", 1]}, r"confidence holds something else than real numbers"),
        ({"confidence": [0.5, 90]}, r"confidence goes beyond 0..1"),
        ({"confidence": [True, False]}, r"confidence holds something else than real numbers: True and False"),
        ({"xyxy": [[str(one) for one in row] for row in TWO]}, r"something else than real numbers: texts"),
        ({"data": ["car", "bus"]}, r"data is of type list; allowed: a dict, whose class_name"),
    ],
)
def test_what_does_not_fit_the_boxes_is_refused_and_the_tracker_stays_as_it_was(given, message):
    tracker = DetectionsTracker(size=(640, 480))
    with pytest.raises(ValueError, match=re.escape(message)):
        tracker.update(SimpleNamespace(**{"xyxy": TWO, **given}))
    for _ in range(4):
        found = tracker.update(SimpleNamespace(xyxy=TWO, confidence=[0.9, 0.8]))
    assert found.tracker_id.tolist() == [1, 2]


def test_boxes_in_parts_of_the_frame_are_said_to_be_such():
    tracker = DetectionsTracker(size=(640, 480))
    with pytest.warns(InputNotice, match=r"all coordinates are from 0 to 1, as parts of the frame \(xyxyn\)"):
        tracker.update(SimpleNamespace(xyxy=np.array(TWO) / 1000))


def test_data_of_none_is_no_data():
    tracker = DetectionsTracker(size=(640, 480))
    assert tracker.update(SimpleNamespace(xyxy=TWO, data=None)).tracker_id.shape == (2,)
    assert tracker.update(SimpleNamespace(xyxy=[], data=None)).tracker_id.shape == (0,)


def test_it_says_what_it_holds_and_what_it_takes():
    tracker = DetectionsTracker(size=(320, 240))
    assert repr(tracker) == "<DetectionsTracker 'kalman_detections', 0 frames, 0 targets>"
    with pytest.raises(TypeError, match=r"ndarray has no xyxy: types\.SimpleNamespace"):
        tracker.update(np.array([[1, 2, 30, 40]]))
    for _ in range(4):
        tracker.update(SimpleNamespace(xyxy=[[20, 100, 60, 200]], confidence=[0.9]))
    assert ", 4 frames, 1 target: <target 1 in frame 3" in repr(tracker)


def walker(n):
    return SimpleNamespace(xyxy=[[20 + 2 * n, 100, 60 + 2 * n, 200]], confidence=[0.9])


@pytest.mark.parametrize("graph", ["kalman_detections", "jpda", "people_detections"])
def test_none_is_a_frame_that_no_detector_looked_at(graph):
    """The target is predicted and stays; with empty detections instead it is lost."""
    gray = np.full((240, 320, 3), 128, np.uint8)
    nothing = SimpleNamespace(xyxy=np.empty((0, 4)), confidence=[])
    statuses = {}
    for seen in (None, nothing):
        tracker = DetectionsTracker(graph, size=(320, 240))
        for n in range(8):
            tracker.update(walker(n), gray)
        for _ in range(6):
            answer = tracker.update(seen, gray)
        statuses[seen is None] = tracker.targets[0].status
        if seen is None:
            assert answer is None and tracker.update(walker(14), gray).tracker_id.tolist() == [1]
    assert statuses == {True: "tracking", False: "lost"}


def test_the_first_frame_may_be_one_that_nobody_looked_at():
    tracker = DetectionsTracker(size=(320, 240))
    assert tracker.update(None) is None and tracker.targets == ()
    for n in range(4):
        marked = tracker.update(walker(n))
    assert marked.tracker_id.tolist() == [1]


def test_it_says_whether_detections_of_the_next_frame_are_used():
    graph = load_graph("kalman_detections").spec.model_dump(exclude_unset=True)
    graph["targets"]["target"]["birth"]["every"] = 3
    seldom, usual = DetectionsTracker(load_graph(graph), size=(320, 240)), DetectionsTracker(size=(320, 240))
    asked = []
    for n in range(31):
        asked.append(seldom.looks_next)
        assert usual.looks_next
        seldom.update(walker(n) if seldom.looks_next else None)
        usual.update(walker(n))
    assert asked == [n % 3 == 0 for n in range(31)]
    assert [one.target for one in seldom.targets] == ["1"] and seldom.targets[0].status == "tracking"
    assert seldom.targets[0].centre_box[0] == pytest.approx(usual.targets[0].centre_box[0], abs=1.0)


@pytest.mark.parametrize("graph", ["kalman_detections", "jpda"])
def test_the_pace_of_the_detector_follows_what_there_is_to_see(graph):
    """Seldom while it is empty, in every frame until a target is confirmed, in every second one then."""
    written = load_graph(graph).spec.model_dump(exclude_unset=True, exclude_none=True)
    plate = written["targets"]["target"]
    plate["birth"] |= {"every": 2, "pace": {"empty": 5}}
    if "death" in plate:
        plate["death"] = {"unseen_frames": 3}
    given, spared = (DetectionsTracker(load_graph(written), size=(320, 240)) for _ in range(2))
    nothing = SimpleNamespace(xyxy=np.empty((0, 4)), confidence=[])
    asked, live = [], []
    for n in range(100):
        seen = walker(n) if 18 <= n < 60 else nothing
        asked.append(spared.looks_next)
        spared.update(seen if spared.looks_next else None)
        given.update(seen)  # detections of other frames are not used
        live.append(bool(spared.targets))
        assert [one.centre_box for one in given.targets] == [one.centre_box for one in spared.targets]
    first, last = live.index(True), max(np.flatnonzero(live))
    assert [n for n in range(21) if asked[n]] == [0, 5, 10, 15, 20]
    assert all(asked[20 : first + 1]) and first < 25
    assert asked[30:60] == [n % 2 == 0 for n in range(30, 60)]
    assert 60 < last < 90 and asked[last + 1 :] == [n % 5 == 0 for n in range(last + 1, 100)]


def standing(count):
    """People who stand apart from each other in rows of ten."""
    left, top = 60.0 * (np.arange(count) % 10), 120.0 * (np.arange(count) // 10)
    return SimpleNamespace(
        xyxy=np.stack([left, top, left + 40, top + 100], axis=1), confidence=np.ones(count)
    )


@pytest.mark.parametrize("graph", ["kalman_detections", "jpda", "people_detections", "sort"])
def test_everybody_in_a_crowd_is_tracked(graph):
    tracker, people = DetectionsTracker(graph, size=(640, 1600)), standing(120)
    gray = np.full((1600, 640, 3), 128, np.uint8) if graph == "people_detections" else None
    for _ in range(8):
        found = tracker.update(people, gray).tracker_id
    assert sorted(found) == list(range(1, 121))


@pytest.mark.slow
@pytest.mark.parametrize("max_overlap", [0.99, 1.0])
def test_more_than_a_thousand_are_tracked_each_with_an_identity(max_overlap):
    graph = load_graph("kalman_detections").spec.model_dump(exclude_unset=True)
    graph["targets"]["target"]["birth"]["detector"] = {"detections": {"max_overlap": max_overlap}}
    tracker = DetectionsTracker(load_graph(graph), size=(1600, 1600))
    down, across = np.divmod(40.0 * np.arange(1200), 1600)
    people = SimpleNamespace(
        xyxy=np.stack([across, 50 * down, across + 20, 50 * down + 40], axis=1),
        confidence=np.linspace(0.5, 0.9, 1200),
    )
    for _ in range(4):
        found = tracker.update(people).tracker_id
    assert sorted(found) == list(range(1, 1201))


boxes_in_a_row = arrays(np.float64, st.tuples(st.integers(0, 8), st.just(4)), elements=st.integers(1, 12))


@given(boxes_in_a_row, boxes_in_a_row, st.data())
def test_the_best_overlaps_come_first(boxes, places, data):
    statuses = data.draw(st.lists(st.sampled_from(["tracking", "lost"]), min_size=8, max_size=8))
    targets = [
        SimpleNamespace(
            target=str(number + 1), centre_box=tuple(place), status=status, is_gone=status == "lost"
        )
        for number, (place, status) in enumerate(zip(places, statuses, strict=False))
    ]
    held = [one for one in targets if one.status != "lost"]
    shares = {
        (row, one.target): float(overlap(box, np.array(one.centre_box)))
        for row, box in enumerate(boxes)
        for one in held
    }
    expected = np.full(len(boxes), NO_TARGET)
    for row, target in sorted(shares, key=lambda pair: (-shares[pair], pair[0], int(pair[1]))):
        if shares[row, target] >= 0.3 and expected[row] == NO_TARGET and int(target) not in expected:
            expected[row] = int(target)
    assert owners(boxes, targets).tolist() == expected.tolist()


def test_classes_are_told_apart_by_their_names(tmp_path):
    text = load_graph("kalman_detections").text
    text = text.replace("detector: detections", "detector: detections\n      labels: [car]")
    path = tmp_path / "cars.yaml"
    path.write_text(text)
    tracker = DetectionsTracker(path)
    boxes = {"xyxy": [[20, 100, 60, 200], [300, 100, 360, 200]], "confidence": [1, 1]}
    with pytest.raises(ValueError, match="the graph takes car only"):
        tracker.update(SimpleNamespace(**boxes))
    for _ in range(4):
        found = tracker.update(SimpleNamespace(**boxes, data={"class_name": ["car", "person"]}))
    assert found.tracker_id.tolist() == [1, NO_TARGET]


# ------------------------------------------------------------------------------- frames

USERS = {
    "people_detections": ("agent color", "agent shade"),
    "kalman_detections": (),
    "jpda": (),
    "sort": (),
    "bytetrack": (),
    "oc_sort": (),
}


@pytest.mark.parametrize("graph", USERS)
def test_a_graph_that_looks_at_the_image_needs_it(graph):
    tracker = DetectionsTracker(graph, size=(640, 480))
    assert image_users(tracker._engine) == USERS[graph]
    if not USERS[graph]:
        tracker.update(SimpleNamespace(xyxy=TWO))
        return
    message = (
        f"the graph {graph} looks at the image ({', '.join(USERS[graph])}): call update(detections, frame)"
    )
    image = np.full((480, 640, 3), 128, np.uint8)
    for frame in (None, image, None):  # some frames without it are no better
        if frame is not None:
            tracker.update(SimpleNamespace(xyxy=TWO), frame)
            continue
        with pytest.raises(ValueError, match=re.escape(message)):
            tracker.update(SimpleNamespace(xyxy=TWO), frame)
    assert ", 1 frame," in repr(tracker)


LOOKING = {
    "agent color": ("nodes", {"color": {"parent": "target", "agent": "color_histogram"}}),
    "motion with camera": ("motion", {"camera": "compensate"}),
    "relocalize by a detector": (
        "motion",
        {"relocalize": {"share": 0.1, "above": {"ud_box": 2}, "by": {"detector": "background"}}},
    ),
    "lost with scene_cut": ("lost", {"scene_cut": 0.5}),
}


@pytest.mark.parametrize("user", LOOKING)
def test_whatever_looks_at_the_image_is_found(user):
    plain = yaml.safe_load(load_graph("kalman_detections").text)
    node = plain["targets"]["target"]["nodes"]["target"]
    place, what = LOOKING[user]
    if place == "nodes":
        plain["targets"]["target"]["nodes"] |= what
        node["fuse"] = "product"
    elif place == "motion":
        node["belief"] = {"particles": {"size": 50}}
        node["motion"]["constant_velocity"] |= what
    else:
        node["lost"] |= what
    with pytest.raises(ValueError, match=rf"looks at the image \({user}\)"):
        DetectionsTracker(plain, size=(640, 480)).update(SimpleNamespace(xyxy=TWO))


def test_births_of_another_detector_look_at_the_image():
    plain = yaml.safe_load(load_graph("kalman_detections").text)
    other = yaml.safe_load(load_graph("kalman_detections").text)["targets"]["target"]
    other["birth"]["detector"] = {"background": {}}
    other["nodes"] = {"other" if name == "target" else name: node for name, node in other["nodes"].items()}
    other["nodes"]["seen"]["parent"] = "other"
    plain["targets"]["other"] = other
    with pytest.raises(ValueError, match=r"looks at the image \(births by background of other\)"):
        DetectionsTracker(plain, size=(640, 480)).update(SimpleNamespace(xyxy=TWO))


def test_frames_may_be_left_out_where_nothing_looks_and_keep_their_size():
    tracker = DetectionsTracker()
    image = np.zeros((480, 640, 3), np.uint8)
    for frame in (image, None, image[..., 0], image, None):
        found = tracker.update(SimpleNamespace(xyxy=TWO), frame)
    assert found.tracker_id.tolist() == [1, 2]
    with pytest.raises(
        ValueError, match=r"frame 5 is 320x240 colour, the frames before it are 640x480; .*reset"
    ):
        tracker.update(SimpleNamespace(xyxy=TWO), image[:240, :320])
    tracker.reset()
    tracker.update(SimpleNamespace(xyxy=TWO), image[:240, :])
    blind = DetectionsTracker(size=(640, 480))
    blind.update(SimpleNamespace(xyxy=TWO))
    with pytest.raises(ValueError, match=r"frame 1 is 320x240 colour, the frames before it are 640x480"):
        blind.update(SimpleNamespace(xyxy=TWO), image[:240, :320])


def test_a_size_that_the_frames_have_not_is_noticed():
    tracker = DetectionsTracker(size=(1280, 720))
    with pytest.warns(
        InputNotice, match=r"size=\(1280, 720\) is not used: the frame that is given has 640x480"
    ):
        tracker.update(SimpleNamespace(xyxy=TWO), np.zeros((480, 640, 3), np.uint8))


@pytest.mark.parametrize("size", [(0, 480), (640,), (640, -1), 640, (640.5, 480), "ab", (True, 480)])
def test_what_is_no_size_is_refused(size):
    with pytest.raises(ValueError, match="size"):
        DetectionsTracker(size=size)


def test_what_is_no_frame_is_refused():
    tracker = DetectionsTracker(size=(640, 480))
    for frame, message in (("frame.png", "not str"), (np.zeros((480, 640)), "float64 values of shape")):
        with pytest.raises(ValueError, match=message):
            tracker.update(SimpleNamespace(xyxy=TWO), frame)


def test_several_targets_that_a_detector_finds_again_are_tracked():
    """The detector's parameters are part of the motion, and targets of the same motion are moved together."""
    plain = yaml.safe_load(load_graph("kalman_detections").text)
    node = plain["targets"]["target"]["nodes"]["target"]
    node["belief"] = {"particles": {"size": 50}}
    node["motion"]["constant_velocity"] |= LOOKING["relocalize by a detector"][1]
    tracker, image = DetectionsTracker(plain), np.zeros((480, 640, 3), np.uint8)
    for _ in range(6):
        found = tracker.update(SimpleNamespace(xyxy=TWO), image)
    assert found.tracker_id.tolist() == [1, 2]
