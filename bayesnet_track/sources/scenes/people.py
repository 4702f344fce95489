"""Scenes of people and cars: a box carried, parts seen, a board, a street, a room with several cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.numerics.cameras import Camera
from bayesnet_track.sources.scenes.scene import (
    ORANGE,
    GroundTruth,
    Movie,
    Scene,
    ScenePart,
    Sprite,
    assemble,
    flat,
    gray_cells,
    shaded_cells,
    smooth_background,
    visible_share,
)

CARRYING_WIDTH, CARRYING_HEIGHT, FRAMES, NOISE_SD = 320, 240, 180, 4.0
GREEN = (70.0, 190.0, 60.0)
"""BGR of the person's clothes."""
PERSON, BOX = (44.0, 110.0), (28.0, 28.0)

PICKED, BEHIND, SHOWN, PUT = 30, 60, 100, 130
"""Frames: the box leaves the floor; is wholly behind the person from here; until here; is on the floor."""


def carried_box(seed: int = 0) -> Scene:
    """An orange box, the target, stands on the floor; a person in green carries it to another place.

    320x240 px, 180 frames. The person reaches it at frame 30, carries it at the side, and behind the body,
    wholly hidden, in frames 60 to 99, in which the person walks on and turns back. The box stands on
    the floor again from frame 130 on, and the person leaves it. Speeds, turns and places depend on the seed.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    stands, side = rng.uniform(95.0, 115.0), 30.0
    begin = stands - side + rng.uniform(15.0, 25.0)
    end, back = begin + rng.uniform(70.0, 95.0), rng.uniform(20.0, 40.0)
    turn = int(rng.integers(78, 88))
    time = np.arange(FRAMES, dtype=np.float64)
    places = [stands - side - 50.0, stands - side, stands - side, begin, end, end - back, end - back, 60.0]
    person_x = np.interp(time, [0, PICKED - 4, PICKED + 4, BEHIND - 4, turn, SHOWN, PUT + 4, FRAMES], places)
    person_y = np.full(FRAMES, 150.0) + 2.0 * np.sin(2 * np.pi * time / 14)
    floor = 150.0 + PERSON[1] / 2 - BOX[1] / 2
    aside = np.interp(
        time, [PICKED, BEHIND - 16, BEHIND, SHOWN - 1, SHOWN + 16, PUT], [side, side, 0, 0, side, side]
    )
    lifted = np.interp(time, [PICKED, PICKED + 16, PUT - 16, PUT], [0.0, 1.0, 1.0, 0.0])
    carried = np.column_stack([person_x + aside, floor * (1 - lifted) + (person_y + 8.0) * lifted])
    carried[:PICKED], carried[PUT:] = carried[PICKED], carried[PUT]
    box = np.column_stack([carried, np.tile(BOX, (FRAMES, 1))])
    person = np.column_stack([person_x, person_y, np.tile(PERSON, (FRAMES, 1))])
    background = smooth_background(CARRYING_WIDTH, CARRYING_HEIGHT, 100.0, 12.0, rng)
    sprites = (
        Sprite(shaded_cells(4, 4, ORANGE, 0.7, rng), box),
        Sprite(shaded_cells(10, 4, GREEN, 0.7, rng), person),
    )
    return assemble("carried_box", background, sprites, 0, NOISE_SD, seed, plates=("box", "person"))


PARTS_WIDTH, PARTS_HEIGHT = 360, 240
SIZE = (52.0, 120.0)
HAIR = (40.0, 120.0, 235.0)
SHIRT = (90.0, 190.0, 70.0)
"""BGR: orange and green. Trousers are gray as everything else."""

HEAD = (0.0, -0.39, 0.44, 0.22)
TORSO = (0.0, -0.08, 0.62, 0.38)
LEGS = ((-0.15, 0.30, 0.24, 0.40), (0.15, 0.30, 0.24, 0.40))
"""Centres and sizes of the parts in those of the person's box, when she stands upright."""

COUNTER = (110.0, 162.0, 100.0, 129.0)
AWNING = (268.0, 58.0, 84.0, 84.0)
"""Centre boxes of what hides the person from the neck downward, and what hides her head."""


def person_parts(seed: int = 0, frames: int = 150) -> Scene:
    """The torso is behind a counter in about frames 20 to 73, the head behind an awning in 103 to 136.

    Where she is behind the counter she stops, turns and turns again, by a way that depends on the seed, so
    that only the head shows where the torso is; she goes under the awning with a change of speed, so that
    only the torso shows where the head is. Her head leans up to 2.5 px to the sides. 360x240 px, noise of
    sd 4. The parts `head` and `torso` have a truth of their own; hidden ones keep their boxes.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    x, y = _walk(frames, rng)
    lean = 2.5 * np.sin(2 * np.pi * np.arange(frames) / 37.0 + rng.uniform(0.0, 2 * np.pi))
    body = np.column_stack([x, y, np.full((frames, 2), SIZE)])
    head, torso = _in(body, HEAD), _in(body, TORSO)
    head[:, 0] += lean
    hiding = tuple(np.tile(box, (frames, 1)) for box in (COUNTER, AWNING))
    sprites = (
        *(Sprite(gray_cells(8, 4, 60, 100, rng), _in(body, leg)) for leg in LEGS),
        Sprite(shaded_cells(7, 5, SHIRT, 0.5, rng), torso),
        Sprite(shaded_cells(4, 4, HAIR, 0.5, rng), head, is_round=True),
        Sprite(gray_cells(12, 10, 90, 150, rng), hiding[0]),
        Sprite(gray_cells(6, 9, 90, 150, rng), hiding[1]),
    )
    return Scene(
        "person_parts",
        PARTS_WIDTH,
        PARTS_HEIGHT,
        Movie(smooth_background(PARTS_WIDTH, PARTS_HEIGHT, 120.0, 40.0, rng), sprites, 4.0, seed),
        corner_from_centre(body),
        tuple(corner_from_centre(path) for path in hiding),
        visible_share(body, hiding, PARTS_WIDTH, PARTS_HEIGHT),
        parts={
            name: ScenePart(corner_from_centre(path), visible_share(path, hiding, PARTS_WIDTH, PARTS_HEIGHT))
            for name, path in (("head", head), ("torso", torso))
        },
    )


def _walk(frames: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """(n,) x and y of the person's centre: behind the counter to and fro, then on to the right."""
    turns = rng.uniform(-10.0, 10.0, 2)
    when = np.array([0.0, 36.0, 52.0, 66.0, 92.0, 108.0, 118.0, 150.0]) / 150.0 * frames
    places = [30.0, 128.0 + turns[0], 92.0 + turns[1] / 2, 124.0, 196.0, 258.0, 262.0, 332.0]
    time = np.arange(frames, dtype=np.float64)
    # Corners of the way are rounded over 5 frames: nobody turns at once.
    rounded = [np.interp(time + step, when, places) for step in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    bob = 2.5 * np.sin(2 * np.pi * time / 14.0 + rng.uniform(0.0, 2 * np.pi))
    return np.mean(rounded, axis=0), 132.0 + bob


def _in(body: Floats, part: tuple[float, float, float, float]) -> Floats:
    """(n, 4) centre boxes of a part, given in sizes of the person's boxes (n, 4)."""
    x, y, w, h = part
    return np.column_stack(
        [body[:, 0] + x * body[:, 2], body[:, 1] + y * body[:, 3], w * body[:, 2], h * body[:, 3]]
    )


Colour = tuple[float, float, float]

BOARD_WIDTH, BOARD_HEIGHT = 320, 240
CLOTHES: Colour = (60.0, 170.0, 230.0)
"""BGR of person and board; its brightness is 175.4."""

GLARE: Colour = (175.4, 175.4, 175.4)
"""BGR of the glare, as bright as the person: what stands before it differs in colour only."""

BODY_PARTS = (
    (0.0, -0.39, 0.44, 0.22, True),
    (0.0, -0.10, 0.60, 0.40, False),
    (-0.42, -0.12, 0.16, 0.36, False),
    (0.42, -0.12, 0.16, 0.36, False),
    (0.0, 0.14, 0.44, 0.12, False),
    (-0.15, 0.34, 0.22, 0.32, False),
    (0.15, 0.34, 0.22, 0.32, False),
)
"""Head, trunk, arms, hips, legs: centre and size in sizes of the person's box, and whether it is round."""


def person(path: Floats, colour: Colour = CLOTHES) -> tuple[Sprite, ...]:
    """A standing person of one colour that fills the centre boxes `path` (n, 4)."""
    return dress(path, (flat(colour),) * len(BODY_PARTS))


def dress(path: Floats, cells: Sequence[Floats]) -> tuple[Sprite, ...]:
    """A standing person that fills the centre boxes `path` (n, 4), with (rows, columns, 3) cells per part."""
    return tuple(
        Sprite(
            surface,
            np.column_stack(
                [
                    path[:, 0] + x * path[:, 2],
                    path[:, 1] + y * path[:, 3],
                    w * path[:, 2],
                    h * path[:, 3],
                ]
            ),
            is_round,
        )
        for surface, (x, y, w, h, is_round) in zip(cells, BODY_PARTS, strict=True)
    )


def person_and_board(seed: int = 0, frames: int = 120) -> Scene:
    """A person walks past a board of its size and colour, and then through a glare (thesis Figure 3.17).

    320x240 px, noise of sd 4. The board stands in the way until frame 30, 8 px ahead of the person then, and
    is carried off upward. The whole person is before the glare in frames 68 to 96.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    time = np.arange(frames, dtype=np.float64)
    size = np.full((frames, 2), (40.0, 96.0))
    walker = np.column_stack([30.0 + 2.2 * time, np.full(frames, 130.0), size])
    board_x = walker[:, 0] + 48.0 + 2.2 * np.maximum(30.0 - time, 0.0)
    board = np.column_stack([board_x, 130.0 - 4.0 * np.maximum(time - 30.0, 0.0), size])
    light = np.tile([211.0, 128.0, 106.0, 150.0], (frames, 1))
    sprites = (Sprite(flat(GLARE), light), Sprite(flat(CLOTHES), board), *person(walker))
    background = smooth_background(BOARD_WIDTH, BOARD_HEIGHT, 90.0, 12.0, rng)
    visible = np.clip(
        (np.minimum(walker[:, 0] + 20, BOARD_WIDTH - 0.5) - (walker[:, 0] - 20)) / 40.0, 0.0, 1.0
    )
    return Scene(
        "person_and_board",
        BOARD_WIDTH,
        BOARD_HEIGHT,
        Movie(background, sprites, 4.0, seed),
        corner_from_centre(walker),
        (corner_from_centre(board),),
        visible,
    )


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
    forward = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), -np.sin(tilt)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    rotation = np.array([right, np.cross(forward, right), forward])
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
    lateral = lanes[:, None] + 0.15 * np.sin(0.7 * t + rng.uniform(0, 6, 5)[:, None])
    sizes = np.column_stack([rng.uniform(2.2, 2.8, 5), rng.uniform(1.4, 1.6, 5)])
    paths = np.concatenate(
        [along[..., None], lateral[..., None], np.broadcast_to(sizes[:, None], (5, frames, 2))], axis=-1
    )
    boxes = camera.boxes(paths.reshape(-1, 4)).reshape(5, frames, 4)
    order = np.array([3, 2, 0, 1, 4])  # the farther lane first, and in it the farther car
    sprites = tuple(
        Sprite(shaded_cells(3, 6, COLOURS[car], 0.6, rng), boxes[car], is_round=True) for car in order
    )
    # A car behind the camera hides nothing.
    cars = np.where(np.isnan(boxes), [-1e4, -1e4, 1.0, 1.0], boxes)
    shares = np.array(
        [
            visible_share(cars[car], tuple(cars[front] for front in order[place + 1 :]), WIDTH, HEIGHT)
            for place, car in enumerate(order)
        ]
    )[np.argsort(order, kind="stable")]
    visible = (shares > 0.5) & (np.nan_to_num(boxes[..., 3]) > SMALLEST_PX)
    ground = GroundTruth(camera, paths, visible, _detections(boxes, visible, rng), 1 / FPS)
    corners = corner_from_centre(cars)
    movie = Movie(_background(camera, rng), sprites, 2.0, seed)
    return Scene("street", WIDTH, HEIGHT, movie, corners[0], tuple(corners[1:]), shares[0], ground=ground)


def _detections(boxes: Floats, visible: Bools, rng: np.random.Generator) -> Floats:
    """Rows of a detector: 1.5 px of noise on each edge, 1 in 15 missed, a false one in five frames."""
    rows = []
    for frame in range(boxes.shape[1]):
        for car in range(len(boxes)):
            noise, chance, score = rng.normal(0.0, 1.5, 4), rng.random(), rng.uniform(0.6, 0.95)
            if not visible[car, frame] or chance < 1 / 15:
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


ROOM_SIZE, ROOM_FPS, ROOM_FRAMES, ROOM_PEOPLE = (8.0, 6.0), 10.0, 200, 5
"""Length and width in m; frames a second; frames of each camera; number of people."""
ROOM_BIAS_PX = 3.0
"""Sd of the shift of each camera's boxes, across and down, as the graph says."""
LATE_S, KNOCK_DEG = 0.4, (1.5, 0.5)
"""Delay of a late camera's clock; pan and tilt by which a knocked one turns at half time."""
ROOMS = {"room": "", "room_late": "late", "room_knocked": "knocked"}
"""Demo -> the fault of its last camera."""

ROOM_GRAPH = """\
# People in a room, seen by three cameras in its corners; detections of each come from a file.
bayesnet: 1
name: room
cameras:
  north: {{calibration: north.yaml, bias_px: {{sd: 3}}}}
  east: {{calibration: east.yaml, bias_px: {{sd: 3}}}}
  west: {{calibration: west.yaml, bias_px: {{sd: 3}}{clock}}}
targets:
  person:
    state:
      ground:
        unit: m
        width: {{mean: 0.55, sd: 0.1}}
        height: {{mean: 1.7, sd: 0.15}}
        area: [[0, 0], [8, 0], [8, 6], [0, 6]]
    associate: marginal
    existence: {{}}
    birth: {{detector: detections, max_targets: 12}}
    nodes:
      person:
        belief: {{gaussian: {{filter: extended, likelihood: sigma_points, gate: 1}}}}
        motion: {{constant_velocity: {{sd_velocity: 0.5, start_velocity_sd: 1.5, sd: {{w: 0.02, h: 0.02}}}}}}
        fuse: product
        estimate: mean
      view: {{parent: person, camera: [north, east, west]}}
      seen:
        parent: view
        agent: {{detection: {{sd_place: 0.01, sd_size: 0.01, sd_place_px: 1.1, sd_size_px: 2.1}}}}
"""


def room_cameras() -> dict[str, Camera]:
    """The cameras of the room by name: 2.6 m high in three corners, half a metre outside, looking inward."""
    length, width = ROOM_SIZE
    corners = {"north": (-0.5, width + 0.5), "east": (length + 0.5, width + 0.5), "west": (-0.5, -0.5)}
    return {name: _looking(np.array([*corner, 2.6]), (0.0, 0.0)) for name, corner in corners.items()}


def _looking(centre: Floats, turned_deg: tuple[float, float]) -> Camera:
    """A camera that looks at the middle of the room, but for what it is turned by: pan and tilt."""
    sight = np.array([ROOM_SIZE[0] / 2, ROOM_SIZE[1] / 2, 0.9]) - centre
    pan = np.arctan2(sight[1], sight[0]) + np.deg2rad(turned_deg[0])
    tilt = np.arctan2(-sight[2], np.hypot(sight[0], sight[1])) + np.deg2rad(turned_deg[1])
    axis = np.array([np.cos(pan) * np.cos(tilt), np.sin(pan) * np.cos(tilt), -np.sin(tilt)])
    right = np.array([np.sin(pan), -np.cos(pan), 0.0])
    rotation = np.array([right, np.cross(axis, right), axis])
    matrix = np.array([[330.0, 0, 320.0], [0, 330.0, 180.0], [0, 0, 1]])
    return Camera(matrix, np.zeros(0), rotation, -rotation @ centre, (WIDTH, HEIGHT))


def room(fault: str = "", seed: int = 0, frames: int = ROOM_FRAMES) -> dict[str, GroundTruth]:
    """People who walk to and fro in a room, as each camera sees them; the last camera has the fault.

    All boxes of a camera are off alike, as by a calibration that is not exact.

    `late`: its clock is `LATE_S` behind: a frame shows what was so long before. `knocked`: from half time on
    it is turned by `KNOCK_DEG`, and its calibration is that from before. The truth is the same for all.
    """
    rng = np.random.default_rng(seed)
    rates, phases = rng.uniform(0.25, 0.5, (ROOM_PEOPLE, 2)), rng.uniform(0.0, 6.28, (ROOM_PEOPLE, 2))
    sizes = np.column_stack([rng.uniform(0.48, 0.6, ROOM_PEOPLE), rng.uniform(1.58, 1.85, ROOM_PEOPLE)])
    middle = np.array(ROOM_SIZE) / 2

    def paths_at(times: Floats) -> Floats:
        places = middle + (middle - 1.0) * np.sin(rates[:, None] * times[:, None] + phases[:, None])
        return np.concatenate([places, np.broadcast_to(sizes[:, None], places.shape)], axis=-1)

    times = np.arange(frames) / ROOM_FPS
    cameras = room_cameras()
    faulty = [*cameras][-1]
    biases = np.random.default_rng([seed, 1]).normal(0.0, ROOM_BIAS_PX, (len(cameras), 2))
    by_camera = {}
    for (name, camera), bias in zip(cameras.items(), biases, strict=True):
        is_faulty = name == faulty
        paths = paths_at(times - LATE_S if is_faulty and fault == "late" else times)
        boxes = camera.boxes(paths.reshape(-1, 4)).reshape(ROOM_PEOPLE, frames, 4)
        if is_faulty and fault == "knocked":
            turned = _looking(-camera.rotation.T @ camera.translation, KNOCK_DEG)
            later = turned.boxes(paths.reshape(-1, 4)).reshape(boxes.shape)
            boxes = np.where(np.arange(frames)[None, :, None] < frames // 2, boxes, later)
        centre = -camera.rotation.T @ camera.translation
        distances = np.hypot(*(paths[..., :2] - centre[:2]).transpose(2, 0, 1))
        visible = np.array([_mostly_visible(boxes[:, k], distances[:, k]) for k in range(frames)]).T
        boxes = boxes + [*bias, 0.0, 0.0]
        truth = paths_at(times)
        by_camera[name] = GroundTruth(camera, truth, visible, _detections(boxes, visible, rng), 1 / ROOM_FPS)
    return by_camera


def _mostly_visible(boxes: Floats, distances: Floats) -> Bools:
    """(n,) True of each centre box (n, 4) of which nearer ones hide less than half."""
    hiding = [
        tuple(boxes[person][None] for person in np.flatnonzero(distances < distance))
        for distance in distances
    ]
    shares = [
        visible_share(box[None], nearer, WIDTH, HEIGHT)[0] for box, nearer in zip(boxes, hiding, strict=True)
    ]
    return np.array(shares) > 0.5


def write_room(folder: Path, fault: str = "", seed: int = 0) -> tuple[Path, dict[str, Path], Path]:
    """Write what a run in the room needs: paths of the graph, of each camera's detections and of the truth.

    Raises:
        OSError: a file cannot be written.
    """
    from bayesnet_track.vision.camera_calibration import write_camera

    by_camera = room(fault, seed)
    detections = {}
    for name, ground in by_camera.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        write_camera(folder / f"{name}.yaml", ground.camera, {})
        (folder / name / "seqinfo.ini").write_text(
            f"[Sequence]\nimWidth={WIDTH}\nimHeight={HEIGHT}\nframeRate={ROOM_FPS:g}\nseqLength={ROOM_FRAMES}\n"
        )
        detections[name] = folder / name / "detections.txt"
        detections[name].write_text(ground.detections_mot(), encoding="utf-8")
    graph, truth = folder / "room.yaml", folder / "truth.csv"
    clock = ", clock: {offset_s: {sd: 0.3}}" if fault == "late" else ""
    graph.write_text(ROOM_GRAPH.format(clock=clock), encoding="utf-8")
    visible = np.any([ground.seen for ground in by_camera.values()], axis=0)
    first = next(iter(by_camera.values()))
    truth.write_text(replace(first, seen=visible).truth_csv(), encoding="utf-8")
    return graph, detections, truth
