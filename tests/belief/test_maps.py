"""The MAP hypotheses of several targets at once are those of one at a time."""

import numpy as np

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.belief import ParticleFilter, find_map_states
from bayesnet_track.graph import spec


def steps(shift=0.0):
    """A step of three targets, the same at each call; with `shift` the parents lie that far away."""
    motion = confined(make_motion(spec.Motion(random_walk={"sd_px": {"x": 3, "y": 3}})), 300, 200)
    belief, made = ParticleFilter(spec.Particles(size=50)), []
    for seed, size in enumerate((50, 50, 40)):
        rng = np.random.default_rng(seed)
        prior = ParticleFilter(spec.Particles(size=size)).start(
            np.array([90.0, 60, 20, 20]), motion, lambda purpose, rng=rng: rng
        )
        step = belief.step(
            prior,
            motion,
            1.0,
            lambda hypotheses, prior_log, rng=rng: Evidence(-rng.exponential(size=len(hypotheses))),
            lambda purpose, rng=rng: rng,
        )
        prior.states[:, 0] += shift
        made.append(step)
    return made


def test_together_and_alone_find_the_same_hypothesis():
    together = steps()
    find_map_states(together)
    assert ["map_state" in one.__dict__ for one in together] == [True, True, True]
    for one, alone in zip(together, steps(), strict=True):
        assert one.map_state.tolist() == alone.map_state.tolist()


def test_a_step_of_which_no_density_is_above_zero_looks_further_by_itself():
    together = steps(1e4)
    find_map_states(together)
    for one, alone in zip(together, steps(1e4), strict=True):
        assert "map_state" not in one.__dict__
        assert one.map_state.tolist() == alone.map_state.tolist()
