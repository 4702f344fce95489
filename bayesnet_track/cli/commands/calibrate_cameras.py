"""The commands `calibrate camera`, `ground` and `poses`: a lens, and places of cameras over their ground."""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.arguments import (
    OK,
    UsageError,
    check_free,
    complain,
    say,
    users_mistake,
    users_output,
)

if TYPE_CHECKING:
    from bayesnet_track.numerics.arrays import Floats, Image
    from bayesnet_track.vision.camera_calibration import GroundFit

COLUMNS = ("px", "py", "x", "y")
HUGE_M = 300.0
"""Diagonal of ground points, m, above which they are probably in centimetres or millimetres."""


def calibrate_camera(options: argparse.Namespace) -> int:
    """Calibrate a lens from a video of a chessboard."""
    from bayesnet_track.vision.calibration import find_corners
    from bayesnet_track.vision.camera_calibration import fit_lens, write_camera

    board, path = options.board, Path(options.out)
    check_free(path, options.overwrite)
    detected, looked, size = [], 0, (0, 0)
    sample: list[Image] = []
    step = 1
    for image in _images(options.source, options.value_range, options.stride):
        looked, size = looked + 1, (image.shape[1], image.shape[0])
        corners = find_corners(image, board, is_small_sought=False)
        if corners is not None:
            detected.append(corners)
        if looked % step == 0:
            sample.append(image)
        if len(sample) > 8:
            sample, step = sample[1::2], 2 * step
    with users_mistake():
        fit = fit_lens(detected, size, board, options.square_m, sample)
    with users_output(path):
        write_camera(path, fit.intrinsics, {"rms_px": fit.rms_px})
    matrix, distortion = fit.intrinsics.matrix, fit.intrinsics.distortion
    say(f"board whole in {len(detected)} of {looked} frames; {fit.views} of them used")
    say(f"reprojection rms: {fit.rms_px:.3f} px, of the worst frame {fit.worst_px:.3f} px")
    say(
        f"focal length {matrix[0, 0]:.1f}, {matrix[1, 1]:.1f} px (sd {fit.focal_sd_px:.1f}), principal point "
        f"{matrix[0, 2]:.1f}, {matrix[1, 2]:.1f} px, distortion "
        f"{', '.join(f'{k:.4g}' for k in distortion[:4])}"
    )
    if min(fit.covered) < 0.6:
        complain(
            f"the board covers {fit.covered[0]:.0%} of the width and {fit.covered[1]:.0%} of the height; the "
            "distortion of the rest is a guess: move the board to the borders too"
        )
    if fit.rms_px > 1.0:
        complain(
            "the rms is above 1 px: is the board flat, are frames blurred, does the camera change its focus?"
        )
    say(f"wrote {path}; next: `bayesnet-track calibrate ground … --intrinsics {path}`")
    return OK


def calibrate_ground(options: argparse.Namespace) -> int:
    """Find a camera's place over the ground from points with known metres."""
    from bayesnet_track.observation.calibrations import read_intrinsics
    from bayesnet_track.vision.camera_calibration import fit_ground, write_camera

    path = Path(options.out)
    check_free(path, options.overwrite)
    if bool(options.points) == bool(options.point):
        raise UsageError("give the points either by --points FILE or by --point, four or more of them")
    image = read_frame(options.source, options.frame, options.value_range)
    size = (image.shape[1], image.shape[0])
    with users_mistake():
        numbers = read_points(Path(options.points)) if options.points else parse_points(options.point)
        lens = None if options.intrinsics is None else read_intrinsics(options.intrinsics)
        _check_inside(numbers[:, :2], size)
        fit = fit_ground(numbers[:, :2], numbers[:, 2:], size, lens)
    _say_fit(fit, numbers)
    rms = math.sqrt(float((fit.residuals_px**2).mean()))
    with users_output(path):
        write_camera(path, fit.view, {"rms_px": rms})
    if lens is None:
        _say_heights(fit)
    say(f"wrote {path}")
    return OK


def _say_fit(fit: GroundFit, numbers: Floats) -> None:
    """Print the residuals, point by point, the place and what looks wrong."""
    from bayesnet_track.numerics.cameras import Camera

    say("point     px      py        x m      y m    off px    off m")
    for n, ((px, py, x, y), error_px, off_m) in enumerate(
        zip(numbers, fit.residuals_px, fit.residuals_m, strict=True), 1
    ):
        say(f"{n:5} {px:7.1f} {py:7.1f} {x:10.3f} {y:8.3f} {error_px:9.2f} {off_m:8.3f}")
    rms = math.sqrt(float((fit.residuals_px**2).mean()))
    say(f"rms {rms:.2f} px, {math.sqrt(float((fit.residuals_m**2).mean())):.3f} m on the ground")
    if isinstance(fit.view, Camera):
        x, y, z = fit.view.centre
        say(f"the camera stands at x {x:.2f}, y {y:.2f} m, {z:.2f} m above the ground")
    if fit.extent_m > HUGE_M:
        complain(f"the points extend over {fit.extent_m:.0f} m: are x and y in metres, not in cm or mm?")
    if fit.spare == 0:
        complain(
            "four points without a known lens fit exactly, whatever they are: give more to see the error"
        )
    worst = int(fit.residuals_px.argmax())
    if len(numbers) > 4 and fit.residuals_px[worst] > max(5.0, 2 * rms / math.sqrt(1 + rms / 50)):
        complain(f"point {worst + 1} is {fit.residuals_px[worst]:.0f} px off: check its pixels and metres")
    elif fit.is_bad.any():
        complain(
            f"the points do not fit: rms {rms:.0f} px where clicks and a tape explain some "
            f"{0.002 * math.hypot(*fit.size):.0f} px; are the pixels and the lens those of this camera and "
            "zoom, and is no distance misread?"
        )


def _say_heights(fit: GroundFit) -> None:
    """Say whether heights follow from the homography."""
    from bayesnet_track.numerics.cameras import CameraError, GroundHomography

    assert isinstance(fit.view, GroundHomography)
    try:
        _ = fit.view.projection
    except CameraError as error:
        complain(f"foot points only: {error}")
        return
    say(
        "no --intrinsics: heights are by the focal length that follows from the points, "
        "if pixels are square and the lens does not distort"
    )


def calibrate_poses(options: argparse.Namespace) -> int:
    """Find the places of several cameras from a board that all see."""
    import json

    from bayesnet_track.observation.calibrations import read_intrinsics
    from bayesnet_track.vision.camera_calibration import camera_entries, fit_poses

    board, path = options.board, Path(options.out)
    check_free(path, options.overwrite)
    if path.suffix.lower() != ".json":
        raise UsageError(
            f"--out {path}: the file of several cameras is JSON; give it a name such as {path.stem}.json"
        )
    sources, files = (dict(_named(texts)) for texts in (options.source, options.intrinsics))
    if sources.keys() != files.keys() or len(sources) < 2:
        raise UsageError(
            f"cameras {', '.join(sources)} have a --source, and {', '.join(files)} --intrinsics; "
            "two cameras or more are needed, each with both"
        )
    images = {name: read_frame(text, options.frame, options.value_range) for name, text in sources.items()}
    with users_mistake():
        lenses = {name: read_intrinsics(text) for name, text in files.items()}
        fit = fit_poses(images, lenses, board, options.square_m)
    entries = {
        name: {key: getattr(value, "tolist", lambda value=value: value)() for key, value in parts.items()}
        for name, parts in ((name, camera_entries(camera)) for name, camera in fit.cameras.items())
    }
    with users_output(path):
        path.write_text(json.dumps({"unit": "m", "cameras": entries}, indent=1) + "\n", encoding="utf-8")
    for name, camera in fit.cameras.items():
        x, y, z = camera.centre
        say(
            f"{name}: rms {fit.residuals_px[name]:.3f} px; at x {x:.2f}, y {y:.2f} m, {z:.2f} m above the "
            "board"
        )
    say(f"wrote {path}: the ground is the board's plane, the origin its first corner at a dark outer square")
    return OK


def _named(texts: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Names and values of NAME=VALUE, each name once."""
    names = set()
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals and value) or name in names:
            raise UsageError(f"{text!r}: NAME=VALUE is needed, each name once, as north=north.mp4")
        names.add(name)
        yield name, value


def parse_points(texts: Sequence[str]) -> Floats:
    """(N, 4) px, py, x, y of texts "px,py=x,y".

    Raises:
        UsageError: a text is something else.
    """
    import numpy as np

    rows = []
    for text in texts:
        try:
            row = [float(word) for side in text.split("=") for word in side.split(",")]
        except ValueError:
            row = []
        if len(row) != 4 or text.count("=") != 1 or not all(map(math.isfinite, row)):
            raise UsageError(f"--point {text!r}: pixels = metres are needed, as 812,403=3.5,0")
        rows.append(row)
    return np.array(rows)


def read_points(path: Path) -> Floats:
    """(N, 4) px, py, x, y of a CSV file with these names in its header line, in any order.

    Raises:
        ValueError: no such columns, a line with another number of values, or one that is no number.
    """
    import numpy as np

    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        header = [word.strip().lower() for word in next(reader, [])]
        if sorted(header) != sorted(COLUMNS):
            raise ValueError(f"{path}:1: {','.join(header)!r}; allowed: a header line {','.join(COLUMNS)}")
        rows = []
        for words in reader:
            if not any(word.strip() for word in words):
                continue
            try:
                row = [float(word) for word in words]
            except ValueError:
                row = []
            if len(row) != len(header) or not all(map(math.isfinite, row)):
                raise ValueError(f"{path}:{reader.line_num}: {','.join(words)!r}; allowed: four numbers")
            rows.append([row[header.index(name)] for name in COLUMNS])
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def _check_inside(pixels: Floats, size: tuple[int, int]) -> None:
    is_outside = ((pixels < -0.5) | (pixels > [size[0] - 0.5, size[1] - 0.5])).any(axis=1)
    if is_outside.any():
        number = int(is_outside.argmax())
        px, py = pixels[number]
        raise ValueError(
            f"point {number + 1} at {px:g}, {py:g} px is outside the image of {size[0]}x{size[1]}; pixels "
            "are "
            "counted from the top left corner of the image in its full size"
            + ("; all would be in one that lies on its side" * bool((pixels < size[::-1]).all()))
        )


def _images(text: str, value_range: tuple[float, float] | None, stride: int | None) -> Iterator[Image]:
    """Images of a source, of a video every fifth."""
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.sources.paths import SourceError
    from bayesnet_track.sources.sources import open_source

    if stride is None:
        stride = 5 if Path(text).is_file() else 1
    with open_source(text, value_range=value_range, stride=stride) as source:
        for item in source:
            if isinstance(item, Frame):
                yield item.image
        if source.end_reason == "frame_size_changed":
            raise SourceError(text, "images of several sizes", "one size", "take out the others")


def read_frame(text: str, number: int, value_range: tuple[float, float] | None) -> Image:
    """One frame of a source."""
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.sources.sources import open_source

    with open_source(text, start=number, end=number + 1, value_range=value_range) as source:
        for item in source:
            if isinstance(item, Frame):
                return item.image
    raise UsageError(f"{text}: there is no frame {number}")
