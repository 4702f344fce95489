"""Depth that another sensor measured: which files hold it, and how they become points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.image_files import read_checked
from bayesnet_track.observation.image_size import PictureError, check_size
from bayesnet_track.vision.stereo.stereo import RectifiedPair


def read_points(path: Path, pair: RectifiedPair | None) -> NDArray[np.float32]:
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
