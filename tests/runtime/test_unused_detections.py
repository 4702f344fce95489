"""Detections that a run will not use, and the reasons."""

import sys

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.observation.detector import Detections
from bayesnet_track.runtime.arguments import explain_unused

SEEN = Detections(np.array([[20.0, 30.0, 20.0, 20.0]]), np.ones(1), ("",))
POOR = Detections(np.array([[20.0, 30.0, 20.0, 20.0]]), np.array([0.1]), ("",))
SPARSE = (
    "only one frame in 3 has detections, and in the others nobody is detected: start=1 stride=3 reads "
    "only those that have some; with every: 3 in the graph's birth nobody looks at the others"
)


@pytest.mark.parametrize(
    ("found", "frames", "reasons"),
    [
        ({}, range(9), ["no detection in it"]),
        ({0: SEEN, 1: SEEN}, range(9), []),
        ({0: SEEN, 3: SEEN}, range(0, 9, 3), []),
        (
            {0: SEEN, 1: POOR, 9: POOR},
            range(9),
            [
                "1 of 3 detections are of frames after the last one that is read (9 to 9; 0 to 8 are read, "
                "counted from 0): is the file of this video, and of its frame rate?",
                "1 of 2 detections are not used: 1 score less than min_score 0.2",
            ],
        ),
        (
            {1: SEEN, 4: SEEN},
            range(9),
            [SPARSE],
        ),
        (
            {7: SEEN},
            range(5, 6),
            [
                "no detection is of a frame that is read: they are of the frames 7 to 7, and 5 to 5 are read "
                "(both counted from 0; a MOT file counts from 1): is the file of this video, and of its "
                "frame rate?"
            ],
        ),
        (
            {7: SEEN},
            range(8, sys.maxsize),
            [
                "no detection is of a frame that is read: they are of the frames 7 to 7, and 8 and later "
                "ones are read (both counted from 0; a MOT file counts from 1): is the file of this "
                "video, and of its frame rate?"
            ],
        ),
    ],
)
def test_each_reason_is_given(found, frames, reasons):
    assert list(explain_unused(load_graph("kalman_detections"), found, (64, 48), frames)) == reasons


@pytest.mark.parametrize(
    ("every", "frames", "first", "said"),
    [
        (3, range(9), 0, False),
        (3, range(9), 1, True),
        (2, range(9), 0, True),
        (3, range(0, 18, 2), 0, False),
        (6, range(0, 18, 2), 0, False),
    ],
)
def test_frames_that_the_graph_leaves_out_need_no_detections(every, frames, first, said):
    written = load_graph("kalman_detections").spec.model_dump(exclude_unset=True)
    written["targets"]["target"]["birth"]["every"] = every
    found = {first: SEEN, first + 3 * frames.step: SEEN}
    reasons = list(explain_unused(load_graph(written), found, (64, 48), frames))
    assert any("only one frame in" in reason for reason in reasons) == said
