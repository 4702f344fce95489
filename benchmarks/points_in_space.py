"""Points of a mouse followed by image agents in four videos from one point in each: errors in mm.

    python benchmarks/points_in_space.py prepare DATA/mouse INPUTS
    python benchmarks/points_in_space.py track INPUTS OUT [--cameras back,mid,side,top] [--agent template]
    python benchmarks/points_in_space.py alone INPUTS OUT [--agent template]
    python benchmarks/points_in_space.py score INPUTS OUT ...

DATA/mouse is the example of talmolab/sleap-anipose: four synchronised videos of 120 frames, a calibration,
and 2-D labels that were proofread. Its calibration gives `side` the numbers of `top`, so `prepare` fits the
pose of `side` to the labels of `FITTED` frames, together with the places of all points, with the lens of
the file; these frames are not scored. `track` follows points as targets in space, all cameras in one graph,
from the labels of frame 0; `alone` follows them in each video by itself, with the same agent and boxes of
the same size, and triangulates what it follows. Ground truth are labels that were triangulated, by least
squares of pixels.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track import Start, Tracker, track
from bayesnet_track.observation.calibrations import read_calibration

Floats = NDArray[np.float64]

CAMERAS = ("back", "mid", "side", "top")
FITTED = (10, 30, 50, 70, 90, 110)
REPORTED = ("Nose", "Neck")

FRAMES, PIXEL_ERROR = 120, 2.0

SPACE = """
bayesnet: 1
name: point
cameras:
  {cameras}
targets:
  point:
    state: {{space: {{size: {{mean: {size}, sd: 0.0005}}}}}}
    nodes:
      point:
        belief: {{gaussian: {{filter: extended}}}}
        motion:
          constant_velocity: {{sd_velocity: 0.1, start_velocity_sd: 0.05, sd: {{w: 1.0e-5, h: 1.0e-5}}}}
        fuse: product
        estimate: mean
      view: {{parent: point, camera: [{names}], fuse: product}}
      look: {{parent: view, agent: {agent}}}
"""

IMAGE = """
bayesnet: 1
name: point
targets:
  point:
    nodes:
      point:
        belief: {{gaussian: {{}}}}
        motion: {{constant_velocity: {{sd_velocity_px: 3, sd_px: {{w: 0.01, h: 0.01}}}}}}
        fuse: product
        ud_fields: [x, y]
        estimate: mean
      look: {{parent: point, agent: {agent}}}
"""

AGENTS = {
    "template": "{template: {sd_place: 0.05, reach_box: 0.6}}",
    "klt": "{klt: {spacing_px: 2, points: 40}}",
}


class Cameras:
    """Lenses and poses by name, in m, of the files NAME.json in a folder."""

    def __init__(self, folder: Path) -> None:
        self.by_name = {name: read_calibration(folder / f"{name}.json") for name in CAMERAS}

    def triangulate(self, points: Mapping[str, Floats], loss: str = "linear") -> Floats:
        """(F, 3) places of points in images (F, 2), camera by camera; nan of fewer than two."""
        from scipy.optimize import least_squares

        places = np.full((len(next(iter(points.values()))), 3), np.nan)
        last = np.array([0.1, 0.0, 0.5])
        for frame in range(len(places)):
            seen = {name: rows[frame] for name, rows in points.items() if np.isfinite(rows[frame]).all()}
            if len(seen) > 1:
                last = places[frame] = least_squares(
                    lambda place, seen=seen: np.concatenate(
                        [self.by_name[name].project(place[None])[0] - point for name, point in seen.items()]
                    ),
                    last,
                    loss=loss,
                    f_scale=PIXEL_ERROR,
                    x_scale=0.01,
                ).x
        return places


def read_labels(data: Path) -> dict[str, dict[str, Floats]]:
    """Point -> camera -> (F, 2) its pixels; nan where it is not labelled."""
    import h5py

    labels: dict[str, dict[str, Floats]] = {}
    for camera in CAMERAS:
        with h5py.File(data / f"{camera}.analysis.h5") as file:
            names = [name.decode() for name in file["node_names"][:]]
            for name, rows in zip(names, file["tracks"][0].transpose(1, 2, 0), strict=True):
                labels.setdefault(name, {})[camera] = np.ascontiguousarray(rows, dtype=np.float64)
    return labels


def fit_side(lens: dict[str, Any], cameras: Cameras, points: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    """Rotation vector and translation of `side`, by its points and those of the others, (N, 2) each."""
    import cv2
    from scipy.optimize import least_squares
    from scipy.sparse import lil_matrix

    matrix, distortion = np.array(lens["K"]), np.array(lens["D"])
    places = cameras.triangulate({name: points[name] for name in CAMERAS if name != "side"}, "soft_l1")
    kept = np.isfinite(places).all(axis=1)
    places, images = places[kept], {name: rows[kept] for name, rows in points.items()}
    seen = {name: np.isfinite(rows).all(axis=1) for name, rows in images.items()}
    world, image = places[seen["side"]], images["side"][seen["side"]]
    _, turn, shift, _ = cv2.solvePnPRansac(
        world,
        image,
        matrix,
        distortion,
        iterationsCount=5000,
        reprojectionError=8.0,
        flags=cv2.SOLVEPNP_SQPNP,
    )

    def misfit(unknown: Floats) -> Floats:
        world = unknown[6:].reshape(-1, 3)
        shown = {name: cameras.by_name[name].project(world) for name in CAMERAS if name != "side"}
        by_side = cv2.projectPoints(world, unknown[:3], unknown[3:6], matrix, distortion)[0]
        shown["side"] = by_side.reshape(-1, 2)
        return np.concatenate([(shown[name] - images[name])[seen[name]].ravel() for name in CAMERAS])

    start = np.concatenate([turn.ravel(), shift.ravel(), places.ravel()])
    rows = np.concatenate([np.repeat(np.flatnonzero(seen[name]), 2) for name in CAMERAS])
    depends = lil_matrix((len(rows), len(start)), dtype=int)
    for row, place in enumerate(rows):
        depends[row, :6] = 1
        depends[row, 6 + 3 * place : 9 + 3 * place] = 1
    fit = least_squares(
        misfit, start, loss="soft_l1", f_scale=PIXEL_ERROR, x_scale="jac", jac_sparsity=depends
    )
    return fit.x[:3], fit.x[3:6]


def prepare(options: argparse.Namespace) -> Iterator[str]:
    """Calibrations, and labels by point."""
    import tomllib

    import cv2

    out, labels = options.inputs, read_labels(options.data)
    out.mkdir(parents=True, exist_ok=True)
    entries = tomllib.loads((options.data / "calibration.toml").read_text())
    lenses: dict[str, dict[str, Any]] = {}
    for entry in (entry for entry in entries.values() if "matrix" in entry):
        rotation = cv2.Rodrigues(np.array(entry["rotation"]))[0].tolist()
        pose = {"R": rotation, "t": (np.array(entry["translation"]) / 1000).tolist(), "size": entry["size"]}
        lenses[entry["name"]] = {"K": entry["matrix"], "D": entry["distortions"], **pose}
    for name, lens in lenses.items():
        (out / f"{name}.json").write_text(json.dumps(lens))
    fitted = {name: np.concatenate([rows[name][[*FITTED]] for rows in labels.values()]) for name in CAMERAS}
    turn, shift = fit_side(lenses["side"], Cameras(out), fitted)
    lenses["side"] |= {"R": cv2.Rodrigues(turn)[0].tolist(), "t": shift.tolist()}
    (out / "side.json").write_text(json.dumps(lenses["side"]))
    side = Cameras(out)
    errors = [side.by_name[name].project(side.triangulate(fitted)) - rows for name, rows in fitted.items()]
    medians = np.nanmedian(np.linalg.norm(errors, axis=2), axis=1)
    each = ", ".join(f"{name} {error:.1f}" for name, error in zip(fitted, medians, strict=True))
    yield f"pose of side by labels of frames {', '.join(map(str, FITTED))}; median errors {each} px"
    rows = {f"{name}/{camera}": labels[name][camera] for name in labels for camera in CAMERAS}
    np.savez(out / "labels.npz", **rows)
    (out / "videos.json").write_text(
        json.dumps({name: str(options.data / f"{name}.mp4") for name in CAMERAS})
    )


def read_inputs(folder: Path, name: str) -> dict[str, Floats]:
    """Camera -> (F, 2) labels of a point."""
    with np.load(folder / "labels.npz") as labels:
        return {camera: labels[f"{name}/{camera}"] for camera in CAMERAS}


def follow_in_space(options: argparse.Namespace) -> Iterator[str]:
    """Places of points that all cameras follow together, a target each."""
    folder, names = options.inputs, options.cameras.split(",")
    lines = [f"{name}: {{calibration: {name}.json}}" for name in names]
    graph = folder / f"{options.agent}_{'_'.join(names)}.yaml"
    graph.write_text(
        SPACE.format(
            cameras="\n  ".join(lines),
            names=", ".join(names),
            size=options.size,
            agent=AGENTS[options.agent],
        )
    )
    videos = json.loads((folder / "videos.json").read_text())
    options.out.mkdir(parents=True, exist_ok=True)
    starts = []
    for point in options.points.split(","):
        first = {name: rows[0] for name, rows in read_inputs(folder, point).items() if name in names}
        starts.append(Start(points={n: tuple(xy) for n, xy in first.items() if np.isfinite(xy).all()}))
    places = [
        [[target.state[f"{axis}_m"] for axis in "xyz"] for target in result.targets]
        for result in track(graph, {name: videos[name] for name in names}, starts)
    ]
    for number, point in enumerate(options.points.split(",")):
        np.save(options.out / f"{point}.npy", np.array(places)[:, number])
    yield f"{len(places)} frames, {len(starts)} points, {', '.join(names)}"


def follow_alone(options: argparse.Namespace) -> Iterator[str]:
    """Places of points that each camera follows by itself, triangulated."""
    import cv2

    folder, cameras = options.inputs, Cameras(options.inputs)
    videos = json.loads((folder / "videos.json").read_text())
    graph = folder / f"{options.agent}_alone.yaml"
    graph.write_text(IMAGE.format(agent=AGENTS[options.agent]))
    labels = {point: read_inputs(folder, point) for point in options.points.split(",")}
    first = {p: cameras.triangulate({c: rows[:1] for c, rows in labels[p].items()})[0] for p in labels}
    followed = {p: {c: np.full((FRAMES, 2), np.nan) for c in CAMERAS} for p in labels}
    for name in CAMERAS:
        video, trackers = cv2.VideoCapture(videos[name]), {}
        for frame in range(FRAMES):
            image = video.read()[1]
            for point in labels:
                x, y = labels[point][name][0]
                if frame == 0 and np.isfinite(x + y):
                    ball = np.array([[*first[point][:2], options.size, options.size, first[point][2]]])
                    side = float(cameras.by_name[name].boxes(ball)[0, 2])
                    trackers[point] = Tracker(graph)
                    trackers[point].init(image, (x - (side - 1) / 2, y - (side - 1) / 2, side, side))
                elif point in trackers:
                    trackers[point].update(image)
                if point in trackers:
                    followed[point][name][frame] = trackers[point].centre_box[:2]
    options.out.mkdir(parents=True, exist_ok=True)
    for point, rows in followed.items():
        np.save(options.out / f"{point}.npy", cameras.triangulate(rows, options.loss))
    yield f"{FRAMES} frames, {len(labels)} points, each camera by itself"


def score(options: argparse.Namespace) -> Iterator[str]:
    """Errors against triangulated labels, frames of the fit and frame 0 left out."""
    cameras = Cameras(options.inputs)
    scored = np.setdiff1d(np.arange(1, FRAMES), FITTED)
    for point in options.points.split(","):
        truth = cameras.triangulate(read_inputs(options.inputs, point)) * 1000
        still = np.repeat(truth[:1], FRAMES, axis=0)
        runs = {out.name: np.load(out / f"{point}.npy") * 1000 for out in options.outs}
        for name, places in {"stays": still, **runs}.items():
            far = np.linalg.norm(places - truth, axis=1)[scored]
            yield (
                f"{point} {name}: median {np.nanmedian(far):.2f}, 90 % {np.nanquantile(far, 0.9):.2f}, "
                f"rms {np.sqrt(np.nanmean(far**2)):.2f} mm"
            )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Points of a mouse in four videos.")
    commands = parser.add_subparsers(required=True)
    first = commands.add_parser("prepare")
    first.add_argument("data", type=Path)
    first.add_argument("inputs", type=Path)
    first.set_defaults(action=prepare)
    for name, action in (("track", follow_in_space), ("alone", follow_alone), ("score", score)):
        command = commands.add_parser(name)
        command.add_argument("inputs", type=Path)
        command.add_argument(
            "outs" if name == "score" else "out", type=Path, nargs="+" * (name == "score") or None
        )
        command.add_argument("--points", default=",".join(REPORTED), help="of the labels")
        command.add_argument("--cameras", default=",".join(CAMERAS), help="of `track`")
        command.add_argument("--agent", choices=[*AGENTS], default="template")
        command.add_argument("--size", type=float, default=0.015, help="of the box, m")
        command.add_argument("--loss", default="linear", help="of `alone`: linear or soft_l1")
        command.set_defaults(action=action)
    options = parser.parse_args(arguments)
    for line in options.action(options):
        print(line, flush=True)


if __name__ == "__main__":
    main()
