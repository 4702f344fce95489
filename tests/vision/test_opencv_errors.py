"""What is told of an error of OpenCV: its own words, in one line."""

import cv2
import numpy as np

from bayesnet_track.vision.siamese_networks import reason_of


def test_an_error_is_told_without_files_and_lines():
    try:
        cv2.resize(np.empty((0, 0, 3), np.uint8), (2, 2))
    except cv2.error as error:
        told = reason_of(error)
    assert told.startswith("(-215")
    assert ".cpp" not in told.split("in function")[0] and "\n" not in told
    assert len(reason_of(ValueError("error: " + "x" * 300))) == 200
