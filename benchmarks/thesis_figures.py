"""Figures in the manner of the thesis' examples, each made from a real run of the engine.

    python benchmarks/thesis_figures.py [--out docs/figures] [--only 2.9,2.10]

Needs matplotlib (the extra `figures`). The same versions make the same files. What each figure shows, and
where it differs from the thesis, is told in docs/figures.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import figures_occlusion
import figures_self_stop
import figures_two_squares
from figure_style import save
from matplotlib.figure import Figure

FIGURES: dict[str, tuple[str, Callable[[], Figure]]] = {
    "2.3": ("initial_cloud.png", figures_two_squares.initial_cloud),
    "2.4": ("likelihood.svg", figures_two_squares.likelihood),
    "2.5": ("color_alone.png", figures_two_squares.color_alone),
    "2.8": ("adaptive.png", figures_two_squares.both_cues),
    "2.9": ("uncertainty.svg", figures_two_squares.uncertainty),
    "2.10": ("surfaces.png", figures_two_squares.surfaces),
    "2.11": ("mean_shift.png", figures_two_squares.mean_shift_beside),
    "2.12": ("detections.png", figures_self_stop.detections),
    "2.13": ("occlusion_tracks.png", figures_occlusion.occlusion_tracks),
    "2.13-ud": ("occlusion_uncertainty.svg", figures_occlusion.occlusion_uncertainty),
    "2.14": ("occlusion_beliefs.png", figures_occlusion.occlusion_beliefs),
    "2.17": ("broad_likelihood.png", figures_self_stop.broad_likelihood),
    "2.18": ("self_stop_strip.png", figures_self_stop.self_stop_strip),
    "2.19": ("gray_square.svg", figures_occlusion.gray_square),
}


def main() -> None:
    """Make the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    parser.add_argument("--only", default="", help="comma-separated numbers; default all")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for number in options.only.split(",") if options.only else FIGURES:
        name, make = FIGURES[number]
        path = options.out / name
        save(make(), path)
        print(f"{number}: {path}, {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
