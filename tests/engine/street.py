"""A street of people in metres and the cameras above it, shared by the tests of targets on the ground."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np

from bayesnet_track.numerics.cameras import Camera

FPS, NOISE, SPEED_SD, START_SD, SIZE_SD = 10.0, 0.03, 0.5, 1.5, 0.02
WIDTH, HEIGHT = (0.6, 0.1), (1.7, 0.1)


def camera_at(x, y, azimuth, size=(640, 480), degrees=30.0):
    """A camera 6 m above (x, y) that looks down by `degrees`: along y, turned to the left by `azimuth`."""
    down, along = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    turn, over = np.radians(azimuth), np.array([x, y, 6.0])
    ahead = np.array([-np.sin(turn) * along, np.cos(turn) * along, -down])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[800.0, 0.0, size[0] / 2], [0.0, 800.0, size[1] / 2], [0.0, 0.0, 1.0]])
    return Camera(matrix, np.zeros(0), rotation, -rotation @ over, size)


CAMERA = camera_at(0.0, 0.0, 0.0)


def write_camera(folder, camera, name="north"):
    calibration = {
        "camera_matrix": camera.matrix.tolist(),
        "rotation": camera.rotation.tolist(),
        "translation": camera.translation.tolist(),
        "size": camera.size,
    }
    (folder / f"{name}.json").write_text(json.dumps(calibration))


def boxes_of(places, camera=CAMERA):
    """(N, 4) boxes with centres, of people of the usual size."""
    places = np.atleast_2d(places)
    return camera.boxes(np.column_stack([places, np.tile([WIDTH[0], HEIGHT[0]], (len(places), 1))]))


def moved(mean, covariance, dt):
    """Mean (6,) and covariance of a walk on the ground after `dt` seconds: x, y, w, h, vx, vy in metres."""
    ahead, noise = np.eye(6), np.zeros((6, 6))
    for k in (0, 1):
        ahead[k, k + 4] = dt
        chain = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        noise[np.ix_([k, k + 4], [k, k + 4])] = SPEED_SD**2 * chain
        noise[k + 2, k + 2] = SIZE_SD**2 * dt
    return ahead @ mean, ahead @ covariance @ ahead.T + noise


def noisy(boxes, rng):
    return boxes + NOISE * boxes[:, [2, 3, 2, 3]] * rng.standard_normal(boxes.shape)


def detections_of(boxes):
    boxes = np.reshape(boxes, (-1, 4))
    low = boxes[:, :2] - boxes[:, 2:] / 2 + 0.5  # centres of pixels are whole numbers, and corners are not
    corners = np.column_stack([low, low + boxes[:, 2:]])
    return SimpleNamespace(xyxy=corners, confidence=np.full(len(boxes), 0.9), data={})
