"""The picture of docs/cues/readings.md: where a target can be, given a range and a bearing.

python benchmarks/figures_readings.py [--out docs/figures]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

RADAR, WIDTH, HEIGHT = (160.0, 480.0), 480, 360
RANGE, SD_RANGE = 300.0, 6.0
BEARING, SD_BEARING = -1.2, 0.03


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    options = parser.parse_args()
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    by_range = -0.5 * ((np.hypot(x - RADAR[0], y - RADAR[1]) - RANGE) / SD_RANGE) ** 2
    by_bearing = -0.5 * ((np.arctan2(y - RADAR[1], x - RADAR[0]) - BEARING) / SD_BEARING) ** 2
    figure, axes = plt.subplots(1, 3, figsize=(9.0, 3.2), layout="constrained", sharey=True)
    shown = {"range": by_range, "bearing": by_bearing, "both": by_range + by_bearing}
    for axis, (title, log) in zip(axes, shown.items(), strict=True):
        axis.imshow(np.exp(log), cmap="Blues", vmin=0.0, vmax=1.0)
        axis.set(title=title, xlabel="x, px")
    axes[0].set_ylabel("y, px")
    figure.savefig(options.out / "cue_readings.png", dpi=110)


if __name__ == "__main__":
    main()
