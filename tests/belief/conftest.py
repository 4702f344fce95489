"""Motion models and streams that the tests of beliefs share, and every belief of the language."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.graph import spec
from bayesnet_track.numerics.streams import Streams

PIXELS = {"x": 3.0, "y": 2.0, "w": 0.5, "h": 0.8}
SETTINGS = {
    "random_walk": {"sd_px": PIXELS},
    "constant_velocity": {"sd_px": PIXELS, "sd_velocity_px": 1.5, "start_velocity_sd_px": 4.0},
    "damped_velocity": {"sd_px": PIXELS, "sd_velocity_px": 1.5, "damping": 0.25},
    "constant_acceleration": {
        "sd_px": PIXELS,
        "sd_acceleration_px": 0.2,
        "start_velocity_sd_px": 3.0,
        "start_acceleration_sd_px": 0.5,
    },
}


@pytest.fixture(params=sorted(SETTINGS))
def linear(request):
    """Each of the four models with noise in pixels."""
    return make_motion(spec.Motion.model_validate({request.param: SETTINGS[request.param]}))


@pytest.fixture
def motion_of():
    """(kind, settings) -> motion model."""

    def make(kind, **settings):
        return make_motion(spec.Motion.model_validate({kind: settings or SETTINGS[kind]}))

    return make


@pytest.fixture
def stream_of():
    """(seed, frame) -> stream of one target."""

    def make(seed, frame):
        return lambda purpose: Streams(seed).of("1", "root", frame, purpose)

    return make


@pytest.fixture
def rng():
    return np.random.default_rng(12)


# ------------------------------------------------------------------------------------ conformance


@dataclass(frozen=True)
class Asked:
    """A belief of the language.

    Attributes:
        name: how the test calls it.
        says: what a graph file says.
        tolerance: error against the exact answer, in its sds; None when that is for its effective sample size
            to say, NaN when it does not aim at the exact answer.
    """

    name: str
    says: Any
    tolerance: float | None

    @property
    def is_kalman(self):
        """True when it aims at the exact answer of a linear model."""
        return self.tolerance is None or not np.isnan(self.tolerance)


def _every_belief():
    listed = yaml.safe_load((Path(__file__).parent / "beliefs.yaml").read_text())
    yield from (Asked(name, says, None) for name, says in listed["sampled"].items())
    yield from (Asked(name, each["belief"], each["to"]) for name, each in listed["exact"].items())
    yield from (Asked(name, says, float("nan")) for name, says in listed["other"].items())


BELIEFS = tuple(_every_belief())


AT_WORK = {
    "bootstrap",
    "kld_revised",
    "likelihood_sum",
    "adaptive_size_and_importance",
    "auxiliary",
    "prior_editing",
    "kalman",
    "unscented_samples",
    "grid_that_resets",
    "few_particles",
}
"""One of every way of working: what is asked of each of the others besides the contract is slow."""


def _others_slow(beliefs):
    return [pytest.param(asked, marks=() if asked.name in AT_WORK else pytest.mark.slow) for asked in beliefs]


@pytest.fixture(params=BELIEFS, ids=lambda asked: asked.name)
def asked_each(request):
    """Every belief of `beliefs.yaml`."""
    return request.param


@pytest.fixture(params=_others_slow(BELIEFS), ids=lambda asked: asked.name)
def asked(request):
    """Every belief of `beliefs.yaml`, one of every way of working in the fast suite."""
    return request.param


@pytest.fixture(params=_others_slow(b for b in BELIEFS if b.is_kalman), ids=lambda asked: asked.name)
def asked_exactly(request):
    """As `asked`, those that aim at the exact answer."""
    return request.param


@pytest.fixture
def every_belief():
    return BELIEFS
