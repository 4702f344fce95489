"""Draw the figures of docs/detectors.md: for each detector a frame that it can bear and one that it cannot.

Run ``python benchmarks/figures_detectors.py`` (extra `figures`); pictures go to docs/figures.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import figure_style as style
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.detector import Detections, installed_detectors
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.scene import Scene
from bayesnet_track.vision.planes.shape_planes import EdgePlane
from bayesnet_track.vision.shape.shape_examples import frame_example
from bayesnet_track.vision.shape.shape_model import learn_model, save_model
from simulated.street import street

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
WHITE = "#ffffff"
Picture = NDArray[np.uint8]


def made(name: str, **parameters: Any) -> Any:
    """A detector at work."""
    declaration = installed_detectors()[name]
    return declaration.make(declaration.parameters(**parameters))


def at(detector: Any, scene: Scene, frame: int, begin: int = 0) -> tuple[Detections, Picture]:
    """What is found in a frame, run from `begin` on, and the frame."""
    state, previous = detector.start(), None
    detections = None
    for item in SceneSource(scene, "scene", frame + 1):
        if item.index >= begin:
            detections, state = detector.detect(FramePair(item, previous), state)
            previous = item
    assert detections is not None and previous is not None
    return detections, previous.image


def panel(axes: Any, found: Detections, image: Picture, title: str) -> None:
    """A frame with its detections and their scores."""
    style.show(axes, image, title, with_ticks=False)
    if len(found):
        style.boxes(axes, found.boxes, WHITE, width=3.0)
        style.boxes(axes, found.boxes, style.BEST, width=1.6)
    for (x, y, w, h), score in zip(found.boxes, found.scores, strict=True):
        axes.text(
            min(max(x - w / 2, 2), image.shape[1] - 26),
            max(y - h / 2 - 4, 10),
            f"{score:.2f}",
            fontsize=8,
            color=WHITE,
            bbox={"facecolor": style.BEST, "edgecolor": "none", "pad": 1},
        )


def pair(path: Path, good: tuple[Detections, Picture, str], bad: tuple[Detections, Picture, str]) -> None:
    """A good and a bad case side by side."""
    figure, panels = plt.subplots(1, 2, figsize=(8, 3.3), layout="constrained")
    for axes, case in zip(panels, (good, bad), strict=True):
        panel(axes, *case)
    style.save(figure, path)


def main() -> None:
    """All figures."""
    squares, hills = make_scene("orange_and_gray", 0), make_scene("gray_square", 0)
    level = made("gray_level")
    pair(
        FIGURES / "detect_gray_level.png",
        (*at(level, squares, 4, 4), "two squares on even ground"),
        (*at(level, hills, 4, 4), "hills of every gray: the square is nothing special"),
    )
    hue = made("color_backprojection", hue_deg=30)
    pair(
        FIGURES / "detect_color.png",
        (*at(hue, make_scene("two_squares", 0), 4, 4), "hue 30 degrees"),
        (*at(hue, make_scene("two_squares", 0), 27, 27), "they touch: one region"),
    )
    road = street(0)
    pair(
        FIGURES / "detect_background.png",
        (*at(made("background"), road, 108), "people, their shadows, 1.35 times brighter for 8 frames"),
        (*at(made("background", shadows=False), road, 76), "told not to know shadows"),
    )
    pair(
        FIGURES / "detect_motion.png",
        (*at(made("motion"), road, 70, 69), "people move, the cart stands"),
        (*at(made("motion"), make_scene("two_squares", 0), 23, 22), "two that come together: one region"),
    )
    stereo = {"camera_height_m": 1.2, "max_depth_m": 6.0}
    pair(
        FIGURES / "detect_stereo.png",
        (
            *at(made("stereo_blobs", **stereo), make_scene("person_stereo", 0), 78, 78),
            "two people, wall cut off",
        ),
        (
            *at(made("stereo_blobs", **stereo), make_scene("glass_wall", 0), 60, 60),
            "the edge of a pane is a target, too",
        ),
    )
    with TemporaryDirectory() as folder:
        model, scene = Path(folder) / "person.npz", make_scene("person_and_board", 5)
        truth = centre_from_corner(scene.truth)
        frames = [Frame(k, float(k), scene.frames[k]) for k in range(36, 56, 2)]
        vectors = [frame_example(frame, truth[frame.index], EdgePlane(), 16)[0] for frame in frames]
        save_model(model, learn_model(np.array(vectors)))
        contour, walk = made("contour_shape", model=str(model)), make_scene("person_and_board", 0)
        pair(
            FIGURES / "detect_contour.png",
            (*at(contour, walk, 24, 24), "a person, and a board of that size and colour"),
            (*at(contour, walk, 76, 76), "in the glare the outline is open: nothing"),
        )


if __name__ == "__main__":
    main()
