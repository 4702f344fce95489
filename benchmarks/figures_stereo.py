"""Figures of the stereo cue: from two pictures to points, and its likelihood in a good and in a bad case.

Run ``python benchmarks/figures_stereo.py`` (needs matplotlib); it writes into docs/figures.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, PEER, SURFACE, Axes, boxes, save, show
from matplotlib.figure import Figure

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.cue import Hypotheses, installed_cues
from bayesnet_track.observation.depth import RightEye
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region, region_of_boxes
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.vision.planes.stereo_planes import Correlation, PointsPlane, Range, SemiGlobal
from bayesnet_track.vision.stereo.stereo_blobs import StereoBlobSettings, detect_stereo_blobs

REACH = Range(1.0, 6.5, camera_height_m=1.2)
IN_ROOM = {"camera_height_m": 1.2, "max_depth_m": 6.5, "floor": 0.003}
STEP = 4
EARLIER = 10
"""The target is learnt this many frames before it is looked for."""


def frame_of(scene: Scene, index: int) -> Frame:
    """One frame with its right eye."""
    return next(frame for frame in SceneSource(scene, scene.name) if frame.index == index)


def chain() -> Figure:
    """Thesis Figures 3.5 to 3.7: pictures, disparity without and with the outlier filters, points, blobs."""
    figure, panels = plt.subplots(2, 5, figsize=(10, 3.6), layout="constrained")
    for row, (name, index) in zip(panels, (("person_stereo", 80), ("glass_wall", 80)), strict=True):
        scene = make_scene(name, 0)
        frame = frame_of(scene, index)
        assert isinstance(frame.depth, RightEye)
        whole = Region(0, 0, frame.width, frame.height)
        show(row[0], frame.image, f"{name}, left", with_ticks=False)
        loose = Correlation(min_texture_gray=0.0, min_correlation=0.0, min_difference=0.0)
        for axes, matcher, title in (
            (row[1], loose, "best match"),
            (row[2], Correlation(), "three filters"),
            (row[3], SemiGlobal(), "semi-global"),
        ):
            found = matcher.disparity(frame.image, frame.depth.image, 0, 60, whole)
            _map(axes, found, 0, 30, title)
        points = PointsPlane(range=REACH).compute(FramePair(frame, None), (), whole)
        _map(row[4], -points[..., 2], -6.5, -3, "in range, off the floor")
        found = detect_stereo_blobs(
            frame, StereoBlobSettings(range=Range(1.0, 6.5, camera_height_m=1.2, min_pixels=400))
        )
        boxes(row[4], found.boxes, BEST, width=1.6)
    return figure


def _map(axes: Axes, values: np.ndarray, low: float, high: float, title: str) -> None:
    axes.imshow(values, cmap=SURFACE, vmin=low, vmax=high, interpolation="nearest")
    axes.set_facecolor("white")
    axes.set(xticks=[], yticks=[], title=title)


def likelihood() -> Figure:
    """Thesis Figures 3.14 and 3.15: likelihood of the target's box over the picture, good cases and bad."""
    cases = (
        ("alone", "person_stereo", 40, {}),
        ("somebody else at its depth", "person_stereo", 80, {}),
        ("before the pane", "glass_wall", 110, {}),
        ("the same, semi-global", "glass_wall", 110, {"matcher": "semi_global"}),
    )
    figure, panels = plt.subplots(2, 4, figsize=(10, 4.2), layout="constrained")
    declaration = installed_cues()["stereo"]
    for (upper, lower), (title, name, index, more) in zip(panels.T, cases, strict=True):
        scene = make_scene(name, 0)
        cue = declaration.make(declaration.parameters(**IN_ROOM, **more))
        start, frame = (frame_of(scene, n) for n in (index - EARLIER, index))
        first, true = (centre_from_corner(scene.truth[n]) for n in (index - EARLIER, index))
        near = PlaneCache(FramePair(start, None)).planes(cue.needs, region_of_boxes(first[None]))
        reference = cue.learn(near, first)
        x, y = np.arange(0, scene.width, STEP), np.arange(0, scene.height, STEP)
        centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        asked = np.column_stack([centres, np.tile(true[2:], (len(centres), 1))])
        planes = PlaneCache(FramePair(frame, None)).planes(cue.needs, region_of_boxes(asked))
        value = np.exp(cue.log_likelihood(planes, Hypotheses(asked), reference)).reshape(len(y), len(x))
        show(upper, frame.image, title, with_ticks=False)
        boxes(upper, true, BEST, width=1.6)
        lower.imshow(
            value,
            cmap=SURFACE,
            vmin=0,
            vmax=1,
            extent=(-0.5, scene.width - 0.5, scene.height - 0.5, -0.5),
            interpolation="nearest",
        )
        lower.plot(*true[:2], "+", color=PEER, markersize=9)
        lower.set(xticks=[], yticks=[], title=f"largest {value.max():.2f}")
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {"stereo_chain.png": chain, "stereo_likelihood.png": likelihood}


def main() -> None:
    """Make the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name, make in FIGURES.items():
        save(make(), options.out / name)
        print(options.out / name)


if __name__ == "__main__":
    main()
