"""The errors of detections, in pixels, of the rule by which they are given to targets."""

import numpy as np
import pytest

from bayesnet_track.observation.protocols import AssociationRule

BOXES = np.array([[100.0, 50.0, 20.0, 40.0], [10.0, 10.0, 2.0, 4.0]])


def test_errors_grow_with_the_sides_and_have_a_part_in_pixels():
    shares = AssociationRule(0.1, 0.2, 0.99, 0.0, 0.0)
    assert shares.variances(BOXES[0]) == pytest.approx([4.0, 16.0, 16.0, 64.0])
    both = AssociationRule(0.1, 0.2, 0.99, 0.0, 0.0, sd_place_px=3.0, sd_size_px=1.0)
    assert both.variances(BOXES) - shares.variances(BOXES) == pytest.approx(
        np.tile([9.0, 9.0, 1.0, 1.0], (2, 1))
    )


@pytest.mark.parametrize("key", [{"direction": 0.2}, {"recover": True}, {"re_update": True}])
def test_only_what_looks_back_remembers(key):
    assert AssociationRule(0.1, 0.2, 0.99, 0.0, 0.0, **key).remembers
    assert not AssociationRule(0.1, 0.2, 0.99, 0.0, 0.0).remembers
