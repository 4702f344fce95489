"""Scenery before a camera that moves, for tests of cues that see motion."""

import cv2
import numpy as np

BORDER = 60
"""How far the scenery reaches beyond the picture on each side, px."""


def drawn_scenery(width: int, height: int) -> np.ndarray:
    """Texture with fine and coarse structure, larger than the picture by the border."""
    rng = np.random.default_rng(5)
    image = np.zeros((height + 2 * BORDER, width + 2 * BORDER))
    for sd in (1.5, 4.0, 12.0):
        layer = cv2.GaussianBlur(rng.normal(size=image.shape), (0, 0), sd)
        image += 30.0 * layer / layer.std()
    return np.clip(image + 128.0, 0, 255)


def seen(scenery: np.ndarray, move: np.ndarray) -> np.ndarray:
    """The picture in which a point at p before is now at move @ (p, 1)."""
    whole = np.vstack([move, [0, 0, 1]]) @ np.array([[1, 0, -BORDER], [0, 1, -BORDER], [0, 0, 1]])
    height, width = (side - 2 * BORDER for side in scenery.shape)
    image = cv2.warpAffine(scenery, whole[:2], (width, height), flags=cv2.INTER_CUBIC)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def shifted(dx: float, dy: float) -> np.ndarray:
    return np.array([[1, 0, dx], [0, 1, dy]], float)
