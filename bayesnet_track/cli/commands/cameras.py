"""The command `cameras`: the ground of a calibrated camera, drawn over a frame before the first run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    OK,
    UsageError,
    check_free,
    complain,
    say,
    users_mistake,
    whole_number,
    writing,
)
from bayesnet_track.cli.commands.calibrate_cameras import read_frame, read_points
from bayesnet_track.cli.options import add_range_option

if TYPE_CHECKING:
    from bayesnet_track.numerics.cameras import GroundView

FAR_OFF_PX = 5.0


def cameras(options: argparse.Namespace) -> int:
    """Draw the ground grid, people for scale, and residuals of known points over a frame."""
    import cv2
    import numpy as np

    from bayesnet_track.numerics.cameras import Camera
    from bayesnet_track.view.ground_picture import draw_ground, draw_points

    out = Path(options.out)
    check_free(out, options.overwrite)
    with users_mistake():
        views = read_cameras(Path(options.file))
        name = _chosen(views, options.camera)
        view = views[name]
    image = read_frame(options.source, options.frame, options.value_range)
    size = (image.shape[1], image.shape[0])
    if view.size not in (None, size):
        w, h = view.size or size
        raise UsageError(
            f"{options.source} has frames of {size[0]}x{size[1]}, camera {name!r} is calibrated for {w}x{h}; "
            "give frames of that size"
        )
    with users_mistake():
        picture, step = draw_ground(image, view)
        if options.points is not None:
            off = draw_points(picture, view, read_points(Path(options.points)))
            say(f"{len(off)} points: rms {np.sqrt(np.nanmean(off**2)):.2f} px, worst {np.nanmax(off):.2f} px")
            if np.nanmax(off) > FAR_OFF_PX or np.isnan(off).any():
                complain(
                    "a point is far from where the camera has it: the camera was moved, or points are wrong"
                )
    if isinstance(view, Camera):
        x, y, z = view.centre
        say(f"{name or 'the camera'} stands at x {x:.2f}, y {y:.2f} m, {z:.2f} m above the ground")
    good, data = cv2.imencode(out.suffix or ".png", picture)
    if not good:
        raise UsageError(f"--out {out}: an image such as cameras.png is needed")
    with writing(out):
        out.write_bytes(data.tobytes())
    say(f"wrote {out}: a line every {step:g} m, the axes x = 0 and y = 0 red, people 1.7 m high blue")
    return OK


def read_cameras(path: Path) -> dict[str, GroundView]:
    """Cameras of a graph, or of a calibration file, by name.

    Raises:
        OSError, ValueError: the file cannot be read, or has no camera.
    """
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.observation.calibrations import read_calibration, read_calibrations

    is_graph = path.suffix.lower() in (".yaml", ".yml", "") and (
        not path.is_file()
        or any(line.startswith("bayesnet:") for line in path.read_text("utf-8").splitlines())
    )
    if not is_graph:
        return read_calibrations(path)
    spec = load_graph(str(path)).spec
    if not spec.cameras:
        raise ValueError(f"{path}: it has no cameras; add `cameras: {{north: {{calibration: FILE}}}}`")
    return {
        name: read_calibration(path.parent / camera.calibration, camera.name)
        for name, camera in spec.cameras.items()
    }


def _chosen(views: dict[str, GroundView], name: str | None) -> str:
    if name is None and len(views) == 1:
        return next(iter(views))
    if name not in views:
        raise UsageError(f"--camera {name or ''}: allowed: one of {', '.join(views)}")
    return name


def add_cameras(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    cameras = commands.add_parser(
        "cameras", help="draw the ground of a calibrated camera, in metres, over a frame"
    )
    cameras.add_argument("file", metavar="FILE", help="graph with `cameras`, or a calibration file")
    cameras.add_argument("--source", required=True, metavar="SOURCE", help="image or video of the camera")
    cameras.add_argument("--camera", metavar="NAME", help="which camera, if there are several")
    cameras.add_argument(
        "--frame", type=whole_number(0), default=0, metavar="N", help="frame of a video (default 0)"
    )
    cameras.add_argument(
        "--points", metavar="CSV", help="known points (px,py,x,y): draw how far they are off"
    )
    add_range_option(cameras)
    cameras.add_argument(
        "-o", "--out", default="cameras.png", metavar="FILE", help="image to write (default cameras.png)"
    )
    cameras.add_argument("--overwrite", action="store_true", help="replace the file if it exists")
