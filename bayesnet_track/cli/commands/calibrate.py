"""The command `calibrate stereo`: chessboard pictures in, calibration file out."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    OK,
    UsageError,
    check_free,
    metres,
    say,
    users_mistake,
    users_output,
    whole_number,
)
from bayesnet_track.cli.options import add_range_option

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def calibrate_stereo(options: argparse.Namespace) -> int:
    """Calibrate a pair of cameras from pictures of a chessboard."""
    from bayesnet_track.vision.calibration import calibrate_pair as fit
    from bayesnet_track.vision.calibration import write_calibration

    board, path = options.board, Path(options.out)
    check_free(path, options.overwrite)
    left, right = (read_all(text, options.value_range) for text in (options.left, options.right))
    with users_mistake():
        fitted = fit(left, right, board, options.square_m)
    with users_output(path):
        write_calibration(path, fitted.cameras)
    x, y, z = (-1000 * value for value in fitted.cameras.translation)
    unused = ", ".join(str(n) for n in range(len(left)) if n not in fitted.used)
    say(f"board whole in {len(fitted.used)} of {len(left)} pairs" + (f", not in {unused}" if unused else ""))
    say(
        f"reprojection rms: left {fitted.left_rms_px:.3f} px, right {fitted.right_rms_px:.3f} px, "
        f"both together {fitted.pair_rms_px:.3f} px"
    )
    say(f"rows after rectification differ by {fitted.epipolar_px:.3f} px")
    say(f"right camera at {x:.1f}, {y:.1f}, {z:.1f} mm of the left one (x right, y down, z forward)")
    say(f"wrote {path}")
    return OK


def parse_board(text: str) -> tuple[int, int]:
    """Inner corners across and down from ``9x6``.

    Raises:
        UsageError: it is something else.
    """
    columns, _, rows = text.partition("x")
    if not (columns.isascii() and columns.isdigit() and rows.isascii() and rows.isdigit()):
        raise UsageError(f"--board {text!r}: two numbers such as 9x6 are needed, the inner corners")
    board = int(columns), int(rows)
    if min(board) < 3 or max(board) > 100:
        raise UsageError(f"--board {text!r}: from 3 to 100 inner corners each way are allowed")
    return board


def read_all(text: str, value_range: tuple[float, float] | None = None) -> list[NDArray[np.uint8]]:
    """Every picture of a folder, glob or video.

    Raises:
        SourceError: there is none, or one of them cannot be read.
    """
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.sources.paths import SourceError
    from bayesnet_track.sources.sources import open_source

    with open_source(text, value_range=value_range) as source:
        items = list(source)
        if source.end_reason != "end_of_source":
            raise SourceError(
                text,
                f"it ends early: {source.end_reason.replace('_', ' ')}",
                "pictures of one size that can all be read",
                "take out what is damaged, in both eyes",
            )
    return [item.image for item in items if isinstance(item, Frame)]


def _calibrate(options: argparse.Namespace) -> int:
    """Calibrate what the first word says."""
    from bayesnet_track.cli.commands import calibrate_cameras

    actions = {
        "stereo": calibrate_stereo,
        "camera": calibrate_cameras.calibrate_camera,
        "ground": calibrate_cameras.calibrate_ground,
        "poses": calibrate_cameras.calibrate_poses,
    }
    if "board" in options:
        options.board = parse_board(options.board)
    return actions[options.what](options)


def _add_calibrate(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command, and what it calibrates."""
    calibrate = commands.add_parser(
        "calibrate", help="calibrate a camera, its place over the ground, or a stereo pair"
    )
    kinds = calibrate.add_subparsers(dest="what", metavar="WHAT", required=True)
    camera = kinds.add_parser("camera", help="focal length and distortion, from a video of a chessboard")
    camera.add_argument("source", metavar="SOURCE", help="video, folder or glob of images of the board")
    _add_board(camera)
    camera.add_argument(
        "--stride",
        type=whole_number(1),
        metavar="K",
        help="look at every K-th frame (default: 5 of a video, 1 of images)",
    )
    ground = kinds.add_parser("ground", help="place of a camera, from points of the ground with known metres")
    ground.add_argument("source", metavar="SOURCE", help="image or video of the camera")
    ground.add_argument(
        "--points", metavar="CSV", help="file with a header line px,py,x,y: pixels and metres"
    )
    ground.add_argument(
        "--point",
        action="append",
        default=[],
        metavar="PX,PY=X,Y",
        help="a point: pixels and metres; may be repeated",
    )
    ground.add_argument(
        "--intrinsics", metavar="FILE", help="calibration of the lens, as of `calibrate camera`"
    )
    poses = kinds.add_parser(
        "poses", help="places of several cameras, from a chessboard that all see on the ground"
    )
    poses.add_argument(
        "--source",
        action="append",
        required=True,
        metavar="NAME=SOURCE",
        help="a camera's video or image; repeated",
    )
    poses.add_argument(
        "--intrinsics",
        action="append",
        required=True,
        metavar="NAME=FILE",
        help="its lens, as of `calibrate camera`",
    )
    _add_board(poses)
    for parser in (ground, poses):
        parser.add_argument(
            "--frame", type=whole_number(0), default=0, metavar="N", help="frame of a video (default 0)"
        )
    stereo = kinds.add_parser("stereo", help="a stereo pair, from images of a chessboard")
    stereo.add_argument("left", metavar="LEFT", help="images of the left camera: folder, glob or video")
    stereo.add_argument("right", metavar="RIGHT", help="those of the right camera, in the same order")
    _add_board(stereo)
    for parser in (camera, ground, poses, stereo):
        add_range_option(parser)
        parser.add_argument("-o", "--out", required=True, metavar="FILE", help="calibration file to write")
        parser.add_argument("--overwrite", action="store_true", help="replace the file if it exists")


def _add_board(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--board", required=True, metavar="CxR", help="inner corners across and down: 9x6")
    parser.add_argument(
        "--square", dest="square_m", required=True, type=metres, metavar="M", help="side of a square, m"
    )


COMMANDS = {"calibrate": (_add_calibrate, _calibrate)}
