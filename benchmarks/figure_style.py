"""One look for all figures: sizes for a page of 800 px, colours by meaning, the parts that figures share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.colors
import matplotlib.pyplot as plt
import matplotlib.ticker
import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

Axes = Any  # matplotlib's axes in 2-D or 3-D
Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

COLOURS = ("#64748b", "#1e293b", "#94a3b8", "#cbd5e1", "#e08a1e", "#a3521b", "#2f8f5b", "#2b6cb0", "#e2e8f0")
"""For stacked parts, in a fixed order."""

INK, QUIET, CLOUD, BEST, PEER, WARNING = "#1f2937", "#9ca3af", "#0e7490", "#1d4ed8", "#be185d", "#b91c1c"
SURFACE = mpl.colors.LinearSegmentedColormap.from_list(
    "surface", ["#eef2f7", "#7dd3d8", "#0e7490", "#1e3a8a", "#3b0764"]
)
AGENTS = {
    "color": "#e08a1e",
    "histogram": "#e08a1e",
    "blobs": "#a3521b",
    "intensity": "#2f8f5b",
    "motion": "#2b6cb0",
    "stereo": "#0e7490",
    "shape": "#7c3aed",
}

mpl.rcParams.update(
    {
        "figure.dpi": 100,
        "savefig.dpi": 100,
        "font.size": 10,
        "axes.titlesize": 10,
        "axes.titlelocation": "left",
        "axes.edgecolor": QUIET,
        "axes.labelcolor": INK,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "xtick.color": INK,
        "ytick.color": INK,
        "text.color": INK,
        "legend.frameon": False,
        "lines.linewidth": 1.4,
        "svg.hashsalt": "bayesnet_track",
        "svg.fonttype": "path",
    }
)


def save(figure: Figure, path: Path) -> None:
    """Write one figure, the same bytes for the same content; pictures as PNG of few colours, plots as SVG."""
    metadata = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    figure.savefig(path, metadata=metadata)
    plt.close(figure)
    if path.suffix == ".png":
        _fewer_colours(path)


def _fewer_colours(path: Path) -> None:
    from PIL import Image as Picture

    with Picture.open(path) as picture:
        picture.convert("RGB").quantize(200, Picture.Quantize.MAXCOVERAGE, dither=Picture.Dither.NONE).save(
            path, optimize=True
        )


def show(axes: Axes, image: Image, title: str, with_ticks: bool = True) -> None:
    """A BGR picture in pixel coordinates, its noise coarsened to steps of 12 so that files stay small."""
    height, width = image.shape[:2]
    shown = np.minimum(image.astype(int) // 12 * 12 + 6, 255).astype(np.uint8)
    axes.imshow(shown[:, :, ::-1], extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="nearest")
    axes.set_title(title)
    axes.spines[:].set_visible(False)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    if with_ticks:
        axes.set_xticks([0, width // 2, width])
        axes.set_yticks([0, height // 2, height])
        axes.tick_params(length=2, labelsize=8)
    else:
        axes.set_xticks([])
        axes.set_yticks([])


def boxes(axes: Axes, centres: Floats, colour: str, alpha: float = 1.0, width: float = 1.0) -> None:
    """Outlines of centre boxes (N, 4)."""
    patches = [Rectangle((x - w / 2, y - h / 2), w, h) for x, y, w, h in np.atleast_2d(centres)]
    axes.add_collection(
        PatchCollection(patches, facecolor="none", edgecolor=colour, alpha=alpha, linewidth=width)
    )


def logarithmic(axes: Axes, ticks: Sequence[float] = (50, 100, 200, 500, 1000, 2000, 5000)) -> None:
    """A logarithmic vertical axis with plain numbers."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_yticks([tick for tick in ticks if low <= tick <= high])
    axes.yaxis.set_major_formatter(mpl.ticker.ScalarFormatter())
    axes.yaxis.set_minor_locator(mpl.ticker.NullLocator())


def level(axes: Axes, value: float, text: str, colour: str, style: str = "--") -> None:
    """A horizontal line, named in the right margin."""
    axes.axhline(value, color=colour, linestyle=style, linewidth=1)
    axes.text(
        1.01, value, text, transform=axes.get_yaxis_transform(), va="center", fontsize=8.5, color=colour
    )


def shaded(axes: Axes, where: NDArray[np.bool_], text: str) -> None:
    """Gray bands over the frames where something holds."""
    for k, (start, end) in enumerate(_stretches(where)):
        axes.axvspan(
            start - 0.5, end - 0.5, color=QUIET, alpha=0.25, linewidth=0, label=text if k == 0 else None
        )


def _stretches(where: NDArray[np.bool_]) -> list[tuple[int, int]]:
    steps = np.diff(np.concatenate([[0], where.astype(int), [0]]))
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    return [(int(start), int(end)) for start, end in zip(starts, ends, strict=True)]


def label(axes: Axes, centre: Floats, text: str) -> None:
    """A name in the middle of an object."""
    axes.text(
        centre[0],
        centre[1],
        text,
        color="white",
        ha="center",
        va="center",
        fontsize=9,
        fontweight="bold",
        clip_on=True,
    )


def activity(axes: Axes, active: Sequence[Sequence[str]], agents: Sequence[str]) -> None:
    """A bar per agent over the frames in which it was active; active[i] belongs to frame i."""
    for place, agent in enumerate(reversed(agents)):
        on = np.array([agent in working for working in active])
        spans = [(start - 0.5, end - start) for start, end in _stretches(on)]
        axes.broken_barh(spans, (place - 0.32, 0.64), color=AGENTS[agent])
    axes.set_yticks(range(len(agents)), list(reversed(agents)))
    axes.set_ylim(-0.6, len(agents) - 0.4)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def density(
    states: Floats, weights: Floats, window: tuple[int, int, int, int], sd: float = 3.0
) -> tuple[Floats, Floats, Floats]:
    """Columns, rows and the density (10^-3 px^-2) of the centre: the weighted hypotheses, smoothed.

    `window` is x from, x to, y from, y to in px; `sd` that of the Gaussian which smooths, in px.
    """
    x, y = np.arange(window[0], window[1], 2.0), np.arange(window[2], window[3], 2.0)
    across = np.exp(-0.5 * ((x - states[:, :1]) / sd) ** 2)
    down = np.exp(-0.5 * ((y - states[:, 1:2]) / sd) ** 2)
    return x, y, 1e3 * (down * weights[:, None]).T @ across / (2.0 * np.pi * sd**2)


def surface(axes: Axes, grid: tuple[Floats, Floats, Floats], title: str) -> None:
    """A density in 3-D; the vertical axis has a scale of its own."""
    x, y, values = grid
    columns, rows = np.meshgrid(x, y)
    axes.plot_surface(
        columns, rows, values, cmap=SURFACE, rcount=len(y), ccount=len(x), linewidth=0, antialiased=False
    )
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[-1], y[0])
    axes.set_zlim(0.0, 1.05 * float(values.max()))
    for axis, most in ((axes.xaxis, 4), (axes.yaxis, 3), (axes.zaxis, 3)):
        axis.set_major_locator(mpl.ticker.MaxNLocator(most))
    axes.set_xlabel("x [px]", labelpad=-6, fontsize=9)
    axes.set_ylabel("y [px]", labelpad=-6, fontsize=9)
    axes.set_title(title, y=1.0)
    axes.tick_params(labelsize=8, pad=-3)
    axes.view_init(elev=32, azim=-62)
    axes.set_box_aspect((4, 3, 2.2), zoom=1.12)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis._axinfo["grid"]["color"] = "#e5e7eb"
