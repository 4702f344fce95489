"""Boxes are judged before tracking exactly as the tracker judges them."""

import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.engine.starts import StartError
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.session import describe_untrackable

VIDEO = Video("made_up.mp4", 2, 64, 48, 0.04)
FRAME = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)


@pytest.mark.parametrize("max_side", [None, 32])
@pytest.mark.parametrize(
    "box",
    [
        (10, 10, 8, 8),
        (10, 10, 1, 1),
        (10, 10, 0.999, 8),
        (10, 10, 8, 1.5),
        (-5, -5, 640, 480),
        (-5, -5, 641, 480),
        (-8, 0, 8, 8),
        (64, 0, 8, 8),
        (63.5, 47.5, 3, 3),
        (0, 0, float("nan"), 8),
        (1e308, 0, 1e308, 8),
    ],
)
def test_a_box_is_refused_if_and_only_if_the_tracker_refuses_it(box, max_side):
    tracker, said = Tracker("gray_square", max_side=max_side), None
    try:
        tracker.init(FRAME, box)
    except StartError as error:
        said = str(error)
    assert describe_untrackable(box, VIDEO, max_side) == said
