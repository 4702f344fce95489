"""The flying ball: a parabola, hidden for as long as stated, the one thing of its colour."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.shapes import GRAVITY, flying_ball


@pytest.mark.parametrize("hidden", [1, 8, 20])
def test_it_is_hidden_for_exactly_so_long(hidden):
    scene = flying_ball(3, hidden)
    gone = np.flatnonzero(scene.visible < 1e-9)
    assert len(gone) == hidden and np.ptp(gone) == hidden - 1
    assert (scene.visible[[0, -1]] > 0.99).all()
    with pytest.raises(ValueError, match="hidden must be 1 to 20 frames, not 21"):
        flying_ball(0, 21)


def test_it_falls_as_things_do():
    path = centre_from_corner(make_scene("flying_ball", 4).truth)
    np.testing.assert_allclose(np.diff(path[:, 1], 2), GRAVITY, atol=1e-9)
    np.testing.assert_allclose(np.diff(path[:, 0], 2), 0.0, atol=1e-9)


def test_the_truth_is_where_the_orange_is():
    for seed in range(3):
        scene = make_scene("flying_ball", seed)
        for index in (0, 45):
            image = scene.frames[index].astype(int)
            orange = (image[..., 2] - image[..., 0] > 90) & (image[..., 2] > 140)
            rows, columns = np.nonzero(orange)
            x, y, w, _ = centre_from_corner(scene.truth[index])
            np.testing.assert_allclose([columns.mean(), rows.mean()], [x, y], atol=0.5)
            assert abs(len(rows) - np.pi / 4 * w**2) < 0.1 * w**2
        middle = np.flatnonzero(scene.visible < 1e-9)[3]
        image = scene.frames[middle].astype(int)
        assert ((image[..., 2] - image[..., 0] > 90) & (image[..., 2] > 140)).sum() < 5
