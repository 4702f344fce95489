"""One look for all figures: sizes for a page of 800 px, colours by meaning, the parts that figures share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

COLOURS = ("#64748b", "#1e293b", "#94a3b8", "#cbd5e1", "#e08a1e", "#a3521b", "#2f8f5b", "#2b6cb0", "#e2e8f0")
"""For stacked parts, in a fixed order."""

INK, QUIET, CLOUD, BEST, PEER, WARNING = "#1f2937", "#9ca3af", "#0e7490", "#1d4ed8", "#be185d", "#b91c1c"
AGENTS = {
    "color": "#e08a1e",
    "histogram": "#e08a1e",
    "blobs": "#a3521b",
    "intensity": "#2f8f5b",
    "motion": "#2b6cb0",
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


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write one figure, the same bytes for the same content; pictures as PNG of few colours, plots as SVG."""
    path = folder / name
    metadata = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    figure.savefig(path, metadata=metadata)
    plt.close(figure)
    if path.suffix == ".png":
        _fewer_colours(path)


def _fewer_colours(path: Path) -> None:
    from PIL import Image as Picture

    with Picture.open(path) as picture:
        picture.convert("RGB").quantize(192, dither=Picture.Dither.NONE).save(path, optimize=True)


def show(axes: Axes, image: Image, title: str, with_ticks: bool = True) -> None:
    """A BGR picture in pixel coordinates."""
    height, width = image.shape[:2]
    axes.imshow(image[:, :, ::-1], extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="nearest")
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


def activity(
    axes: Axes, active: Sequence[Sequence[str]], agents: Sequence[str], names: Mapping[str, str] | None = None
) -> None:
    """A bar per agent over the frames in which it was active; active[i] belongs to frame i."""
    for place, agent in enumerate(reversed(agents)):
        on = np.array([agent in working for working in active], dtype=int)
        steps = np.diff(np.concatenate([[0], on, [0]]))
        starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
        spans = [(start - 0.5, end - start) for start, end in zip(starts, ends, strict=True)]
        axes.broken_barh(spans, (place - 0.32, 0.64), color=AGENTS[agent])
    axes.set_yticks(range(len(agents)), [(names or {}).get(agent, agent) for agent in reversed(agents)])
    axes.set_ylim(-0.6, len(agents) - 0.4)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def density(states: Floats, weights: Floats, width: int, height: int, sd: float = 4.0) -> tuple[Floats, ...]:
    """Columns, rows and the density (px^-2) of the centre, the weighted hypotheses smoothed by a Gaussian."""
    x, y = np.arange(0.0, width, 4.0), np.arange(0.0, height, 4.0)
    across = np.exp(-0.5 * ((x - states[:, :1]) / sd) ** 2)
    down = np.exp(-0.5 * ((y - states[:, 1:2]) / sd) ** 2)
    return x, y, (down * weights[:, None]).T @ across / (2.0 * np.pi * sd**2)


def surface(axes: Axes, grid: tuple[Floats, ...], title: str, top: float | None = None) -> None:
    """The density over the picture, in 3-D."""
    x, y, values = grid
    columns, rows = np.meshgrid(x, y)
    height = top or float(values.max())
    axes.plot_surface(  # type: ignore[attr-defined]
        columns,
        rows,
        values * 1e3,
        cmap="viridis",
        rcount=len(y),
        ccount=len(x),
        linewidth=0,
        antialiased=True,
        vmin=0.0,
        vmax=height * 1e3,
    )
    axes.set_zlim(0.0, height * 1e3)  # type: ignore[attr-defined]
    axes.set_xlim(0, x[-1])
    axes.set_ylim(y[-1], 0)
    axes.set_xlabel("x [px]", labelpad=-4)
    axes.set_ylabel("y [px]", labelpad=-4)
    axes.set_title(title, y=0.98)
    axes.tick_params(labelsize=7, pad=-2)
    axes.view_init(elev=34, azim=-62)  # type: ignore[attr-defined]
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):  # type: ignore[attr-defined]
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis._axinfo["grid"]["color"] = "#e5e7eb"
