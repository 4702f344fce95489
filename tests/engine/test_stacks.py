"""Tables of short arrays and tuples."""

import numpy as np

from bayesnet_track.engine.rows.stacks import stack


def test_arrays_are_stacked_also_when_there_are_none():
    assert stack([np.ones((2, 2)), np.zeros((2, 2))], 2, 2)[:, 0, 0].tolist() == [1.0, 0.0]
    assert stack([], 2, 2).shape == (0, 2, 2)
