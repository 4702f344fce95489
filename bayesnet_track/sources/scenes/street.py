"""A street seen by one calibrated camera: cars on the ground in metres, their boxes, and noisy detections."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.numerics.cameras import Camera
from bayesnet_track.sources.scenes.scene import GroundTruth, Movie, Scene, Sprite, shaded_cells, visible_share

WIDTH, HEIGHT, FPS = 640, 360, 25.0
CAMERA_HEIGHT_M = 6.0
SMALLEST_PX = 12.0
"""Height of the smallest box that the detector finds: cars within 60 m."""
ROAD = (7.0, 16.0)
"""Nearer and farther kerb, m from the camera's foot point."""
COLOURS = (
    (40.0, 60.0, 200.0),
    (200.0, 120.0, 40.0),
    (60.0, 170.0, 90.0),
    (40.0, 180.0, 220.0),
    (180.0, 70.0, 160.0),
)


def street_camera() -> Camera:
    """The camera: 6 m above the pavement, looking along the street, 35 degrees towards it and 14 down."""
    turn, tilt = np.deg2rad(35.0), np.deg2rad(14.0)
    ahead = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), -np.sin(tilt)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    rotation = np.array([right, np.cross(ahead, right), ahead])
    matrix = np.array([[480.0, 0, 320.0], [0, 480.0, 180.0], [0, 0, 1]])
    centre = np.array([0.0, 0.0, CAMERA_HEIGHT_M])
    return Camera(matrix, np.zeros(0), rotation, -rotation @ centre, (WIDTH, HEIGHT))


def street(seed: int = 0, frames: int = 300) -> Scene:
    """Five cars in two directions, one of which brakes; the first is the target."""
    rng = np.random.default_rng(seed)
    camera = street_camera()
    t = np.arange(frames) / FPS
    lanes = np.array([9.3, 9.3, 13.7, 13.7, 9.3])
    speeds = np.array([13.9, 9.0, -11.1, -8.0, 11.0]) * rng.uniform(0.95, 1.05, 5)
    starts = np.array([9.0, -20.0, 70.0, 100.0, -60.0]) + rng.uniform(-1.0, 1.0, 5)
    along = starts[:, None] + speeds[:, None] * t
    braking = np.maximum(t - 5.0, 0.0)
    along[1] -= 0.5 * 1.5 * np.minimum(braking, 4.0) ** 2 + 6.0 * np.maximum(braking - 4.0, 0.0)
    across = lanes[:, None] + 0.15 * np.sin(0.7 * t + rng.uniform(0, 6, 5)[:, None])
    sizes = np.column_stack([rng.uniform(2.2, 2.8, 5), rng.uniform(1.4, 1.6, 5)])
    paths = np.concatenate(
        [along[..., None], across[..., None], np.broadcast_to(sizes[:, None], (5, frames, 2))], axis=-1
    )
    boxes = camera.boxes(paths.reshape(-1, 4)).reshape(5, frames, 4)
    order = np.array([3, 2, 0, 1, 4])  # the farther lane first, and in it the farther car
    sprites = tuple(
        Sprite(shaded_cells(3, 6, COLOURS[car], 0.6, rng), boxes[car], is_round=True) for car in order
    )
    apart = np.where(np.isnan(boxes), [-1e4, -1e4, 1.0, 1.0], boxes)  # behind the camera: hides nothing
    shares = np.array(
        [
            visible_share(apart[car], tuple(apart[other] for other in order[place + 1 :]), WIDTH, HEIGHT)
            for place, car in enumerate(order)
        ]
    )[np.argsort(order, kind="stable")]
    seen = (shares > 0.5) & (np.nan_to_num(boxes[..., 3]) > SMALLEST_PX)
    ground = GroundTruth(camera, paths, seen, _detections(boxes, seen, rng), 1 / FPS)
    corners = corner_from_centre(apart)
    movie = Movie(_background(camera, rng), sprites, 2.0, seed)
    return Scene("street", WIDTH, HEIGHT, movie, corners[0], tuple(corners[1:]), shares[0], ground=ground)


def _detections(boxes: Floats, seen: Bools, rng: np.random.Generator) -> Floats:
    """Rows of a detector: 1.5 px of noise on each edge, 1 in 15 missed, a false one in five frames."""
    rows = []
    for frame in range(boxes.shape[1]):
        for car in range(len(boxes)):
            noise, chance, score = rng.normal(0.0, 1.5, 4), rng.random(), rng.uniform(0.6, 0.95)
            if not seen[car, frame] or chance < 1 / 15:
                continue
            x, y, w, h = boxes[car, frame]
            edges = np.array([x - w / 2, y - h / 2, x + w / 2, y + h / 2]) + noise
            edges = np.clip(edges, -0.5, [WIDTH - 0.5, HEIGHT - 0.5] * 2)
            rows.append([frame, edges[0] + 0.5, edges[1] + 0.5, *(edges[2:] - edges[:2]), score])
        if rng.random() < 0.2:
            left, top = rng.uniform(0, [WIDTH - 60, HEIGHT - 60])
            rows.append([frame, left, top, *rng.uniform(20, 60, 2), rng.uniform(0.3, 0.7)])
    return np.array(rows)


def _background(camera: Camera, rng: np.random.Generator) -> Floats:
    """(H, W, 3) sky, pavements of tiles, a road with dashes in its middle, each where the camera sees it."""
    columns, rows = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))
    ground = camera.ground_points(np.column_stack([columns.ravel(), rows.ravel()]))
    x, y = np.nan_to_num(ground, nan=1e6).T.reshape(2, HEIGHT, WIDTH)
    tiles = 150.0 + 14.0 * ((np.floor(x) + np.floor(y)) % 2)
    road = 85.0 + 5.0 * rng.standard_normal((64, 64))[np.int64(x * 4) % 64, np.int64(y * 4) % 64]
    dashes = (np.abs(y - np.mean(ROAD)) < 0.1) & (x % 6 < 3)
    gray = np.where((y > ROAD[0]) & (y < ROAD[1]), np.where(dashes, 220.0, road), tiles)
    gray = np.where(np.hypot(x, y) > 150, 190.0, gray)
    return np.repeat(gray[:, :, None], 3, axis=2)
