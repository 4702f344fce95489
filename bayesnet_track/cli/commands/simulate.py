"""The command `simulate`: trajectories from the prior over the first frame of a video."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import OK, UsageError, check_free, say, users_mistake, writing
from bayesnet_track.cli.commands.start_boxes import parse_start, read_start
from bayesnet_track.cli.options.arguments import (
    add_plugins,
    add_set_option,
    add_truth_format,
    set_values,
    whole_number,
)
from bayesnet_track.cli.options.sources import add_range_option

if TYPE_CHECKING:
    from bayesnet_track.engine.simulating import Simulated
    from bayesnet_track.observation.planes import Frame

FILES = ("png", "csv")


def simulate(options: argparse.Namespace) -> int:
    """Draw trajectories, print how far they go, and write picture and CSV."""
    from bayesnet_track.engine.simulating import Simulation
    from bayesnet_track.engine.simulating import simulate as draw
    from bayesnet_track.engine.starts import check_given
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.numerics.boxes import centre_from_corner

    graph = load_graph(options.graph)
    if options.set:
        graph = set_values(graph.text, options.set)
    if (options.init is None) == (options.init_from is None):
        raise UsageError("give the box of the first frame: --init X,Y,W,H, or --init-from FILE")
    if options.init is not None:
        start = parse_start(options.init)
    else:
        start = read_start(Path(options.init_from), options.start, options.truth_format)
    for name in FILES:
        if getattr(options, name) is not None:
            check_free(Path(getattr(options, name)), options.overwrite)
    frame = _first_frame(options)
    with users_mistake():
        check_given(graph, [start], frame.width, frame.height)
    plate = graph.targets[start.plate or next(iter(graph.targets))]
    chosen = Simulation(options.frames, options.draws, options.seed, (frame.width, frame.height))
    drawn = draw(plate, dict(graph.spec.constants), centre_from_corner(start.box), chosen)
    say(_summary(drawn, frame))
    if options.csv is not None:
        with writing(Path(options.csv)):
            Path(options.csv).write_text(csv_text(drawn, frame.index), encoding="utf-8")
        say(f"wrote {options.csv}")
    if options.png is not None:
        import cv2

        from bayesnet_track.view.overlay import draw_trajectories

        picture = cv2.imencode(".png", draw_trajectories(frame.image, drawn.boxes))[1].tobytes()
        with writing(Path(options.png)):
            Path(options.png).write_bytes(picture)
        say(f"wrote {options.png}")
    return OK


def csv_text(drawn: Simulated, first: int = 0) -> str:
    """A row for each trajectory and frame: corner box in px, then the further fields."""
    from bayesnet_track.numerics.boxes import corner_from_centre

    further = drawn.fields[4:]
    lines = [",".join(("trajectory", "frame", "x", "y", "w", "h", *further))]
    for number in range(drawn.states.shape[1]):
        for frame, state in enumerate(drawn.states[:, number]):
            values = [f"{value:.3f}" for value in corner_from_centre(state[:4])]
            for name, value in zip(further, state[4:], strict=True):
                is_mode = drawn.modes and name == further[-1]
                values.append(drawn.modes[int(value)] if is_mode else f"{value:.4f}")
            lines.append(",".join((str(number), str(first + frame), *values)))
    return "\n".join(lines) + "\n"


def _summary(drawn: Simulated, frame: Frame) -> str:
    """How far the centre and the size have gone after some frames."""
    import numpy as np

    boxes, last = drawn.boxes, len(drawn.boxes) - 1
    side = np.sqrt(boxes[..., 2] * boxes[..., 3])
    away = np.hypot(*np.moveaxis(boxes[..., :2] - boxes[0, :, :2], -1, 0))
    x, y = boxes[..., 0], boxes[..., 1]
    at_border = ((x <= 0) | (y <= 0) | (x >= frame.width - 1) | (y >= frame.height - 1)).mean(axis=1)
    rows = ["frames  centre, px from the start     side, % of the first    centre at the"]
    rows += ["ahead        50 %         90 %            5 %       95 %          border"]
    for ahead in sorted({1, 5, 10, 25, 50, last} & set(range(1, last + 1))):
        near, far = np.quantile(away[ahead], (0.5, 0.9))
        small, large = 100 * np.quantile(side[ahead] / side[0], (0.05, 0.95))
        border = 100 * at_border[ahead]
        rows.append(f"{ahead:5d} {near:11.1f} {far:12.1f} {small:14.0f} {large:10.0f} {border:14.0f} %")
    return "\n".join(rows)


def _first_frame(options: argparse.Namespace) -> Frame:
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.sources.paths import SourceError
    from bayesnet_track.sources.sources import open_source

    window = (options.source, options.start, options.start + 1, options.allow_network)
    with open_source(*window, value_range=options.value_range) as source:
        for item in source:
            if isinstance(item, Frame):
                return item
        raise SourceError(source.description, f"no frame {options.start}", "a readable frame", "--start N")


def add_simulate(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    simulate = commands.add_parser(
        "simulate",
        help="draw trajectories from a graph's prior over the first frame",
        description="Draw how a graph expects a target to move before it has seen anything but the first "
        "box, and print how far: a check of its motion against what you know. No agent is asked.",
    )
    simulate.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    simulate.add_argument("--source", required=True, help="video file, folder of images, glob, or URL")
    simulate.add_argument("--init", metavar="[TYPE:]X,Y,W,H", help="box in the first frame")
    simulate.add_argument("--init-from", metavar="FILE", help="ground-truth file; its box of the first frame")
    add_truth_format(simulate)
    simulate.add_argument(
        "--start", type=whole_number(0), default=0, metavar="N", help="first frame (default 0)"
    )
    simulate.add_argument(
        "--frames", type=whole_number(1), default=50, metavar="N", help="frames ahead (default 50)"
    )
    simulate.add_argument(
        "--draws", type=whole_number(1), default=200, metavar="N", help="trajectories (default 200)"
    )
    simulate.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="N", help="seed of the draws (default 0)"
    )
    simulate.add_argument("--png", metavar="FILE", help="write a picture of them on the first frame")
    simulate.add_argument("--csv", metavar="FILE", help="write them, one row per trajectory and frame")
    simulate.add_argument("--overwrite", action="store_true", help="replace existing files")
    simulate.add_argument("--allow-network", action="store_true", help="let the source be a URL")
    add_range_option(simulate)
    add_set_option(simulate)
    add_plugins(simulate)
