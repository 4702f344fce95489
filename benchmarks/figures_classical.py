"""Draw the figures of the pages on `klt`, `template`, `siamese`, `color_kernel_histogram`, `opencv_tracker`.

The scenes are rendered. Run ``python benchmarks/figures_classical.py`` (extra `figures`); pictures go to
docs/figures.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import figure_style as style
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.cue import Hypotheses, Reference, installed_cues
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region, region_of_boxes
from bayesnet_track.sources.scenes import Scene, make_scene

Floats = NDArray[np.float64]
FIGURES = Path(__file__).parents[1] / "docs" / "figures"


def cue_of(name: str, **parameters: Any) -> Any:
    """An installed cue at work."""
    declaration = installed_cues()[name]
    return declaration.make(declaration.parameters(**parameters))


def planes_of(cue: Any, scene: Scene, index: int, region: Region) -> Planes:
    """A cue's planes of a frame."""
    frame = Frame(index, float(index), scene.frames[index])
    return PlaneCache(FramePair(frame, None)).planes(cue.needs, region)


def learnt(cue: Any, scene: Scene, index: int, box: Floats) -> Reference:
    """Its reference of a box."""
    return cue.learn(planes_of(cue, scene, index, region_of_boxes(box[None], 1.0)), box)


def zoomed(axes: Any, centre: Floats, reach: float) -> None:
    """Look at the surroundings of a place only."""
    axes.set_xlim(centre[0] - reach, centre[0] + reach)
    axes.set_ylim(centre[1] + 0.75 * reach, centre[1] - 0.75 * reach)
    axes.set_xticks([])
    axes.set_yticks([])


def surface(axes: Any, cue: Any, scene: Scene, index: int, centre: Floats, reference: Reference) -> None:
    """The likelihood of the target's size at every second pixel around a place."""
    x = np.arange(centre[0] - 60, centre[0] + 61, 2.0)
    y = np.arange(centre[1] - 45, centre[1] + 46, 2.0)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    boxes = np.concatenate([grid, np.tile(centre[2:], (len(grid), 1))], axis=1)
    planes = planes_of(cue, scene, index, region_of_boxes(boxes))
    values = np.exp(cue.log_likelihood(planes, Hypotheses(boxes), reference)).reshape(len(y), len(x))
    extent = (x[0] - 1, x[-1] + 1, y[-1] + 1, y[0] - 1)
    axes.imshow(values, cmap=style.SURFACE, extent=extent, vmin=0, vmax=1)
    axes.plot(*centre[:2], "+", color="white", ms=9)
    axes.set_xticks([])
    axes.set_yticks([])


def colours(path: Path) -> None:
    """A ball seen and partly hidden: the frame, the hue histogram's surface, the kernel histogram's."""
    scene = make_scene("flying_ball", 0)
    truth = centre_from_corner(scene.truth)
    names = {"color_histogram": "hue histogram", "color_kernel_histogram": "kernel histogram"}
    cues = {name: cue_of(name) for name in names}
    references = {name: learnt(cue, scene, 0, truth[0]) for name, cue in cues.items()}
    figure, rows = plt.subplots(2, 3, figsize=(9, 5), layout="constrained")
    for axes, index in zip(rows, (8, 18), strict=True):
        style.show(axes[0], scene.frames[index], f"frame {index}", False)
        style.boxes(axes[0], truth[index : index + 1], style.INK)
        zoomed(axes[0], truth[index], 60)
        for panel, (name, title) in zip(axes[1:], names.items(), strict=True):
            surface(panel, cues[name], scene, index, truth[index], references[name])
            panel.set_title(title)
    style.save(figure, path)


def covered_more_and_more(scene: Scene, box: Floats) -> dict[str, NDArray[np.uint8]]:
    """Title -> the fifth frame, with none, half and all of the box covered by background."""
    x, y, w, h = box
    later = scene.frames[4].copy()
    cases = {"four frames later": later}
    for title, share in (("half is covered", 0.5), ("all is covered: not seen", 1.0)):
        covered = later.copy()
        left, top = round(x - w / 2) - 1, round(y - h / 2) - 1
        patch = scene.frames[0][-3 - round(h) :, -3 - round(w * share) :]
        covered[top : top + patch.shape[0], left : left + patch.shape[1]] = patch
        cases[title] = covered
    return cases


def copies(path: Path) -> None:
    """The copy that is learnt, and where it is found with its two sds."""
    scene = make_scene("gray_square", 0)
    truth, cue = centre_from_corner(scene.truth), cue_of("template")
    reference = learnt(cue, scene, 0, truth[0])
    figure, panels = plt.subplots(1, 4, figsize=(11, 2.8), layout="constrained")
    panels[0].imshow(reference["same"], cmap="gray", vmin=0, vmax=255)
    panels[0].set(title="the copy", xticks=[], yticks=[])
    cases = covered_more_and_more(scene, truth[4])
    for axes, (title, image) in zip(panels[1:], cases.items(), strict=True):
        planes = PlaneCache(FramePair(Frame(4, 4.0, image), None)).planes(
            cue.needs, region_of_boxes(truth[4:5])
        )
        expected = truth[4] + [12, -8, 0, 0]
        found = cue.measure(planes, Hypotheses(expected[None]), np.ones(1), reference)
        style.show(axes, image, title, False)
        if found is not None:
            style.boxes(axes, found.mean[None], style.BEST)
            sds = 2.0 * np.sqrt(np.diag(found.covariance)[:2])
            axes.errorbar(*found.mean[:2], sds[1], sds[0], color=style.BEST)
        axes.plot(*expected[:2], "+", color=style.WARNING, ms=9)
        zoomed(axes, truth[4], 50)
    style.save(figure, path)


def proposals(path: Path) -> None:
    """A target in its frame, and the likelihood of its box by the plain pixels of `siamese`."""
    scene = make_scene("gray_square", 0)
    truth, cue = centre_from_corner(scene.truth), cue_of("siamese")
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
    style.show(left, scene.frames[4], "four frames later", False)
    style.boxes(left, truth[4:5], style.INK)
    zoomed(left, truth[4], 60)
    surface(right, cue, scene, 4, truth[4], learnt(cue, scene, 0, truth[0]))
    right.set_title("likelihood")
    style.save(figure, path)


def points(path: Path) -> None:
    """Points when they are chosen, followed, partly hidden, and on something else."""
    scene = make_scene("gray_square", 0)
    truth, cue = centre_from_corner(scene.truth), cue_of("klt")
    reference = learnt(cue, scene, 0, truth[0])
    figure, panels = plt.subplots(1, 4, figsize=(11, 2.8), layout="constrained")
    style.show(panels[0], scene.frames[0], "chosen", False)
    style.boxes(panels[0], truth[:1], style.INK)
    panels[0].plot(*reference["at"].T, ".", color=style.BEST, ms=5)
    zoomed(panels[0], truth[0], 50)
    cases = covered_more_and_more(scene, truth[4])
    for axes, (title, image) in zip(panels[1:], cases.items(), strict=True):
        pair = FramePair(Frame(4, 4.0, image), None)
        planes = PlaneCache(pair).planes(cue.needs, region_of_boxes(truth[4:5]))
        motion = cue.followed(planes, truth[4] + [3, -2, 0, 0], reference)
        style.show(axes, image, title, False)
        if motion is not None:
            axes.plot(*motion.places[~motion.kept].T, "x", color=style.WARNING, ms=5)
            axes.plot(*motion.places[motion.kept].T, ".", color=style.BEST, ms=5)
            box = np.concatenate([motion.of(reference["box"][:2]), abs(motion.factor) * reference["box"][2:]])
            style.boxes(axes, box[None], style.BEST)
        zoomed(axes, truth[4], 50)
    style.save(figure, path)


def tracker(path: Path) -> None:
    """MIL's box in a few frames, under the truth; the last thing that it saw is not the target."""
    scene = make_scene("flying_ball", 0)
    truth, cue = centre_from_corner(scene.truth), cue_of("opencv_tracker")
    reference = learnt(cue, scene, 0, truth[0])
    hidden = int(np.flatnonzero(scene.visible < 0.01)[2])
    shown = (2, hidden - 7, hidden, min(hidden + 12, len(scene.frames) - 1))
    figure, panels = plt.subplots(1, 4, figsize=(11, 2.8), layout="constrained")
    rng = np.random.default_rng(0)
    for index in range(1, shown[-1] + 1):
        boxes = np.tile(truth[index], (50, 1))
        boxes[:, :2] += rng.normal([4.0, -3.0], 4.0, (50, 2))
        planes = planes_of(cue, scene, index, region_of_boxes(boxes))
        found = cue.measure(planes, Hypotheses(boxes), np.full(50, 0.02), reference)
        if found is not None:
            reference = cue.blend(reference, learnt(cue, scene, index, found.mean), 0.2)
        if index in shown:
            axes = panels[shown.index(index)]
            style.show(
                axes, scene.frames[index], f"frame {index}" + (": not seen" if found is None else ""), False
            )
            if found is not None:
                style.boxes(axes, found.mean[None], style.BEST)
            zoomed(axes, truth[index], 70)
    style.save(figure, path)


def main() -> None:
    """Draw all five."""
    colours(FIGURES / "color_kernel.png")
    points(FIGURES / "klt_points.png")
    copies(FIGURES / "template_copy.png")
    proposals(FIGURES / "cue_siamese.png")
    tracker(FIGURES / "opencv_tracker.png")


if __name__ == "__main__":
    main()
