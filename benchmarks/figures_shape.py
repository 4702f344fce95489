"""Pictures of the shape cue: the chain from edges to modes, and its likelihood in a good and in a bad case.

Run ``python benchmarks/figures_shape.py`` with the extra `figures`; it writes into docs/figures.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, CLOUD, PEER, SURFACE, boxes, save, show
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bayesnet_track.cues.shape import CUE
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.sources.scenes.render import Movie
from bayesnet_track.sources.scenes.silhouettes import person
from bayesnet_track.vision.shape.shape_contours import contours, fields
from bayesnet_track.vision.shape.shape_examples import mask_example
from bayesnet_track.vision.shape.shape_model import ShapeModel, learn_model

Floats = NDArray[np.float64]

FOLDER = Path(__file__).parents[1] / "docs" / "figures"
CUE_MADE = CUE.make(CUE.parameters())


def planes_of(scene: Scene, index: int) -> Planes:
    """The cue's planes of one frame."""
    cache = PlaneCache(FramePair(Frame(index, float(index), scene.frames[index]), None))
    return cache.planes(CUE_MADE.needs, Region(0, 0, scene.width, scene.height))


def model_of_people(count: int = 60) -> ShapeModel:
    """What `learn-shape` makes of masks of people who differ in width, arms and legs."""
    rng = np.random.default_rng(0)
    examples = []
    for _ in range(count):
        path = np.array([[100.0, 130.0, 80.0 * rng.uniform(0.8, 1.2), 192.0]])
        parts = person(path, (255.0, 255.0, 255.0))
        lift, stride = rng.uniform(0.0, 14.0), rng.uniform(-3.0, 9.0)
        for part, dx, dy in ((2, -lift, -lift), (3, lift, -lift), (5, -stride, 0.0), (6, stride, 0.0)):
            parts[part].path[:, :2] += dx, dy
        mask = Movie(np.zeros((260, 200, 3)), parts, 0.0, 0)[0][:, :, 0] > 127
        examples.append(mask_example(mask, 16)[0])
    return learn_model(np.array(examples))


def closed(points: Floats) -> Floats:
    """The points (P, 2) with the first repeated at the end."""
    return np.concatenate([points, points[:1]])


def near(axes: Axes, box: Floats) -> None:
    """Show the box and a quarter more."""
    axes.set_xlim(box[0] - 0.9 * box[2], box[0] + 0.9 * box[2])
    axes.set_ylim(box[1] + 0.65 * box[3], box[1] - 0.65 * box[3])


def chain() -> Figure:
    """Thesis Figure 3.8, and the modes of a model."""
    scene, index = make_scene("person_and_board"), 15
    box = centre_from_corner(scene.truth)[index]
    planes = planes_of(scene, index)
    points = planes[CUE_MADE.edges]
    points = points[(points[:, 2] & 1) == 1, :2]
    found = contours(points, box[None], np.array([scene.width, scene.height]))
    figure, rows = plt.subplots(2, 5, figsize=(11, 7), layout="constrained")
    edges = np.zeros((scene.height, scene.width, 3), np.uint8)
    edges[points[:, 1], points[:, 0]] = 255
    angle = np.linspace(0, 2 * np.pi, 100)
    start = box[:2] + 0.5 * box[2:] * np.column_stack([np.cos(angle), np.sin(angle)])
    titles = ("a) picture", "b) edges and start", "c) snake", "d) spline, 40 points")
    for axes, title in zip(rows[0], titles, strict=False):
        show(axes, scene.frames[index] if title[0] in "ad" else edges, title, with_ticks=False)
        near(axes, box)
    boxes(rows[0, 0], box, BEST)
    rows[0, 1].plot(*start.T, color=CLOUD, linewidth=1.5)
    rows[0, 2].plot(*closed(found.snakes[0]).T, ".-", color=CLOUD, markersize=4, linewidth=1)
    rows[0, 3].plot(*closed(found.curves[0]).T, color=PEER, linewidth=1.5)
    rows[0, 3].plot(*found.controls[0].T, "x", color=BEST, markersize=4)
    height, width = 1.5 * box[3] / 2, 1.5 * box[2] / 2
    field = fields(found)[0]
    extent = (box[0] - width, box[0] + width, box[1] + height, box[1] - height)
    rows[0, 4].imshow(field, extent=extent, cmap="RdBu_r", vmin=-25, vmax=25, interpolation="bilinear")
    rows[0, 4].contour(
        np.linspace(*extent[:2], 24), np.linspace(*extent[:1:-1], 24), field, [0.0], colors="k", linewidths=1
    )
    rows[0, 4].set_title("e) signed distance")
    near(rows[0, 4], box)
    model = model_of_people()
    shapes = [("f) mean of 60 masks", model.mean)]
    for k in range(2):
        for sign, word in ((-2.0, "−"), (2.0, "+")):
            shape = model.mean + sign * np.sqrt(model.variances[k]) * model.modes[k]
            shapes.append((f"mode {k + 1}, {word}2 sd", shape))
    for axes, (title, shape) in zip(rows[1], shapes, strict=True):
        grid = shape.reshape(model.grid, model.grid)
        axes.imshow(grid, extent=(-1, 1, 1, -1), cmap="RdBu_r", vmin=-1, vmax=1, aspect=2.4)
        middle = (np.arange(model.grid) + 0.5) / model.grid * 2 - 1
        axes.contour(middle, middle, grid, [0.0], colors="k", linewidths=1)
        axes.set_title(title)
    for axes in rows.ravel():
        axes.set_xticks([])
        axes.set_yticks([])
    share = f"{len(model.modes)} modes hold {100 * model.explained:.0f} % of the variance"
    figure.suptitle(f"From a picture to a shape vector (a–e); a model of people, {share} (f)")
    return figure


def surfaces() -> Figure:
    """The frame, the likelihood over it, in a good and in a bad case."""
    scene = make_scene("person_and_board")
    truth = centre_from_corner(scene.truth)
    reference = CUE_MADE.learn(planes_of(scene, 0), truth[0])
    figure, rows = plt.subplots(2, 2, figsize=(10, 7.4), layout="constrained")
    cases = ((24, "good: a board of the same colour and size"), (80, "bad: a glare hides the outline"))
    for (index, title), (left, right) in zip(cases, rows, strict=True):
        xs, ys = np.arange(0.0, scene.width, 3.0), np.arange(60.0, 200.0, 3.0)
        x, y = (a.ravel() for a in np.meshgrid(xs, ys))
        hypotheses = np.column_stack([x, y, np.full((x.size, 2), truth[index, 2:])])
        values = np.exp(CUE_MADE.log_likelihood(planes_of(scene, index), Hypotheses(hypotheses), reference))
        show(left, scene.frames[index], f"frame {index}, {title}")
        boxes(left, truth[index], BEST, width=1.5)
        picture = right.imshow(
            values.reshape(len(ys), len(xs)),
            extent=(xs[0] - 1.5, xs[-1] + 1.5, ys[-1] + 1.5, ys[0] - 1.5),
            cmap=SURFACE,
            vmin=0,
            vmax=1,
        )
        right.plot(*truth[index, :2], "+", color=BEST, markersize=12)
        right.set_title("likelihood of a box of the person's size, by its centre")
        right.set_xlim(left.get_xlim())
        right.set_ylim(left.get_ylim())
        figure.colorbar(picture, ax=right, shrink=0.7)
    return figure


def main() -> None:
    """Write both pictures."""
    cv2.setNumThreads(1)
    save(chain(), FOLDER / "shape_chain.png")
    save(surfaces(), FOLDER / "shape_surface.png")


if __name__ == "__main__":
    main()
