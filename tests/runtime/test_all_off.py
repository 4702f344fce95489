"""With every agent switched off nothing but prediction is left, and no box is a confident one."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import Start, load_graph, track
from bayesnet_track.journal.events.load import Toggled
from bayesnet_track.sources.scenes.library import SceneSource

OFF, FRAMES = 12, 33
WITHIN = 6
"""Frames after which the graphs below call a target lost that is not seen."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "name"),
    [
        ("two_squares", "general"),
        ("two_squares", "two_squares"),
        ("flying_ball", "kalman_ball"),
        ("person_parts", "person_parts"),
        ("gray_square", "gray_square"),
    ],
)
def test_prediction_only(scene, name):
    graph, source = load_graph(name), SceneSource.named(scene, 1, FRAMES)
    plate, target = next(iter(graph.targets.items()))
    off = [Toggled(OFF, "1", agent, False) for agent in target.agents]
    results = list(
        track(graph, source, [Start(source.scene.start_box, plate)], inputs=lambda n: off if n == OFF else ())
    )
    lines = [result.targets[0] for result in results]
    assert lines[OFF].active and lines[OFF].score > 0.3
    after = lines[OFF + 1 :]
    assert all(line.active == () for line in after)
    assert max(line.score for line in after) < 0.01, "never a confident box"
    assert all(line.status == "lost" for line in after[WITHIN:])
    # Hypotheses are drawn anew in every frame: means of five frames rise.
    ud = np.array([line.ud_px2 for line in after])
    assert ud[0] > lines[OFF].ud_px2 and (np.diff(ud.reshape(4, 5).mean(axis=1)) > 0).all()
