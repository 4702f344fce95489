"""Modes: an interacting multiple model on the manoeuvre of the tracking chapter, and a ball that is hidden.

    python benchmarks/modes.py                     the table of docs/modes.md
    python benchmarks/modes.py --figure FILE.svg   its figure

The settings were chosen on the seeds 1000 to 1019; the table is of the seeds 0 to 59.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import figure_style  # noqa: F401  (the look of all figures)
import kalman_experiments as experiments
import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, CLOUD, PEER, QUIET, WARNING
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bayesnet_track import Tracker
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.modal import ModalFilter
from bayesnet_track.belief.modes import make_modes
from bayesnet_track.belief.motion.modal import Modal
from bayesnet_track.graph import spec
from bayesnet_track.sources.scenes import make_scene

Floats = NDArray[np.float64]

TURNING = slice(20, 44)
DRAWN = {
    "Kalman, sd 1.5": (PEER, "-"),
    "UKF, the same": (CLOUD, "--"),
    "modes: sd .2, or turn (UKF)": (BEST, "-"),
}
PARTS = {"straight": slice(5, 20), "turning": TURNING, "all": slice(5, None)}


def in_modes(kind: str, motions: Sequence[MotionModel]) -> tuple[ModalFilter, Modal]:
    """A filter whose target changes between these motions every 20 frames on average."""
    modes = make_modes({f"mode_{number}": spec.Mode(mean_frames=20) for number in range(len(motions))})
    settings = spec.Gaussian.model_validate({"filter": kind, "gate": 1.0, "samples": 20})
    return ModalFilter(settings, modes), Modal(modes, tuple(motions))


def filters() -> dict[str, tuple[Any, MotionModel]]:
    """What is compared: the chapter's filters, and modes of the same motions."""
    straight, wide = experiments.constant_velocity(0.2), experiments.constant_velocity(1.5)
    return {
        "Kalman, sd of velocity .2": (experiments.gaussian("kalman", 1.0), straight),
        "Kalman, sd 1.5": (experiments.gaussian("kalman", 1.0), wide),
        "EKF, turn at an unknown rate": (experiments.gaussian("extended", 1.0), experiments.turning()),
        "UKF, the same": (experiments.gaussian("unscented", 1.0), experiments.turning()),
        "modes: sd .2 or 1.5": in_modes("kalman", (straight, wide)),
        "modes: sd .2, or turn (EKF)": in_modes("extended", (straight, experiments.turning())),
        "modes: sd .2, or turn (UKF)": in_modes("unscented", (straight, experiments.turning())),
    }


def manoeuvres(seeds: Sequence[int], names: Sequence[str] = ()) -> dict[str, list[experiments.Track]]:
    """Filter -> its tracks of figure 3.13."""
    path = experiments.manoeuvre()
    return {
        name: [
            experiments.follow(belief, motion, path, experiments.measure(path, seed), seed) for seed in seeds
        ]
        for name, (belief, motion) in filters().items()
        if not names or name in names
    }


def print_table(found: dict[str, list[experiments.Track]]) -> None:
    """Errors, and the paired difference to the last filter with its standard error."""
    best = experiments.rmse(found["modes: sd .2, or turn (UKF)"], PARTS["all"])
    print(f"{len(best)} runs: rmse in px; share inside 90 %; all, less the last row's, with standard error")
    for name, tracks in found.items():
        errors = [experiments.rmse(tracks, part) for part in PARTS.values()]
        inside = np.mean([track.inside()[5:].mean() for track in tracks])
        more = errors[-1] - best
        row = " ".join(f"{error.mean():6.2f}" for error in errors)
        print(f"{name:30s} {row} {inside:6.2f} {more.mean():+.2f} ± {more.std() / np.sqrt(len(more)):.2f}")


def hidden_ball() -> tuple[Floats, Floats, Floats]:
    """Of the graph `hidden_ball` on its scene: P(hidden), share of the ball in view, 1 where it is lost."""
    scene, tracker = make_scene("flying_ball", 0), Tracker("hidden_ball")
    images = iter(scene.frames)
    tracker.init(next(images), scene.start_box)
    lines = [tracker.targets[0]]
    for image in images:
        tracker.update(image)
        lines.append(tracker.targets[0])
    hidden = np.array([line.hidden for line in lines], dtype=np.float64)
    return hidden, scene.visible, np.array([float(line.status == "lost") for line in lines])


def draw(found: dict[str, list[experiments.Track]]) -> Figure:
    """The errors on the manoeuvre by frame, and the probability that the ball is hidden."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
    for name, (colour, style) in DRAWN.items():
        away = np.array([track.estimated - track.truth for track in found[name]])
        label = "UKF, turn" if name == "UKF, the same" else name
        left.plot(np.sqrt(np.mean(np.sum(away**2, axis=2), axis=0)), style, color=colour, label=label)
    left.axvspan(19.5, 43.5, color=QUIET, alpha=0.2, linewidth=0, label="turning")
    left.set(title=f"rmse of {len(found['UKF, the same'])} runs, px", xlabel="frame", ylim=(0, 8))
    left.legend(loc="lower right", fontsize=8)
    hidden, visible, lost = hidden_ball()
    right.fill_between(range(len(lost)), lost, step="mid", color=WARNING, alpha=0.12, label="lost")
    right.plot(visible, color=QUIET, linewidth=3, label="share of the ball in view")
    right.plot(hidden, color=BEST, label="probability that it is hidden")
    right.set(title="hidden_ball", xlabel="frame", ylim=(-0.03, 1.03))
    right.legend(loc="center right", fontsize=8)
    return figure


def main() -> None:
    """Print the table, or draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", metavar="FILE", help="draw the figure, of 30 runs")
    parser.add_argument("--runs", type=int, default=60)
    options = parser.parse_args()
    if options.figure:
        draw(manoeuvres(range(30), DRAWN)).savefig(options.figure)
    else:
        print_table(manoeuvres(range(options.runs)))


if __name__ == "__main__":
    main()
