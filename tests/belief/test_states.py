"""States as cues see them."""

import numpy as np

from bayesnet_track.belief.contract import WeightedStates, hypotheses_of
from bayesnet_track.numerics.log_weights import LogWeights


def test_further_fields_go_by_their_names():
    states = np.arange(18.0).reshape(3, 6)
    found = hypotheses_of(states, ("x", "y", "w", "h", "vx", "angle"))
    np.testing.assert_array_equal(found.boxes, states[:, :4])
    assert set(found.fields) == {"vx", "angle"}
    np.testing.assert_array_equal(found.fields["angle"], [5.0, 11.0, 17.0])
    weighted = WeightedStates(states, LogWeights.uniform(3))
    np.testing.assert_array_equal(weighted.boxes, states[:, :4])
