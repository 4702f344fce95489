"""People in a room, in metres, by the detections of cameras: scores, and what the detections' errors are.

    python benchmarks/ground_cmc.py DATA/cmc [--sequences CMC1 CMC2] [--cameras 1 2] [--boxes fairmot]
        [--errors] [--bias 18] [--detection "sd_place_slow: 0.05"] [--together] [--area "[[2, 0], ..]"]
        [--knock 40]

DATA/cmc holds CMCn_camC_DETECTOR.txt (MOT lines), CMCn_gt_world.txt and cameras.json (3 x 4 projections) of
researchwork888/Multi-view-3D-multi-object-tracking-dataset. The first table has a line for a sequence and a
camera: MOTA and IDF1 at 1 m, the mean error, the share of true places inside their 90 % ellipse (`cover90`),
ANEES with the bounds of calibrated runs, and the autocorrelation of innovations (detection less the box
predicted from the last frame, in heights of the box) of one target, and of their mean over the targets.

`--together` tracks by all cameras at once, and ends a line with the median time of a step; `--area` says
where in the room people are followed. `--knock` shifts the detections of the last camera by so many px, to
the right, from half time on, and adds a line for each knock that was noticed, and the cover of both halves.
The settings chosen on CMC1 are

    --together --bias 4 --by-place 25 --detection "sd_place: 0.09, sd_size: 0.09"
        --area "[[2, 0], [6.3, 0], [6.3, 3.4], [2, 3.4]]"

`--errors` adds what the detections' own errors are made of: feet and centres of boxes less those of the true
ellipsoids, in heights of the box. The mean square of the error is that of the camera's mean (`camera`), of
what a target's errors share beyond it for so long as their correlation lasts (`slow`, with the frames in
which it falls to 1 / e), and of what changes from frame to frame (`white`).
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track import DetectionsTracker
from bayesnet_track.evaluate.truth import assign_rows
from bayesnet_track.evaluate.world import GroundPlaces, WorldScore, score_world
from bayesnet_track.journal.events.cameras import CameraKnocked
from bayesnet_track.numerics.cameras import Camera, camera_of_projection

Floats = NDArray[np.float64]

SIZE, FPS = (1920, 1024), 4.0

NEAR = 0.15
"""A detection is that of a true place when centre and feet are within so many heights of the box."""

GRAPH = """
bayesnet: 1
name: room
cameras:
  {cameras}
targets:
  person:
    state: {{ground: {{unit: m, height: {{mean: 1.7, sd: 0.15}}{area}}}}}
    associate: marginal
    existence: {{}}
    birth: {{detector: detections, max_targets: 20}}
    nodes:
      person:
        belief: {{gaussian: {{filter: extended, likelihood: sigma_points, gate: 1}}}}
        motion: {{constant_velocity: {{sd_velocity: 0.5, start_velocity_sd: 1.5, sd: {{w: 0.02, h: 0.02}}}}}}
        fuse: product
        estimate: mean
      view: {{parent: person, camera: [{names}]}}
      seen: {{parent: view, agent: {agent}}}
"""


@dataclass(frozen=True)
class Sequence4:
    """A sequence as one camera sees it: its camera, detections (N, 7) and truth (M, 6).

    Columns: frame, left, top, width, height, score; and frame, id, x, y, width, height in m.
    """

    name: str
    camera: Camera
    detections: Floats
    truth: Floats


def read(folder: Path, sequence: str, number: int, boxes: str) -> Sequence4:
    """One camera of a sequence."""
    projection = json.loads((folder / "cameras.json").read_text())["projection_3x4"][str(number)]
    lines = _table(folder / f"{sequence}_cam{number}_{boxes}.txt", 7)[:, [0, 2, 3, 4, 5, 6]]
    true = _table(folder / f"{sequence}_gt_world.txt", 13)
    sizes = 2.0 * true[:, [10, 12]]
    truth = np.column_stack([true[:, [0, 1, 7, 8]], sizes])
    return Sequence4(f"{sequence} {number}", camera_of_projection(np.array(projection), SIZE), lines, truth)


def _table(path: Path, width: int) -> Floats:
    rows = (line.replace(",", " ").split() for line in path.read_text().splitlines())
    return np.array([[float(word) for word in row[:width]] for row in rows if len(row) >= width])


@dataclass(frozen=True)
class Tracked:
    """Tracked places, (N, 5) innovations: frame, target, x, feet, head in heights of the box; ms a step."""

    places: GroundPlaces
    innovations: Floats
    step_ms: float
    knocks: tuple[str, ...]


def track(cameras: Sequence[Sequence4], graph: Path, knock_px: float = 0.0) -> Tracked:
    """The detections of cameras, tracked frame by frame; innovations are those of the first one."""
    tracker = DetectionsTracker(graph, size=SIZE, fps=FPS)
    times: list[float] = []
    ids: list[str] = []
    rows: list[tuple[float, ...]] = []
    innovations: list[tuple[float, ...]] = []
    before: dict[int, Floats] = {}
    took: list[float] = []
    knocks: list[str] = []
    count = int(cameras[0].truth[:, 0].max())
    for frame in range(1, count + 1):
        given = {camera_name(seen): _boxes(seen, frame) for seen in cameras}
        if frame > count // 2:
            given[camera_name(cameras[-1])].xyxy[:, [0, 2]] += knock_px
        first, boxes = next(iter(given.items()))
        started = time.perf_counter()
        marked = tracker.update(given if len(cameras) > 1 else boxes)
        took.append(1000.0 * (time.perf_counter() - started))
        knocks += [
            f"{frame}: {event.describe()}" for event in tracker.events if isinstance(event, CameraKnocked)
        ]
        owners = np.asarray((marked[first] if len(cameras) > 1 else marked).tracker_id)
        for box, owner in zip(boxes.xyxy, owners.tolist(), strict=True):
            if owner in before:
                innovations.append((frame, owner, *_away(cameras[0].camera, box, before[owner])))
        before = {}
        for target in tracker.targets:
            state, number = target.state, int(target.target)
            if "x_m" not in state:
                continue
            place = [state["x_m"], state["y_m"], state["w_m"], state["h_m"]]
            step = [state["vx"] / FPS, state["vy"] / FPS, 0.0, 0.0]
            before[number] = np.add(place, step)
            if target.status in ("lost", "hidden"):
                continue
            times.append(frame / FPS)
            ids.append(str(number))
            sds = state["x_m_sd"], state["y_m_sd"]
            rows.append((*place[:2], sds[0] ** 2, sds[1] ** 2, state["xy_corr"] * sds[0] * sds[1]))
    table = np.array(rows).reshape(-1, 5)
    covariances = table[:, [2, 4, 4, 3]].reshape(-1, 2, 2)
    places = GroundPlaces(np.array(times), ids, table[:, :2], covariances)
    return Tracked(places, np.array(innovations).reshape(-1, 5), float(np.median(took)), tuple(knocks))


def _boxes(seen: Sequence4, frame: int) -> SimpleNamespace:
    """The detections of a camera in a frame."""
    own = seen.detections[seen.detections[:, 0] == frame]
    corners = np.column_stack([own[:, 1:3], own[:, 1:3] + own[:, 3:5]])
    return SimpleNamespace(xyxy=corners, confidence=np.clip(own[:, 5], 0.0, 1.0), data={})


def camera_name(seen: Sequence4) -> str:
    """The camera's name in the graph."""
    return f"camera{seen.name.split()[1]}"


def _away(camera: Camera, corners: Floats, place: Floats) -> Floats:
    """(3,) x, feet and head of a box less those of a place, in heights of the box; nan where unseen."""
    box = camera.boxes(place[None])[0]
    middle = (corners[0] + corners[2]) / 2.0
    return np.asarray(
        [
            middle - box[0],
            corners[3] - box[1] - box[3] / 2.0,
            corners[1] - box[1] + box[3] / 2.0,
        ]
        / box[3]
    )


def scores(seen: Sequence4, tracked: Tracked, later: bool | None = None) -> WorldScore:
    """Scores of the places against the truth, at 1 m; of the first or the second half of the frames alone."""
    truth, places = seen.truth, tracked.places
    if later is not None:
        half = int(truth[:, 0].max()) // 2
        truth = truth[(truth[:, 0] > half) == later]
        own = np.flatnonzero((places.times > half / FPS) == later)
        ids = [places.ids[row] for row in own.tolist()]
        places = GroundPlaces(places.times[own], ids, places.points[own], places.covariances[own])
    nothing = np.full((len(truth), 2, 2), np.nan)
    true = GroundPlaces(truth[:, 0] / FPS, [f"{one:g}" for one in truth[:, 1]], truth[:, 2:4], nothing)
    return score_world(true, places)


def detection_errors(seen: Sequence4) -> Floats:
    """(N, 5) frame, id, and errors of x, feet and head of the detections of true places, in heights."""
    rows = []
    for frame in np.unique(seen.truth[:, 0]):
        true = seen.truth[seen.truth[:, 0] == frame]
        boxes = seen.detections[seen.detections[:, 0] == frame][:, 1:5]
        corners = np.column_stack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])
        away = np.array([[_away(seen.camera, box, one[2:]) for box in corners] for one in true])
        away = away.reshape(len(true), len(corners), 3)
        apart = np.hypot(away[..., 0], away[..., 1])
        for i, j in zip(*assign_rows(np.maximum(np.nan_to_num(NEAR - apart, nan=0.0), 0.0)), strict=True):
            if apart[i, j] < NEAR:
                rows.append((frame, true[i, 1], *away[i, j]))
    return np.array(rows).reshape(-1, 5)


def products(errors: Floats, column: int, lag: int) -> Floats:
    """Products of a target's errors `lag` frames apart."""
    at: dict[float, dict[float, float]] = defaultdict(dict)
    for row in errors:
        at[row[1]][row[0]] = row[column]
    return np.array([x * own[t + lag] for own in at.values() for t, x in own.items() if t + lag in own])


def shares(errors: Floats, column: int) -> tuple[float, float, float, float]:
    """Sd of the camera's share of errors, of the slow and of the white one; frames that slow ones last."""
    mean = float(errors[:, column].mean())
    left = errors.copy()
    left[:, column] -= mean
    total = float((left[:, column] ** 2).mean())
    by_lag = [float(products(left, column, lag).mean()) for lag in (1, 2)]
    # exp(-lag / frames) through the first two lags: what it is at 0 is slow, the rest white
    kept = min(max(by_lag[1] / by_lag[0], 0.01), 0.99) if by_lag[0] > 0 else 0.01
    slow = min(max(by_lag[0] / kept, 0.0), total)
    return abs(mean), slow**0.5, (total - slow) ** 0.5, -1.0 / float(np.log(kept))


def correlation(errors: Floats, column: int, lag: int = 1) -> float:
    """Autocorrelation of a target's errors."""
    return float(products(errors, column, lag).mean() / (errors[:, column] ** 2).mean())


def of_cameras(errors: Floats) -> Floats:
    """The errors' means over the targets of a frame, as those of one target."""
    frames = np.unique(errors[:, 0])
    return np.array([[t, 0.0, *errors[errors[:, 0] == t][:, 2:].mean(axis=0)] for t in frames])


def measure(options: argparse.Namespace) -> Iterator[str]:
    """The tables, line by line."""
    sequences = [
        read(options.data, name, camera, options.boxes)
        for name in options.sequences
        for camera in options.cameras
    ]
    if options.errors:
        yield "errors of detections, heights of the box: sd camera / slow (frames) / white"
        for seen in sequences:
            errors = detection_errors(seen)
            parts = [(name, shares(errors, 2 + k)) for k, name in enumerate(("x", "feet", "head"))]
            yield f"{seen.name}  n {len(errors):5d}  " + "  ".join(
                f"{name} {own[0]:.3f} / {own[1]:.3f} ({own[3]:.0f}) / {own[2]:.3f}" for name, own in parts
            )
    yield "camera    MOTA   IDF1  error_m  cover90  ANEES (bounds)      acf 1 x, feet: target  camera"
    with TemporaryDirectory() as folder:
        groups = [[seen] for seen in sequences]
        if options.together:
            by_name = [seen.name.split()[0] for seen in sequences]
            groups = [
                [seen for seen, own in zip(sequences, by_name, strict=True) if own == name]
                for name in dict.fromkeys(by_name)
            ]
        for cameras in groups:
            seen = cameras[0]
            name = seen.name if len(cameras) == 1 else f"{seen.name.split()[0]} *"
            tracked = track(cameras, write_graph(Path(folder), cameras, options), options.knock)
            score, far = scores(seen, tracked), tracked.innovations
            half = [scores(seen, tracked, later).coverage for later in (False, True)]
            own = [correlation(far, column) for column in (2, 3)]
            shared = [correlation(of_cameras(far), column) for column in (2, 3)]
            bounds = f"({score.anees_low:.2f}..{score.anees_high:.2f})"
            yield (
                f"{name}  {100 * score.mota:5.1f}  {100 * score.idf1:5.1f}  {score.error_m:7.3f}"
                f"  {score.coverage:7.3f}  {score.anees:5.2f} {bounds:13}"
                f"  {own[0]:14.2f} {own[1]:.2f}   {shared[0]:.2f} {shared[1]:.2f}"
                + (f"  {tracked.step_ms:.1f} ms a step" if options.together else "")
            )
            if options.knock:
                yield f"cover90 in the halves: {half[0]:.3f} {half[1]:.3f}"
            yield from tracked.knocks


def write_graph(folder: Path, cameras: Sequence[Sequence4], options: argparse.Namespace) -> Path:
    """The graph's file, and its cameras beside it."""
    shift = f"sd: {options.bias}, sd_by_place: {options.by_place}"
    bias = f", bias_px: {{{shift}}}" if options.bias else ""
    lines = []
    for seen in cameras:
        camera, name = seen.camera, camera_name(seen)
        projection = camera.matrix @ np.column_stack([camera.rotation, camera.translation])
        calibration = {"P": projection.tolist(), "size": list(SIZE)}
        (folder / f"{name}.json").write_text(json.dumps(calibration))
        lines.append(f"{name}: {{calibration: {name}.json{bias}}}")
    agent = f"{{detection: {{{options.detection}}}}}" if options.detection else "detection"
    area = f", area: {options.area}" if options.area else ""
    path = folder / "room.yaml"
    names = ", ".join(map(camera_name, cameras))
    path.write_text(GRAPH.format(cameras="\n  ".join(lines), names=names, agent=agent, area=area))
    return path


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="People in a room by cameras, in metres.")
    parser.add_argument("data", type=Path, help="folder of the sequences")
    parser.add_argument("--sequences", nargs="+", default=["CMC1", "CMC2"])
    parser.add_argument("--cameras", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--boxes", choices=("fairmot", "frcnn"), default="fairmot", help="detector")
    parser.add_argument("--errors", action="store_true", help="what the detections' errors are made of")
    parser.add_argument("--bias", type=float, default=0.0, help="sd of bias_px of cameras; 0: none")
    parser.add_argument("--by-place", type=float, default=0.0, help="sd_by_place of it")
    parser.add_argument("--detection", default="", help="parameters of the agent, as in a graph")
    parser.add_argument("--together", action="store_true", help="by all cameras at once")
    parser.add_argument("--knock", type=float, default=0.0, help="px by which the last camera is shifted")
    parser.add_argument("--area", default="", help="corners of the ground where people are followed, m")
    for line in measure(parser.parse_args(arguments)):
        print(line, flush=True)


if __name__ == "__main__":
    main()
