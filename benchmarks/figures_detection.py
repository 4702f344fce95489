"""The picture of docs/cues/detection.md: predictions, gates, detections, and whose each is.

python benchmarks/figures_detection.py [--out docs/figures]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse, Rectangle

from bayesnet_track.adapt.assign import assign, gated_gains
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.observation.cue import AssociationRule

RULE = AssociationRule(0.06, 0.06, 0.999, 0.2, 0.0)
EXPECTED = {
    "1": (np.array([100.0, 100, 40, 90]), 6.0),
    "2": (np.array([132.0, 104, 42, 92]), 5.0),
    "3": (np.array([230.0, 100, 40, 90]), 14.0),
}
"""Target -> predicted centre box and the sd of its x and y: the third has not been seen for some frames."""
FOUND = np.array([[113.0, 101, 41, 91], [137, 103, 42, 90], [248, 96, 41, 88], [320, 70, 40, 90]])


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    options = parser.parse_args()
    gain = np.array(
        [
            gated_gains(
                mean, np.diag([sd**2, sd**2, 9.0, 9.0]), FOUND, RULE, lambda boxes: np.zeros(len(boxes))
            )
            for mean, sd in EXPECTED.values()
        ]
    )
    figure, axes = plt.subplots(figsize=(7.2, 3.2), layout="constrained")
    reach = 2.0 * np.sqrt(chi_square_quantile(RULE.gate, 4))
    for number, (name, (mean, sd)) in enumerate(EXPECTED.items()):
        colour = f"C{number}"
        x, y, w, h = mean
        axes.add_patch(Rectangle((x - w / 2, y - h / 2), w, h, fill=False, color=colour, ls="--"))
        sides = [reach * np.hypot(sd, RULE.sd_place * side) for side in (w, h)]
        axes.add_patch(Ellipse((x, y), *sides, color=colour, alpha=0.12))
        axes.annotate(f"target {name}", (x - w / 2, y - h / 2 - 3), color=colour)
        own = int(assign(gain)[number])
        axes.annotate("", FOUND[own, :2], (x, y), arrowprops={"arrowstyle": "->", "color": colour})
    for x, y, w, h in FOUND:
        axes.add_patch(Rectangle((x - w / 2, y - h / 2), w, h, fill=False, color="0.2"))
        axes.plot(x, y, "o", color="0.2", ms=3)
    axes.annotate("nobody's", (FOUND[3, 0] - 20, FOUND[3, 1] - 48), color="0.2")
    axes.set(xlim=(40, 360), ylim=(180, 10), aspect="equal", xlabel="x, px", ylabel="y, px")
    figure.savefig(options.out / "cue_detection.png", dpi=110)


if __name__ == "__main__":
    main()
