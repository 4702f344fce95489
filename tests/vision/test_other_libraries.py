"""Detections of other libraries, by objects with the fields that theirs have."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from bayesnet_track.observation.detector import detections_of
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.detection_files import format_frame, parse_detections

CORNERS = np.array([[10, 20, 51, 51], [100, 50, 120, 90]], np.float32)


class Tensor:
    """What a tensor on another device shows: no array before it is fetched."""

    def __init__(self, values):
        self.values = np.asarray(values)

    def cpu(self):
        return self.values


def supervision(**fields):
    given = {"xyxy": CORNERS, "confidence": None, "class_id": None, "data": {}}
    return SimpleNamespace(**{**given, **fields})


def test_supervision_with_names():
    found = detections_of(
        supervision(
            confidence=np.array([0.5, 0.75]),
            class_id=np.array([0, 2]),
            data={"class_name": np.array(["person", "car"])},
        )
    )
    np.testing.assert_array_equal(found.boxes, [[109.5, 69.5, 20, 40], [30, 35, 41, 31]])
    assert found.scores.tolist() == [0.75, 0.5] and found.labels == ("car", "person")


def test_without_confidence_the_score_is_one_and_without_names_labels_are_numbers():
    found = detections_of(supervision(class_id=np.array([0, 2])))
    assert found.scores.tolist() == [1.0, 1.0] and found.labels == ("0", "2")
    assert detections_of(supervision()).labels == ("", "")


def test_ultralytics_on_another_device():
    boxes = SimpleNamespace(xyxy=Tensor(CORNERS), conf=Tensor([0.9, 0.3]), cls=Tensor([0.0, 1.0]))
    found = detections_of(SimpleNamespace(boxes=boxes, names={0: "person", 1: "bicycle"}))
    assert found.labels == ("person", "bicycle") and found.boxes.shape == (2, 4)


@pytest.mark.parametrize("names", [{0: "person", 1: "bicycle"}, {}])
def test_results_of_ultralytics_are_tracked_as_they_are(names):
    boxes = SimpleNamespace(xyxy=Tensor(CORNERS), conf=Tensor([0.9, 0.8]), cls=Tensor([0.0, 1.0]))
    result, tracker = SimpleNamespace(boxes=boxes, names=names), DetectionsTracker(size=(200, 200))
    for _ in range(4):
        marked = tracker.update(result)
    assert marked.tracker_id.tolist() == [1, 2] and marked.boxes is boxes
    assert not hasattr(result, "tracker_id")


def test_none_found_is_none():
    nothing = supervision(xyxy=np.empty((0, 4)), confidence=np.empty(0), class_id=np.empty(0, int))
    assert len(detections_of(nothing)) == 0


def test_a_file_of_them_reads_back():
    frame = Frame(3, 3.0, np.zeros((200, 200, 3), np.uint8))
    found = detections_of(supervision(confidence=np.array([0.5, 0.25])))
    again = parse_detections("\n".join(format_frame(frame, found, as_json=True)))
    np.testing.assert_array_equal(again[3].boxes, found.boxes)
    np.testing.assert_array_equal(again[3].scores, found.scores)


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (SimpleNamespace(), "SimpleNamespace without xyxy"),
        (supervision(xyxy=np.zeros((2, 3))), r"xyxy of shape \(2, 3\)"),
        (supervision(confidence=np.array([0.5])), "confidence of 1 values for 2 boxes"),
        (supervision(confidence=np.array([0.5, 40.0])), "confidence 0.5 .. 40; allowed: 0 .. 1"),
        (supervision(data={"class_name": ["a"]}), "class_name of 1 values for 2 boxes"),
        (supervision(xyxy=CORNERS[:, [2, 3, 0, 1]]), "boxes without area"),
    ],
)
def test_what_does_not_fit_is_named(found, message):
    with pytest.raises(ValueError, match=message):
        detections_of(found)
