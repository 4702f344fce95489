"""Commands that look at a source before a run: `detect`, and `cameras`, the ground of a camera."""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    INCOMPLETE,
    OK,
    UsageError,
    add_plugins,
    check_free,
    complain,
    run_silently,
    say,
    users_mistake,
    users_output,
    whole_number,
)
from bayesnet_track.cli.commands.calibrate_cameras import read_frame, read_points
from bayesnet_track.cli.options import (
    add_depth_options,
    add_range_option,
    add_size_option,
    add_window_options,
    open_given,
)
from bayesnet_track.numerics.compile_watch import WATCH

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayesnet_track.numerics.outlines import GroundView
    from bayesnet_track.observation.cue import CueDeclaration
    from bayesnet_track.observation.detector import Detector, DetectorDeclaration, DetectorState
    from bayesnet_track.observation.planes import Frame, FramePair
    from bayesnet_track.runtime.resizing import Resizing
    from bayesnet_track.sources.frames import Source


JSON_LINES = (".jsonl", ".json", ".ndjson")


def _detect(options: argparse.Namespace) -> int:
    """Detect in every frame; write MOT or JSON Lines, and a video on request."""
    from bayesnet_track.observation.detector import DetectorError, LearningDetector
    from bayesnet_track.observation.planes import ways_of_depth
    from bayesnet_track.sources.paths import SourceError

    if options.end is not None and options.end <= options.start:
        raise UsageError(f"--end {options.end} must be greater than --start {options.start}")
    declaration = _declaration(options.name)
    parameters = read_parameters(declaration, options.set)
    for path in (options.out, options.save_video):
        if path is not None:
            check_free(Path(path), options.overwrite)
    with users_mistake():
        detector = declaration.make(parameters)
        state = detector.start()
    if options.learn is not None and not isinstance(detector, LearningDetector):
        raise UsageError(f"--learn: {declaration.name} cannot be shown a target")
    with ExitStack() as stack:
        source = stack.enter_context(open_given(options))
        try:
            declaration.check_source(source.has_color, source.has_depth)
        except DetectorError as error:
            needed = "one with colour" if declaration.needs_color else ways_of_depth()
            mend = "give one, or use another detector"
            raise SourceError(source.description, str(error), needed, mend) from error
        try:
            return _detect_all(options, detector, state, source, stack)
        except DetectorError as error:
            raise UsageError(str(error)) from error


def _detect_all(
    options: argparse.Namespace,
    detector: Detector,
    state: DetectorState,
    source: Source,
    stack: ExitStack,
) -> int:
    from bayesnet_track.journal.text.wording import plural
    from bayesnet_track.journal.writer import LineFile
    from bayesnet_track.observation.detector import NOTHING, LearningDetector
    from bayesnet_track.observation.planes import Frame, FramePair
    from bayesnet_track.runtime.arguments import resizing_of
    from bayesnet_track.runtime.pace import Progress
    from bayesnet_track.runtime.recording.videowriter import VideoWriter
    from bayesnet_track.runtime.results import interval_of
    from bayesnet_track.sources.detection_files import format_frame
    from bayesnet_track.view.overlay import draw_detections

    with users_mistake():
        resizing = resizing_of(source, options.max_side)
    learns = isinstance(detector, LearningDetector)
    file: LineFile | None = None
    video: VideoWriter | None = None
    previous: Frame | None = None
    frames = count = 0
    # Where detections are printed, a line that is redrawn would stand among them.
    progress = Progress(sys.stderr, source.expected_frames, sys.stderr.isatty() and options.out is not None)
    for item in source:
        if not isinstance(item, Frame):
            continue
        frame = resizing.frame(item)
        pair = FramePair(frame, previous)
        if previous is None:
            state = _show(options, detector, pair, state, resizing) if learns else state
            if options.out is not None:
                file = stack.enter_context(LineFile(Path(options.out)))
            if options.save_video is not None:
                size = (item.width, item.height, interval_of(source))
                video = stack.enter_context(VideoWriter(Path(options.save_video), *size))
        detected, state = detector.detect(pair, state)
        detections = resizing.found(NOTHING if detected is None else detected)
        for line in format_frame(item, detections, _is_json(options)):
            (say if file is None else file.append)(line)
        if file is not None:
            file.flush()
        if video is not None:
            video.write(draw_detections(item.image, detections))
        previous, frames, count = frame, frames + 1, count + len(detections)
        text = plural(count, "detection")
        run_silently(partial(progress.advance, time.monotonic() - WATCH.seconds, frames, text, {}))
    run_silently(progress.finish)
    complain(f"{plural(count, 'detection')} in {plural(frames, 'frame')}")
    if source.end_reason != "end_of_source":
        complain(f"{source.description}: {source.end_reason.replace('_', ' ')}")
        return INCOMPLETE
    return OK


def _declaration(name: str) -> DetectorDeclaration:
    from bayesnet_track.graph.text.messages import nearest
    from bayesnet_track.observation.detector import ENTRY_POINT_GROUP, installed_detectors
    from bayesnet_track.observation.plugins import why_absent

    declarations = installed_detectors([name])
    if name not in declarations:
        if (absent := why_absent(ENTRY_POINT_GROUP, name)) is not None:
            raise UsageError(f"detector {absent[0]}; {absent[1]}")
        suggestion = nearest(name, declarations)
        hint = f"; did you mean {suggestion}?" if suggestion else ""
        raise UsageError(f"no detector is called {name!r}; there are {', '.join(declarations)}{hint}")
    return declarations[name]


def read_parameters(declaration: DetectorDeclaration | CueDeclaration, settings: Sequence[str]) -> Any:
    """A detector's or cue's parameters from texts ``key=value``, values as in YAML; raises UsageError."""
    import yaml
    from pydantic import ValidationError

    from bayesnet_track.graph.text.messages import nearest

    values: dict[str, Any] = {}
    for text in settings:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise UsageError(f"--set {text!r}: key=value is needed")
        if key in values:
            raise UsageError(f"--set {key} is given twice")
        try:
            values[key] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise UsageError(f"--set {key}: {value!r} is no value: {error}") from error
    try:
        return declaration.parameters.model_validate(values)
    except ValidationError as error:
        raise UsageError("\n".join(_mistakes(error, declaration, nearest))) from None


def _mistakes(error: Any, declaration: DetectorDeclaration | CueDeclaration, nearest: Any) -> list[str]:
    fields, messages = declaration.parameters.model_fields, []
    for fault in error.errors(include_url=False):
        key = str(fault["loc"][0]) if fault["loc"] else ""
        reason = fault["msg"].removeprefix("Value error, ")
        if fault["type"] == "extra_forbidden":
            suggestion = nearest(key, fields)
            hint = f"; did you mean {suggestion}?" if suggestion else ""
            messages.append(f"{declaration.name} has no parameter {key!r}; it has {', '.join(fields)}{hint}")
        elif key in fields:
            messages.append(f"{key}: {reason} ({(fields[key].description or '').rstrip('.')})")
        else:
            messages.append(reason)
    return list(dict.fromkeys(messages))


def _show(
    options: argparse.Namespace, detector: Any, pair: FramePair, state: DetectorState, resizing: Resizing
) -> DetectorState:
    """The state of a detector that learns, with the target of --learn."""
    from bayesnet_track.engine.starts import Start, StartError, check_box
    from bayesnet_track.numerics.boxes import centre_from_corner

    if options.learn is not None:
        try:
            box = [float(part) for part in options.learn.split(",")]
            if len(box) != 4:
                raise ValueError
        except ValueError:
            format_hint = "four numbers X,Y,W,H are needed (top-left corner, px)"
            raise UsageError(f"--learn {options.learn!r}: {format_hint}") from None
        try:
            check_box(box, *resizing.source)
        except StartError as error:
            raise UsageError(f"--learn {options.learn!r}: {error}") from None
        x, y, w, h = box
        small = resizing.start(Start((x, y, w, h))).box
        learned: DetectorState = detector.learn(pair, centre_from_corner(small), state)
        return learned
    if not detector.knows_target(state):
        raise UsageError(
            f"{options.name} has nothing to look for: give --learn X,Y,W,H, or --set what to look for"
        )
    return state


def _is_json(options: argparse.Namespace) -> bool:
    return options.out is not None and Path(options.out).suffix.lower() in JSON_LINES


def _add_detect(commands: argparse._SubParsersAction[Any]) -> None:
    detect = commands.add_parser("detect", help="find targets in every frame with a detector")
    detect.add_argument("name", metavar="DETECTOR", help="see `list`")
    detect.add_argument(
        "--source", required=True, help="video file, folder of images, glob, camera index, or URL"
    )
    add_depth_options(detect)
    detect.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of the detector, as YAML"
    )
    detect.add_argument(
        "--learn",
        metavar="X,Y,W,H",
        help="box of the target in the first frame, for a detector that learns",
    )
    detect.add_argument(
        "-o",
        "--out",
        metavar="FILE",
        help="file to write: JSON Lines if it ends in .jsonl, else MOT (default: print)",
    )
    detect.add_argument(
        "--save-video", metavar="FILE", help="also write the video with the boxes (.mkv or .mp4)"
    )
    add_size_option(detect)
    add_window_options(detect)
    detect.add_argument("--overwrite", action="store_true", help="replace existing files")
    add_plugins(detect)


FAR_OFF_PX = 5.0


def _cameras(options: argparse.Namespace) -> int:
    """Draw the ground grid, people for scale, and residuals of known points over a frame."""
    import cv2
    import numpy as np

    from bayesnet_track.numerics.cameras import Camera
    from bayesnet_track.view.overlay import draw_ground, draw_points

    path = Path(options.out)
    check_free(path, options.overwrite)
    with users_mistake():
        views = read_cameras(Path(options.file))
        name = _camera_name(views, options.camera)
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
            errors_px = draw_points(picture, view, read_points(Path(options.points)))
            say(
                f"{len(errors_px)} points: rms {np.sqrt(np.nanmean(errors_px**2)):.2f} px, "
                f"worst {np.nanmax(errors_px):.2f} px"
            )
            if np.nanmax(errors_px) > FAR_OFF_PX or np.isnan(errors_px).any():
                complain(
                    "a point is far from where the camera has it: the camera was moved, or points are wrong"
                )
    if isinstance(view, Camera):
        x, y, z = view.centre
        say(f"{name or 'the camera'} stands at x {x:.2f}, y {y:.2f} m, {z:.2f} m above the ground")
    good, data = cv2.imencode(path.suffix or ".png", picture)
    if not good:
        raise UsageError(f"--out {path}: an image such as cameras.png is needed")
    with users_output(path):
        path.write_bytes(data.tobytes())
    say(f"wrote {path}: a line every {step:g} m, the axes x = 0 and y = 0 red, people 1.7 m high blue")
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


def _camera_name(views: dict[str, GroundView], name: str | None) -> str:
    if name is None and len(views) == 1:
        return next(iter(views))
    if name not in views:
        raise UsageError(f"--camera {name or ''}: allowed: one of {', '.join(views)}")
    return name


def _add_cameras(commands: argparse._SubParsersAction[Any]) -> None:
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


COMMANDS = {"detect": (_add_detect, _detect), "cameras": (_add_cameras, _cameras)}
