"""Figure 5.8 of the thesis by each importance function: effective hypotheses, and errors.

Usage: python benchmarks/importance_figure.py [--runs 40] [--figure docs/figures/importance.png]
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from importance import BOX, METHODS, Floats, OneFrame, R, motion_of, particle_filter

from bayesnet_track.belief.contract import Step
from bayesnet_track.belief.particles.belief import ParticleSet
from bayesnet_track.numerics.log_weights import LogWeights

CLUSTERS = np.array([[100.0, 140.0], [220.0, 120.0], [150.0, 40.0]])
SHARES = np.array([0.94, 0.04, 0.02])
CLUSTER_SD, STEP_SD = 12.0, 6.0


def figure_frame(size: int, seed: int) -> OneFrame:
    """A prior of three clusters, most of it on the first; the likelihood stands at the edge of the second."""
    rng = np.random.default_rng(seed)
    cluster = rng.choice(3, size, p=SHARES)
    states = np.tile(BOX, (size, 1))
    states[:, :2] = CLUSTERS[cluster] + CLUSTER_SD * rng.standard_normal((size, 2))
    motion = motion_of("random_walk", sd_px={"x": STEP_SD, "y": STEP_SD})
    return OneFrame(motion, ParticleSet(states, motion.fields, LogWeights.uniform(size)), FIGURE_PLACE)


FIGURE_PLACE = CLUSTERS[1] + np.array([15.0, -10.0])


def figure_exact() -> tuple[Floats, Floats]:
    """Mean and covariance of the exact posterior: only the second cluster counts there."""
    prior = CLUSTER_SD**2 + STEP_SD**2
    gain = prior / (prior + R**2)
    return CLUSTERS[1] + gain * (FIGURE_PLACE - CLUSTERS[1]), np.eye(2) * prior * (1 - gain)


def print_figure(runs: int, figure: Path | None, size: int = 300) -> None:
    """Figure 5.8: effective hypotheses and errors by each method, and the plot."""
    mean, covariance = figure_exact()
    sd = float(np.sqrt(covariance[0, 0]))
    print(
        f"Figure 5.8: prior on cluster 1 ({SHARES[0]:.0%}), likelihood on cluster 2 ({SHARES[1]:.0%}); "
        f"N = {size}, {runs} runs"
    )
    beliefs = {"plain, 2 N": particle_filter(2 * size, "bootstrap")}
    beliefs |= {name: particle_filter(size, importance) for name, importance in METHODS.items()}
    kept = {}
    for name, belief in beliefs.items():
        steps = [figure_frame(size, seed).step(belief, seed) for seed in range(runs)]
        effective = np.mean([step.posterior.weights.ess for step in steps])
        away = [np.sum((step.posterior.mean[:2] - mean) ** 2) / 2 for step in steps]
        spread = np.mean([np.sqrt(np.trace(step.posterior.covariance[:2, :2]) / 2) for step in steps])
        print(
            f"  {name:20s} {effective:6.1f} effective of {np.mean([len(s.posterior) for s in steps]):.0f}; "
            f"rmse of the mean {np.sqrt(np.mean(away)) / sd:.2f} sd, sd {spread / sd:.2f} of the exact one"
        )
        kept[name] = steps[0]
    if figure is not None:
        draw_figure(kept, figure)


def draw_figure(steps: Mapping[str, Step[ParticleSet]], path: Path) -> None:
    """The posterior by each method: area of a point is its weight; the cross is the exact mean."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    mean, covariance = figure_exact()
    figure, axes = plt.subplots(2, 4, figsize=(13, 6.4), sharex=True, sharey=True)
    for axis, (name, step) in zip(axes.ravel(), steps.items(), strict=True):
        states, weights = step.posterior.states, step.posterior.weights.weights
        axis.scatter(states[:, 0], states[:, 1], s=3, color="0.75", linewidths=0)
        axis.scatter(states[:, 0], states[:, 1], s=600 * weights, color="C0", alpha=0.5, linewidths=0)
        axis.add_patch(plt.Circle(tuple(mean), 2 * np.sqrt(covariance[0, 0]), fill=False, color="C3"))
        axis.set_title(f"{name}\n{step.posterior.weights.ess:.0f} effective of {len(states)}", fontsize=9)
        axis.set_aspect("equal")
    axes[0, 0].invert_yaxis()
    figure.supxlabel("x, px")
    figure.supylabel("y, px")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Print the table, and draw the figure on request."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=40, help="frames by each method")
    parser.add_argument("--figure", type=Path, help="where to draw it")
    arguments = parser.parse_args()
    print_figure(arguments.runs, arguments.figure)


if __name__ == "__main__":
    main()
