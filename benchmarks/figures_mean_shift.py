"""Draw the figures of docs/cues/mean_shift.md: back-projections, windows, messages, a ball held while hidden.

Run ``python benchmarks/figures_mean_shift.py`` (extra `figures`); pictures go to docs/figures.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import figure_style as style
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from bayesnet_track import Start, track
from bayesnet_track.cues.camshift import back_projection
from bayesnet_track.graphs import find_graph
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.cue import Hypotheses, Measurement, Reference, installed_cues
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region, region_of_boxes
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.vision.kernels.mean_shift_kernels import kernel_histogram

Floats = NDArray[np.float64]
FIGURES = Path(__file__).parents[1] / "docs" / "figures"
GOOD, HALF = 8, 18
"""Frames in which the ball is seen, and a part of it."""


def planes_of(cue: Any, image: Any, region: Region) -> Planes:
    """A cue's planes of a picture."""
    return PlaneCache(FramePair(Frame(0, 0.0, image), None)).planes(cue.needs, region)


def measured(name: str, scene: Scene, frame: int) -> tuple[Any, Reference, Hypotheses, Measurement | None]:
    """A cue learnt in frame 0, asked in another about hypotheses that lie 20 px off."""
    declaration = installed_cues()[name]
    cue: Any = declaration.make(declaration.parameters())
    truth = centre_from_corner(scene.truth)
    reference = cue.learn(planes_of(cue, scene.frames[0], region_of_boxes(truth[:1], 1.0)), truth[0])
    rng = np.random.default_rng(0)
    boxes = np.tile(truth[frame], (300, 1))
    boxes[:, :2] += rng.normal([-16.0, 12.0], 9.0, (300, 2))
    hypotheses, equal = Hypotheses(boxes), np.full(300, 1 / 300)
    planes = planes_of(cue, scene.frames[frame], region_of_boxes(boxes))
    return cue, reference, hypotheses, cue.measure(planes, hypotheses, equal, reference)


def message(axes: Any, found: Measurement) -> None:
    """The ellipse of two sds of a measurement's x and y."""
    values, turn = np.linalg.eigh(found.covariance[:2, :2])
    angle = float(np.degrees(np.arctan2(turn[1, 1], turn[0, 1])))
    axes.add_patch(
        Ellipse(
            tuple(found.mean[:2]),
            *(4.0 * np.sqrt(values[::-1])),
            angle=angle,
            fill=False,
            color=style.BEST,
            lw=2,
        )
    )
    axes.plot(*found.mean[:2], "+", color=style.BEST, ms=9)


def windows(path: Path) -> None:
    """The frame with its prediction, then for both cues a good and a bad case on the back-projection."""
    scene = make_scene("flying_ball", 0)
    figure, ((first, good, half), (other, cam, cam_half)) = plt.subplots(
        2, 3, figsize=(10, 6.4), layout="constrained"
    )
    for column, frame in ((0, GOOD), (1, GOOD), (2, HALF)):
        for row, name in enumerate(("mean_shift", "camshift")):
            axes = ((first, good, half), (other, cam, cam_half))[row][column]
            cue, reference, hypotheses, found = measured(name, scene, frame)
            equal = np.full(len(hypotheses), 1 / len(hypotheses))
            truth = centre_from_corner(scene.truth)[frame]
            view = region_of_boxes(truth[None], 1.6)
            if column == 0:
                shown = frame if row == 0 else HALF
                centre = centre_from_corner(scene.truth)[shown]
                style.show(axes, scene.frames[shown], f"frame {shown}")
                if row == 0:
                    axes.plot(*hypotheses.boxes[:, :2].T, ".", color=style.CLOUD, ms=2)
                    axes.set_title(f"frame {GOOD}: the ball, centres of the prediction")
                else:
                    axes.set_title(f"frame {HALF}: partly behind the pillar")
                style.boxes(axes, centre[None], style.INK)
                axes.set_xlim(centre[0] - 75, centre[0] + 75)
                axes.set_ylim(centre[1] + 55, centre[1] - 55)
                continue
            planes = planes_of(cue, scene.frames[frame], view)
            cells = planes[cue.needs[0]].astype(np.uint16)
            climb = cue.climb(
                planes_of(cue, scene.frames[frame], region_of_boxes(hypotheses.boxes)),
                hypotheses,
                equal,
                reference,
            )
            if name == "mean_shift":
                x, y, rx, ry = climb[-1]
                here = kernel_histogram(
                    cells, x - planes.region.x0, y - planes.region.y0, rx, ry, len(reference["shares"])
                )
                ratio = np.divide(reference["shares"], here, out=np.zeros_like(here), where=here > 0)
                image, track_of = np.sqrt(np.minimum(ratio, 4.0))[cells], climb[:, :2]
                for x, y, rx, ry in climb:
                    axes.add_patch(Ellipse((x, y), 2 * rx, 2 * ry, fill=False, color=style.PEER, lw=0.8))
            else:
                image, track_of = back_projection(reference)[cells], climb.path[:, :2]
                style.boxes(axes, climb.path, style.PEER, 1.0, 0.8)
            r = planes.region
            axes.imshow(image, cmap="gray", extent=(r.x0 - 0.5, r.x1 - 0.5, r.y1 - 0.5, r.y0 - 0.5), vmin=0)
            axes.plot(*track_of.T, ".-", color=style.PEER, lw=1, ms=4)
            if found is not None:
                message(axes, found)
            kind = "mean shift" if name == "mean_shift" else "CamShift"
            axes.set_title(f"{kind}, frame {frame}" + ("" if found is not None else ": not seen"))
            axes.set_xlim(r.x0 - 0.5, r.x1 - 0.5)
            axes.set_ylim(r.y1 - 0.5, r.y0 - 0.5)
    style.save(figure, path)
    plt.close(figure)


def held(path: Path) -> None:
    """Errors and stated sds over the frames, of the graph as it is and with particles."""
    scene = make_scene("flying_ball", 0)
    text = find_graph("kalman_ball").read_text(encoding="utf-8")
    figure, panels = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
    kinds = {
        "Gaussian (Kalman)": (text, style.BEST),
        "600 particles": (
            text.replace("{gaussian: {filter: kalman, gate: 0.99}}", "{particles: {size: 600}}"),
            style.CLOUD,
        ),
    }
    for label, (graph, colour) in kinds.items():
        with TemporaryDirectory() as folder:
            file = Path(folder) / "graph.yaml"
            file.write_text(graph, encoding="utf-8")
            results = list(
                track(file, SceneSource(scene, "scene:flying_ball"), [Start(scene.start_box)], seed=0)
            )
        boxes = np.array([result.targets[0].centre_box for result in results])
        away = np.hypot(*(boxes - centre_from_corner(scene.truth))[:, :2].T)
        panels[0].plot(away, color=colour, label=label)
        panels[1].plot(np.sqrt([result.targets[0].ud_px2 for result in results]), color=colour, label=label)
    for axes, title in zip(panels, ("error of the estimate, px", "√UD, px"), strict=True):
        style.shaded(axes, scene.visible < 1e-9, "hidden")
        axes.set_title(title)
        axes.legend(loc="upper left")
    panels[1].set_xlabel("frame")
    style.save(figure, path)
    plt.close(figure)


def main() -> None:
    """Draw both."""
    windows(FIGURES / "mean_shift_windows.png")
    held(FIGURES / "kalman_ball.svg")


if __name__ == "__main__":
    main()
