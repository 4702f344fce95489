"""Cue: a small copy of the target, found again by normalised cross-correlation around the prediction.

Classical template matching with a size of its own: three sizes are tried, and a parabola through the best
answer and its neighbours gives the place between the cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.arrays import Bytes
from bayesnet_track.observation.cue import (
    CueDeclaration,
    CueParameters,
    Floats,
    Hypotheses,
    Measurement,
    MeasuringCue,
    Reference,
)
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.planes import WholeFrame

STEP = 1.05
"""Factor between the sizes that are tried."""
SIZES = {"same": 1.0, "smaller": 1.0 / STEP, "larger": STEP}
"""Array of a reference -> the target's size in it, of the last one."""
OTHER_SIZE = 0.98
"""What an answer at another size than the last one counts, so that noise alone does not change it."""
NEAR = 0.7
"""What an answer far from the prediction counts at least."""


class TemplateParameters(CueParameters):
    """Parameters of the template."""

    cells: int = Field(
        default=20,
        ge=6,
        le=64,
        description="Cells along the template's mean side, at most one a pixel (count).",
    )
    reach_box: float = Field(
        default=0.8, gt=0, le=4, description="How far around the prediction it is searched for (sqrt(w h))."
    )
    min_correlation: float = Field(
        default=0.6,
        ge=-1,
        lt=1,
        description="Smallest correlation at which the target is seen; below, nothing is measured (no unit).",
    )
    sd_place: float = Field(
        default=0.04, gt=0, description="Error of the place at a correlation of 1 (share of the box's sides)."
    )
    sd_size: float = Field(default=0.2, gt=0, description="The same of the sides (share of the box's sides).")
    sd_shift: float = Field(
        default=0.3,
        ge=0,
        description="Added to the error of the place far from the prediction (share of the distance).",
    )


@dataclass(frozen=True)
class Template:
    """The template at work.

    Reference: `same`, `smaller` and `larger` (rows, columns) uint8 the target's cells at its last size and
    one step from it; `size` (2,) its sides, px.
    """

    parameters: TemplateParameters
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The picture: it is searched beyond the hypotheses' boxes."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The cells of the centre box (4,)."""
        cell = max(float(np.sqrt(box[2] * box[3])) / self.parameters.cells, 1.0)
        gray = _gray_around(planes[WholeFrame()], box)[0]
        learnt = {name: _shrunk(gray, box[2:] * scale / cell) for name, scale in SIZES.items()}
        return {**learnt, "size": np.array(box[2:], dtype=np.float64)}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """The new template at any rate above 0: a mixture of two would be sharp nowhere."""
        return old if rate <= 0.0 else new

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """Best place of the template, sds over the correlation; None below `min_correlation`."""
        p = self.parameters
        expected = (weights @ hypotheses.boxes)[:2]
        match = self.find(planes[WholeFrame()], expected, reference)
        if match is None or match[1] < p.min_correlation:
            return None
        (box, correlation), (x, y) = match, expected.tolist()
        right, found_y, w, h = box.tolist()
        shift = p.sd_shift**2 * ((right - x) * (right - x) + (found_y - y) * (found_y - y))
        sds = [side * sd / max(correlation, 0.1) for sd in (p.sd_place, p.sd_size) for side in (w, h)]
        variances = [sd * sd + extra for sd, extra in zip(sds, (shift, shift, 0.0, 0.0), strict=True)]
        return Measurement(("x", "y", "w", "h"), box, np.diag(variances), p.floor)

    def find(self, image: Bytes, place: Floats, reference: Reference) -> tuple[Floats, float] | None:
        """The centre box (4,) of the largest answer around a place (2,), and its correlation.

        An answer is the correlation times a weight, which prefers the prediction and the last size.
        """
        import cv2

        size = reference["size"]
        cells = np.array(reference["same"].shape[::-1])
        side = float(np.sqrt(cells[0] * cells[1]))
        area_cells = cells + 2 * max(2, round(self.parameters.reach_box * side))
        # Cells of the template's own size, so that it fits without a shift where it was cut out.
        gray, left, top = _gray_around(image, np.concatenate([place, size / cells * area_cells]))
        area = _shrunk(gray, area_cells)
        lowest, highest, _, _ = cv2.minMaxLoc(area)
        if lowest == highest:  # OpenCV says 1 where both are flat, but nothing says where
            return None
        scale_x, scale_y = gray.shape[1] / area.shape[1], gray.shape[0] / area.shape[0]
        best_score, match = 0.0, None
        for name, scale in SIZES.items():
            template = reference[name]
            answers = np.asarray(cv2.matchTemplate(area, template, cv2.TM_CCOEFF_NORMED))
            weight = preferred(answers.shape, side)
            row, column = divmod(int((answers * weight).argmax()), answers.shape[1])
            value = float(answers[row, column])
            score = value * float(weight[row, column]) * (1.0 if scale == 1.0 else OTHER_SIZE)
            if best_score < score < np.inf:
                x = column + _between(answers[row], column) + 0.5 * template.shape[1]
                y = row + _between(answers[:, column], row) + 0.5 * template.shape[0]
                box = np.array([left + x * scale_x, top + y * scale_y, *(scale * size)])
                best_score, match = score, (box, value)
        return match


def _shrunk(gray: Bytes, cells: Floats) -> Bytes:
    """A gray part of a frame as so many cells in x and y, at least 4."""
    import cv2

    columns, rows = (max(4, round(count)) for count in cells.tolist())
    return np.asarray(cv2.resize(gray, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)


def _gray_around(image: Bytes, box: Floats) -> tuple[Bytes, float, float]:
    """The pixels of a centre box (4,) in gray, and where they begin, px; the border continues outside."""
    import cv2

    box_columns, box_rows = (max(1, round(side)) for side in box[2:].tolist())
    left, top = round(float(box[0]) - (box_columns - 1) / 2), round(float(box[1]) - (box_rows - 1) / 2)
    height, width = image.shape[:2]
    # Of a box wholly outside the nearest pixels are left.
    x0, y0 = min(max(left, 0), width - 1), min(max(top, 0), height - 1)
    x1, y1 = max(min(left + box_columns, width), x0 + 1), max(min(top + box_rows, height), y0 + 1)
    gray = np.asarray(cv2.cvtColor(image[y0:y1, x0:x1], cv2.COLOR_BGR2GRAY), np.uint8)
    if gray.shape != (box_rows, box_columns):
        margin_before = max(y0 - top, 0), max(x0 - left, 0)
        margin_after = (
            max(box_rows - margin_before[0] - gray.shape[0], 0),
            max(box_columns - margin_before[1] - gray.shape[1], 0),
        )
        gray = np.pad(
            gray, ((margin_before[0], margin_after[0]), (margin_before[1], margin_after[1])), mode="edge"
        )[:box_rows, :box_columns]
    return gray, left - 0.5, top - 0.5


@lru_cache(maxsize=256)
def preferred(shape: tuple[int, ...], side: float) -> NDArray[np.float32]:
    """(rows, columns) weight of answers by their distance from the middle one, `side` cells a box."""
    row_weights, column_weights = (
        np.exp(-0.5 * ((np.arange(count) - 0.5 * (count - 1)) / (0.5 * side)) ** 2) for count in shape
    )
    return np.asarray(NEAR + (1.0 - NEAR) * np.outer(row_weights, column_weights), np.float32)


def _between(line: NDArray[np.float32], index: int) -> float:
    """Offset from cell `index` of the top of the parabola through it and its neighbours, -1..1.

    >>> _between(np.array([0.0, 1.0, 0.5], np.float32), 1)
    0.16666666666666666
    """
    if not 0 < index < len(line) - 1:
        return 0.0
    previous, middle, following = line[index - 1 : index + 2].tolist()
    bend = previous - 2.0 * middle + following
    return max(-1.0, min(1.0, 0.5 * (previous - following) / bend)) if bend < -1e-6 else 0.0


def _make(parameters: TemplateParameters) -> MeasuringCue:
    import cv2  # noqa: F401  load before the first frame

    return Template(parameters)


CUE = CueDeclaration(
    name="template",
    summary="Template matching: measures where a small copy of the target correlates best.",
    parameters=TemplateParameters,
    make=_make,
    cost_ms=0.5,
    rate_max=1.0,
    measures=True,
)
