"""A large target is read on a grid: no likelihood jumps where it grows through the bound."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.observation.planes import Frame, FramePair

PLACES = [(x, y) for x in (-0.3, 0.0, 0.1, 0.5) for y in (-0.2, 0.0, 0.3)]
BOXES = np.array([(*place, *size) for place in PLACES for size in ((1, 1), (0.8, 0.9), (1.3, 1.2))])
"""Hypotheses in sides of the target, from its centre."""


def zoomed(side, columns, rows):
    """(rows, columns, 3) a target of `side` px in the middle; patches and surroundings grow with it."""
    rng = np.random.default_rng(5)
    scene = rng.integers(60, 200, (72, 96, 1), np.uint8).repeat(3, axis=2)
    scene[30:42, 42:54] = rng.integers(0, 120, (12, 12, 3)) + np.array([0, 60, 130])
    unit = side / 12
    first = [columns / 2 - 47.5 * unit - 0.5, rows / 2 - 35.5 * unit - 0.5]
    matrix = np.array([[unit, 0, first[0]], [0, unit, first[1]]])
    kinds = {"flags": cv2.INTER_CUBIC, "borderMode": cv2.BORDER_REFLECT}
    return cv2.warpAffine(scene, matrix, (columns, rows), **kinds)


@pytest.mark.parametrize("bound", [96, 128, 192, 384])
@pytest.mark.parametrize("name", ["foreground_color", "texture", "correlation_filter"])
def test_likelihoods_do_not_jump_at_a_step_of_the_grid(ask, name, bound):
    asked, answers = ask(name), []
    for side in (bound - 1.0, bound + 1.0):
        frame, centre = Frame(0, 0.0, zoomed(side, 960, 720)), np.array([479.5, 359.5, 0.0, 0.0])
        reference = asked.learn(FramePair(frame, None), centre + [0, 0, side, side])
        answers.append(asked.score(FramePair(frame, None), centre + side * BOXES, reference))
    span = np.ptp(answers[0])
    assert span > 3.0, "or nothing is told"
    assert np.abs(answers[1] - answers[0]).max() < 0.1 * span


def test_a_target_that_grows_through_the_bound_is_followed_without_a_jump():
    sides = 100.0 * 1.02 ** np.arange(50)  # to 264 px: the grid changes at 128, 192 and 256
    tracker, found = Tracker("general"), []
    tracker.init(zoomed(sides[0], 640, 480), (270.0, 190.0, 100.0, 100.0))
    for side in sides[1:]:
        _, (x, y, w, h) = tracker.update(zoomed(side, 640, 480))
        found.append(((x + w / 2 - 320) / side, (y + h / 2 - 240) / side, np.log(w * h / side**2) / 2))
    assert np.abs(found).max() < 0.06
    assert np.abs(np.diff(found, axis=0)).max() < 0.04
