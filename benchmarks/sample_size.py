"""The example of thesis 5.4: how many hypotheses each bound asks for, and the error that comes of it.

A posterior of two Gaussians is sampled through two others that do not match it (figures 5.5-5.7). Hypotheses
are drawn until there are as many as they ask for.

Usage: python benchmarks/sample_size.py [runs]
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from bayesnet_track.numerics import sample_size as sizes

ERROR, CONFIDENCE, BIN = 0.01, 0.95, 0.25
EDGES = np.arange(-12.0, 26.0 + BIN / 2, BIN)
MOST = 120_000
Bound = Callable[[np.ndarray, np.ndarray], float]


def mixture(x: np.ndarray, means: tuple[float, float], variance: float) -> np.ndarray:
    """Density of two Gaussians of equal weight."""
    away = (x[:, None] - np.array(means)) ** 2
    return np.exp(-0.5 * away / variance).sum(axis=1) / (2 * np.sqrt(2 * np.pi * variance))


def posterior(x: np.ndarray) -> np.ndarray:
    """p = N(3, 2) / 2 + N(10, 2) / 2; the second parameter is the variance."""
    return mixture(x, (3.0, 10.0), 2.0)


def proposal(x: np.ndarray) -> np.ndarray:
    """q = N(2, 4) / 2 + N(7, 4) / 2."""
    return mixture(x, (2.0, 7.0), 4.0)


def draw(count: int, rng: np.random.Generator) -> np.ndarray:
    """Values from the proposal."""
    return np.where(rng.random(count) < 0.5, 2.0, 7.0) + 2.0 * rng.standard_normal(count)


def until_enough(bound: Bound, x: np.ndarray, w: np.ndarray) -> int:
    """The first number, of a sequence that grows by at most 30 %, that is as large as its sample asks for."""
    count = 100
    while (need := bound(x[:count], w[:count])) > count:
        count = min(max(count + 1, int(min(1.3 * count, np.ceil(need)))), len(x))
    return count


def divergence(x: np.ndarray, w: np.ndarray, exact: np.ndarray) -> float:
    """KL(estimate || posterior) over the bins, nats."""
    share = np.histogram(x, EDGES, weights=w)[0] / w.sum()
    return float(np.sum(share[share > 0] * np.log(share[share > 0] / exact[share > 0])))


def binned(worth: Callable[[np.ndarray, np.ndarray], float]) -> Bound:
    """A bound of the KLD family."""
    return lambda x, w: sizes.kld_revised(sizes.occupied_bins(x, w, BIN), ERROR, CONFIDENCE, worth(x, w))


def of_the_mean(x: np.ndarray, w: np.ndarray) -> float:
    """(5.17) with the thesis' error, 1 % of the mean 6.5."""
    return sizes.asymptotic_normal(sizes.importance_variance(x, w), ERROR * 6.5, CONFIDENCE)


BOUNDS: dict[str, Bound] = {
    "KLD (5.6)": binned(lambda x, w: 1.0),
    "KLD revised (5.10)": binned(sizes.inflation),
    "simplified (5.14)": binned(lambda x, w: sizes.simple_inflation(w)),
    "asymptotic normal (5.17)": of_the_mean,
}


def main() -> None:
    """Print one line for each bound: number and KL with their sds, and how often the mean is right."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    fine = np.linspace(-30.0, 45.0, 300_001)
    step, p, q = fine[1] - fine[0], posterior(fine), proposal(fine)
    inflation = np.sum((fine - 6.5) ** 2 * p**2 / q) / np.sum((fine - 6.5) ** 2 * p)
    print(f"by quadrature: sigma2_IS / Var {inflation:.3f}, E w^2 {np.sum(p**2 / q) * step:.3f}, ", end="")
    print(f"KL(p || q) {np.sum(p * np.log(p / q)) * step:.3f}")
    exact = np.histogram(fine, EDGES, weights=p * step)[0]
    print(f"{'bound':26}{'N':>9}{'sd':>7}{'KL':>9}{'sd':>8}{'|error| < 1 %':>16}   ({runs} runs)")
    for name, bound in BOUNDS.items():
        rows = []
        for seed in range(runs):
            x = draw(MOST, np.random.default_rng(seed))
            w = posterior(x) / proposal(x)
            count = until_enough(bound, x, w)
            x, w = x[:count], w[:count]
            rows.append((count, divergence(x, w, exact), abs(w @ x / w.sum() / 6.5 - 1) < ERROR))
        mean, sd = np.mean(rows, axis=0), np.std(rows, axis=0)
        print(f"{name:26}{mean[0]:9.0f}{sd[0]:7.0f}{mean[1]:9.4f}{sd[1]:8.4f}{mean[2]:16.0%}")


if __name__ == "__main__":
    main()
