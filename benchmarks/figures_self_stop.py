"""Figures of the thesis' Examples 2 and 3 with a net for each square: detections, and a broad agent."""

from __future__ import annotations

from functools import cache
from textwrap import fill
from typing import Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, INK, QUIET, Axes, boxes, density, show, surface
from figures_occlusion import GRAY
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from traces import Moment, Trace, trace

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, region_of_boxes
from bayesnet_track.runtime.run import Start
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.vision.detectors.gray_level import GrayLevel, GrayLevelParameters, outliers
from bayesnet_track.vision.planes.gray_plane import gray

SHARP, BROAD, FLOOR = 0.3, 0.36, 0.0001
"""Of the gray square's intensity agent: `sd_pattern` with which UD is below the level for dropping agents,
`sd_pattern` with which it is above, and `floor`."""

SETTINGS = GrayLevelParameters()
COMPARED, SHOWN, FRAMES = 20, (4, 6, 21, 38), 45
NAMES = {
    "histogram": "ColorH",
    "blobs": "ColorB",
    "color": "ColorH",
    "intensity": "Intensity",
    "motion": "Motion",
}
"""The agents as the thesis labels them."""


@cache
def stage() -> tuple[Scene, Detections]:
    """The scene, and what the detector by gray level finds in its first frame: orange first."""
    scene = make_scene("orange_and_gray", 0)
    detector = GrayLevel(SETTINGS)
    found, _ = detector.detect(FramePair(Frame(0, 0.0, scene.frames[0]), None), detector.start())
    return scene, found


@cache
def tracked(sd_pattern: float, frames: int = FRAMES) -> Trace:
    """Both squares from their detections: `color_fusion` on orange, colour and intensity on gray."""
    scene, found = stage()
    orange = load_graph("color_fusion").spec.model_dump(exclude_none=True)["targets"]["square"]
    gray = load_graph("gray_square").spec.model_dump(exclude_none=True)["targets"]["square"]
    nodes: dict[str, Any] = gray["nodes"]
    nodes["intensity"] = {
        "parent": "square",
        "agent": {"intensity": {"floor": FLOOR, "sd_pattern": sd_pattern}},
    }
    graph = GraphSpec.model_validate(
        {"name": "self_stop", "targets": {"orange": orange, "gray": {"nodes": nodes}}}
    )
    corners = [tuple(float(value) for value in box) for box in corner_from_centre(found.boxes)]
    starts = [Start(box, plate) for box, plate in zip(corners, ("orange", "gray"), strict=True)]  # type: ignore[arg-type]
    return trace(graph, scene, 0, starts, frames)


def detections() -> Figure:
    """Thesis Figure 2.12: the first frame with what the detector finds in it, and why."""
    scene, found = stage()
    image = scene.frames[0]
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.0), layout="constrained", width_ratios=(1.15, 1))
    show(left, image, "a) frame 0 and the detections")
    for number, (box, colour) in enumerate(zip(found.boxes, (BEST, GRAY), strict=True), 1):
        boxes(left, box, colour, width=2.0)
        _numbered(left, box, str(number), colour)
    counts = np.bincount(cv2.medianBlur(gray(image), SETTINGS.median_px).ravel(), minlength=256)
    is_target = outliers(counts, SETTINGS.spread, SETTINGS.min_difference) > 0
    levels = np.arange(256)
    right.bar(levels[~is_target], counts[~is_target], width=1.0, color=QUIET, label="ground")
    right.bar(levels[is_target], counts[is_target], width=1.0, color=INK, label="targets")
    right.set_yscale("log")
    right.yaxis.set_minor_locator(NullLocator())
    right.set_xlim(0, 255)
    right.set_ylim(0.7, 3 * counts.max())
    right.set_xlabel("gray level")
    right.set_ylabel("pixels")
    right.set_title("b) gray levels of the frame")
    right.legend(loc="upper right", fontsize=9)
    return figure


def broad_likelihood() -> Figure:
    """Thesis Figure 2.17: the intensity agent's likelihood made broad, beside a sharp one, and beliefs."""
    figure = plt.figure(figsize=(8, 5.4))
    for row, (name, sd) in enumerate((("sharp", SHARP), ("broad", BROAD))):
        run = tracked(sd, COMPARED + 1)
        moment = run.moments["2"][COMPARED]
        x, y = (round(value / 2) * 2 for value in moment.box[:2])
        window = (x - 50, x + 52, y - 40, y + 42)
        axes = figure.add_subplot(2, 2, 2 * row + 1, projection="3d")
        surface(axes, _likelihood(run, moment, window), f"{name} agent: log-likelihood")
        axes = figure.add_subplot(2, 2, 2 * row + 2, projection="3d")
        grid = density(moment.states, moment.weights, window)
        surface(axes, grid, f"belief, UD {moment.metrics.ud_px2:.0f} px²")
    figure.text(
        0.995,
        0.99,
        "vertical: nats above the floor on the left, density of the centre [10⁻³ px⁻²] on the right",
        ha="right",
        va="top",
        fontsize=8.5,
    )
    figure.subplots_adjust(left=0.02, right=0.96, bottom=0.04, top=0.91, wspace=0.08, hspace=0.14)
    return figure


def _likelihood(
    run: Trace, moment: Moment, window: tuple[int, int, int, int]
) -> tuple[Floats, Floats, Floats]:
    """Columns, rows and log-likelihood of the gray square's intensity agent at boxes of the estimate's size.

    In nats above the floor.
    """
    cue = run.engine.plates["gray"].cues["intensity"]
    x, y = np.arange(window[0], window[1], 2.0), np.arange(window[2], window[3], 2.0)
    columns, rows = np.meshgrid(x, y)
    tried = np.column_stack([columns.ravel(), rows.ravel(), np.tile(moment.box[2:4], (columns.size, 1))])
    frames = FramePair(Frame(COMPARED, float(COMPARED), moment.image), None)
    planes = PlaneCache(frames).planes(cue.needs, region_of_boxes(tried))
    reference = run.last.state.targets["2"].references["intensity"]
    log = cue.log_likelihood(planes, Hypotheses(tried), reference)  # type: ignore[union-attr]
    return x, y, (log - np.log(FLOOR)).reshape(columns.shape)


def self_stop_strip() -> Figure:
    """Thesis Figure 2.18: both squares, and below them the agents that work for each."""
    run = tracked(BROAD)
    figure, panels = plt.subplots(1, len(SHOWN), figsize=(10, 2.75), layout="constrained")
    for axes, index in zip(panels, SHOWN, strict=True):
        show(axes, run.first[index].image, f"frame {index}", with_ticks=False)
        for target, colour in (("1", BEST), ("2", GRAY)):
            box = run.moments[target][index].box
            boxes(axes, box, colour, width=2.0)
            _numbered(axes, box, target, colour)
        axes.set_xlabel("\n".join(_working(run, target, index) for target in run.moments), fontsize=8.5)
    return figure


def _numbered(axes: Axes, box: Floats, target: str, colour: str) -> None:
    """The first target's number at its right, the second's at its left, so that they keep apart."""
    side, away = ("left", 0.5) if target == "1" else ("right", -0.5)
    axes.text(
        box[0] + away * (box[2] + 12),
        box[1] - box[3] / 2,
        target,
        color="white",
        fontsize=8.5,
        fontweight="bold",
        ha=side,
        va="center",
        bbox={"facecolor": colour, "edgecolor": "none", "pad": 1.5},
    )


def _working(run: Trace, target: str, index: int) -> str:
    names = sorted(NAMES[agent] for agent in run.moments[target][index].metrics.active)
    return fill(f"{target}: {', '.join(names)}", 26, subsequent_indent="    ")
