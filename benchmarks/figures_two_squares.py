"""Figures of the thesis' Example 1: two identical squares, colour alone, and colour with motion on demand."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import matplotlib.pyplot as plt
import numpy as np
from figure_style import (
    BEST,
    CLOUD,
    INK,
    PEER,
    QUIET,
    SURFACE,
    WARNING,
    Axes,
    activity,
    boxes,
    density,
    label,
    level,
    logarithmic,
    shaded,
    show,
    surface,
)
from matplotlib.figure import Figure
from traces import Trace, mean_shift, trace
from two_squares import held_to_the_end, without_adaptation

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, region_of_boxes
from bayesnet_track.sources.scenes import Scene, random_geometry, two_squares

SEEDS = range(20)
CLOSE_PX = 60


# ------------------------------------------------------------------------------------ the runs


@cache
def stated() -> Scene:
    """Example 1 in its stated geometry."""
    return two_squares(0)


@cache
def color_only() -> tuple[int, Trace]:
    """The first seed with which colour alone ends on the wrong square, and its run."""
    graph = without_adaptation(frozenset({"color"}))
    for seed in SEEDS:
        run = trace(graph, stated(), seed)
        if not held_to_the_end(np.array([moment.box for moment in run.first]), stated()):
            return seed, run
    raise SystemExit("colour alone held the right square with every seed: nothing to show")


@cache
def adaptive() -> Trace:
    """The installed graph `two_squares` on Example 1."""
    return trace("two_squares", stated(), 0)


def random_squares(seed: int) -> Scene:
    """Two squares in a random geometry."""
    return two_squares(seed, random_geometry(np.random.default_rng(seed)))


def levels(graph: GraphSpec | str) -> dict[str, float]:
    """The root's levels of UD in px^2, as the graph has them: on above, off below."""
    (plate,) = load_graph(graph).targets.values()
    rules = plate.inference(plate.root).adapt
    assert rules is not None and rules.activate is not None and rules.deactivate is not None
    on, off = rules.activate.above.ud_px2, rules.deactivate.below.ud_px2
    return {name: value for name, value in (("on above", on), ("off below", off)) if value is not None}


# ------------------------------------------------------------------------------------ the particle filter


def initial_cloud() -> Figure:
    """Thesis Figure 2.3: the initial distribution and its x-coordinate."""
    start, moment = adaptive().first[:2]
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.1), layout="constrained")
    show(left, start.image, "a) hypotheses of frame 1, before the evidence")
    boxes(left, moment.states[::5, :4], CLOUD, alpha=0.4, width=0.7)
    boxes(left, start.box, BEST, width=2.0)
    x, mean, sd = moment.states[:, 0], start.box[0], _spread_px()
    right.hist(x, bins=30, density=True, color=CLOUD, alpha=0.55, label=f"{len(x)} hypotheses")
    at = np.linspace(mean - 4 * sd, mean + 4 * sd, 200)
    normal = np.exp(-0.5 * ((at - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
    right.plot(at, normal, color=INK, label=f"Gaussian, sd {sd:g} px")
    if at[-1] > stated().width:
        right.axvline(stated().width - 1, color=QUIET, linewidth=0.8, linestyle=":")
        right.text(stated().width + 1, 0.8 * normal.max(), "border of\nthe picture", fontsize=8.5)
    right.set_xlabel("x of the centre [px]")
    right.set_ylabel("share per px")
    right.set_title("b) their x-coordinate")
    right.set_ylim(0, 1.5 * normal.max())
    right.legend(loc="upper left", fontsize=9)
    return figure


def _spread_px() -> float:
    """The sd of the motion in x, as the graph has it."""
    (plate,) = load_graph("two_squares").targets.values()
    motion = plate.inference(plate.root).motion
    assert motion is not None and motion.random_walk is not None
    return float(motion.random_walk.sd_px.x)


def likelihood() -> Figure:
    """Thesis Figure 2.4: likelihood against distance."""
    _, run = color_only()
    (compiled,) = run.engine.plates.values()
    cue, reference = compiled.cues["color"], run.last.state.targets["1"].references["color"]
    true = centre_from_corner(stated().truth[1])
    spread = np.random.default_rng(0).normal(0.0, 16.0, (300, 2))
    tried = np.column_stack([true[:2] + spread, np.tile(true[2:], (len(spread), 1))])
    frame = Frame(1, 1.0, run.first[1].image)
    planes = PlaneCache(FramePair(frame, None)).planes(cue.needs, region_of_boxes(tried))
    distance, _ = cue._distances(planes, tried, reference["shares"])  # type: ignore[attr-defined]
    value = np.exp(cue.log_likelihood(planes, Hypotheses(tried), reference))
    alpha = float(reference["alpha"])

    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.1), layout="constrained", sharey=True)
    at = np.linspace(0.0, 4 * alpha, 200)
    left.plot(at, 1 / (1 + np.exp(4 * (at - alpha) / alpha)), color=QUIET, label="eq. 2.9, halved")
    left.plot(distance, value, ".", color=CLOUD, markersize=4, label="the cue on 300 hypotheses")
    left.axvline(alpha, color=QUIET, linewidth=0.8, linestyle=":")
    left.text(alpha, 1.03, f" α = {alpha:.3f}", fontsize=9)
    left.set_xlim(0, at[-1])
    left.set_xlabel("distance of the hue histograms [1 = opposite hues]")
    left.set_ylabel("likelihood [of a perfect match]")
    left.set_title("a) against the distance of histograms", pad=16)
    left.legend(fontsize=9)
    right.plot(np.hypot(*spread.T), value, ".", color=CLOUD, markersize=4)
    right.set_xlim(0, 50)
    right.set_xlabel("distance from the true centre [px]")
    right.set_title("b) against the distance in the picture", pad=16)
    return figure


def color_alone() -> Figure:
    """Thesis Figure 2.5: colour alone, clouds and MAP at three frames."""
    seed, run = color_only()
    return _clouds_and_best(run, (2, 29, 40), f"Colour only (seed {seed})")


def both_cues() -> Figure:
    """Thesis Figure 2.8: adaptive, clouds and MAP at three frames."""
    return _clouds_and_best(adaptive(), (2, 29, 40), "Colour, and motion on demand")


def _clouds_and_best(run: Trace, frames: Sequence[int], what: str) -> Figure:
    """A column per frame: above the belief, below the MAP."""
    figure, panels = plt.subplots(2, len(frames), figsize=(8, 4.5), layout="constrained")
    for column, index in enumerate(frames):
        moment = run.first[index]
        upper, lower = panels[:, column]
        show(upper, moment.image, f"frame {index}, active: {', '.join(moment.metrics.active)}")
        boxes(upper, moment.drawn(60), CLOUD, alpha=0.35, width=0.7)
        show(lower, moment.image, f"MAP; UD {moment.metrics.ud_px2:.0f} px²")
        boxes(lower, np.array(moment.metrics.map), BEST, width=2.2)
        _numbered(lower, stated(), index)
    figure.suptitle(what, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    return figure


def _numbered(axes: Axes, scene: Scene, index: int) -> None:
    """1 on the target, 2 on the other one where it can be told apart."""
    target, other = centre_from_corner(scene.truth[index]), centre_from_corner(scene.others[0][index])
    label(axes, target, "1")
    if np.abs(target - other)[:2].max() > 12:
        label(axes, other, "2")


# ------------------------------------------------------------------------------------ adaptation


def uncertainty() -> Figure:
    """Thesis Figure 2.9: UD, its levels, and the agents' activity."""
    run = adaptive()
    figure, upper = ud_and_activity(run, levels("two_squares"), ("color", "motion"))
    apart = np.hypot(*(stated().truth - stated().others[0])[:, :2].T)
    shaded(upper, apart < CLOSE_PX, f"centres closer than {CLOSE_PX} px")
    upper.legend(loc="upper center", ncols=2, fontsize=9, bbox_to_anchor=(0.5, 1.22))
    return figure


def ud_and_activity(run: Trace, lines: dict[str, float], agents: tuple[str, ...]) -> tuple[Axes]:
    """UD over the frames on a logarithmic scale, and below it when each agent worked."""
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(8, 3.7), layout="constrained", sharex=True, height_ratios=(5, 0.6 * len(agents))
    )
    ud = run.ud()
    upper.plot(np.arange(1, len(ud)), ud[1:], color=INK, label="UD of the belief")
    logarithmic(upper)
    upper.set_ylabel("UD [px²]")
    for (name, value), colour in zip(lines.items(), (WARNING, BEST), strict=True):
        level(upper, value, f"{name} {value:g}", colour)
    activity(lower, run.active(), agents)
    lower.set_xlabel("frame")
    lower.set_xlim(-0.5, len(ud) - 0.5)
    return figure, upper


def surfaces() -> Figure:
    """Thesis Figure 2.10: the posterior before motion is switched on and after, and without motion."""
    run, (_, alone) = adaptive(), color_only()
    on = next(d.frame for d in run.decisions if isinstance(d, Activated))
    figure = plt.figure(figsize=(8, 4.4))
    for column, (index, one) in enumerate(((1, run), (on, run), (on + 12, run), (on + 12, alone)), 1):
        moment = one.first[index]
        target, other = (centre_from_corner(path[index]) for path in (stated().truth, stated().others[0]))
        middle = target if column == 1 else (target + other) / 2
        left, top = (round(float(c) - room) for c, room in zip(middle[:2], (80, 60), strict=True))
        window = (left, left + 160, top, top + 120)
        grid = density(moment.states, moment.weights, window)
        working = " + ".join(moment.metrics.active)
        surface(figure.add_subplot(2, 4, column, projection="3d"), grid, f"{index}: {working}")
        flat = figure.add_subplot(2, 4, 4 + column)
        flat.contourf(*grid, levels=np.linspace(0.02, 1.0, 12) * grid[2].max(), cmap=SURFACE)
        for number, box in enumerate((target, other), 1):
            if left < box[0] < left + 160 and top < box[1] < top + 120:
                boxes(flat, box, QUIET)
                flat.text(box[0] - 18, box[1] - 11, str(number), fontsize=9)
        flat.set(xlim=window[:2], ylim=window[:1:-1], aspect="equal")
        flat.set_title(f"UD {moment.metrics.ud_px2:.0f} px²", fontsize=9)
        flat.set_xlabel("x [px]", fontsize=9)
        flat.tick_params(labelsize=8)
    figure.axes[1].set_ylabel("y [px]", fontsize=9)
    note = "frame: active agents; vertical: density of the centre [10⁻³ px⁻²]"
    figure.text(0.99, 0.985, note, ha="right", va="top", fontsize=8.5)
    figure.subplots_adjust(left=0.065, right=0.955, bottom=0.08, top=0.89, wspace=0.28, hspace=0.12)
    return figure


def mean_shift_beside() -> Figure:
    """Thesis Figure 2.11: mean shift on the same scene, and on a geometry that traps it."""
    seed, trapped = next(
        (seed, scene)
        for seed in SEEDS
        if not held_to_the_end(mean_shift(scene := random_squares(seed)), scene)
    )
    figure, panels = plt.subplots(2, 4, figsize=(8, 3.7), layout="constrained")
    meeting = _first_meeting(trapped)
    rows = (
        ("stated geometry", stated(), adaptive(), (1, 20, 29, 45)),
        (
            f"random geometry {seed}",
            trapped,
            trace("two_squares", trapped, seed),
            (1, meeting, meeting + 4, meeting + 20),
        ),
    )
    for row, (name, scene, run, frames) in enumerate(rows):
        shifted = mean_shift(scene)
        panels[row, 0].set_ylabel(name)
        for axes, index in zip(panels[row], frames, strict=True):
            show(axes, run.first[index].image, f"frame {index}", with_ticks=False)
            _numbered(axes, scene, index)
            boxes(axes, shifted[index], PEER, width=1.8)
            boxes(axes, run.first[index].box + np.array([0, 0, 12, 12]), BEST, width=1.8)
    handles = [
        plt.Line2D([], [], color=colour, linewidth=2, label=name)
        for colour, name in ((BEST, "adaptive net (drawn 6 px wider)"), (PEER, "cv2.meanShift"))
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=2, fontsize=9)
    return figure


def _first_meeting(scene: Scene) -> int:
    """The frame in which the squares first overlap most."""
    shared = overlap(centre_from_corner(scene.truth), centre_from_corner(scene.others[0]))
    first = int((shared > 0).argmax())
    apart = np.flatnonzero(shared[first:] == 0)
    end = first + int(apart[0]) if len(apart) else len(shared)
    return first + int(shared[first:end].argmax())
