"""How much two frames differ as a whole: by their colours, and by where light and dark lie.

Both have to differ for a cut: another exposure changes the colours only, and something that passes close to
the camera the structure only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Image, Singles

SAMPLES = (64, 48)
"""Columns and rows of pixels that stand for the frame."""
CELLS = (32, 24)
"""Columns and rows of the structure, each the mean of four samples."""
SHIFT = (8, 6)
"""Cells by which the view may have moved, each way."""
BINS = 6
"""Of the colour histogram, in each channel."""
USUAL_LEVEL = 100.0
"""Mean to which samples are brought before their colours are counted."""
LEAST_SD = 4.0
"""Standard deviation of the cells below which a frame shows no scene, as a black one."""
BRIGHT = 245
"""Gray level from which on a sample is saturated."""
MOST_BRIGHT = 0.4
"""Share of saturated samples from which on a frame shows no scene, as in a flash."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What a frame shows, in a few numbers.

    Attributes:
        colors: (216,) square roots of the shares of colours, brought to a common brightness.
        cells: (24, 32) gray levels.
    """

    colors: Singles
    cells: Singles


@dataclass(frozen=True)
class SceneChange:
    """How much two frames differ.

    Attributes:
        colors: Hellinger distance of their colours, 0 to 1.
        structure: 1 - correlation of their gray levels at the best shift, 0 to 1.
    """

    colors: float
    structure: float

    @property
    def distance(self) -> float:
        """The geometric mean of both: 0 if either is 0, 1 if both are."""
        return math.sqrt(self.colors * self.structure)


def describe_scene(image: Image) -> Scene | None:
    """What an image (H, W, 3) uint8 shows; None if that is nothing: a black frame, a flash."""
    import cv2

    samples = cv2.resize(image, SAMPLES, interpolation=cv2.INTER_NEAREST)
    gray = cv2.cvtColor(samples, cv2.COLOR_BGR2GRAY)
    cells = cv2.resize(gray, CELLS, interpolation=cv2.INTER_AREA)
    cells = cv2.GaussianBlur(cells.astype(np.float32), (5, 5), 0.0)
    if cells.std() < LEAST_SD or np.count_nonzero(gray >= BRIGHT) >= MOST_BRIGHT * gray.size:
        return None
    even = cv2.convertScaleAbs(samples, alpha=USUAL_LEVEL / max(cv2.mean(gray)[0], 1.0))
    counts = cv2.calcHist([even], [0, 1, 2], None, [BINS] * 3, [0, 256] * 3)
    return Scene(np.sqrt(counts.ravel() / gray.size), cells)


def compare_scenes(before: Scene, after: Scene) -> SceneChange:
    """How much the two differ."""
    import cv2

    across, down = SHIFT
    middle = after.cells[down:-down, across:-across]
    # Of a uniform middle the correlation is said to be 1 wherever it is looked for.
    is_flat = float(middle.std()) < LEAST_SD / 4
    match = 0.0 if is_flat else float(cv2.matchTemplate(before.cells, middle, cv2.TM_CCOEFF_NORMED).max())
    shared = float(before.colors @ after.colors)
    return SceneChange(math.sqrt(max(1.0 - shared, 0.0)), min(max(1.0 - match, 0.0), 1.0))
