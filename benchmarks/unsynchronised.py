"""A drone seen by cameras that nobody synchronised, by points in their images: errors in metres, and clocks.

    python benchmarks/unsynchronised.py prepare DATA/drone3 INPUTS [--seed 0] [--rate 10]
    python benchmarks/unsynchronised.py track INPUTS OUT [--half 2] [--clocks given | one_second | none]
    python benchmarks/unsynchronised.py score INPUTS OUT ...

DATA/drone3 is dataset 3 of CenekAlbl/drone-tracking-datasets. `prepare` writes what the tracker may read to
INPUTS: a camera a file with its lens and pose, labels thinned to about `--rate` a second, and their times;
and what only `score` reads to INPUTS/truth. Poses are fitted to the first half of the track, with the
published clocks, by PnP. Times are in seconds of the first camera: `given` by the published clocks,
`one_second` off by a shift drawn from -1 to 1 s for each other camera. The shifts stand in INPUTS/truth
alone. `track` writes places, and the clocks as they are believed at the end; `--half` is of the track. Camera
1, whose labels were interpolated to another rate, is left out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track import DetectionsTracker

Floats = NDArray[np.float64]

CAMERAS = {0: "gopro3", 2: "mate10_1", 3: "sony5n_1440x1080", 4: "sony5100", 5: "sonyG_1"}
"""Camera -> the file of its lens; the first one's clock is that of the run."""

FIRST_RATE, FIRST_PLACE, PLACE_HZ = 59.94006, -3706.0, 5.0
"""Frames a second of camera 0, its frame at the first place of the track, and places a second."""

ALPHA = {0: 1.0, 2: 0.4960, 3: 0.4171, 4: 0.5000, 5: 0.8341}
BETA = {0: 0.0, 2: 546.98, 3: 251.16, 4: 961.02, 5: 137.51}
"""Published: frame i of camera 0 is frame alpha i + beta of another."""

GRAPH = """
bayesnet: 1
name: drone
cameras:
  {cameras}
targets:
  drone:
    state: {{space: {{size: {{mean: 0.5, sd: 0.1}}, {start}}}}}
    associate: marginal
    existence: {{}}
    birth: {{detector: detections, max_targets: 1}}
    nodes:
      drone:
        belief: {{gaussian: {{filter: extended, likelihood: sigma_points, gate: 1}}}}
        motion: {{constant_velocity: {{sd_velocity: {sd_velocity}, start_velocity_sd: 6}}}}
        fuse: product
        estimate: mean
      view: {{parent: drone, camera: [{names}]}}
      seen: {{parent: view, agent: {{detection: {{points: true, sd_place_px: {sd_px}}}}}}}
"""


@dataclass(frozen=True)
class Labels:
    """Labels of a camera: times in s of the first camera's clock, and points (n, 2) in px."""

    times: Floats
    points: Floats


def read_labels(folder: Path, camera: int) -> Labels:
    """The frames in which the drone was seen, at the times of the published clocks."""
    rows = np.loadtxt(folder / "detections" / f"cam{camera}.txt", skiprows=1)
    rows = rows[(rows[:, 1:] != 0.0).any(axis=1)]
    return Labels((rows[:, 0] - BETA[camera]) / ALPHA[camera] / FIRST_RATE, rows[:, 1:])


def read_track(folder: Path) -> tuple[Floats, Floats]:
    """Times, in s of the first camera's clock, and places (n, 3) in m of the drone."""
    places = np.loadtxt(folder / "trajectory" / "rtk.txt")
    return FIRST_PLACE / FIRST_RATE + np.arange(len(places)) / PLACE_HZ, places


def at(times: Floats, track: tuple[Floats, Floats]) -> Floats:
    """(n, 3) places at times; nan outside of the track."""
    return np.column_stack([np.interp(times, track[0], axis, np.nan, np.nan) for axis in track[1].T])


def fit_pose(lens: dict[str, Any], labels: Labels, places: Floats) -> tuple[Floats, Floats, float]:
    """Rotation (3, 3), translation (3,) and median error in px of a camera, by PnP and its refinement."""
    import cv2

    matrix, distortion = np.array(lens["K-matrix"]), np.array(lens["distCoeff"])
    usable = np.isfinite(places).all(axis=1)
    world, image = places[usable], labels.points[usable]
    _, turn, shift, inliers = cv2.solvePnPRansac(
        world, image, matrix, distortion, iterationsCount=2000, reprojectionError=20.0
    )
    rows = inliers.ravel()
    turn, shift = cv2.solvePnPRefineLM(world[rows], image[rows], matrix, distortion, turn, shift)
    seen = cv2.projectPoints(world, turn, shift, matrix, distortion)[0].reshape(-1, 2)
    error = float(np.median(np.linalg.norm(seen - image, axis=1)))
    return cv2.Rodrigues(turn)[0], shift.ravel(), error


def prepare(options: argparse.Namespace) -> Iterator[str]:
    """Inputs of the tracker, and the truth beside them."""
    data, out, rng = options.data, options.inputs, np.random.default_rng(options.seed)
    (out / "truth").mkdir(parents=True, exist_ok=True)
    track = read_track(data)
    np.savetxt(out / "truth" / "track.csv", np.column_stack(track), delimiter=",")
    all_labels = {camera: read_labels(data, camera) for camera in CAMERAS}
    start = max(track[0][0], min(labels.times[0] for labels in all_labels.values()))
    end = min(track[0][-1], max(labels.times[-1] for labels in all_labels.values()))
    middle = (start + end) / 2.0
    shifts = {}
    for camera, labels in all_labels.items():
        lens = json.loads(next((data / "calibration").glob(f"*/{CAMERAS[camera]}.json")).read_text())
        early = labels.times < middle
        fitted = Labels(labels.times[early], labels.points[early])
        turn, shift, error = fit_pose(lens, fitted, at(fitted.times, track))
        calibration = {"K": lens["K-matrix"], "D": lens["distCoeff"], "R": turn.tolist(), "t": shift.tolist()}
        calibration["size"] = lens["resolution"]
        (out / f"cam{camera}.json").write_text(json.dumps(calibration))
        shifts[camera] = 0.0 if camera == 0 else float(rng.uniform(-1.0, 1.0))
        kept = np.flatnonzero(np.diff(np.floor(labels.times * options.rate), prepend=-np.inf))
        for name, late in (("given", 0.0), ("one_second", shifts[camera])):
            rows = np.column_stack([labels.times[kept] + late, labels.points[kept]])
            np.savetxt(out / f"cam{camera}_{name}.csv", rows, delimiter=",", fmt="%.6f")
        yield f"camera {camera}: {len(kept)} labels; pose of {early.sum()} labels, median {error:.1f} px"
    (out / "truth" / "shifts.json").write_text(json.dumps(shifts))
    spread = {"start": start, "middle": middle, "end": end}
    first = at(all_labels[0].times[all_labels[0].times < middle], track)
    moments = {axis: [float(np.nanmean(first[:, k])), 30.0] for k, axis in enumerate("xyz")}
    (out / "run.json").write_text(json.dumps({**spread, "place": moments}))
    yield f"track from {start:.1f} to {end:.1f} s of the first camera's clock"


def write_graph(options: argparse.Namespace, folder: Path) -> Path:
    """The graph's file beside the calibrations."""
    run = json.loads((folder / "run.json").read_text())
    start = ", ".join(f"{axis}: {{mean: {m:.1f}, sd: {sd}}}" for axis, (m, sd) in run["place"].items())
    clock = "" if options.clocks == "given" else f", clock: {{offset_s: {{sd: {options.sd_offset}}}}}"
    bias = f", bias_px: {{sd: {options.bias}}}" if options.bias else ""
    lines = [
        f"cam{camera}: {{calibration: cam{camera}.json{bias}{clock if camera else ''}}}" for camera in CAMERAS
    ]
    path = folder / f"drone_{options.clocks}.yaml"
    path.write_text(
        GRAPH.format(
            cameras="\n  ".join(lines),
            start=start,
            names=", ".join(f"cam{camera}" for camera in CAMERAS),
            sd_velocity=options.sd_velocity,
            sd_px=options.sd_px,
        )
    )
    return path


def track_drone(options: argparse.Namespace) -> Iterator[str]:
    """Places of the drone, a line for each step, and the clocks."""
    folder = options.inputs
    run = json.loads((folder / "run.json").read_text())
    times = "given" if options.clocks == "given" else "one_second"
    low, high = ((run["start"], run["middle"]), (run["middle"], run["end"]))[options.half - 1]
    tracker = DetectionsTracker(write_graph(options, folder), fps=options.rate)
    rows = []
    for camera in CAMERAS:
        labels = np.loadtxt(folder / f"cam{camera}_{times}.csv", delimiter=",")
        inside = (labels[:, 0] >= low) & (labels[:, 0] < min(high, low + options.seconds))
        rows += [(time, camera, x, y) for time, x, y in labels[inside]]
    rows.sort()
    last, written = -np.inf, []
    for time, camera, x, y in rows:
        time = max(time, last + 1e-4)
        last = time
        point = SimpleNamespace(xyxy=[[x - 0.5, y - 0.5, x + 1.5, y + 1.5]], confidence=[0.9])
        tracker.update({f"cam{camera}": point}, time_s=time - low)
        for event in tracker.events:
            if options.verbose:
                print(event.describe())
        for target in tracker.targets:
            state = target.state
            if "x_m" in state:
                moments = [state[f"{axis}_m{kind}"] for kind in ("", "_sd") for axis in "xyz"]
                names = [f"view.cam{other}.clock_s{kind}" for other in CAMERAS for kind in ("", "_sd")]
                clocks = [state.get(name, 0.0) for name in names]
                written.append([time, float(target.target), *moments, *clocks])
    options.out.mkdir(parents=True, exist_ok=True)
    np.savetxt(options.out / "places.csv", np.array(written), delimiter=",", fmt="%.5f")
    yield f"{len(rows)} labels, {len(written)} places of {len({row[1] for row in written})} targets"


def score(options: argparse.Namespace) -> Iterator[str]:
    """Errors of the places, and of the clocks at the end."""
    truth = np.loadtxt(options.inputs / "truth" / "track.csv", delimiter=",")
    shifts = json.loads((options.inputs / "truth" / "shifts.json").read_text())
    for out in options.outs:
        rows = np.loadtxt(out / "places.csv", delimiter=",")
        errors = rows[:, 2:5] - at(rows[:, 0], (truth[:, 0], truth[:, 1:]))
        settled = np.isfinite(errors).all(axis=1) & (rows[:, 0] > rows[0, 0] + options.settle)
        far = np.linalg.norm(errors[settled], axis=1)
        scaled = (errors[settled] / rows[settled, 5:8]) ** 2
        yield (
            f"{out.name}: {settled.sum()} places, median {np.median(far):.2f} m, "
            f"90 % {np.quantile(far, 0.9):.2f} m, rms {np.sqrt((far**2).mean()):.2f} m; "
            f"mean square in sds {scaled.mean():.1f}"
        )
        for number, camera in enumerate(CAMERAS):
            offset, sd = rows[-1, 8 + 2 * number : 10 + 2 * number]
            if sd > 0:
                shift = shifts[str(camera)]
                off = offset - shift
                yield f"  camera {camera}: {offset:+.3f} ± {sd:.3f} s, true {shift:+.3f}, off {off:+.3f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="A drone by cameras that nobody synchronised.")
    commands = parser.add_subparsers(required=True)
    first = commands.add_parser("prepare")
    first.add_argument("data", type=Path)
    first.add_argument("inputs", type=Path)
    first.add_argument("--seed", type=int, default=0, help="of the shifts")
    first.set_defaults(action=prepare)
    second = commands.add_parser("track")
    second.add_argument("inputs", type=Path)
    second.add_argument("out", type=Path)
    second.add_argument("--half", type=int, choices=(1, 2), default=2, help="of the track")
    second.add_argument("--seconds", type=float, default=1e9, help="at most, of the half")
    second.add_argument("--clocks", choices=("given", "one_second"), default="given")
    second.add_argument("--sd-offset", type=float, default=0.6, help="prior of a clock, s")
    second.add_argument("--sd-velocity", type=float, default=2.0, help="of the motion, m/s in one second")
    second.add_argument("--sd-px", type=float, default=5.0, help="of labels, px")
    second.add_argument("--bias", type=float, default=0.0, help="sd of bias_px, px; 0: none")
    second.add_argument("--verbose", action="store_true", help="print events")
    second.set_defaults(action=track_drone)
    for command in (first, second):
        command.add_argument("--rate", type=float, default=10.0, help="labels a second of a camera")
    third = commands.add_parser("score")
    third.add_argument("inputs", type=Path)
    third.add_argument("outs", type=Path, nargs="+")
    third.add_argument("--settle", type=float, default=10.0, help="s at the beginning that do not count")
    third.set_defaults(action=score)
    options = parser.parse_args(arguments)
    for line in options.action(options):
        print(line, flush=True)


if __name__ == "__main__":
    main()
