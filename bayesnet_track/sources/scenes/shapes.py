"""Scenes of squares and discs: bouncing, hidden, thrown, many alike (thesis Examples 1 to 3, Figure 5.9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.scenes.scene import (
    ORANGE,
    Scene,
    Sprite,
    assemble,
    flat,
    gray_cells,
    paint,
    shaded_cells,
    smooth_background,
)

Point = tuple[float, float]

WIDTH, HEIGHT, SIDE, NOISE_SD = 320, 240, 40.0, 4.0


@dataclass(frozen=True)
class TwoSquares:
    """Starts (centres, px) and steps (px per frame) of two squares."""

    target: Point
    target_step: Point
    other: Point
    other_step: Point


STATED = TwoSquares((270.0, 190.0), (-4.0, -2.74), (50.0, 60.0), (3.5, 1.74))
"""The squares cross near frame 29 and meet again in frames 174 to 183."""


def bouncing(start: Point, step: Point, size: float, frames: int, width: int, height: int) -> Floats:
    """(frames, 4) centre boxes of a square that stays wholly inside the picture, reflected at its borders."""
    travelled = np.array(start) + np.arange(frames)[:, None] * np.array(step)
    low = size / 2 - 0.5
    room = np.array([width, height]) - size
    folded = np.abs((travelled - low + room) % (2 * room) - room)
    return np.column_stack([low + folded, np.full((frames, 2), size)])


def random_geometry(rng: np.random.Generator, frames: int = 200) -> TwoSquares:
    """Two squares that start apart and cross.

    Starts are uniform inside the picture, headings uniform, speeds uniform in 2 .. 5 px per frame. Drawn
    again until (a) the squares do not touch in the first 10 frames, (b) in some frame they overlap by at
    least half of a square's area, and (c) they do not touch in the last frame, so that it can be told which
    of them is held.
    """
    while True:
        starts = rng.uniform([SIDE / 2 - 0.5] * 2, [WIDTH - SIDE / 2 - 0.5, HEIGHT - SIDE / 2 - 0.5], (2, 2))
        heading, speed = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(2.0, 5.0, 2)
        steps = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        geometry = TwoSquares(_point(starts[0]), _point(steps[0]), _point(starts[1]), _point(steps[1]))
        target, distractor = _paths(geometry, frames)
        shared = np.prod(np.clip(SIDE - np.abs(target - distractor)[:, :2], 0.0, None), axis=1) / SIDE**2
        if shared[:10].max() == 0 and shared.max() >= 0.5 and shared[-1] == 0:
            return geometry


def two_squares(seed: int = 0, geometry: TwoSquares = STATED, frames: int = 200) -> Scene:
    """Two identical orange squares, one of them the target (thesis Example 1).

    320x240 px, squares of 40 px, noise of sd 4; `seed` governs background and noise only.
    """
    target, distractor = _paths(geometry, frames)
    background = smooth_background(WIDTH, HEIGHT, 100.0, 12.0, _rng(seed))
    sprites = (Sprite(flat(ORANGE), distractor), Sprite(flat(ORANGE), target))
    return assemble("two_squares", background, sprites, target=1, noise_sd=NOISE_SD, seed=seed)


def orange_and_gray(seed: int = 0, frames: int = 100) -> Scene:
    """An orange square, the target, that a gray patterned one hides in frame 23 (thesis Example 2)."""
    rng = _rng(seed)
    orange = bouncing((270.0, 190.0), (-4.0, -2.74), SIDE, frames, WIDTH, HEIGHT)
    meeting = orange[23, :2]
    step = (meeting - np.array([50.0, 60.0])) / 23
    gray = bouncing((50.0, 60.0), _point(step), SIDE + 4, frames, WIDTH, HEIGHT)
    background = smooth_background(WIDTH, HEIGHT, 100.0, 12.0, rng)
    sprites = (Sprite(flat(ORANGE), orange), Sprite(gray_cells(9, 9, 20, 235, rng), gray))
    return assemble(
        "orange_and_gray",
        background,
        sprites,
        target=0,
        noise_sd=NOISE_SD,
        seed=seed,
        plates=("orange", "gray"),
    )


def gray_square(seed: int = 0, frames: int = 120) -> Scene:
    """A gray patterned square on a gray hilly background: colour says nothing of it (thesis Figure 2.19)."""
    rng = _rng(seed)
    background = smooth_background(WIDTH, HEIGHT, 128.0, 70.0, rng, cell=8)
    path = bouncing((60.0, 70.0), (3.1, 2.2), SIDE, frames, WIDTH, HEIGHT)
    sprites = (Sprite(gray_cells(8, 8, 30, 225, rng), path),)
    return assemble("gray_square", background, sprites, target=0, noise_sd=NOISE_SD, seed=seed)


def _paths(geometry: TwoSquares, frames: int) -> tuple[Floats, Floats]:
    target = bouncing(geometry.target, geometry.target_step, SIDE, frames, WIDTH, HEIGHT)
    return target, bouncing(geometry.other, geometry.other_step, SIDE, frames, WIDTH, HEIGHT)


def _point(pair: Floats) -> Point:
    return float(pair[0]), float(pair[1])


def _rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


CROWD_WIDTH, CROWD_HEIGHT, DISC, CROWD_NOISE_SD = 640, 480, 28.0, 4.0
SPEEDS = (1.5, 4.0)
TURN_SD = 0.06
"""Change of heading per frame, radians."""
BORDER, TURN_BACK = 60.0, 0.25
"""Distance from a border, px, from which on it turns away, and how strongly at the border itself."""

REFUSED = 400
"""Places in a row that are not free, after which there is no room."""


def crowd(seed: int = 0, count: int = 10, frames: int = 200) -> Scene:
    """`count` orange discs, all alike, on winding ways from border to border; the first is the target.

    640x480 px, discs of 28 px, speeds uniform in 1.5 .. 4 px per frame, headings a random walk. None touches
    another in the first 5 frames; a later one hides an earlier one.

    Raises:
        ValueError: so many find no place apart from each other.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    paths: list[Floats] = []
    refused = 0
    while len(paths) < count:
        inset = np.full(2, (DISC - 1) / 2)
        places = winding(rng, frames, inset, np.array([CROWD_WIDTH, CROWD_HEIGHT]) - 1 - inset, SPEEDS)
        begins = places[:5]
        if all(np.abs(begins - earlier[:5, :2]).max(axis=1).min() > DISC + 2 for earlier in paths):
            paths.append(np.column_stack([places, np.full((frames, 2), DISC)]))
            refused = 0
        elif (refused := refused + 1) == REFUSED:
            raise ValueError(f"no room for {count} discs")
    background = smooth_background(CROWD_WIDTH, CROWD_HEIGHT, 100.0, 12.0, rng)
    sprites = tuple(Sprite(flat(ORANGE), path, is_round=True) for path in paths)
    return assemble("crowd", background, sprites, 0, CROWD_NOISE_SD, seed, plates=("disc",) * count)


def winding(
    rng: np.random.Generator, frames: int, low: Floats, high: Floats, speeds: tuple[float, float]
) -> Floats:
    """(frames, 2) places that turn a little in each frame, and away from the borders `low` and `high` (2,).

    Place, heading and speed, in px per frame, are drawn once; they never leave the borders.
    """
    place, speed, heading = rng.uniform(low, high), rng.uniform(*speeds), rng.uniform(0.0, 2 * np.pi)
    turns = rng.normal(0.0, TURN_SD, frames)
    path = np.empty((frames, 2))
    for frame in range(frames):
        path[frame] = place
        direction = speed * np.array([np.cos(heading + turns[frame]), np.sin(heading + turns[frame])])
        inward = np.clip(low + BORDER - place, 0.0, None) - np.clip(place - high + BORDER, 0.0, None)
        direction += inward * (speed / BORDER) * TURN_BACK
        heading = float(np.arctan2(direction[1], direction[0]))
        place = np.clip(place + speed * direction / np.linalg.norm(direction), low, high)
    return path


OCCLUDER_WIDTH, OCCLUDER_HEIGHT, HIDDEN_SIDE, HIDDEN_SPEED, HIDDEN_FRAMES = 320, 240, 40.0, 4.0, 60
COLUMN = (150.0, 125.0, 100.0)
"""BGR of the column: a dull blue."""


def occluder(seed: int = 0, hidden: int = 11) -> Scene:
    """An orange patterned square crosses from left to right at 4 px per frame, behind a column.

    It is hidden entirely in exactly `hidden` consecutive frames (1 .. 38), in the middle of the 60 frames;
    `seed` governs its height, its vertical drift (up to 1 px per frame), patterns and noise.

    Raises:
        ValueError: `hidden` outside 1 .. 38.
    """
    if not 1 <= hidden <= 38:
        raise ValueError(f"hidden must be 1 to 38 frames, not {hidden}")
    rng = np.random.Generator(np.random.Philox(seed))
    frame = np.arange(HIDDEN_FRAMES)
    y = rng.uniform(90.0, 150.0) + (frame - HIDDEN_FRAMES / 2) * rng.uniform(-1.0, 1.0)
    path = np.column_stack([40.0 + HIDDEN_SPEED * frame, y, np.full((HIDDEN_FRAMES, 2), HIDDEN_SIDE)])
    # A quarter step of slack on either side: hidden at the first and the last of these frames, not beyond.
    first = (HIDDEN_FRAMES - hidden) // 2
    middle = (path[first, 0] + path[first + hidden - 1, 0]) / 2
    width = HIDDEN_SIDE + (hidden - 1) * HIDDEN_SPEED + HIDDEN_SPEED / 2
    column = np.tile([middle, (OCCLUDER_HEIGHT - 1) / 2, width, float(OCCLUDER_HEIGHT)], (HIDDEN_FRAMES, 1))
    background = smooth_background(OCCLUDER_WIDTH, OCCLUDER_HEIGHT, 100.0, 12.0, rng)
    sprites = (
        Sprite(shaded_cells(8, 8, ORANGE, 0.45, rng), path),
        Sprite(shaded_cells(48, max(int(width / 5), 1), COLUMN, 0.4, rng), column),
    )
    return assemble("occluder", background, sprites, target=0, noise_sd=4.0, seed=seed)


FLIGHT_WIDTH, FLIGHT_HEIGHT, FLYING_BALL, FLIGHT_FRAMES = 320, 240, 26.0, 50
SPEED, GRAVITY = 5.2, 0.16
"""px per frame across, px per frame^2 down."""
WALL, FLOOR, STEEL, WINDOW = (150, 165, 170), (85, 100, 105), (140, 118, 95), (190, 150, 90)
"""BGR of the papered wall, the floor, the pillar, and a window: not one of the ball's hue."""


def flying_ball(seed: int = 0, hidden: int = 8) -> Scene:
    """An orange ball of 26 px, the target, on a parabola from left to right; a pillar hides it on its way.

    320x240 px, 50 frames. The ball is hidden entirely in exactly `hidden` consecutive frames (1 .. 20) in the
    middle of its flight. `seed` governs where it starts, how steeply, patterns and noise.

    Raises:
        ValueError: `hidden` outside 1 .. 20.
    """
    if not 1 <= hidden <= 20:
        raise ValueError(f"hidden must be 1 to 20 frames, not {hidden}")
    rng = np.random.Generator(np.random.Philox(seed))
    frame = np.arange(FLIGHT_FRAMES)
    top, turn = rng.uniform(50.0, 90.0), rng.uniform(0.3, 0.6) * FLIGHT_FRAMES
    x = rng.uniform(24.0, 32.0) + SPEED * frame
    y = top + GRAVITY / 2 * (frame - turn) ** 2
    path = np.column_stack([x, y, np.full((FLIGHT_FRAMES, 2), FLYING_BALL)])
    first = (FLIGHT_FRAMES - hidden) // 2
    # A quarter step of slack on either side: hidden at the first and the last of these frames, not beyond.
    middle = (x[first] + x[first + hidden - 1]) / 2
    width = FLYING_BALL + (hidden - 1) * SPEED + SPEED / 2
    room = smooth_background(FLIGHT_WIDTH, FLIGHT_HEIGHT, 120.0, 10.0, rng)
    for cells, box in (
        (shaded_cells(24, 40, WALL, 0.8, rng), (159.5, 95.5, 320.0, 192.0)),
        (shaded_cells(6, 10, FLOOR, 0.6, rng), (159.5, 215.5, 320.0, 48.0)),
        (shaded_cells(4, 4, WINDOW, 0.8, rng), (262.0, 70.0, 60.0, 70.0)),
    ):
        paint(room, Sprite(cells, np.array([box])), 0)
    column = np.tile([middle, (FLIGHT_HEIGHT - 1) / 2, width, float(FLIGHT_HEIGHT)], (FLIGHT_FRAMES, 1))
    sprites = (
        Sprite(shaded_cells(7, 7, ORANGE, 0.7, rng), path, is_round=True),
        Sprite(shaded_cells(40, max(int(width / 6), 1), STEEL, 0.6, rng), column),
    )
    return assemble("flying_ball", room, sprites, target=0, noise_sd=4.0, seed=seed)


GARDEN_WIDTH, GARDEN_HEIGHT, GARDEN_FRAMES, THROWN_BALL = 320, 240, 45, 22.0
LEFT, RIGHT = (64.0, 132.0), (252.0, 136.0)
CHILD = (46.0, 130.0)
FLIGHTS = ((3, 7), (23, 27))
"""First and last frame of the ball in the air: from the left child to the right one, and back."""

HAIR, SKIN, TROUSERS = (45.0, 42.0, 45.0), (172.0, 180.0, 198.0), (110.0, 75.0, 60.0)
GREEN, BLUE = (90.0, 150.0, 70.0), (190.0, 110.0, 60.0)


def ball_between_children(seed: int = 0) -> Scene:
    """An orange ball, the target, flies between two children; the first of `others` is the left child.

    320x240 px. The children sway by a few px. The ball of 22 px rests in the left child's hands, moves by
    some 32 px per frame in frames 3 to 7, rests with the right child, and comes back in frames 23 to 27, so
    that a random walk fits it while it is held and fails while it flies. `seed` governs sway, patterns and
    noise.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    left, right = _sway(LEFT, rng), _sway(RIGHT, rng)
    background = smooth_background(GARDEN_WIDTH, GARDEN_HEIGHT, 110.0, 18.0, rng)
    thrown = _boxes(_throw(left, right), THROWN_BALL, THROWN_BALL)
    sprites = (
        Sprite(_clothes(GREEN, rng), _boxes(left, *CHILD)),
        Sprite(_clothes(BLUE, rng), _boxes(right, *CHILD)),
        Sprite(shaded_cells(6, 6, ORANGE, 0.75, rng), thrown, is_round=True),
    )
    return assemble(
        "ball_between_children", background, sprites, 2, noise_sd=4.0, seed=seed, plates=("ball", "child")
    )


def _sway(centre: tuple[float, float], rng: np.random.Generator) -> Floats:
    """(FRAMES, 2) a slow swing about a place, up to 4 px wide."""
    phase, period = rng.uniform(0, 2 * np.pi, 2), rng.uniform(18.0, 30.0, 2)
    turn = 2 * np.pi * np.arange(GARDEN_FRAMES)[:, None] / period + phase
    return np.asarray(np.array(centre) + np.array([4.0, 1.5]) * np.sin(turn))


def _throw(left: Floats, right: Floats) -> Floats:
    """(FRAMES, 2) the ball's path: in a child's hands, or on an arc between them."""
    hands = np.array([24.0, -8.0])
    hand_paths = {True: left + hands, False: right + hands * [-1, 1]}
    path, is_left = np.empty((GARDEN_FRAMES, 2)), True
    starts = dict(FLIGHTS)
    frame = 0
    while frame < GARDEN_FRAMES:
        if frame not in starts:
            path[frame] = hand_paths[is_left][frame]
            frame += 1
            continue
        landing = starts[frame]
        begin, end = hand_paths[is_left][frame - 1], hand_paths[not is_left][landing + 1]
        share = np.arange(1, landing - frame + 2) / (landing - frame + 2)
        arc = begin + share[:, None] * (end - begin)
        arc[:, 1] -= 4 * 45.0 * share * (1 - share)
        path[frame : landing + 1] = arc
        is_left, frame = not is_left, landing + 1
    return path


def _clothes(shirt: tuple[float, float, float], rng: np.random.Generator) -> Floats:
    """(13, 5, 3): hair, face, a shirt and trousers, each in shades."""
    parts = ((1, HAIR), (2, SKIN), (5, shirt), (5, TROUSERS))
    return np.concatenate([shaded_cells(rows, 5, colour, 0.7, rng) for rows, colour in parts])


def _boxes(centres: Floats, w: float, h: float) -> Floats:
    return np.column_stack([centres, np.full((len(centres), 2), [w, h])])
