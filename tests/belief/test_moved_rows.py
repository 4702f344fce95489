"""Hypotheses of several targets moved in one call: the bits of one call for each."""

import numpy as np
import pytest

from bayesnet_track.belief.motion.models import make_motion, propagate_rows
from bayesnet_track.graph import spec

MOTIONS = {
    "walk": {"random_walk": {"sd_box": {"x": 0.1, "y": 0.1}, "sd_log": {"scale": 0.05}}},
    "velocity": {"constant_velocity": {"sd_velocity_px": 1.0, "sd_px": {"w": 1.0, "h": 1.0}}},
    "acceleration": {"constant_acceleration": {"sd_acceleration_px": 1.0}},
}


@pytest.mark.parametrize("name", MOTIONS)
def test_each_target_moves_by_its_own_stream(name):
    motion = make_motion(spec.Motion(**MOTIONS[name]))
    rng = np.random.default_rng(0)
    states = rng.uniform(20, 40, (3, 30, len(motion.fields)))
    parents = np.sort(rng.integers(0, 30, (3, 40)), axis=1)
    moved = propagate_rows(motion, states, 0.5, [np.random.default_rng(k) for k in range(3)], parents)
    for k in range(3):
        alone = motion.propagate(states[k], 0.5, np.random.default_rng(k), parents[k])
        assert moved[k].tobytes() == alone.tobytes()
