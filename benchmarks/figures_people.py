"""Figures of the thesis' examples with people (section 3.6) and of its two squares: strips of frames and UD.

    python benchmarks/figures_people.py [--out docs/figures] [--only squares,person,people]

Needs matplotlib (the extra `figures`). Each picture is of one run, seed 0, of the graph named like its
scene; what it shows, and where it differs from the thesis, is told in docs/figures.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from figure_style import (
    BEST,
    INK,
    PEER,
    QUIET,
    WARNING,
    Axes,
    activity,
    boxes,
    level,
    logarithmic,
    save,
    show,
)
from matplotlib.figure import Figure
from traces import Trace, trace

from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.self_checks import SelfStopped
from bayesnet_track.runtime.run import Start
from bayesnet_track.sources.scenes import Scene, make_scene

TARGETS, THIN = (BEST, PEER), "#fde047"
Span = tuple[int, int, str]


@dataclass(frozen=True)
class Story:
    """What is drawn of one scene.

    Attributes:
        name: of the scene and its graph.
        shown: frames of the strip.
        agents: in the order of the bars.
        spans: first and last frame of what happens to each target, and what it is.
        ticks: of the axis of UD, px^2.
    """

    name: str
    shown: tuple[int, ...]
    agents: tuple[str, ...]
    spans: tuple[tuple[Span, ...], ...]
    ticks: tuple[int, ...] = (20, 50, 100, 200, 500, 1000, 2000, 5000)


SQUARES = Story(
    "orange_and_gray",
    (4, 20, 23, 25),
    ("color", "intensity", "motion"),
    (((20, 26, "partly hidden"),), ()),
)
PERSON = Story(
    "person_color_stereo",
    (4, 62, 69, 76, 100),
    ("stereo", "color"),
    (((60, 88, "somebody else"),),),
)
PEOPLE = Story(
    "two_people_color_stereo_shape",
    (7, 50, 62, 85, 115),
    ("color", "stereo", "shape"),
    (
        ((58, 70, "daylight"),),
        ((30, 31, "glare"), (50, 51, ""), (76, 100, "")),
    ),
)


@cache
def played(story: Story) -> tuple[Scene, Trace]:
    """The scene and its run."""
    scene = make_scene(story.name, 0)
    starts = [Start(box, plate) for plate, box in scene.starts]
    return scene, trace(story.name, scene, 0, starts)


def strip(story: Story) -> Figure:
    """Frames with the belief (thin), the estimate (thick) and the active agents."""
    _, run = played(story)
    words = 0.45 + 0.15 * len(run.moments)
    figure, panels = plt.subplots(
        1, len(story.shown), figsize=(10, 7.3 / len(story.shown) + words), layout="constrained"
    )
    for axes, index in zip(panels, story.shown, strict=True):
        show(axes, run.first[index].image, f"frame {index}", with_ticks=False)
        axes.set_xlabel("\n".join(_working(run, target, index) for target in run.moments), fontsize=8.5)
        for colour, moments in zip(TARGETS, run.moments.values(), strict=False):
            boxes(axes, moments[index].drawn(40), THIN, alpha=0.4, width=0.5)
            boxes(axes, moments[index].box, colour, width=2.0)
    return figure


def _working(run: Trace, target: str, index: int) -> str:
    active = " + ".join(run.moments[target][index].metrics.active)
    return active if len(run.moments) == 1 else f"{target}: {active}"


def timeline(story: Story) -> Figure:
    """UD of every target with its levels, and below it when each agent worked."""
    _, run = played(story)
    count = len(run.moments)
    figure, panels = plt.subplots(
        2 * count,
        1,
        figsize=(8, 2.6 * count + 0.5),
        layout="constrained",
        sharex=True,
        height_ratios=(5, 0.5 * len(story.agents)) * count,
    )
    plates = load_graph(story.name).targets
    for number, (target, (plate, checked)) in enumerate(zip(run.moments, plates.items(), strict=True)):
        upper, lower = panels[2 * number : 2 * number + 2]
        ud = run.ud(target)
        upper.plot(np.arange(1, len(ud)), ud[1:], color=TARGETS[number], linewidth=1.2)
        _happenings(upper, story.spans[number])
        rules = checked.inference(checked.root).adapt
        assert rules is not None and rules.activate is not None and rules.deactivate is not None
        on, off = rules.activate.above.ud_px2, rules.deactivate.below.ud_px2
        assert on is not None and off is not None
        logarithmic(upper, story.ticks)
        level(upper, on, f"on above {on:g}", WARNING)
        level(upper, off, f"off below {off:g}", QUIET)
        upper.set_ylabel("UD [px²]")
        upper.set_title(f"{target}: {plate}" if count > 1 else plate)
        activity(lower, run.active(target), story.agents)
        _self_stops(lower, run, target, story.agents)
        lower.set_xlim(-0.5, len(ud) - 0.5)
    panels[-1].set_xlabel("frame")
    return figure


def _happenings(axes: Axes, spans: Sequence[Span]) -> None:
    for first, last, name in spans:
        axes.axvspan(first - 0.5, last + 0.5, color=QUIET, alpha=0.25, linewidth=0)
        axes.text(last + 1, 0.97, name, transform=axes.get_xaxis_transform(), va="top", fontsize=8.5)


def _self_stops(axes: Axes, run: Trace, target: str, agents: Sequence[str]) -> None:
    """A cross where an agent stopped itself."""
    for decision in run.decisions:
        if isinstance(decision, SelfStopped) and decision.target == target:
            row = len(agents) - 1 - agents.index(decision.node)
            axes.plot(decision.frame + 1, row, "x", color=INK, markersize=6, markeredgewidth=1.6)
            axes.text(decision.frame + 2.5, row, "stops itself", va="center", fontsize=8.5)


FIGURES: dict[str, tuple[tuple[str, Callable[[Story], Figure]], ...]] = {
    name: ((f"{name}_strip.png", strip), (f"{name}_uncertainty.svg", timeline))
    for name in ("squares", "person", "people")
}
STORIES = {"squares": SQUARES, "person": PERSON, "people": PEOPLE}


def main() -> None:
    """Make the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    parser.add_argument("--only", default=",".join(STORIES), help="comma-separated; default all")
    options = parser.parse_args()
    for name in options.only.split(","):
        for file, make in FIGURES[name]:
            path = options.out / file
            save(make(STORIES[name]), path)
            print(f"{path}, {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
