"""Planes of a frame: all of it, brightness, hue, colour cells, texture codes, edges; differences of scenes.

Colours and structure of two frames have to differ for a cut: another exposure changes the colours only, and
something that passes close to the camera the structure only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array, Floats, Image, Ints, Singles
from bayesnet_track.observation.geometry import crop_of
from bayesnet_track.observation.planes import (
    Frame,
    FramePair,
    Plane,
    Planes,
    Region,
    for_reading,
    region_of_boxes,
)


@dataclass(frozen=True)
class WholeFrame:
    """The frame's own picture, (H, W, 3) uint8 BGR, not copied and never cut: in frame coordinates."""

    margin: ClassVar[None] = None
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The picture, whatever the region."""
        return frames.current.image


@dataclass(frozen=True)
class GrayPlane:
    """Brightness (rows, columns) uint8: .299 R + .587 G + .114 B, rounded in fixed point.

    A gray source gives its own values back: the three weights sum to 1.
    """

    margin: ClassVar[int] = 0
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = False

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """(rows, columns) uint8 of the current frame on `region`."""
        return gray(region.of(frames.current.image))


def gray(image: Array) -> Array:
    """(H, W) uint8 brightness of an (H, W, 3) uint8 BGR image, which may be empty."""
    import cv2

    if image.size == 0:
        return np.zeros(image.shape[:2], dtype=np.uint8)
    converted: Array = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return converted


@dataclass(frozen=True)
class Hue:
    """Hue of each pixel, (rows, columns) int16: 0..255 round the circle, or -1 where there is no colour.

    Attributes:
        min_chroma: pixels whose largest and smallest channel differ by less than this (of 255, at least 1)
            have no colour: their hue is noise.
        median_px: side of the median filter on each channel before hue is taken: 1 (none), 3 or 5.
    """

    min_chroma: int = 30
    median_px: int = 1
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = False

    @property
    def margin(self) -> int:
        """Half the median filter."""
        return self.median_px // 2

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Hue on `region`."""
        from bayesnet_track.vision.kernels.color_kernels import hue_of_bgr

        frame = frames.current
        if self.margin == 0 or region.is_empty:
            return hue_of_bgr(region.of(frame.image), self.min_chroma)
        import cv2

        wide = region.grown(self.margin).within(frame)
        smooth = cv2.medianBlur(np.ascontiguousarray(wide.of(frame.image)), self.median_px)
        left, top = region.x0 - wide.x0, region.y0 - wide.y0
        inner = Region(left, top, left + region.x1 - region.x0, top + region.y1 - region.y0)
        return hue_of_bgr(inner.of(smooth), self.min_chroma)


@dataclass(frozen=True)
class HueBins:
    """Hue in equal bins, (rows, columns) uint8: 0..bins-1, or `bins` where there is no colour.

    Attributes:
        bins: number of bins round the circle, at most 128.
        min_chroma: as in `Hue`.
    """

    bins: int = 32
    min_chroma: int = 30
    margin: ClassVar[int] = 0
    is_points: ClassVar[bool] = False

    @property
    def inputs(self) -> tuple[Plane, ...]:
        """Hue."""
        return (Hue(self.min_chroma),)

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Bins on `region`."""
        from bayesnet_track.vision.kernels.color_kernels import bins_of_hue

        bin_of_hue = np.append(np.arange(256) * self.bins // 256, self.bins).astype(np.uint8)
        return bins_of_hue(np.ascontiguousarray(inputs[0]), bin_of_hue)


@dataclass(frozen=True)
class ColorCells:
    """Cell of each pixel, (rows, columns) uint16.

    Attributes:
        space: `rgb`, `levels` values of each channel; or `hsv`, `levels` hues and saturations, half as many
            values (the chapter's 8 x 8 x 8 and 8 x 8 x 4).
        levels: 2 .. 16, even.
    """

    space: Literal["rgb", "hsv"] = "rgb"
    levels: int = 8
    margin: ClassVar[int] = 0
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = False

    @property
    def size(self) -> int:
        """Number of cells."""
        return self.levels**3 if self.space == "rgb" else self.levels**3 // 2

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Cells on `region`."""
        image = region.of(frames.current.image)
        if image.size == 0:
            return np.zeros(image.shape[:2], np.uint16)
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.vision.kernels.color_kernels import fill_color_cells

        last_levels = self.levels
        if self.space == "hsv":
            import cv2

            image = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2HSV_FULL)
            last_levels = self.levels // 2
        cells: NDArray[np.uint16] = fill_color_cells(for_reading(image), _layout(self.levels, last_levels))
        return cells


@lru_cache(maxsize=8)
def _layout(levels: int, last_levels: int) -> NDArray[np.uint16]:
    """(2, 3) levels of each channel, `last_levels` of the third, and what each adds to a cell's number."""
    layout = np.array([[levels, levels, last_levels], [levels * last_levels, last_levels, 1]], np.uint16)
    layout.setflags(write=False)  # shared by all who ask for it
    return layout


GRID_SIDE = 64
"""Pixels of a grid along the side of a target, about, at least: one of twice as many px is read on a grid."""


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """Pixels of a part of a frame: all of them, or of a large target every `step`-th column and row.

    They lie on the same columns and rows of the frame wherever the part begins.

    Attributes:
        values: (rows, columns) or (rows, columns, 3), C order, read-only.
        x: column of the first pixel, frame px; likewise `y`.
        step: between columns and between rows, px.
    """

    values: Array
    x: int
    y: int
    step: int

    def boxes(self, boxes: Floats) -> Floats:
        """Centre boxes (..., 4) of the frame in steps of the grid from its first pixel."""
        if self.step == 1 and self.x == self.y == 0:
            return boxes
        return np.asarray((boxes - np.array([self.x, self.y, 0.0, 0.0])) / self.step)

    @classmethod
    def of_image(cls, frame: Frame, boxes: Floats, size: Floats, ring: float = 0.0) -> Self:
        """Pixels (rows, columns, 3) in centre boxes (N, 4) of a target of `size` (2,), and in their rings.

        A ring is `ring` mean sides of its box wide. The whole image where every pixel is taken.
        """
        step = step_of(size)
        if step == 1:
            return cls(for_reading(frame.image), 0, 0, 1)
        from bayesnet_track.vision.kernels.patch_kernels import sample_squares

        sides = boxes[:, 2:] + ring * (boxes[:, 2:3] + boxes[:, 3:4])
        rows, columns = _grid_lines(frame, np.concatenate([boxes[:, :2], sides], axis=1), step)
        sampled, half = np.empty((len(rows), len(columns), 3), np.uint8), step // 2
        sample_squares(for_reading(frame.image), columns.start - half, rows.start - half, step, 1, sampled)
        return cls(for_reading(sampled), columns.start, rows.start, step)


def step_of(size: Floats) -> int:
    """Step of the grid on which a target of `size` (2,), px, is read: 1 if a side has less than 128 px.

    Of any larger target a grid has 64 to 128 pixels a side (the root of its area).
    """
    return max(int(math.sqrt(float(size[0]) * float(size[1])) // GRID_SIDE), 1)


def _grid_lines(frame: Frame, boxes: Floats, step: int) -> tuple[range, range]:
    """Rows and columns, px, of the grid of a `step` that centre boxes (N, 4) may hold inside the frame."""
    region = region_of_boxes(boxes).within(frame)
    rows, columns = (
        range(start // step * step + step // 2, min(-(-stop // step) * step, length), step)
        for start, stop, length in (
            (region.y0, region.y1, frame.height),
            (region.x0, region.x1, frame.width),
        )
    )
    return rows, columns


def seen_cells(planes: Planes, plane: Plane, boxes: Floats) -> tuple[Array, Floats]:
    """The cells inside `boxes` (N, 4), whatever else was computed, and the x, y of their first pixel."""
    cells, first = crop_of(planes, plane, region_of_boxes(boxes).within(planes.frame))
    return for_reading(cells), np.array(first, dtype=np.float64)


@dataclass(frozen=True)
class TextureCodes:
    """Code of each pixel, uint8, below `bins`, from its neighbours.

    Attributes:
        form: `patterns`, uniform local binary patterns of the 8 neighbours, however turned; or `gradients`,
            the direction of the gradient, one of 8, or none where it is weak.
        noise: differences up to this are none, gray levels.
    """

    form: Literal["patterns", "gradients"] = "gradients"
    noise: int = 8

    @property
    def bins(self) -> int:
        """Number of codes."""
        return 10 if self.form == "patterns" else 9

    def grid(self, frame: Frame, boxes: Floats, size: Floats) -> PixelGrid:
        """Codes (rows, columns) in the centre boxes (N, 4) of a target of `size` (2,), px.

        Beyond the frame its border is repeated. The neighbours of a pixel are those in the frame, one pixel
        away, also where the grid has larger steps: what a texture is does not depend on them.
        """
        from bayesnet_track.vision.kernels.patch_kernels import binary_patterns, gradient_directions

        step = step_of(size)
        rows, columns = _grid_lines(frame, boxes, step)
        if not (rows and columns):
            return PixelGrid(np.zeros((0, 0), np.uint8), columns.start, rows.start, step)
        y, x = _with_neighbours(rows, frame.height), _with_neighbours(columns, frame.width)
        values = gray(frame.image[:, x[0] : x[-1] + 1].take(y, axis=0)).take(x - x[0], axis=1)
        codes, spread = np.empty((len(y) - 2, len(x) - 2), np.uint8), 1 if step == 1 else 3
        fill = binary_patterns if self.form == "patterns" else gradient_directions
        fill(values, self.noise, codes)
        return PixelGrid(for_reading(codes[::spread, ::spread]), columns.start, rows.start, step)


def _with_neighbours(lines: range, length: int) -> Ints:
    """Each row (or column) of a grid between its neighbours, as far as inside a frame of `length` px."""
    steps = np.arange(lines.start - 1, lines[-1] + 2) if lines.step == 1 else np.add.outer(lines, [-1, 0, 1])
    return np.asarray(steps.ravel().clip(0, length - 1))


SOBEL = 8.0
"""What a 3x3 Sobel filter makes of a slope of one gray level per pixel."""

CONTRASTS = (1.0, 0.5, 2.0)
"""The thresholds of the three edge sets, as factors of the plane's own; the first is used at first."""


@dataclass(frozen=True)
class EdgePlane:
    """Canny's edges of the whole frame: (points, 3) int64 x, y, bits, ordered by row, then column.

    Bit k of `bits` is set where the pixel is an edge at the threshold ``min_gradient_gray * CONTRASTS[k]``.
    An edge starts at that gradient and goes on down to half of it. Always the whole frame, because an edge
    may go on as far as it likes.

    Attributes:
        min_gradient_gray: gradient at which an edge starts, gray levels per pixel.
        blur_px: standard deviation of the Gaussian that smooths the picture first; 0 for none.
    """

    min_gradient_gray: float = 8.0
    blur_px: float = 1.0
    margin: ClassVar[None] = None
    is_points: ClassVar[bool] = True

    @property
    def inputs(self) -> tuple[Plane, ...]:
        """Made from the brightness."""
        return (GrayPlane(),)

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The edge points of the frame."""
        import cv2

        smooth = np.ascontiguousarray(inputs[0])
        if self.blur_px > 0:
            smooth = cv2.GaussianBlur(smooth, (0, 0), self.blur_px)
        dx, dy = (
            cv2.Sobel(smooth, cv2.CV_16S, *order, borderType=cv2.BORDER_REPLICATE)
            for order in ((1, 0), (0, 1))
        )
        bits = np.zeros(smooth.shape, dtype=np.uint8)
        for k, factor in enumerate(CONTRASTS):
            high = SOBEL * factor * self.min_gradient_gray
            bits |= cv2.Canny(dx, dy, 0.5 * high, high, L2gradient=True) & np.uint8(1 << k)
        pixels = cv2.findNonZero(bits)
        if pixels is None:
            return np.empty((0, 3), dtype=np.int64)
        points = pixels.reshape(-1, 2).astype(np.int64)
        return np.column_stack([points, bits[points[:, 1], points[:, 0]]])


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
    """Description of a frame in a few numbers.

    Attributes:
        colors: (216,) square roots of the shares of colours, brought to a common brightness.
        cells: (24, 32) gray levels.
    """

    colors: Singles
    cells: Singles


@dataclass(frozen=True)
class SceneChange:
    """Difference of two frames.

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
    """Description of an image (H, W, 3) uint8; None if it shows nothing: a black frame, a flash."""
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


def compare_scenes(previous: Scene, current: Scene) -> SceneChange:
    """Difference of the two."""
    import cv2

    shift_x, shift_y = SHIFT
    middle = current.cells[shift_y:-shift_y, shift_x:-shift_x]
    # Of a uniform middle the correlation is said to be 1 wherever it is looked for.
    is_flat = float(middle.std()) < LEAST_SD / 4
    match = 0.0 if is_flat else float(cv2.matchTemplate(previous.cells, middle, cv2.TM_CCOEFF_NORMED).max())
    shared = float(previous.colors @ current.colors)
    return SceneChange(math.sqrt(max(1.0 - shared, 0.0)), min(max(1.0 - match, 0.0), 1.0))
