"""Of given detections it is said which are left out, and by which key."""

import numpy as np

from bayesnet_track.observation.detector import Detections, GivenParameters
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.detectors.selection import left_out, select


def test_every_reason_is_named_once():
    boxes = [
        [50, 20, 9, 9],
        [50, 20, 9, 8],
        [20, 20, 9, 9],
        [200, 20, 9, 9],
        [9, 9, 0.5, 0.5],
        [30, 20, 99, 99],
    ]
    boxes = np.array([*boxes, [9, 9, 5, 5]], dtype=float)
    found = Detections(boxes, np.array([1, 0.9, 0.1, 1, 1, 1, 1]), (*["car"] * 6, "person"))
    size, parameters = (100, 80), GivenParameters(max_area_share=0.5)
    reasons = left_out({3: found, 8: found}, parameters, size, ["car"])
    assert list(reasons.values()) == [2] * 6 and reasons["score less than min_score 0.2"] == 2
    kept = select(found.boxes, found.scores, Frame(0, 0.0, np.zeros((80, 100, 3), np.uint8)), parameters)
    assert len(kept) + sum(left_out({0: found}, parameters, size).values()) == len(found)


def test_what_is_used_is_not_spoken_of():
    found = Detections(np.array([[50.0, 20, 9, 9], [2, 20, 9, 9]]), np.array([1, 0.9]), ("", ""))
    assert left_out({0: found}, GivenParameters(), (100, 80)) == {}
