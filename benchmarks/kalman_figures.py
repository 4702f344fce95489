"""The tracking chapter's figures 3.11-3.13 and 3.16: prints what was measured and draws a run of each.

    python benchmarks/kalman_figures.py [--out docs/figures] [--runs 200]

Needs matplotlib (the extra `figures`). Takes about four minutes with 200 runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import kalman_experiments as experiments
import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, CLOUD, INK, PEER, QUIET, WARNING, save
from kalman_experiments import HIDDEN, OTHER, TARGET, Floats, Track
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.graph import spec

Axes = Any


def main() -> None:
    """Print the tables and draw the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    parser.add_argument("--runs", type=int, default=200)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name, make in (
        ("kalman_uniform.svg", uniform),
        ("kalman_occlusion.svg", occlusion),
        ("kalman_manoeuvre.svg", manoeuvre),
        ("kalman_bimodal.png", bimodal),
    ):
        save(make(options.runs), options.out / name)


def _row(name: str, *values: Floats) -> None:
    print(f"{name:28s}" + "".join(f"  {v.mean():6.2f} (sd {v.std():5.2f})" for v in values))


def _ground(axes: Axes, title: str) -> None:
    axes.set_title(title)
    axes.set_aspect("equal")
    low, high = sorted(axes.get_ylim())
    axes.set_ylim(high, low)
    axes.set_xlabel("x [px]")
    axes.set_ylabel("y [px]")


def _ellipses(axes: Axes, track: Track, frames: Sequence[int], colour: str) -> None:
    """The ellipse that holds 90 % of the belief, at some frames."""
    for k in frames:
        values, vectors = np.linalg.eigh(track.covariance[k])
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        size = 2 * np.sqrt(values[::-1] * -2 * np.log(0.1))
        axes.add_patch(
            Ellipse(track.estimated[k], *size, angle=angle, fill=False, edgecolor=colour, linewidth=0.8)
        )


def uniform(runs: int) -> Figure:
    """Figure 3.11."""
    tracks = experiments.uniform_motion(runs)
    late = slice(10, None)
    print(f"3.11 uniform motion, {runs} runs, frames 10 to 59: rmse in px")
    for part in ("measured", "predicted", "estimated"):
        _row(part, experiments.rmse(tracks, late, part))
    _row("truth inside the 90 % ellipse", np.array([track.inside()[late].mean() for track in tracks]))
    one = tracks[0]
    figure, axes = plt.subplots(figsize=(8, 4.4), layout="constrained")
    axes.plot(*one.truth.T, color=QUIET, linewidth=4, label="true path")
    axes.plot(*one.measured.T, ".", color=PEER, markersize=4, label="measured")
    axes.plot(*one.predicted.T, "+", color=INK, markersize=5, label="predicted")
    axes.plot(*one.estimated.T, color=BEST, label="estimated")
    _ellipses(axes, one, range(4, 60, 8), BEST)
    _ground(axes, "Kalman filter, uniform motion; ellipses hold 90 %")
    axes.legend(loc="upper left")
    return figure


def occlusion(runs: int) -> Figure:
    """Figure 3.12."""
    found = experiments.occlusion(runs)
    print(f"3.12 occlusion in frames 25 to 39, {runs} runs: rmse in px while hidden, in frame 39, from 45 on")
    for name, tracks in found.items():
        parts = (HIDDEN, slice(39, 40), slice(45, None))
        _row(name, *(experiments.rmse(tracks, part) for part in parts))
    gated = found["another, gate .99"]
    _row("wrong ones not used", np.array([track.gated[HIDDEN].mean() for track in gated]))
    _row("first right one used", np.array([1.0 - track.gated[40] for track in gated]))
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained", sharey=True)
    for axes, name, title in (
        (left, "another, gate .99", "gate .99: predicted only"),
        (right, "another, no gate", "no gate: the other ball is followed"),
    ):
        one = found[name][0]
        axes.plot(*one.truth.T, color=QUIET, linewidth=4, label="true path")
        axes.plot(*one.measured.T, ".", color=PEER, markersize=4, label="measured")
        axes.plot(*one.estimated.T, color=BEST, label="estimated")
        axes.plot(*one.estimated[HIDDEN].T, ".", color=WARNING, markersize=4, label="hidden")
        _ellipses(axes, one, [24, 29, 34, 39, 44], BEST)
        _ground(axes, title)
    right.set_ylabel("")
    left.legend(loc="upper left", fontsize=8)
    return figure


def manoeuvre(runs: int) -> Figure:
    """Figure 3.13."""
    found = experiments.manoeuvres(runs)
    print(f"3.13 manoeuvre, {runs} runs: rmse in px straight (5-19), turning (20-43), all; share inside 90 %")
    for name, tracks in found.items():
        parts = (slice(5, 20), slice(20, 44), slice(5, None))
        inside = np.array([track.inside()[5:].mean() for track in tracks])
        _row(name, *(experiments.rmse(tracks, part) for part in parts), inside)
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.9), layout="constrained", width_ratios=(1.15, 1))
    styles = {
        "Kalman, uniform motion": (WARNING, "-"),
        "Kalman, wide noise": (PEER, "-"),
        "EKF, turn": (BEST, "-"),
        "UKF, turn": (CLOUD, "--"),
        "particles, turn": (INK, ":"),
    }
    one = found["EKF, turn"][0]
    left.plot(*one.truth.T, color=QUIET, linewidth=4, label="true path")
    left.plot(*one.measured.T, ".", color=QUIET, markersize=4, label="measured")
    for name, (colour, style) in styles.items():
        left.plot(*found[name][0].estimated.T, style, color=colour, label=name)
        away = np.array([track.estimated - track.truth for track in found[name]])
        right.plot(np.sqrt(np.mean(np.sum(away**2, axis=2), axis=0)), style, color=colour, label=name)
    _ground(left, "one run")
    right.axvspan(19.5, 43.5, color=QUIET, alpha=0.2, linewidth=0, label="turning")
    right.set_title(f"rmse of {runs} runs, px")
    right.set_xlabel("frame")
    right.set_ylim(0, 26)
    right.legend(loc="upper left", fontsize=8)
    return figure


def bimodal(runs: int) -> Figure:
    """Figure 3.16."""
    for size in (500, 100):
        found = experiments.bimodal(50, size)
        print(
            f"3.16 two modes, {size} particles: of 50 runs within 10 px of the target; rms distance of these"
        )
        for name, places in found.items():
            away = np.linalg.norm(places - TARGET, axis=1)
            near = away[away < 10.0]
            print(
                f"{name:28s}  {experiments.held(places)}  {np.sqrt(np.mean(near**2)) if len(near) else 0:.2f}"
            )
    figure, axes = plt.subplots(figsize=(8, 3.4), layout="constrained")
    step = experiments.two_mode_step(ParticleFilter(spec.Particles(size=500)), 0)
    states, weights = step.support.states, step.support.weights.weights
    axes.scatter(*states[:, :2].T, s=3, color=QUIET, label="hypotheses, larger by weight")
    axes.scatter(*states[:, :2].T, s=4000 * weights, color=CLOUD, alpha=0.45, linewidth=0)
    for at, text in ((TARGET, "target"), (OTHER, "another, .8 as likely")):
        axes.annotate(text, (at[0], at[1] + 34), ha="center", fontsize=9)
    found = experiments.bimodal(50)
    marks = {
        "mean": ("x", WARNING),
        "gaussian": ("^", PEER),
        "best": ("o", BEST),
        "robust_mean": ("s", INK),
    }
    for name, (mark, colour) in marks.items():
        axes.plot(
            *found[name].T, mark, color=colour, markersize=4, fillstyle="none", linestyle="", label=name
        )
    _ground(axes, "two modes: estimates of 50 runs, hypotheses of one")
    axes.set_xlim(50, 290)
    axes.set_ylim(170, 45)
    axes.legend(loc="upper right", fontsize=8)
    return figure


if __name__ == "__main__":
    main()
