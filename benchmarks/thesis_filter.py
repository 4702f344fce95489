"""Thesis figures 5.4 to 5.7: importance sampling, a mismatched proposal, and what the bounds ask for.

Usage: python benchmarks/thesis_filter.py [--runs 50] [--out docs/figures]

p = N(3, 2) / 2 + N(10, 2) / 2 is sampled through q = N(2, 4) / 2 + N(7, 4) / 2 (means and variances), as in
`sample_size.py`, whose table has the same bounds. Prints the figures; with --out it draws them too.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import sample_size
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SAMPLES = 100
MEAN = 6.5


def draw_posterior(count: int, rng: np.random.Generator) -> Floats:
    """Values from p."""
    return np.where(rng.random(count) < 0.5, 3.0, 10.0) + np.sqrt(2.0) * rng.standard_normal(count)


def exact_shares() -> Floats:
    """The probability under p of each bin of `sample_size.EDGES`."""
    fine = np.linspace(-30.0, 45.0, 300_001)
    share: Floats = np.histogram(fine, sample_size.EDGES, weights=sample_size.posterior(fine))[0]
    return share * (fine[1] - fine[0])


def right_mode(runs: int) -> tuple[Floats, Floats]:
    """Figure 5.5: effective samples of p's right mode (beyond 6.5) among 100 from p, and among 100 from q."""
    found: tuple[list[float], list[float]] = ([], [])
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        found[0].append(float(np.sum(draw_posterior(SAMPLES, rng) > MEAN)))
        x = sample_size.draw(SAMPLES, rng)
        w = (sample_size.posterior(x) / sample_size.proposal(x))[x > MEAN]
        found[1].append(float(w.sum() ** 2 / np.sum(w**2)))
    return np.array(found[0]), np.array(found[1])


@dataclass(frozen=True, eq=False)
class Trials:
    """One bound over many runs, (runs,) each.

    Attributes:
        counts: the number of samples that it asks for.
        errors: KL divergence of the estimate in nats, from that many samples of q.
        from_posterior: the same from that many samples of p itself.
        means: relative error of the estimated mean.
    """

    counts: Floats
    errors: Floats
    from_posterior: Floats
    means: Floats


def trials(bound: sample_size.Bound, runs: int) -> Trials:
    """Figures 5.6 and 5.7: as many samples of q as `bound` asks for, in each of `runs` runs."""
    exact, rows = exact_shares(), []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        x = sample_size.draw(sample_size.MOST, rng)
        w = sample_size.posterior(x) / sample_size.proposal(x)
        count = sample_size.until_enough(bound, x, w)
        x, w = x[:count], w[:count]
        direct = draw_posterior(count, rng)
        rows.append(
            (
                count,
                sample_size.divergence(x, w, exact),
                sample_size.divergence(direct, np.ones(count), exact),
                w @ x / w.sum() / MEAN - 1.0,
            )
        )
    return Trials(*np.array(rows).T)


def print_all(found: dict[str, Trials], runs: int) -> None:
    """Print the figures."""
    direct, proposed = right_mode(runs)
    print(f"Figure 5.5, {SAMPLES} samples: effective ones on the right mode, {runs} runs")
    print(f"  from p {direct.mean():.1f} (sd {direct.std():.1f}), from q {proposed.mean():.1f}", end="")
    print(f" (sd {proposed.std():.1f})")
    print("Figures 5.6 and 5.7: number, KL from q, KL from as many of p, |error of the mean| < 1 %")
    for name, one in found.items():
        print(
            f"  {name:25} {one.counts.mean():7.0f} (sd {one.counts.std():4.0f})  "
            f"{one.errors.mean():.4f}  {one.from_posterior.mean():.4f}  "
            f"{np.mean(np.abs(one.means) < 0.01):.0%}"
        )


# ------------------------------------------------------------------------------------ pictures


def draw_sampling(path: Path) -> None:
    """Figures 5.4 and 5.5: both densities, the weight p / q, and 100 samples of each."""
    import matplotlib.pyplot as plt
    from figure_style import BEST, PEER, QUIET, save

    at = np.linspace(-6.0, 16.0, 600)
    p, q = sample_size.posterior(at), sample_size.proposal(at)
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 2.9), constrained_layout=True)
    for axis in axes:
        axis.plot(at, p, color=BEST, label="p, true")
        axis.plot(at, q, color=PEER, linestyle="--", label="q, proposed")
        axis.set_xlabel("x")
    for x, place, text in (
        (10.0, (7.0, 0.165), "p/q {:.1f}: counts more"),
        (5.6, (-5.8, 0.14), "p/q {:.2f}: less"),
    ):
        pair = [float(f(np.array([x]))[0]) for f in (sample_size.posterior, sample_size.proposal)]
        axes[0].plot([x, x], pair, color=QUIET, marker="o", markersize=3)
        line = {"arrowstyle": "-", "color": QUIET}
        axes[0].annotate(text.format(pair[0] / pair[1]), (x, max(pair)), place, fontsize=8.5, arrowprops=line)
    axes[0].set_ylim(0.0, 0.19)
    axes[0].set_title("(a) weights make up for the proposal")
    rng = np.random.default_rng(1)
    for height, colour, values in (
        (0.188, BEST, draw_posterior(SAMPLES, rng)),
        (0.165, PEER, sample_size.draw(SAMPLES, rng)),
    ):
        axes[1].plot(values, np.full(SAMPLES, height), "|", color=colour, markersize=7, markeredgewidth=0.7)
    axes[1].set_ylim(0.0, 0.27)
    axes[1].set_title("(b) 100 samples of each")
    axes[1].legend(loc="upper center", ncols=2, fontsize=8.5)
    save(figure, path)


def draw_bounds(found: dict[str, Trials], path: Path) -> None:
    """Figures 5.6 and 5.7: number and error of every bound, run by run."""
    import matplotlib.pyplot as plt
    from figure_style import COLOURS, PEER, QUIET, level, save

    colours = (COLOURS[0], COLOURS[7], COLOURS[6], COLOURS[4])
    figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.1), constrained_layout=True)
    for colour, (name, one) in zip(colours, found.items(), strict=True):
        axes[0].plot(one.counts / 1000, color=colour, label=name)
        if "normal" not in name:
            axes[1].plot(1000 * one.errors, color=colour)
    kld = next(iter(found.values()))
    axes[1].plot(1000 * kld.from_posterior, color=QUIET, linestyle=":", label="as many as (5.6), from p")
    axes[2].plot(100 * found["asymptotic normal (5.17)"].means, ".", color=colours[3])
    axes[2].axhspan(-1, 1, color=QUIET, alpha=0.2, linewidth=0)
    axes[0].set_title("(a) samples asked for, thousands")
    axes[0].set_ylim(0, 78)
    axes[0].legend(fontsize=7.5, ncols=2, loc="upper left")
    axes[1].set_title("(b) KL of the estimate, 10⁻³ nats")
    axes[1].set_ylim(0, 58)
    axes[1].legend(fontsize=8, loc="upper center")
    level(axes[1], 10.0, "ε", PEER)
    axes[2].set_title("(c) error of the mean by (5.17), %")
    axes[2].set_ylim(-2, 2)
    for axis in axes:
        axis.set_xlabel("run")
    save(figure, path)


def main() -> None:
    """Print, and draw where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--out", type=Path, help="where to draw")
    arguments = parser.parse_args()
    found = {name: trials(bound, arguments.runs) for name, bound in sample_size.BOUNDS.items()}
    print_all(found, arguments.runs)
    if arguments.out is not None:
        draw_sampling(arguments.out / "importance_sampling.svg")
        draw_bounds(found, arguments.out / "sample_bounds.svg")


if __name__ == "__main__":
    main()
