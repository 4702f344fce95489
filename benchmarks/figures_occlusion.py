"""Figures of the thesis' Examples 2 and 3: an orange square that a gray one hides, and a gray one alone."""

from __future__ import annotations

from functools import cache

import matplotlib.pyplot as plt
import numpy as np
from figure_style import (
    BEST,
    CLOUD,
    INK,
    PEER,
    boxes,
    density,
    level,
    logarithmic,
    shaded,
    show,
    surface,
)
from figures_two_squares import levels, ud_and_activity
from matplotlib.figure import Figure
from traces import Trace, mean_shift, trace

from bayesnet_track.graph.spec import AgentNode
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.self_checks import LocallyAdapted, SelfStopped
from bayesnet_track.runtime.run import Start
from bayesnet_track.sources.scenes import Scene, make_scene

GRAY, COLOR_UD = "#15803d", "#b26a10"
FRAMES = (4, 20, 23, 30)


@cache
def hidden() -> tuple[Scene, Trace]:
    """Both squares of Example 2, each with a copy of the library's `color_fusion`."""
    scene = make_scene("orange_and_gray", 0)
    x, y, w, h = (float(value) for value in scene.others[0][0])
    return scene, trace("color_fusion", scene, 0, [Start(scene.start_box), Start((x, y, w, h))], frames=60)


def occlusion_tracks() -> Figure:
    """Thesis Figures 2.13 and 2.15: the squares before, in and after the occlusion, mean shift beside."""
    scene, run = hidden()
    shifted = mean_shift(scene)
    figure, panels = plt.subplots(2, 4, figsize=(8, 3.7), layout="constrained")
    for (upper, lower), index in zip(panels.T, FRAMES, strict=True):
        show(upper, run.first[index].image, f"frame {index}", with_ticks=False)
        boxes(upper, run.moments["2"][index].box, GRAY, width=2.0)
        boxes(upper, run.first[index].box, BEST, width=2.0)
        show(lower, run.first[index].image, f"frame {index}", with_ticks=False)
        boxes(lower, shifted[index], PEER, width=2.0)
    panels[0, 0].set_ylabel("color_fusion")
    panels[1, 0].set_ylabel("mean shift")
    handles = [
        plt.Line2D([], [], color=colour, linewidth=2, label=name)
        for colour, name in (
            (BEST, "target 1, orange"),
            (GRAY, "target 2, gray"),
            (PEER, "cv2.meanShift on target 1"),
        )
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3, fontsize=9)
    return figure


def occlusion_beliefs() -> Figure:
    """Thesis Figure 2.14: the belief about the orange square, and the hypotheses of both."""
    scene, run = hidden()
    figure = plt.figure(figsize=(8, 4.8))
    for column, index in enumerate(FRAMES[1:], 1):
        moment = run.first[index]
        axes = figure.add_subplot(2, 3, column, projection="3d")
        grid = density(moment.states, moment.weights, (0, scene.width, 0, scene.height))
        surface(axes, grid, f"frame {index}, target 1")
        flat = figure.add_subplot(2, 3, 3 + column)
        show(flat, moment.image, f"UD of target 1: {moment.metrics.ud_px2:.0f} px²")
        for target, colour in (("1", CLOUD), ("2", GRAY)):
            drawn = run.moments[target][index].drawn(200)
            flat.plot(drawn[:, 0], drawn[:, 1], ".", color=colour, markersize=2.5, label=f"target {target}")
    flat.legend(loc="upper right", fontsize=8, markerscale=3, labelcolor="white", handletextpad=0)
    figure.text(
        0.995, 0.985, "vertical: density of the centre [10⁻³ px⁻²]", ha="right", va="top", fontsize=8.5
    )
    figure.subplots_adjust(left=0.05, right=0.97, bottom=0.05, top=0.91, wspace=0.2, hspace=0.12)
    return figure


def occlusion_uncertainty() -> Figure:
    """UD of the hidden square and its agents, told of in the thesis' text to Figure 2.13."""
    scene, run = hidden()
    figure, upper = ud_and_activity(
        run, levels("color_fusion"), ("histogram", "blobs", "intensity", "motion")
    )
    shaded(upper, scene.visible[:60] < 0.5, "more than half hidden")
    upper.legend(loc="upper right", fontsize=9)
    return figure


def gray_square() -> Figure:
    """Thesis Figure 2.19: UD of the gray square, and the colour agent's self-stop."""
    graph = load_graph("gray_square").spec
    run = trace(graph, make_scene("gray_square", 0), 0, frames=60)
    figure, upper = ud_and_activity(run, levels(graph), ("color", "intensity"))
    own = [moment.metrics.agent_ud_px2.get("color", np.nan) for moment in run.first]
    upper.plot(own, "o-", color=COLOR_UD, markersize=4, label="color's own UD")
    color = graph.targets["square"].nodes["color"]
    assert isinstance(color, AgentNode) and color.self_check is not None
    check = color.self_check.above.settings
    level(upper, check, f"self-check {check:g}", COLOR_UD, ":")
    stop = next(d for d in run.decisions if isinstance(d, SelfStopped))
    tries = sum(isinstance(d, LocallyAdapted) for d in run.decisions)
    upper.annotate(
        f"frame {stop.frame}: after {tries} tries to sharpen itself\ncolor stops itself",
        (stop.frame + 0.3, stop.cause.ud_px2),
        (stop.frame + 4, stop.cause.ud_px2 * 1.05),
        arrowprops={"arrowstyle": "->", "color": INK},
        fontsize=9,
        va="center",
    )
    upper.set_ylim(20, 2500)
    logarithmic(upper)
    upper.legend(loc="upper right", ncols=2, fontsize=9)
    return figure
