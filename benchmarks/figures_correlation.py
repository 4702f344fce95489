"""Pictures of the correlation filter: what it sees and learns, and what it says in a good and a bad case.

    python benchmarks/figures_correlation.py

With the extra `figures`; it writes docs/figures/cue_correlation_filter.png. For a picture of one's own there
is ``benchmarks/figures_cues.py correlation_filter --frame``.
"""

from __future__ import annotations

import cv2
import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, CLOUD, PEER, SURFACE, Axes, boxes, show
from figures_cues import FOLDER, Case, case_of, close, intensity_cases, learnt, made, planes_of, save

from bayesnet_track.observation.cue import Cue, Hypotheses
from bayesnet_track.vision.correlation import hann


def cases() -> list[Case]:
    """Another pattern beside the target, in less light; and the target turned by 30 degrees."""
    good, bad = intensity_cases()
    dark = cv2.convertScaleAbs(good.image, alpha=0.8)
    good = case_of("good: another pattern beside it, less light", good.first, dark, *ends(good))
    return [good, bad]


def ends(case: Case) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Where the target is in both pictures, as numbers."""
    return tuple(map(float, case.box)), tuple(map(float, case.truth))


def explain(panels: list[Axes], cue: Cue, case: Case) -> None:
    """The target with its patch, the power of gradients under the window, the filter's own power."""
    reference = learnt(cue, case)
    cells, size = reference["kernel"].shape[1], case.box[2:]
    spare = 1.5 * np.sqrt(size.prod())
    cell = (size.max() + spare) / cells
    show(panels[0], case.first, "the target and its patch", with_ticks=False)
    close(panels[0], case.box, 1.2 * cells * cell / size.max())
    boxes(panels[0], case.box, BEST, width=1.8)
    boxes(panels[0], np.array([*case.box[:2], cells * cell, cells * cell]), CLOUD, width=1.2)
    window = hann(cells, *((size + spare) / cell))
    power = (reference["patch"][:8] ** 2).sum(axis=0)
    for axes, values, title in (
        (panels[1], power * window**2, "gradients under the window"),
        (panels[2], (reference["kernel"][:8] ** 2).sum(axis=0), "power of the filter"),
    ):
        axes.imshow(values, cmap=SURFACE, interpolation="nearest")
        axes.set(xticks=[], yticks=[], title=title)


def surface(axes: Axes, cue: Cue, case: Case) -> None:
    """The log-likelihood of a box of the target's size, by its centre: the likelihood is a few px wide."""
    height, width = case.image.shape[:2]
    centres = np.stack(np.meshgrid(np.arange(0.0, width, 2), np.arange(0.0, height, 2)), axis=-1)
    asked = np.column_stack([centres.reshape(-1, 2), np.tile(case.truth[2:], (centres[..., 0].size, 1))])
    log = cue.log_likelihood(planes_of(cue, case.image), Hypotheses(asked), learnt(cue, case))
    low = np.log(cue.parameters.floor)
    extent = (-1.0, width - 1.0, height - 1.0, -1.0)
    drawn = axes.imshow(log.reshape(centres.shape[:2]), cmap=SURFACE, vmin=low, vmax=0.0, extent=extent)
    axes.plot(*case.truth[:2], "+", color=PEER, markersize=9)
    axes.set(xticks=[], yticks=[], title=f"log-likelihood, largest {log.max():.1f}")
    axes.figure.colorbar(drawn, ax=axes, shrink=0.75)


def main() -> None:
    """Draw the page."""
    cv2.setNumThreads(1)
    cue, shown = made("correlation_filter"), cases()
    figure = plt.figure(figsize=(8, 8), layout="constrained")
    top, rest = figure.subfigures(2, 1, height_ratios=[2.5, 5.5])
    explain(list(top.subplots(1, 3)), cue, shown[0])
    for case, (left, right) in zip(shown, rest.subplots(2, 2), strict=True):
        show(left, case.image, case.title, with_ticks=False)
        boxes(left, case.truth, BEST, width=1.8)
        surface(right, cue, case)
    save(figure, FOLDER / "cue_correlation_filter.png")


if __name__ == "__main__":
    main()
