"""A motion around another one does what that does, in every respect that it does not change."""

import numpy as np

from bayesnet_track.belief.motion.borders import Wrapped
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.graph.spec import Motion

MOTION = make_motion(Motion.model_validate({"constant_velocity": {"sd_px": {"x": 3, "y": 2}}}))
BOX = np.array([50.0, 40.0, 20.0, 10.0])


def test_it_is_the_motion_inside():
    wrapped, states = Wrapped(MOTION), MOTION.start(BOX, 5, np.random.default_rng(1))
    assert wrapped.fields == MOTION.fields
    np.testing.assert_array_equal(wrapped.start(BOX, 5, np.random.default_rng(1)), states)
    new = wrapped.propagate(states, 2.0, np.random.default_rng(2), np.array([1, 0, 3, 3, 2]))
    same = MOTION.propagate(states, 2.0, np.random.default_rng(2), np.array([1, 0, 3, 3, 2]))
    np.testing.assert_array_equal(new, same)
    for asked in (
        lambda motion: motion.start_moments(BOX),
        lambda motion: motion.linearise(states[0], 2.0),
        lambda motion: motion.drift(states, 2.0),
        lambda motion: motion.log_density(new, states, 2.0),
        lambda motion: motion.transition(states, 2.0).log_density(new),
    ):
        for one, other in zip(asked(wrapped), asked(MOTION), strict=True):
            np.testing.assert_array_equal(one, other)
