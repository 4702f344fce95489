"""Commands that learn from videos with ground truth: `learn-shape` and `learn-stereo`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    INCOMPLETE,
    OK,
    TRUTH_LINES,
    UsageError,
    add_truth_format,
    complain,
    gradient,
    say,
    share,
    users_file,
    users_mistake,
    users_output,
    whole_number,
)
from bayesnet_track.cli.commands.detect import read_parameters
from bayesnet_track.cli.options import add_depth_options, add_range_option, add_window_options, open_depth

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesnet_track.numerics.arrays import Floats
    from bayesnet_track.sources.frames import Source
    from bayesnet_track.vision.shape import ShapeModel

    Examples = list[tuple[str, Floats, float]]
    import numpy as np


SHOWN = 5
"""How many of the examples that are left out are named."""


def _learn_shape(options: argparse.Namespace) -> int:
    """Learn a model from the silhouettes of masks or boxes, write it, and say what it holds."""
    import numpy as np

    from bayesnet_track.vision.shape import learn_model

    if (options.source is None) != (options.truth is None):
        raise UsageError("--source and --truth belong together: a video, and the target's boxes in it")
    code, candidates = _from_masks(options) if options.masks is not None else _from_boxes(options)
    examples = [vector for _, vector, support in candidates if support >= options.min_support]
    poor = [name for name, _, support in candidates if support < options.min_support]
    if poor:
        named = ", ".join(poor[:SHOWN]) + (", ..." if len(poor) > SHOWN else "")
        complain(f"{len(poor)} left out, with too little of the silhouette on edges: {named}")
    if not examples:
        raise UsageError(f"no example is left of {len(candidates)}; nothing is written")
    model = learn_model(np.array(examples), options.keep)
    _write(Path(options.out), model)
    modes = f"{len(model.modes)} mode{'' if len(model.modes) == 1 else 's'}"
    total = float(model.variances.sum()) / model.explained
    spread = float(np.sqrt(total / model.mean.size))
    say(
        f"{options.out}: {len(examples)} examples, grid {model.grid}x{model.grid}, {modes} with "
        f"{100 * model.explained:.1f} % of the variance; root mean square spread {spread:.3f} half sides"
    )
    return code


def _from_masks(options: argparse.Namespace) -> tuple[int, Examples]:
    from bayesnet_track.sources.images import read_image
    from bayesnet_track.sources.paths import images_in, natural_key
    from bayesnet_track.vision.shape import mask_example

    if options.value_range is not None:
        raise UsageError("--range is for --source; a mask is what is not black")
    folder, examples = Path(options.masks), []
    with users_mistake():
        paths = sorted(images_in(folder), key=natural_key)
        if not paths:
            raise UsageError(f"{folder}: holds no images")
        for path in paths:
            try:
                examples.append((path.name, *mask_example(read_image(path)[0].max(axis=2), options.grid)))
            except ValueError as error:
                raise UsageError(f"{path}: {error}") from error
    return OK, examples


def _from_boxes(options: argparse.Namespace) -> tuple[int, Examples]:
    import numpy as np

    from bayesnet_track.evaluate.truth import read_truth
    from bayesnet_track.numerics.boxes import centre_from_corner
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.sources.entrances.notices import notice
    from bayesnet_track.sources.sources import open_source
    from bayesnet_track.vision.planes import EdgePlane
    from bayesnet_track.vision.shape import frame_example

    with users_file("--truth", TRUTH_LINES):
        boxes = centre_from_corner(read_truth(options.truth, options.truth_format))
    edges, examples = EdgePlane(options.edge_gray), []
    with open_source(options.source, None, len(boxes), value_range=options.value_range) as source:
        last_index = -1
        for item in source:
            if isinstance(item, Frame):
                last_index = item.index
            if not isinstance(item, Frame) or item.index % options.every:
                continue  # a notice, or not asked for
            box = boxes[item.index]
            if np.isfinite(box).all():
                examples.append((f"frame {item.index}", *frame_example(item, box, edges, options.grid)))
    if not examples:
        raise UsageError(f"{options.truth}: no box for any frame of {options.source}")
    if last_index + 1 < len(boxes):
        notice(
            f"{options.truth} has {len(boxes)} rows, {options.source} {last_index + 1} frames: is it of this "
            f"video? Not used: rows {last_index + 1} to {len(boxes) - 1}, counted from 0"
        )
    if source.end_reason != "end_of_source":
        complain(f"{options.source}: {source.end_reason.replace('_', ' ')}; learnt from what could be read")
        return INCOMPLETE, examples
    return OK, examples


def _write(path: Path, model: ShapeModel) -> None:
    from bayesnet_track.vision.shape import save_model

    with users_output(path):
        save_model(path, model)


def _add_learn_shape(commands: argparse._SubParsersAction[Any]) -> None:
    shape = commands.add_parser("learn-shape", help="learn a shape model from masks, or boxes on a video")
    shape.add_argument("out", metavar="MODEL", help="model file to write (.npz)")
    examples = shape.add_mutually_exclusive_group(required=True)
    examples.add_argument("--masks", metavar="DIR", help="folder of mask images: the target is not black")
    examples.add_argument("--source", help="video file, folder of images, or glob")
    shape.add_argument("--truth", metavar="FILE", help="ground-truth file of the boxes in --source")
    add_truth_format(shape)
    add_range_option(shape)
    shape.add_argument("--every", type=whole_number(1), default=1, metavar="N", help="every Nth frame only")
    shape.add_argument("--grid", type=_cells, default=16, metavar="G", help="cells per side (default 16)")
    shape.add_argument(
        "--keep",
        type=share,
        default=0.95,
        metavar="SHARE",
        help="variance that the modes keep (default .95)",
    )
    shape.add_argument(
        "--min-support",
        type=share,
        default=0.5,
        metavar="SHARE",
        help="leave out silhouettes with a smaller share on edges (default .5)",
    )
    shape.add_argument(
        "--edge-gray",
        type=gradient,
        default=8.0,
        metavar="G",
        help="gradient where an edge starts, gray levels per pixel (default 8)",
    )


def _cells(text: str) -> int:
    """Parser of the cells of a shape grid."""
    if not (text.isascii() and text.isdigit() and 4 <= int(text[:4]) <= 64 and len(text) < 4):
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number from 4 to 64 is needed")
    return int(text)


ESTIMATED = ("sd_depth_m", "sd_spread_m", "sd_height_m", "sd_log_shape", "sd_valid")
"""Parameters of the stereo cue that are estimated, in the order of its features."""


LEAST_SHARE = 0.01
"""Least standard deviation, as a share of its default: examples may agree to the last digit."""


def _learn_stereo(options: argparse.Namespace) -> int:
    """Collect the features at the true boxes, estimate how much they vary, print the agent for a graph."""
    import numpy as np

    from bayesnet_track.evaluate.truth import read_truth
    from bayesnet_track.numerics.boxes import centre_from_corner
    from bayesnet_track.observation.cue import installed_cues
    from bayesnet_track.vision.stereo_planes import estimate_spread

    declaration = installed_cues()["stereo"]
    parameters = read_parameters(declaration, options.set)
    settings = parameters.model_dump(exclude_unset=True)
    for name in ESTIMATED:
        if name in settings:
            raise UsageError(f"--set {name}: it is what is estimated; leave it out")
    with users_file("--truth", TRUTH_LINES):
        boxes = centre_from_corner(read_truth(options.truth, options.truth_format))
    end = len(boxes) if options.end is None else min(options.end, len(boxes))
    if options.start >= end:
        raise UsageError(f"{options.truth}: no box from frame {options.start} on, of {end}")
    with open_depth(options, end) as source:
        frames, features = _examples(declaration.make(parameters), source, boxes, options.every)
    groups = np.zeros(len(frames), np.int64) if options.within is None else frames // options.within
    default = np.array([getattr(parameters, name) for name in ESTIMATED])
    try:
        spread = estimate_spread(features, groups, default, options.prior)
    except ValueError as error:
        hint = "" if options.within is None else "; a larger --within makes fewer groups"
        raise UsageError(f"too few boxes with a blob of depth: {error}{hint}") from error
    sd = np.maximum(spread.sd, LEAST_SHARE * default)
    grouping = "" if options.within is None else f", each about the mean of its {options.within} frames"
    say(f"# {len(frames)} examples{grouping}; the default counts for {options.prior:g} more")
    for name, estimate, was in zip(ESTIMATED, spread.raw, default, strict=True):
        say(f"# {name}: {estimate:.3g} in the examples, {was:g} by default")
    learnt = {name: float(f"{value:.3g}") for name, value in zip(ESTIMATED, sd, strict=True)}
    say(f"stereo: {{{', '.join(f'{key}: {_yaml(value)}' for key, value in {**settings, **learnt}.items())}}}")
    if source.end_reason != "end_of_source":
        complain(
            f"{source.description}: {source.end_reason.replace('_', ' ')}; learnt from what could be read"
        )
        return INCOMPLETE
    return OK


def _examples(cue: Any, source: Source, boxes: Floats, stride: int) -> tuple[NDArray[np.int64], Floats]:
    """(n,) frames with a blob in the true box, and (n, K) its features there."""
    import numpy as np

    from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, region_of_boxes

    frames, features, empty = [], [], []
    for item in source:
        if not isinstance(item, Frame) or item.index % stride:
            continue  # a notice, or not asked for
        box = boxes[item.index]
        if not np.isfinite(box).all():
            continue
        planes = PlaneCache(FramePair(item, None)).planes(cue.needs, region_of_boxes(box[None]))
        learnt = cue.learn(planes, box)
        if learnt["known"]:
            frames.append(item.index)
            features.append(learnt["features"])
        else:
            empty.append(str(item.index))
    if empty:
        named = ", ".join(empty[:SHOWN]) + (", ..." if len(empty) > SHOWN else "")
        complain(f"{len(empty)} left out, without a blob of depth in the box: frame {named}")
    if not frames:
        raise UsageError(f"no frame of {source.description} has a box with a blob of depth")
    return np.array(frames, dtype=np.int64), np.array(features)


def _yaml(value: Any) -> str:
    """A value of one line as a graph file has it."""
    import yaml

    text: str = yaml.safe_dump(value, default_flow_style=True)
    return text.removesuffix("\n").removesuffix("\n...")


def _add_learn_stereo(commands: argparse._SubParsersAction[Any]) -> None:
    stereo = commands.add_parser("learn-stereo", help="learn how much a target's depth features vary")
    stereo.add_argument("--source", required=True, help="video file, folder of images, or glob")
    add_depth_options(stereo)
    stereo.add_argument(
        "--truth", required=True, metavar="FILE", help="ground-truth file of the boxes in the left image"
    )
    add_truth_format(stereo)
    stereo.add_argument("--every", type=whole_number(1), default=1, metavar="N", help="every Nth frame only")
    stereo.add_argument(
        "--within",
        type=whole_number(2),
        metavar="N",
        help="measure the variation within N frames, about as many as the reference takes to follow "
        "(default: the whole video)",
    )
    stereo.add_argument(
        "--prior",
        type=whole_number(0),
        default=10,
        metavar="N",
        help="weight of the default, in examples (default 10)",
    )
    stereo.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of the cue, as YAML"
    )
    add_window_options(stereo)


COMMANDS = {
    "learn-shape": (_add_learn_shape, _learn_shape),
    "learn-stereo": (_add_learn_stereo, _learn_stereo),
}
