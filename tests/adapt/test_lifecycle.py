"""When a net ends by what is counted of its target."""

import numpy as np
import pytest

from bayesnet_track.adapt.lifecycle import TrackRecord, find_end_cause
from bayesnet_track.graph.spec import Death


@pytest.mark.parametrize(
    ("lost", "unseen", "cause"),
    [
        (0, 0, None),
        (29, 4, None),
        (30, 0, ("lost", 30, 30)),
        (0, 5, ("unseen", 5, 5)),
        (31, 6, ("lost", 31, 30)),
    ],
)
def test_it_ends_at_the_first_count_that_is_reached(lost, unseen, cause):
    record = TrackRecord(0, np.zeros(4), np.eye(4), 0.0, lost, unseen)
    assert find_end_cause(record, Death(unseen_frames=5)) == cause
    assert (find_end_cause(record, Death()) is None) == (lost < 30), "it need not be detected"
