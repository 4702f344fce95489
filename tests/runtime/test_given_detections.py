"""Rows of detections that cannot be used: named, counted, and no loss to the others."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, load_graph
from bayesnet_track.runtime.detections_tracker import NO_TARGET
from bayesnet_track.sources.entrances.notices import InputNotice

TWO = [[20, 100, 60, 200], [300, 100, 360, 200]]
ALL_NAN = [np.nan] * 4


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        ([0, 50, 0, 90], "is not finite or has no area"),
        ([10, 50, 60, 50], "is not finite or has no area"),
        ([60, 90, 10, 50], "is not finite or has no area"),
        (ALL_NAN, "is not finite or has no area"),
        ([10, 10, np.inf, 50], "is not finite or has no area"),
        ([-np.inf, -np.inf, np.inf, np.inf], "is not finite or has no area"),
        ([0, 0, 1e300, 1e300], "is not finite or has no area"),
        ([700, 100, 760, 200], "is outside of the frames of 640x480 px"),
        ([-90, 100, -30, 200], "is outside of the frames of 640x480 px"),
        ([0.1, 0.2, 0.3, 0.9], "is smaller than 1 px²"),
    ],
)
@pytest.mark.parametrize("row", [0, 1, 2])
def test_a_row_that_cannot_be_used_is_named_and_the_others_are_tracked(bad, why, row):
    tracker = DetectionsTracker("kalman_detections", size=(640, 480))
    for _ in range(4):
        assert tracker.update(SimpleNamespace(xyxy=TWO)).tracker_id.shape == (2,)
    boxes, names = [list(map(float, box)) for box in TWO], ["first", "second"]
    boxes.insert(row, bad), names.insert(row, "bad")
    given = SimpleNamespace(xyxy=np.array(boxes), confidence=[0.9] * 3, data={"class_name": names})
    with pytest.warns(
        InputNotice, match=rf"1 of 3 boxes {why} and (is )?left out: row {row}(;.*)?$"
    ) as heard:
        marked = tracker.update(given)
    assert len(heard) == 1 and heard[0].filename == __file__
    ids = dict(zip(marked.data["class_name"], marked.tracker_id.tolist(), strict=True))
    assert ids == {"first": 1, "second": 2, "bad": NO_TARGET}


def test_rows_stay_with_their_confidences_and_names(tmp_path):
    """The unusable row is a car with confidence 1; shifted by one row, others would be cars and sure."""
    path = tmp_path / "cars.yaml"
    text = load_graph("kalman_detections").text
    path.write_text(text.replace("detector: detections", "detector: detections\n      labels: [car]"))
    tracker = DetectionsTracker(path, size=(640, 480))
    boxes = np.array([[20, 100, 60, 200], ALL_NAN, [300, 100, 360, 200], [400, 100, 460, 200]])
    given = SimpleNamespace(
        xyxy=boxes, confidence=[0.1, 1.0, 0.9, 0.8], data={"class_name": ["car", "car", "person", "car"]}
    )
    with pytest.warns(InputNotice, match="left out: row 1$"):
        for _ in range(4):
            found = tracker.update(given)
    assert found.tracker_id.tolist() == [-1, -1, -1, 1]


@pytest.mark.parametrize("unknown", [np.nan, np.inf, None, np.ma.masked])
def test_a_confidence_that_is_no_number_costs_its_row_only(unknown):
    tracker = DetectionsTracker("kalman_detections", size=(640, 480))
    confidence = np.ma.array([0.9, 0.8]) if unknown is np.ma.masked else [0.9, 0.8]
    for _ in range(4):
        tracker.update(SimpleNamespace(xyxy=TWO, confidence=confidence))
    confidence[0] = unknown
    with pytest.warns(InputNotice, match="1 of 2 boxes is without a number as confidence .* row 0$"):
        found = tracker.update(SimpleNamespace(xyxy=TWO, confidence=confidence))
    assert found.tracker_id.tolist() == [NO_TARGET, 2]


@pytest.mark.parametrize(
    "form", [list, np.array, lambda boxes: np.array(boxes, np.uint16), lambda boxes: np.ma.array(boxes)]
)
def test_boxes_come_in_any_form(form):
    tracker = DetectionsTracker(size=(640, 480))
    for _ in range(4):
        found = tracker.update(SimpleNamespace(xyxy=form(TWO)))
    assert found.tracker_id.tolist() == [1, 2]


def test_masked_boxes_are_left_out():
    tracker = DetectionsTracker(size=(640, 480))
    boxes = np.ma.array(np.array(TWO), mask=[[True] * 4, [False] * 4])
    with pytest.warns(InputNotice, match="1 of 2 boxes .* left out: row 0$"):
        for _ in range(4):
            found = tracker.update(SimpleNamespace(xyxy=boxes))
    assert found.tracker_id.tolist() == [NO_TARGET, 1]


def test_nothing_is_learnt_where_the_notice_is_an_error_or_the_ids_cannot_be_written():
    class Frozen(SimpleNamespace):
        def __setattr__(self, name, value):
            raise AttributeError(name)

    tracker = DetectionsTracker(size=(640, 480))
    for _ in range(3):
        tracker.update(SimpleNamespace(xyxy=TWO))
    before = repr(tracker)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputNotice):
            tracker.update(SimpleNamespace(xyxy=[*TWO, ALL_NAN]))
    with pytest.raises(AttributeError):
        tracker.update(Frozen(xyxy=TWO))
    assert repr(tracker) == before
