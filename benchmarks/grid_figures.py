"""Figures of the grid belief: Monte Carlo against the grid (thesis 5.1 to 5.3), and displacement matrices.

Usage: python benchmarks/grid_figures.py [--only integration,matrices] [--out docs/figures]
       python benchmarks/grid_figures.py --only matrices --sequence FOLDER --box X,Y,W,H --out /tmp

The committed pictures are of rendered scenes; FOLDER holds the pictures of a real sequence in order of name.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FIGURES = Path(__file__).parents[1] / "docs" / "figures"
TRIALS = 20


# ------------------------------------------------------------------------------- integration


@dataclass(frozen=True)
class Mixture:
    """A mixture of two Gaussians on the diagonal of [0, 1]^d, cut to that cube (thesis eqs. 5.3, 5.4).

    Attributes:
        dimension: d.
        sd: of both, on every axis.
        share: weight of the first.
        centres: of both, on every axis.
    """

    dimension: int
    sd: float = 0.1
    share: float = 0.7
    centres: tuple[float, float] = (0.25, 0.75)

    def _lines(self, at: Floats) -> Floats:
        """(2, n) the two densities along an axis, without normalisation."""
        return np.exp(-0.5 * ((at - np.array(self.centres)[:, None]) / self.sd) ** 2)

    def _mean(self, masses: Floats, firsts: Floats) -> float:
        """Mean of a coordinate from each component's mass and first moment along an axis."""
        weights = np.array([self.share, 1.0 - self.share]) * masses**self.dimension
        return float(weights @ (firsts / masses) / weights.sum())

    @property
    def mean(self) -> float:
        """The true mean of every coordinate, by 20,001 midpoints along one axis."""
        at = (np.arange(20_001) + 0.5) / 20_001
        lines = self._lines(at)
        return self._mean(lines.mean(axis=1), (lines * at).mean(axis=1))

    def grid_error(self, points: int) -> float:
        """Distance of the mean by points^d midpoints from the truth. The sum factorises over the axes."""
        at = (np.arange(points) + 0.5) / points
        lines = self._lines(at)
        found = self._mean(lines.mean(axis=1), (lines * at).mean(axis=1))
        return float(np.sqrt(self.dimension) * abs(found - self.mean))

    def sample(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, d) draws, those outside drawn again."""
        found = np.zeros((0, self.dimension))
        while len(found) < size:
            centre = np.where(rng.random((size, 1)) < self.share, *self.centres)
            drawn = rng.normal(centre, self.sd, (size, self.dimension))
            found = np.concatenate([found, drawn[((drawn >= 0) & (drawn <= 1)).all(axis=1)]])
        return found[:size]

    def monte_carlo_errors(self, size: int, rng: np.random.Generator, trials: int = TRIALS) -> Floats:
        """(trials,) distances of the samples' mean from the truth."""
        means = np.array([self.sample(size, rng).mean(axis=0) for _ in range(trials)])
        return np.asarray(np.linalg.norm(means - self.mean, axis=1))


ASIDE = (0.28, 0.71)
"""Centres that no midpoints of a coarse grid are symmetric to, as .25 and .75 are to every fourth number."""

CASES = (
    ("thesis: d = 2, sd .1, equal weights", Mixture(2, share=0.5), (3, 5, 10, 18, 32)),
    ("d = 2, sd .1, weights .7 and .3", Mixture(2), (3, 5, 7, 10, 18, 32)),
    ("d = 4, sd .1", Mixture(4), (3, 4, 6, 8, 10)),
    ("d = 8, sd .1", Mixture(8, centres=ASIDE), (2, 3, 4)),
    ("d = 3, sd .03", Mixture(3, 0.03, centres=ASIDE), (4, 6, 8, 12, 16, 22)),
)


def integration(out: Path) -> None:
    """Print both errors for every case, and draw them beside the density and the two sets of samples."""
    import figure_style as style
    import matplotlib.pyplot as plt

    rng = np.random.default_rng(0)
    figure, axes = plt.subplots(2, 3, figsize=(10, 6.4), layout="constrained")
    panels = axes.ravel()
    at = (np.arange(80) + 0.5) / 80
    thesis = CASES[0][1]
    lines = thesis._lines(at)
    density = sum(w * np.outer(line, line) for w, line in zip((0.5, 0.5), lines, strict=True))
    panels[0].imshow(density, origin="lower", extent=(0, 1, 0, 1), cmap=style.SURFACE)
    grid = np.stack(np.meshgrid((np.arange(18) + 0.5) / 18, (np.arange(18) + 0.5) / 18), -1).reshape(-1, 2)
    drawn = thesis.sample(324, rng)
    panels[0].plot(*grid.T, ".", color=style.QUIET, markersize=1.5)
    panels[0].plot(*drawn.T, "x", color="white", markersize=2.5, markeredgewidth=0.6)
    panels[0].set_title("5.1, 5.3: density and samples")
    for panel, (name, mixture, sides) in zip(panels[1:], CASES, strict=True):
        sizes = [side**mixture.dimension for side in sides]
        grids = [mixture.grid_error(side) for side in sides]
        spread = [mixture.monte_carlo_errors(size, rng) for size in sizes]
        for size, by_grid, errors in zip(sizes, grids, spread, strict=True):
            rms = np.sqrt((errors**2).mean())
            print(f"{name:<38} N {size:>6}  grid {by_grid:8.1e}  Monte Carlo rms {rms:8.1e}")
        middle = np.array([errors.mean() for errors in spread])
        ends = np.array([[m - e.min(), e.max() - m] for m, e in zip(middle, spread, strict=True)]).T
        panel.errorbar(sizes, middle, ends, color=style.CLOUD, capsize=2, label="Monte Carlo, 20 trials")
        panel.plot(
            sizes, np.maximum(grids, 1e-7), "o-", color=style.PEER, markersize=4, label="midpoint grid"
        )
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_title(f"5.2: {name}" if panel is panels[1] else name)
    panels[1].text(0.05, 0.1, "grid: 0 by symmetry", transform=panels[1].transAxes, fontsize=8.5)
    panels[2].legend(loc="lower left", fontsize=8.5)
    for panel in axes[1]:
        panel.set_xlabel("samples or cells")
    for panel in (panels[1], panels[3]):
        panel.set_ylabel("error of the mean")
    style.save(figure, out / "integration.png")


# ------------------------------------------------------------------------------- matrices


def gray_pictures(folder: Path | None, count: int) -> tuple[list[NDArray[np.uint8]], Floats]:
    """The pictures of a folder, or of a rendered scene with its start box."""
    import cv2

    from bayesnet_track.numerics.boxes import centre_from_corner
    from bayesnet_track.sources.scenes import make_scene
    from bayesnet_track.vision.planes.gray_plane import gray

    if folder is None:
        scene = make_scene("gray_square", 0)
        return [gray(scene.frames[k]) for k in range(count)], centre_from_corner(scene.start_box)
    files = sorted(path for path in folder.iterdir() if path.suffix in {".jpg", ".png"})[:count]
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in files], np.zeros(4)


def as_gaussian(matrix: Floats) -> Floats:
    """A Gaussian of the matrix' mean and covariance, on the same cells."""
    from bayesnet_track.vision.displacement import moments

    mean, covariance = moments(matrix)
    steps = np.arange(len(matrix)) - (len(matrix) - 1) / 2
    u, v = np.meshgrid(steps - mean[0], steps - mean[1])
    away = np.stack([u, v], -1)
    inverse = np.linalg.inv(covariance + 0.05 * np.eye(2))
    values = np.exp(-0.5 * np.einsum("...k,kl,...l", away, inverse, away))
    return np.asarray(values / values.sum())


def matrices(out: Path, folder: Path | None = None, box: Floats | None = None) -> None:
    """One point's matrix, the same filtered over the frames, the sum over all points; below, as Gaussians."""
    import figure_style as style
    import matplotlib.pyplot as plt

    from bayesnet_track.vision.displacement import (
        Matching,
        Points,
        cut_patches,
        displace,
        flat_motion,
        moments,
    )

    pictures, start = gray_pictures(folder, 6)
    start = start if box is None else box
    matching = Matching(reach=10, sd_gray=12.0, sd_motion_px=0.7)
    x, y = (np.linspace(-0.42, 0.42, 7) * side + at for at, side in zip(start[:2], start[2:], strict=True))
    at = np.rint(np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)).astype(np.int64)
    patches, whole = cut_patches(pictures[0], (0, 0), at, 9)
    whole &= patches.var(axis=(1, 2)) > 36.0
    still = np.zeros(2, dtype=np.int64)
    points = Points(at[whole], patches[whole], flat_motion(int(whole.sum()), matching), still)
    for picture in pictures[1:]:
        now = displace(points, picture, (0, 0), 1.0, still, matching)
        if now is None:
            raise SystemExit("no point is seen again")
        before, points = points, now.points
        # As the paper does: each picture is compared with the one before it.
        points = Points(
            points.at, cut_patches(picture, (0, 0), points.at, 9)[0], points.motion, points.centre
        )
    spreads = np.array([np.trace(moments(m)[1]) for m in now.measured])
    gains = spreads / np.array([np.trace(moments(m)[1]) + 0.3 for m in now.points.motion])
    one = int(np.argmax(np.where(now.seen, gains, 0)))
    shown = [now.measured[one], now.points.motion[one], now.total]
    figure, axes = plt.subplots(2, 4, figsize=(10, 5), layout="constrained")
    picture = np.repeat(pictures[-2][:, :, None], 3, axis=2)
    style.show(axes[0, 0], picture, "points; the one shown", with_ticks=False)
    axes[0, 0].plot(*before.at.T, ".", color=style.CLOUD, markersize=3)
    axes[0, 0].plot(*before.at[one], "o", color=style.WARNING, markersize=9, fillstyle="none")
    low, high = before.at.min(axis=0) - 25, before.at.max(axis=0) + 25
    axes[0, 0].set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
    axes[1, 0].axis("off")
    titles = ("one point", "filtered", "P_sum")
    for column, (matrix, title) in enumerate(zip(shown, titles, strict=True), 1):
        r = matching.reach + 0.5
        for row, values in enumerate((matrix, as_gaussian(matrix))):
            panel = axes[row, column]
            panel.imshow(values, extent=(-r, r, r, -r), cmap=style.SURFACE)
            panel.set_title(title if row == 0 else f"{title}, as a Gaussian")
        mean, covariance = moments(matrix)
        peak = np.unravel_index(int(np.argmax(as_gaussian(matrix))), matrix.shape)
        under = matrix[peak] / matrix.max()
        print(
            f"{title:<10} mean u {mean[0]:6.2f} v {mean[1]:6.2f}  "
            f"sd {np.sqrt(np.diag(covariance)).round(2)}  "
            f"matrix under the Gaussian's peak: {under:.2g} of its maximum"
        )
    axes[0, 1].set_ylabel("v [px]")
    axes[1, 1].set_ylabel("v [px]")
    axes[1, 2].set_xlabel("u [px]")
    style.save(figure, out / "displacement_matrices.png")


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the figures that are asked for."""
    parser = argparse.ArgumentParser(description="Figures of the grid belief.")
    parser.add_argument("--only", default="integration,matrices")
    parser.add_argument("--out", type=Path, default=FIGURES)
    parser.add_argument("--sequence", type=Path, default=None)
    parser.add_argument("--box", default=None, help="top-left corner box X,Y,W,H in the first picture")
    chosen = parser.parse_args(arguments)
    if "integration" in chosen.only:
        integration(chosen.out)
    if "matrices" in chosen.only:
        from bayesnet_track.numerics.boxes import centre_from_corner

        box = None if chosen.box is None else centre_from_corner([float(v) for v in chosen.box.split(",")])
        matrices(chosen.out, chosen.sequence, box)


if __name__ == "__main__":
    main()
