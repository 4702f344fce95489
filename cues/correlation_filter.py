"""Cue: the answer of a correlation filter on oriented gradients and colour, learnt online.

The filter is learnt to answer to the target and not to its surroundings. It is asked what it answers to a
patch centred on each hypothesis. A few Fourier transforms give the answers for a whole tile of the frame and
several scales, and the hypotheses read theirs. The tiles lie where the target was last learnt, not where the
hypotheses are: what a hypothesis is worth does not depend on the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.observation.cue import (
    ANGLE,
    Cue,
    CueDeclaration,
    Floats,
    Hypotheses,
    Reference,
    SizedCueParameters,
    blend_arrays,
    floored,
    log_size_penalty,
)
from bayesnet_track.observation.geometry import share_inside
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.correlation import (
    SCALE_STEP,
    TURN_STEP,
    TileKey,
    equations,
    find_maps,
    find_tile,
    gaussian_label,
    hann,
    patch_at,
    solve,
    turned_patch_at,
)
from bayesnet_track.vision.planes import WholeFrame

REACH = 40
"""Cells by which a tile is wider than the filter; hypotheses are read in the inner `REACH` - 4."""
LEVELS = 4
"""Levels of scale on either side of the last learnt one."""
USUAL = 0.55
"""First guess of the usual answer, as a share of that to the very picture the filter comes from."""
FOLLOW = 20.0
"""The usual answer falls toward the last one at so many times the learning rate; it rises at once."""
LEAST_ANSWER = 0.1
"""The usual answer is at least this, of a wanted 1: nothing less is a target."""
LEAST_CELL = 0.5
"""Side of a cell, px, at least: a smaller target is seen with more of its surroundings."""


class CorrelationFilterParameters(SizedCueParameters):
    """Parameters of the correlation filter."""

    floor: float = Field(
        default=1e-5,
        gt=0,
        lt=1,
        description="Likelihood of an outlier as a share of the best possible likelihood.",
    )
    sharpness: float = Field(
        default=12.0,
        gt=0,
        description="Log-likelihood between the filter's usual response to the target and no response (no "
        "unit).",
    )
    context: float = Field(
        default=1.5,
        ge=0,
        le=6,
        description="Width and height of the region that the filter sees, box included (roots of the box's "
        "area).",
    )
    cells: int = Field(
        default=24, ge=8, le=64, multiple_of=2, description="Side of the filter, cells (count, even)."
    )
    sd_answer: float = Field(
        default=0.07, gt=0, description="Width of the peak that is learnt (roots of the box's area)."
    )
    ridge: float = Field(
        default=0.01, gt=0, description="Ridge of the regression as a share of the mean power of the patch."
    )
    signed: bool = Field(
        default=True,
        description="Light to dark differs from dark to light in two thirds of the gradients; without them "
        "the filter takes half the time.",
    )


@dataclass(frozen=True)
class CorrelationFilter:
    """The correlation filter at work.

    Reference: `numerator` (C, S, S / 2 + 1) and `denominator` (S, S / 2 + 1) of the regression; `kernel`
    (C, S, S) the filter that they give, under its window; `patch` (C, S, S) the features that were last
    learnt; `usual` () the answer that the target usually gets; `place` (2,) and `size` (2,), px, where it
    was last learnt.
    """

    parameters: CorrelationFilterParameters
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The whole picture: the filter looks beyond the boxes."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The filter that answers to this patch with a narrow peak in its middle."""
        return self.learn_turned(planes, box, 0.0)

    def learn_turned(self, planes: Planes, box: Floats, angle: float) -> Reference:
        """The same for a target turned by `angle` degrees: the patch is cut out as turned, and so upright."""
        equations = self._equations(planes, box, angle)
        kernel = self._kernel(equations["numerator"], equations["denominator"], equations["size"])
        usual_answer = max(USUAL * _answer(kernel, equations["patch"]), LEAST_ANSWER)
        return {**equations, "kernel": kernel, "usual": np.array(usual_answer)}

    def _equations(self, planes: Planes, box: Floats, angle: float) -> dict[str, NDArray[Any]]:
        """Equations learnt of the patch alone: all of a reference but `kernel` and `usual`."""
        p = self.parameters
        size = np.array(box[2:], dtype=np.float64)
        cell, mean = self._cell(size), np.sqrt(size[0] * size[1])
        image, x, y = planes[WholeFrame()], float(box[0]), float(box[1])
        if angle == 0.0:
            patch = patch_at(image, x, y, cell, p.cells, p.signed)
        else:
            patch = turned_patch_at(image, x, y, cell, p.cells, p.signed, angle)
        offset = (box[0] - patch.x) / patch.cell, (box[1] - patch.y) / patch.cell
        label = gaussian_label(p.cells, max(p.sd_answer * mean / cell, 0.3), *offset)
        numerator, denominator = equations(patch.features * self._window(size), label)
        return {
            "numerator": numerator,
            "denominator": denominator,
            "patch": patch.features,
            "place": np.array(box[:2], dtype=np.float64),
            "size": size,
        }

    def follow(self, planes: Planes, box: Floats, reference: Reference, rate: float) -> Reference:
        """`blend` of the reference with what is learnt here, whose own filter is not needed in between."""
        if rate >= 1.0:
            return self.learn(planes, box)
        return self.blend(reference, self._equations(planes, box, 0.0), rate)

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Numerator and denominator linearly (thesis eq. 2.15); the usual answer follows faster."""
        if rate <= 0.0:
            return old
        if rate >= 1.0:
            return new
        names = ("numerator", "denominator")
        mixed = blend_arrays({name: old[name] for name in names}, new, rate)
        numerator = mixed["numerator"].astype(np.complex64, copy=False)
        answer, usual_answer = _answer(old["kernel"], new["patch"]), float(old["usual"])
        share = 1.0 if answer > usual_answer else min(1.0, FOLLOW * rate)
        return {
            **new,
            "numerator": numerator,
            "denominator": mixed["denominator"],
            "kernel": self._kernel(numerator, mixed["denominator"], new["size"]),
            "usual": np.array(max(usual_answer + share * (answer - usual_answer), LEAST_ANSWER)),
        }

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """-sharpness (1 - s q) with the size penalty, over the floor.

        q is the answer over the usual one, at most 1, and s the share of the box inside the frame.
        """
        p, boxes = self.parameters, hypotheses.boxes
        share = share_inside(boxes, planes.frame)
        answers = self.answers(planes, boxes, reference, share > 0.0, hypotheses.fields.get(ANGLE))
        q = answers / float(reference["usual"])
        size = log_size_penalty(boxes, reference["size"], p.sd_log_area, p.sd_log_aspect)
        return floored(p.sharpness * (share * np.minimum(np.maximum(q, 0.0), 1.0) - 1.0) + size, p.floor)

    def answers(
        self,
        planes: Planes,
        boxes: Floats,
        reference: Reference,
        asked: NDArray[np.bool_],
        angles: Floats | None = None,
    ) -> Floats:
        """(N,) answers of the filter to the centre boxes (N, 4); 0 for those that are not `asked`.

        With `angles` (N,), in degrees, those of the filter turned by as much.
        """
        from bayesnet_track.numerics.compiled import plain
        from bayesnet_track.vision.kernels.correlation_kernels import add_answers

        p, image, boxes, values = self.parameters, planes[WholeFrame()], plain(boxes), np.zeros(len(boxes))
        size, place, kernel = reference["size"], reference["place"], reference["kernel"]
        cell = self._cell(size)
        step = (REACH - 4) * cell  # between tiles; a column of boxes at a time is several times faster
        columns, rows = (np.floor((boxes[:, k] - place[k]) / step + 0.5) for k in (0, 1))
        tile_of = columns + rows * 2.0**20  # one number is sorted faster than two
        log_scale = 0.5 * np.log(boxes[:, 2] * boxes[:, 3] / (size[0] * size[1]))
        turns = {0: np.ones(len(boxes))} if angles is None else _turns_of(angles)
        parts: dict[int, NDArray[np.float32]] = {}
        for number in _different(tile_of[asked]):
            indices = np.flatnonzero(asked & (tile_of == number))
            tile_place = np.array([columns[indices[0]], rows[indices[0]]])
            x, y = (place + tile_place * (REACH - 4) * cell).tolist()
            tile = find_tile(planes.frame, image, TileKey(x, y, cell, p.cells + REACH, p.cells, p.signed))
            levels = (log_scale[indices] + np.log(cell / tile.cell)) / SCALE_STEP
            levels = np.minimum(np.maximum(levels, -LEVELS), LEVELS)
            for turn, share in turns.items():
                part = share[indices]
                of_turn = levels[part > 0.0]
                if not len(of_turn):
                    continue
                lowest, highest = math.floor(of_turn.min()), math.ceil(of_turn.max())
                maps = find_maps(tile, kernel, turn, range(lowest, highest + 1), parts)
                at_tile = (tile.x, tile.y, tile.cell)
                add_answers(maps, lowest, boxes, at_tile, indices, levels, part, values)
        return values

    def _cell(self, size: Floats) -> float:
        """Side of a cell, px, for a target of this size."""
        width, height = size.tolist()
        span = max(width, height) + self.parameters.context * math.sqrt(width * height)
        return max(span / self.parameters.cells, LEAST_CELL)

    def _window(self, size: Floats) -> NDArray[np.float32]:
        (width, height), cell = size.tolist(), self._cell(size)
        context = self.parameters.context * math.sqrt(width * height)
        spans = ((side + context) / cell for side in (width, height))
        return hann(self.parameters.cells, *(max(span, 4.0) for span in spans))

    def _kernel(
        self, numerator: NDArray[np.complex64], denominator: Floats, size: Floats
    ) -> NDArray[np.float32]:
        """The filter under its window, so that it can be laid on any place of a frame."""
        return np.asarray(solve(numerator, denominator, self.parameters.ridge) * self._window(size))


def _answer(kernel: NDArray[np.float32], patch: NDArray[np.float32]) -> float:
    """The answer to a patch in whose middle the target is."""
    return float(np.sum(kernel * patch, dtype=np.float64))


def _different(numbers: Floats) -> Floats:
    """The different ones among the numbers, sorted; mostly they are all the same."""
    all_equal = not len(numbers) or (numbers == numbers[0]).all()
    return numbers[:1] if all_equal else np.unique(numbers)


def _turns_of(angles: Floats) -> dict[int, Floats]:
    """Level of turn -> (N,) share of it in the answer at each angle: linear between the two nearest."""
    steps = np.asarray(angles) / TURN_STEP
    lower_levels = np.floor(steps)
    part, level_count = steps - lower_levels, round(360.0 / TURN_STEP)
    shares: dict[int, Floats] = {}
    for offset in (0, 1):
        turns = (lower_levels.astype(np.int64) + offset) % level_count
        weights = part if offset else 1.0 - part
        for turn in np.unique(turns).tolist():
            angle_shares = shares.setdefault(turn, np.zeros(len(steps)))
            angle_shares += np.where(turns == turn, weights, 0.0)
    return shares


def _make(parameters: CorrelationFilterParameters) -> Cue:
    import cv2  # noqa: F401  (loaded when tracking starts, not at the first frame)

    return CorrelationFilter(parameters)


CUE = CueDeclaration(
    name="correlation_filter",
    summary="Response of a correlation filter on oriented gradients and colour, learnt online.",
    parameters=CorrelationFilterParameters,
    make=_make,
    cost_ms=3.0,
    rate_max=0.015,
    reads_angle=True,
)
