"""Motion models and streams that the tests of beliefs share."""

import numpy as np
import pytest

from bayesnet_track.belief.motion import make_motion
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
