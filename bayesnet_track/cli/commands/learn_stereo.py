"""The command `learn-stereo`: standard deviations of the stereo cue, from the target's boxes on a pair."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    INCOMPLETE,
    OK,
    UsageError,
    add_truth_format,
    complain,
    say,
    users_mistake,
    whole_number,
)
from bayesnet_track.cli.commands.detect import read_parameters
from bayesnet_track.cli.options import add_depth_options, add_window_options, open_depth

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bayesnet_track.numerics.arrays import Floats
    from bayesnet_track.sources.frames import Source


ESTIMATED = ("sd_depth_m", "sd_spread_m", "sd_height_m", "sd_log_shape", "sd_valid")
"""Parameters of the stereo cue that are estimated, in the order of its features."""

SHOWN = 5
"""How many of the frames that are left out are named."""

LEAST_SHARE = 0.01
"""Least standard deviation, as a share of its default: examples may agree to the last digit."""


def learn_stereo(options: argparse.Namespace) -> int:
    """Collect the features at the true boxes, estimate how much they vary, print the agent for a graph."""
    import numpy as np

    from bayesnet_track.evaluate.truth import read_truth
    from bayesnet_track.numerics.boxes import centre_from_corner
    from bayesnet_track.observation.cue import installed_cues
    from bayesnet_track.vision.stereo_planes import estimate_spread

    declaration = installed_cues()["stereo"]
    parameters = read_parameters(declaration, options.set)
    given = parameters.model_dump(exclude_unset=True)
    for name in ESTIMATED:
        if name in given:
            raise UsageError(f"--set {name}: it is what is estimated; leave it out")
    with users_mistake():
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
    about = "" if options.within is None else f", each about the mean of its {options.within} frames"
    say(f"# {len(frames)} examples{about}; the default counts for {options.prior:g} more")
    for name, own, was in zip(ESTIMATED, spread.raw, default, strict=True):
        say(f"# {name}: {own:.3g} in the examples, {was:g} by default")
    learnt = {name: float(f"{value:.3g}") for name, value in zip(ESTIMATED, sd, strict=True)}
    say(f"stereo: {{{', '.join(f'{key}: {_yaml(value)}' for key, value in {**given, **learnt}.items())}}}")
    if source.end_reason != "end_of_source":
        complain(
            f"{source.description}: {source.end_reason.replace('_', ' ')}; learnt from what could be read"
        )
        return INCOMPLETE
    return OK


def _examples(cue: Any, source: Source, boxes: Floats, every: int) -> tuple[NDArray[np.int64], Floats]:
    """(n,) frames with a blob in the true box, and (n, K) its features there."""
    import numpy as np

    from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, region_of_boxes

    frames, features, empty = [], [], []
    for item in source:
        if not isinstance(item, Frame) or item.index % every:
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


def add_learn_stereo(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
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
        help="examples that the default counts for (default 10)",
    )
    stereo.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of the cue, as YAML"
    )
    add_window_options(stereo)
