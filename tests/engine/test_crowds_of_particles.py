"""Particles of many targets in one frame: each target's track is the same bytes alone or among others."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track import load_graph
from bayesnet_track.engine.step import State, make_engine, start_target, step
from bayesnet_track.observation.planes import Frame

SIDE, FRAMES = 16, 4
GRAPH = load_graph(
    {
        "name": "crowd",
        "targets": {
            "square": {
                "nodes": {
                    "square": {
                        "belief": {"particles": {"size": 60}},
                        "motion": {"constant_velocity": {"sd_velocity_px": 1.0}},
                        "fuse": "product",
                        "ud_fields": ["x", "y"],
                        "learn": {"below": {"ud_px2": 100}, "rate_max": 0.05},
                    },
                    "color": {"parent": "square", "agent": {"color_histogram": {"floor": 0.003}}},
                    "gray": {"parent": "square", "agent": "intensity"},
                }
            }
        },
    }
)


def frames(seed: int) -> list[Frame]:
    """Coloured noise that moves to the right by 2 px a frame."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 255, (6, 8, 3), dtype=np.uint8)
    image = np.kron(cells, np.ones((16, 16, 1), np.uint8))
    return [Frame(n, float(n), np.roll(image, 2 * n, axis=1)) for n in range(FRAMES)]


def tracks(seed: int, starts: dict[str, tuple[float, float]]) -> dict[str, list[str]]:
    """Target -> what is written down of it, frame by frame."""
    engine, state = make_engine(GRAPH, seed), State()
    first, *others = frames(seed)
    for target, at in starts.items():
        box = np.array([*at, SIDE, SIDE], dtype=np.float64)
        state = start_target(engine, state, first, target, "square", box).state
    found: dict[str, list[str]] = {target: [] for target in starts}
    for frame in others:
        outcome = step(engine, state, frame)
        state = outcome.state
        for one in outcome.metrics:
            found[one.target].append(repr(one))
    return found


@given(
    seed=st.integers(0, 2**32),
    places=st.lists(st.tuples(st.floats(-5, 130), st.floats(-5, 100)), min_size=2, max_size=4),
)
@settings(max_examples=3, deadline=None)
def test_a_track_is_the_same_bytes_alone_or_in_a_crowd(seed, places):
    starts = {str(n + 1): at for n, at in enumerate(places)}
    together = tracks(seed, starts)
    backwards = tracks(seed, dict(reversed(starts.items())))
    assert backwards == together
    for target, at in starts.items():
        assert tracks(seed, {target: at})[target] == together[target]
