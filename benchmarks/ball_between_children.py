"""A ball in flight under adaptive numbers and an adaptive importance function (after thesis 5.9 to 5.15).

    python benchmarks/ball_between_children.py [--seeds 20] [--out docs/figures]

Runs the graph `ball_between_children` on its scene as it is, and without its importance function. Prints how
many hypotheses the ball takes while it is held and while it flies, KL(posterior || prior), and the error.
--out draws the numbers frame by frame (Figures 5.11, 5.13 and 5.15) and the hypotheses (5.12 and 5.14).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measuring import table
from numpy.typing import NDArray

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.runtime.run import Start
from bayesnet_track.runtime.session import track
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.sources.scenes.children import FLIGHTS, FRAMES

Floats = NDArray[np.float64]
NAME = "ball_between_children"
IN_FLIGHT = [frame for first, last in FLIGHTS for frame in range(first, last + 2)]
"""Frames into which the ball leaps: those in the air and the one in which it is caught."""
HELD = [frame for frame in range(12, FRAMES) if not any(a - 1 <= frame <= b + 4 for a, b in FLIGHTS)]
"""Frames well away from a flight."""

VARIANTS = {"number adapted": "bootstrap", "number and importance": None}
SHOWN = (2, 3, 5, 7, 9, 12)
"""Frames whose hypotheses are drawn."""


@dataclass(frozen=True, eq=False)
class Traced:
    """One run, frame by frame: ball and child in rows 0 and 1.

    Attributes:
        particles: (2, n) hypotheses asked about.
        surprise: (2, n) KL(posterior || prior), nats.
        error: (2, n) distance of the estimate's centre from the true one, px.
        clouds: (n, 48, 4) boxes drawn from the ball's posterior.
    """

    particles: Floats
    surprise: Floats
    error: Floats
    clouds: Floats


def graph_with(importance: str | None) -> GraphSpec:
    """The library's graph, with another importance function unless None."""
    data = as_plain(load_graph(NAME).spec)
    for plate in data["targets"].values():
        for node in plate["nodes"].values():
            if importance is not None and "belief" in node:
                node["belief"]["particles"]["proposal"] = importance
    return GraphSpec.model_validate(data)


def traced(graph: GraphSpec, scene: Scene, seed: int) -> Traced:
    """Run a graph on the scene."""
    starts = [Start(box, plate) for plate, box in scene.starts]
    truth = [centre_from_corner(path) for path in (scene.truth, scene.others[0])]
    frames = []
    for result in track(graph, SceneSource(scene, NAME), starts, seed=seed):
        rows = [
            (
                metrics.particles,
                metrics.surprise,
                np.hypot(*(np.array(metrics.centre_box[:2]) - truth[k][result.frame.index, :2])),
            )
            for k, metrics in enumerate(result.targets)
        ]
        cloud = result.targets[0].cloud or [tuple(truth[0][0].astype(int))] * 48
        frames.append((rows, cloud))
    numbers = np.array([rows for rows, _ in frames], dtype=np.float64).transpose(2, 1, 0)
    return Traced(*numbers, clouds=np.array([cloud for _, cloud in frames], dtype=np.float64))


def report(runs: dict[str, list[Traced]]) -> str:
    """One row for each variant: means over runs and frames, the largest error, and runs held to the end."""
    rows = []
    for name, all_runs in runs.items():
        ball = {
            key: np.array([getattr(run, key)[0] for run in all_runs])
            for key in ("particles", "surprise", "error")
        }
        child = np.array([run.particles[1] for run in all_runs])
        rows.append(
            [
                name,
                f"{np.mean(ball['particles'][:, HELD]):.0f}",
                f"{np.mean(ball['particles'][:, IN_FLIGHT]):.0f}",
                f"{np.mean(child[:, 1:]):.0f}",
                f"{np.mean(ball['surprise'][:, HELD]):.2f}",
                f"{np.mean(ball['surprise'][:, IN_FLIGHT]):.2f}",
                f"{np.mean(ball['error'][:, IN_FLIGHT]):.2f}",
                f"{np.max(ball['error']):.0f}",
                f"{sum(np.max(run.error[0, -5:]) < 11 for run in all_runs)}/{len(all_runs)}",
            ]
        )
    heads = [
        "",
        "N held",
        "N in flight",
        "N child",
        "KL held",
        "KL in flight",
        "error in flight px",
        "largest",
        "held",
    ]
    return table(heads, rows)


def draw(runs: dict[str, list[Traced]], scene: Scene, out: Path) -> None:
    """The two figures."""
    import matplotlib.pyplot as plt
    from figure_style import AGENTS, BEST, CLOUD, INK, QUIET, save

    regular, adaptive = runs.values()
    figure, axes = plt.subplots(3, 1, figsize=(8.0, 6.0), sharex=True, constrained_layout=True)
    frames = np.arange(FRAMES)
    lines = (
        (axes[0], "particles", regular, "hypotheses, number adapted (5.11)"),
        (axes[1], "surprise", regular, "KL(posterior || prior), nats (5.13)"),
        (axes[2], "particles", adaptive, "hypotheses, importance function adapted too (5.15)"),
    )
    for ax, key, some, title in lines:
        for row, name, colour in ((0, "ball", AGENTS["histogram"]), (1, "child", AGENTS["intensity"])):
            values = np.array([getattr(run, key)[row] for run in some])
            low, middle, high = np.quantile(values, [0.1, 0.5, 0.9], axis=0)
            ax.fill_between(frames[1:], low[1:], high[1:], color=colour, alpha=0.15, linewidth=0)
            ax.plot(frames[1:], middle[1:], color=colour, label=name)
        for first, last in FLIGHTS:
            ax.axvspan(first - 0.5, last + 1.5, color=QUIET, alpha=0.15, linewidth=0)
        ax.set_title(title)
        ax.set_ylim(bottom=0)
    axes[1].axhline(3.0, color=INK, linewidth=0.8, linestyle=":")
    axes[0].set_ylim(
        axes[2].get_ylim() if axes[2].get_ylim()[1] > axes[0].get_ylim()[1] else axes[0].get_ylim()
    )
    axes[2].set_ylim(axes[0].get_ylim())
    axes[0].legend(loc="upper right", ncols=2)
    axes[2].set_xlabel(f"frame (the ball leaps where it is gray); median and 10-90 % of {len(regular)} runs")
    save(figure, out / "ball_particles.svg")

    figure, panels = plt.subplots(2, len(SHOWN), figsize=(9.6, 3.3), constrained_layout=True)
    truth = centre_from_corner(scene.truth)
    for row, (name, some) in enumerate(runs.items()):
        for ax, frame in zip(panels[row], SHOWN, strict=True):
            ax.imshow(scene.frames[frame][:, :, ::-1])
            cloud = some[0].clouds[frame]
            ax.plot(cloud[:, 0], cloud[:, 1], ".", color=CLOUD, markersize=2)
            ax.plot(*truth[frame, :2], "+", color=BEST, markersize=6)
            ax.set_title(f"{frame}: {some[0].particles[0, frame]:.0f}")
            ax.set_xlim(20, 300)
            ax.set_ylim(215, 35)
            ax.set_xticks([])
            ax.set_yticks([])
        panels[row, 0].set_ylabel(name.replace(" and ", "\nand "), fontsize=8)
    figure.suptitle(
        "frame: hypotheses asked about; dots are drawn from the posterior", fontsize=9, x=0.01, ha="left"
    )
    save(figure, out / "ball_clouds.png")


def main() -> None:
    """Run, print, draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, help="folder for the figures")
    options = parser.parse_args()
    runs: dict[str, list[Traced]] = {name: [] for name in VARIANTS}
    for seed in range(options.seeds):
        scene = make_scene(NAME, seed)
        for name, importance in VARIANTS.items():
            runs[name].append(traced(graph_with(importance), scene, seed))
    print(f"{options.seeds} seeds; the ball leaps into frames {IN_FLIGHT}")
    print(report(runs))
    if options.out is not None:
        draw(runs, make_scene(NAME, 0), options.out)


if __name__ == "__main__":
    main()
