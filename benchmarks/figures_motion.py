"""Pictures of the motion cue: flow by each method, and its likelihood in good and in bad cases.

Run ``python benchmarks/figures_motion.py`` with the extra `figures`; it writes into docs/figures.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, PEER, SURFACE, boxes, save, show
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bayesnet_track.cues.motion import CUE, MotionCue
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.cue import Hypotheses, Reference
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region
from bayesnet_track.sources.scenes import make_scene

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

FOLDER = Path(__file__).parents[1] / "docs" / "figures"
WIDTH, HEIGHT, SIDE = 320, 240, 64
PAN, OWN = np.array([7.0, 3.0]), np.array([-4.0, 2.0])
"""How the camera shifts the picture, and how the target moves on the ground, px."""


def cue(**parameters: Any) -> MotionCue:
    """The cue with these parameters."""
    made = CUE.make(CUE.parameters(**parameters))
    assert isinstance(made, MotionCue)
    return made


def planes_of(made: MotionCue, now: Image, then: Image) -> Planes:
    """What the cue sees of two pictures, one interval apart."""
    cache = PlaneCache(FramePair(Frame(1, 1.0, now), Frame(0, 0.0, then)))
    return cache.planes(made.needs, Region(0, 0, now.shape[1], now.shape[0]))


def texture(seed: int, height: int, width: int) -> Floats:
    """(height, width, 3) texture with fine and coarse structure."""
    rng = np.random.default_rng(seed)
    image = np.full((height, width), 128.0)
    for sd in (1.5, 4.0, 12.0):
        layer = cv2.GaussianBlur(rng.normal(size=image.shape), (0, 0), sd)
        image += 22.0 * layer / layer.std()
    return np.repeat(image[..., None], 3, axis=2)


def scenery(camera: Floats, target: Floats) -> Image:
    """Ground shifted by `camera`, px, with a reddish patterned square at `target`."""
    ground = texture(3, HEIGHT + 80, WIDTH + 80)
    move = np.column_stack([np.eye(2), camera - 40])
    image = cv2.warpAffine(ground, move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    patch = texture(8, SIDE, SIDE) * np.array([0.7, 0.8, 1.3])
    place = np.column_stack([np.eye(2), target - (SIDE - 1) / 2])
    cover = cv2.warpAffine(np.ones((SIDE, SIDE, 1)), place, (WIDTH, HEIGHT))[..., None]
    moved = cv2.warpAffine(patch, place, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)
    return np.clip(np.rint(image * (1 - cover) + moved * cover), 0, 255).astype(np.uint8)


def arrows(axes: Axes, vectors: Floats, own: Floats) -> None:
    """At most one arrow per cell of 12 px, three times as long as the flow; those in the box `own` in red."""
    _, first = np.unique(vectors[:, :2].astype(int) // 12, axis=0, return_index=True)
    x, y, dx, dy = vectors[first].T
    inside = (np.abs(vectors[first, :2] - own[:2]) <= own[2:] / 2).all(axis=1)
    for which, colour in ((~inside, BEST), (inside, PEER)):
        axes.quiver(
            x[which],
            y[which],
            3 * dx[which],
            3 * dy[which],
            color=colour,
            angles="xy",
            scale_units="xy",
            scale=1,
            width=0.004,
        )


def flows() -> Figure:
    """The same two pictures seen by each method, and with the camera's motion taken off."""
    at = np.array([150.0, 120.0])
    then, now = scenery(np.zeros(2), at), scenery(PAN, at + PAN + OWN)
    box = np.array([*(at + PAN + OWN), SIDE, SIDE])
    figure, rows = plt.subplots(2, 2, figsize=(10, 7.8), layout="constrained")
    variants: list[tuple[str, dict[str, str]]] = [
        ("sparse: corners, Lucas and Kanade", {"flow": "sparse"}),
        ("dense: DIS", {"flow": "dense"}),
        ("odp: orthogonal dynamic programming", {"flow": "odp"}),
        ("sparse, the camera's motion taken off", {"flow": "sparse", "camera": "auto"}),
    ]
    for axes, (title, parameters) in zip(rows.ravel(), variants, strict=True):
        made = cue(**parameters)
        vectors = made.vectors(planes_of(made, now, then))
        show(axes, (now // 2 + 120).astype(np.uint8), f"{title} ({len(vectors)} vectors)", with_ticks=False)
        arrows(axes, vectors, box)
        boxes(axes, box, PEER, width=1.2)
    return figure


def likelihood(
    made: MotionCue, planes: Planes, reference: Reference, size: Floats, step: float = 3.0
) -> tuple[Floats, tuple[float, float, float, float]]:
    """Likelihood of boxes of one size by their centre over the frame, and its extent."""
    xs, ys = np.arange(0.0, planes.frame.width, step), np.arange(0.0, planes.frame.height, step)
    x, y = (a.ravel() for a in np.meshgrid(xs, ys))
    hypotheses = np.column_stack([x, y, np.full((x.size, 2), size)])
    values = np.exp(made.log_likelihood(planes, Hypotheses(hypotheses), reference))
    extent = (xs[0] - step / 2, xs[-1] + step / 2, ys[-1] + step / 2, ys[0] - step / 2)
    return values.reshape(len(ys), len(xs)), extent


def surfaces() -> Figure:
    """The frame beside the likelihood: one of two squares, the two as they cross, a jerk of the camera."""
    figure, rows = plt.subplots(3, 3, figsize=(11, 8.6), layout="constrained")
    scene, made = make_scene("two_squares"), (cue(), cue(flow="dense"))
    truth = centre_from_corner(scene.truth)
    references = [m.learn(planes_of(m, scene.frames[1], scene.frames[0]), truth[1]) for m in made]
    for row, index, title in zip(rows, (12, 29), ("good: apart", "bad: they cross"), strict=False):
        show(row[0], scene.frames[index], f"two_squares, frame {index}; {title}", with_ticks=False)
        boxes(row[0], truth[index], BEST, width=1.5)
        for axes, m, reference, name in zip(row[1:], made, references, ("sparse", "dense"), strict=True):
            planes = planes_of(m, scene.frames[index], scene.frames[index - 1])
            panel(axes, m, planes, reference, truth[index], f"likelihood, {name}")
    at = np.array([150.0, 120.0])
    still, moved = scenery(np.zeros(2), at), scenery(np.zeros(2), at + OWN)
    shaken = scenery(PAN, at + 2 * OWN + PAN)
    box = np.array([*(at + OWN), SIDE, SIDE])
    after = np.array([*(at + 2 * OWN + PAN), SIDE, SIDE])
    show(rows[2, 0], shaken, f"the camera jerks by {PAN[0]:.0f}, {PAN[1]:.0f} px", with_ticks=False)
    boxes(rows[2, 0], after, BEST, width=1.5)
    cases = (("ignore", "bad: camera: ignore"), ("auto", "good: camera: auto"))
    for axes, (mode, title) in zip(rows[2, 1:], cases, strict=True):
        m = cue(camera=mode)
        reference = m.learn(planes_of(m, moved, still), box)
        picture = panel(axes, m, planes_of(m, shaken, moved), reference, after, title)
    figure.colorbar(picture, ax=rows[:, 2], shrink=0.5, label="likelihood of a box, by its centre")
    return figure


def panel(axes: Axes, made: MotionCue, planes: Planes, reference: Reference, box: Floats, title: str) -> Any:
    """One surface, with a cross at the target."""
    values, extent = likelihood(made, planes, reference, box[2:])
    picture = axes.imshow(values, extent=extent, cmap=SURFACE, vmin=0, vmax=1)
    axes.plot(*box[:2], "+", color=BEST, markersize=12)
    axes.set_title(title)
    axes.set_xticks([])
    axes.set_yticks([])
    return picture


def main() -> None:
    """Write both pictures."""
    cv2.setNumThreads(1)
    save(flows(), FOLDER / "motion_flow.png")
    save(surfaces(), FOLDER / "motion_surface.png")


if __name__ == "__main__":
    main()
