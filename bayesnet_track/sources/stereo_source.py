"""Sources with depth: two eyes, two eyes in one picture, or one eye and the depth of another sensor.

What comes out are frames of the rectified left picture that carry the right one (or points). Pictures are
paired by their number, and their times have to agree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Image
from bayesnet_track.observation.image_files import PictureError, check_size, read_checked
from bayesnet_track.observation.planes import Depth, PointMap, RightEye
from bayesnet_track.observation.settings import setting
from bayesnet_track.sources.entrances.levels import ValueRange
from bayesnet_track.sources.frames import OnResize, Source
from bayesnet_track.sources.images import ImageReader, times_of
from bayesnet_track.sources.live import LiveReader
from bayesnet_track.sources.origin import Kind, Origin
from bayesnet_track.sources.paths import SourceError, depth_files, shown_address
from bayesnet_track.sources.sources import check_range, make_reader
from bayesnet_track.sources.timing import Damage, Picture, Reader, ReaderItem, strided
from bayesnet_track.vision.calibration import RectifiedPair, Rectifier, read_rectification

Completed = tuple[Image, Depth]
Completer = Callable[[int, Picture | None, Image], Completed]
"""(frame, the second eye's picture, the first eye's pixels) -> the frame's own pixels and its depth."""

OUT_OF_STEP = 0.5
"""Pictures of a pair whose times differ by more than this many frame intervals are not of one moment."""


def open_stereo_source(
    left: str,
    start: int | None = None,
    end: int | None = None,
    allow_network: bool = False,
    on_resize: OnResize = "stop",
    *,
    right: str | None = None,
    depth: str | None = None,
    side_by_side: bool = False,
    calibration: str | Path | None = None,
    stride: int = 1,
    live: bool | None = None,
    value_range: ValueRange | None = None,
) -> Source:
    """A source whose frames carry a second eye or points.

    Args:
        left: the left eye, any source; with `side_by_side` both eyes in one picture, the left one left.
        right: the right eye, any source.
        depth: instead of a right eye, depth images (16 bit, 0 for unknown) or ``.npy`` arrays, (H, W) depths
            or (H, W, 3) points in m, one per picture: a folder or a glob.
        calibration: OpenCV YAML file; only ``.npy`` points do without.
        start, end, allow_network, on_resize, stride, live, value_range: as for `open_source`; depth images
            have no range.

    Raises:
        SourceError: nothing can be read, or the eyes do not belong together.
        CalibrationError: the calibration file cannot be used.
    """
    eye_count = sum((right is not None, depth is not None, side_by_side))
    if eye_count != 1:
        right_eye, halves_of_one = setting("--right", "SOURCE"), setting("--stereo", "side_by_side", "True")
        ways = f"one of {right_eye}, {halves_of_one} and {setting('--depth', 'FOLDER')}"
        raise SourceError(left, f"{eye_count} second eyes are given", ways, "choose one")
    check_range(left, start, end)
    rectifier = None if calibration is None else read_rectification(Path(calibration))
    if rectifier is None and depth is None:
        raise SourceError(
            left,
            "a pair without a calibration has no depth",
            f"a pair with {setting('--calibration', 'FILE')} (OpenCV YAML)",
            "make one from chessboard pictures with `bayesnet-track calibrate stereo`",
        )
    address = shown_address(left)
    first = make_reader(left, allow_network, live, value_range)
    try:
        if side_by_side and rectifier is not None:
            description, reader = (
                f"{address} (side by side)",
                DepthReader(left, first, partial(_halves, rectifier)),
            )
        elif depth is not None:
            description, paths = f"{address} with depth {depth}", depth_files(depth)
            _check_alike(first, paths, left, depth)
            rectified = rectifier if isinstance(rectifier, RectifiedPair) else None
            reader = DepthReader(left, first, partial(_measured, paths, rectified))
        else:
            assert right is not None and rectifier is not None
            description = f"{address} + {shown_address(right)}"
            second = make_reader(right, allow_network, live, value_range)
            if (files := _files(second)) is not None:
                _check_alike(first, files.paths, left, right)
            reader = DepthReader(left, first, partial(two_eyes, rectifier), second)
    except BaseException:
        first.close()
        raise
    kind: Kind = "side_by_side" if side_by_side else "right" if depth is None else "depth"
    pair = None if calibration is None else str(calibration)
    origin = Origin(
        kind,
        left,
        description,
        start,
        end,
        on_resize,
        allow_network,
        right,
        depth,
        calibration=pair,
        stride=stride,
        value_range=value_range,
    )
    return Source(description, strided(left, reader, start, stride), start, end, on_resize, origin)


# ------------------------------------------------------------------------------------ pairing


def two_eyes(rectifier: Rectifier, index: int, second: Picture | None, image: Image) -> Completed:
    """Two pictures of a calibrated pair, rectified; raises PictureError."""
    assert second is not None
    try:
        right, _ = second.pixels()
    except PictureError as error:
        raise PictureError(f"right eye: {error}") from error
    return _rectify(rectifier, image, right)


def _halves(rectifier: Rectifier, index: int, second: Picture | None, image: Image) -> Completed:
    """Both eyes in one picture, rectified; raises PictureError."""
    half, odd = divmod(image.shape[1], 2)
    if odd:
        raise PictureError(f"{_size(image)} has no two halves of the same width")
    left, right = (np.ascontiguousarray(part) for part in (image[:, :half], image[:, half:]))
    return _rectify(rectifier, left, right)


def _measured(
    paths: Sequence[Path], pair: RectifiedPair | None, index: int, second: Picture | None, image: Image
) -> Completed:
    """The picture as it is, and the points of another sensor; raises PictureError."""
    if index >= len(paths):
        raise PictureError(f"there are {len(paths)} depth files, none for frame {index}")
    points = read_depth_points(paths[index], pair)
    if points.shape[:2] != image.shape[:2]:
        raise PictureError(f"depth is {_size(points)}, the picture {_size(image)}")
    return image, PointMap(points)


class DepthReader:
    """A reader whose pictures are completed to frames with depth.

    What does not fit in the first picture is an error of the source; later it is damage.
    """

    def __init__(self, text: str, first: Reader, completer: Completer, second: Reader | None = None) -> None:
        self._text, self._first, self._second, self._completer = text, first, second, completer
        self._has_begun = False
        for reader in self._readers if second is not None else ():
            if isinstance(reader, LiveReader):  # the newest of one eye goes with the newest of the other
                reader.counts_dropped = False
        self.frame_interval_s, self.gap_from = first.frame_interval_s, first.gap_from
        self.is_live = any(isinstance(reader, LiveReader) for reader in (first, second))
        counts = [reader.declared_frames for reader in self._readers if reader.declared_frames is not None]
        self.declared_frames: int | None = max(counts, default=None)

    @property
    def _readers(self) -> list[Reader]:
        return [self._first] if self._second is None else [self._first, self._second]

    def close(self) -> None:
        """Let go of both."""
        for reader in self._readers:
            reader.close()

    def __iter__(self) -> Iterator[ReaderItem]:
        if self._second is None:
            for item in self._first:
                yield self._completed(item, None) if isinstance(item, Picture) else item
            return
        yield from self._pairs(iter(self._first), iter(self._second))

    def _pairs(self, first: Iterator[ReaderItem], second: Iterator[ReaderItem]) -> Iterator[ReaderItem]:
        has_clock = None not in (reader.declared_frames for reader in self._readers)
        left, right = _Eye("left", first), _Eye("right", second)
        while True:
            yield from left.advance()
            yield from right.advance()
            left_picture, right_picture = left.picture, right.picture
            if left_picture is None or right_picture is None:
                ended, longer = (left, right_picture) if left_picture is None else (right, left_picture)
                if longer is not None and not ended.is_truncated:
                    reason = f"the {ended.name} eye ends at frame {longer.index}, the other one goes on"
                    yield Damage(longer.index, reason, True)
                return
            if left_picture.index != right_picture.index:
                early = left if left_picture.index < right_picture.index else right
                assert early.picture is not None
                yield Damage(early.picture.index, f"only the {early.name} eye has a picture")
                early.picture = None
                continue
            if has_clock and abs(left_picture.time - right_picture.time) > OUT_OF_STEP:
                times = f"left at {left_picture.time_s:.3f} s, right at {right_picture.time_s:.3f} s"
                yield Damage(left_picture.index, f"the eyes are out of step: {times}")
                return
            left.picture = right.picture = None
            yield self._completed(left_picture, right_picture)

    def _completed(self, picture: Picture, second: Picture | None) -> Picture:
        return replace(picture, complete=partial(self._complete, picture.index, second))

    def _complete(self, index: int, second: Picture | None, image: Image) -> Completed:
        try:
            completed = self._completer(index, second, image)
        except PictureError as error:
            if self._has_begun:
                raise
            raise SourceError(
                self._text,
                f"frame {index}: {error}",
                "two eyes (or eye and depth) of one size, that of the calibration",
                "check that they belong together",
            ) from error
        self._has_begun = True
        return completed


class _Eye:
    """One reader's next picture."""

    def __init__(self, name: str, items: Iterator[ReaderItem]) -> None:
        self.name, self._items = name, items
        self.picture: Picture | None = None
        self.is_truncated = False

    def advance(self) -> Iterator[ReaderItem]:
        """Hold the next picture, if none is held and there is one; what was wrong before it."""
        while self.picture is None:
            item = next(self._items, None)
            if item is None:
                return
            if isinstance(item, Picture):
                self.picture = item
            elif not isinstance(item, Damage):
                yield item
            else:
                self.is_truncated |= item.truncated
                yield replace(item, reason=f"{self.name} eye: {item.reason}")


def _rectify(rectifier: Rectifier, left: Image, right: Image) -> Completed:
    if left.shape != right.shape:
        raise PictureError(f"the left eye is {_size(left)}, the right one {_size(right)}")
    if left.shape[:2] != (rectifier.height, rectifier.width):
        raise PictureError(
            f"the pictures are {_size(left)}, the calibration is for {rectifier.width}x{rectifier.height}"
        )
    left_image, right_image = rectifier.rectify(left, right)
    return left_image, RightEye(right_image, rectifier.geometry)


def _size(image: NDArray[np.generic]) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"


def _check_alike(first: Reader, paths: Sequence[Path], left: str, right: str) -> None:
    """Refuse image files of which one has no partner."""
    left_files = _files(first)
    if left_files is None:
        return
    times = times_of(paths)
    matched: Callable[[int], bool] = lambda n: abs(left_files.times[n] - times[n]) <= OUT_OF_STEP  # noqa: E731
    shorter = min(len(times), len(left_files.times))
    lone = next((n for n in range(shorter) if not matched(n)), shorter)
    if lone == shorter and len(times) == len(left_files.times):
        return
    names = [str(files[lone].name) if lone < len(files) else "none" for files in (left_files.paths, paths)]
    raise SourceError(
        f"{left} + {right}",
        f"{len(left_files.paths)} and {len(paths)} files, and frame {lone} has no partner "
        f"(left {names[0]}, right {names[1]})",
        "as many files on either side, with the same numbers",
        "take out what has no partner",
    )


def _files(reader: Reader) -> ImageReader | None:
    """The image files of a reader; None when it reads a video, a camera or a file of several images."""
    return reader if isinstance(reader, ImageReader) and reader.stack is None else None


# ------------------------------------------------------------------------------------ depth files


def read_depth_points(path: Path, pair: RectifiedPair | None) -> NDArray[np.float32]:
    """(H, W, 3) points in m from a depth file; NaN where nothing was measured.

    Raises:
        PictureError: it cannot be read, has another shape, or is of depths and `pair` is None.
    """
    values = _array(path) if path.suffix.lower() == ".npy" else _depth_image(path, pair)
    if values.ndim == 3 and values.shape[2] == 3:
        points = values.astype(np.float32)
    elif values.ndim == 2 and pair is not None:
        points = pair.geometry.points_of_depth(values.astype(np.float32))
    elif values.ndim == 2:
        raise PictureError(f"{path.name}: depths become points by a calibration with focal_px and centres")
    else:
        raise PictureError(f"{path.name}: shape {values.shape}; allowed: (H, W) depths, (H, W, 3) points")
    points[~(np.isfinite(points).all(axis=2) & (points[..., 2] > 0))] = np.nan
    return points


def _array(path: Path) -> NDArray[np.generic]:
    try:
        # Mapped, so that its shape is known before its values take memory.
        values = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fui" or values.ndim not in (2, 3):
            raise PictureError(f"{path.name}: not an array of numbers of shape (H, W) or (H, W, 3)")
        check_size(path.name, values.shape[1], values.shape[0])
        return np.array(values)
    except (OSError, ValueError, EOFError) as error:
        if isinstance(error, PictureError):
            raise
        raise PictureError(f"{path.name}: {error}") from error


def _depth_image(path: Path, pair: RectifiedPair | None) -> NDArray[np.generic]:
    import cv2

    data = read_checked(path)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise PictureError(f"{path.name}: {str(error).strip()}") from error
    if image is None or image.ndim != 2 or image.dtype not in (np.uint16, np.float32):
        raise PictureError(f"{path.name}: not a depth image of one channel, 16 bit or float")
    unit = np.float32(1.0 if image.dtype == np.float32 or pair is None else pair.depth_unit_m)
    return np.asarray(image.astype(np.float32) * unit)
