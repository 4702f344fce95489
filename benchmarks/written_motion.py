"""What a motion that is written down gains behind a pillar, and smoothing afterwards: the ball in flight.

    python benchmarks/written_motion.py [--seeds 20] [--figure docs/figures/written_motion.svg]

`falling_ball` knows gravity, `kalman_ball` takes it for noise; both measure by mean shift. Prints, of each
run and of the same smoothed, the distance from the hidden ball and the square root of UD in its last frame.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, INK, PEER, QUIET
from matplotlib.patches import Rectangle
from measuring import on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track import Start, open_run, track
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.runtime.smoothing import smooth
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import Scene, make_scene

Floats = NDArray[np.float64]
GRAPHS = ("kalman_ball", "falling_ball")


@dataclass(frozen=True)
class Flight:
    """(T, 2) centres, (T,) square root of UD, (T, 4) 90 % regions: x_low, x_high, y_low, y_high."""

    centres: Floats
    spread: Floats
    regions: Floats


def fly(graph: str, scene: Scene, seed: int) -> tuple[Flight, Flight]:
    """One run, and the same smoothed."""
    with tempfile.TemporaryDirectory() as out:
        source = SceneSource(scene, "scene:flying_ball")
        list(track(graph, source, [Start(scene.start_box)], seed=seed, out=f"{out}/run", keep_beliefs=True))
        run = open_run(f"{out}/run")
        return _flight(run.metrics), _flight(smooth(run, 50, seed).metrics)


def _flight(lines: tuple[FrameMetrics, ...]) -> Flight:
    return Flight(
        np.array([line.centre_box[:2] for line in lines]),
        np.sqrt([line.ud_px2 for line in lines]),
        np.array([line.region90 for line in lines]),
    )


def row(name: str, flights: list[tuple[Scene, Flight]]) -> list[str]:
    """One line of the table."""
    away, spread, inside = [], [], []
    for scene, flight in flights:
        hidden, truth = scene.visible < 1e-9, centre_from_corner(scene.truth)[:, :2]
        away.append(np.hypot(*(flight.centres - truth)[hidden].T).mean())
        spread.append(flight.spread[np.flatnonzero(hidden)[-1]])
        low, high = flight.regions[:, ::2], flight.regions[:, 1::2]
        inside.append(((low <= truth) & (truth <= high))[hidden].mean())
    return [name, f"{np.mean(away):.1f}", f"{np.mean(spread):.1f}", f"{100 * np.mean(inside):.0f} %"]


def draw(path: str) -> None:
    """Both runs of one scene, and the smoothed one, with their 90 % regions behind the pillar."""
    scene = make_scene("flying_ball", 0)
    truth, hidden = centre_from_corner(scene.truth)[:, :2], scene.visible < 1e-9
    figure, panels = plt.subplots(1, 3, figsize=(8, 3.0), sharey=True, layout="constrained")
    plain, written = (fly(graph, scene, 0) for graph in GRAPHS)
    shown = (
        (GRAPHS[0], plain[0], PEER),
        (GRAPHS[1], written[0], BEST),
        ("kalman_ball, smoothed", plain[1], PEER),
    )
    for panel, (title, flight, colour) in zip(panels, shown, strict=True):
        panel.axvspan(*truth[hidden, 0][[0, -1]], color=QUIET, alpha=0.25, linewidth=0)
        panel.plot(*truth.T, color=INK, linewidth=1, label="ground truth")
        panel.plot(*flight.centres.T, "--", color=colour, label="estimate")
        for left, right, top, bottom in flight.regions[hidden]:
            box = Rectangle((left, top), right - left, bottom - top, fill=False, edgecolor=colour, alpha=0.5)
            panel.add_patch(box)
        panel.set(title=title, xlim=(80, 240), ylim=(130, -5), xlabel="px")
    panels[0].legend(loc="lower left", fontsize=8)
    figure.savefig(path)


def main() -> None:
    """Print the table, or draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--figure", metavar="FILE")
    options = parser.parse_args()
    on_one_thread()
    if options.figure:
        draw(options.figure)
        return
    rows = []
    for graph in GRAPHS:
        found = []
        for seed in range(options.seeds):
            scene = make_scene("flying_ball", seed)
            found.append((scene, *fly(graph, scene, seed)))
        rows.append(row(graph, [(scene, run) for scene, run, _ in found]))
        rows.append(row(f"{graph}, smoothed", [(scene, after) for scene, _, after in found]))
    print(table(["graph", "from the hidden ball, px", "√UD, px", "in its 90 % region"], rows))


if __name__ == "__main__":
    main()
