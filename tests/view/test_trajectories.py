"""Trajectories are drawn where they run, and the frame that was given stays as it is."""

import numpy as np

from bayesnet_track.view.overlay import FIRST, LAST, draw_trajectories


def test_first_box_last_box_and_path_are_drawn():
    image = np.zeros((60, 100, 3), np.uint8)
    boxes = np.array([[[20.0, 30.0, 11.0, 11.0]], [[80.0, 30.0, 11.0, 11.0]]])
    drawn = draw_trajectories(image, boxes)
    assert tuple(drawn[25, 20]) == FIRST and tuple(drawn[25, 80]) == LAST
    assert drawn[30, 50].any() and not drawn[40, 50].any()
    assert not image.any()


def test_paths_out_of_sight_do_not_matter():
    boxes = np.array([[[1e9, -1e9, 11.0, 11.0]], [[1e12, 0.0, 11.0, 11.0]]])
    assert not draw_trajectories(np.zeros((60, 100, 3), np.uint8), boxes).any()
