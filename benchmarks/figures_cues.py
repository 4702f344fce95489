"""Pictures of the cues of colour and brightness: what they see, and their likelihood in good and bad cases.

    python benchmarks/figures_cues.py [CUE ...]
    python benchmarks/figures_cues.py CUE --frame PICTURE --box X,Y,W,H [--later PICTURE] --out FILE

With the extra `figures`; it writes docs/figures/cue_CUE.png. With `--frame` it draws the cue's surface for a
picture of one's own, learnt from the corner box, in a later picture if one is given.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from figure_style import BEST, CLOUD, COLOURS, PEER, SURFACE, Axes, boxes, show
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray
from shading import Balls

from bayesnet_track.cues.shading import polynomials
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.cue import Cue, Hypotheses, Reference, installed_cues
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region
from bayesnet_track.sources.scenes.render import Movie, Sprite
from bayesnet_track.sources.scenes.texture import ORANGE, gray_cells, smooth_background

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
FOLDER = Path(__file__).parents[1] / "docs" / "figures"


@dataclass(frozen=True, eq=False)
class Case:
    """A target learnt in one picture and looked for in another.

    Attributes:
        title: what is good or bad about it.
        first: the picture in which it is learnt.
        box: (4,) centre box there.
        image: the picture in which it is looked for.
        truth: (4,) its centre box there.
    """

    title: str
    first: Image
    box: Floats
    image: Image
    truth: Floats


def save(figure: Figure, path: Path) -> None:
    """Write the picture, the same bytes for the same content, in all colours: few would tint the grays."""
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)


def made(name: str) -> Cue:
    """The cue with its own parameters."""
    declaration = installed_cues()[name]
    cue = declaration.make(declaration.parameters())
    assert isinstance(cue, Cue)
    return cue


def planes_of(cue: Cue, image: Image) -> Planes:
    """The cue's planes of a whole picture."""
    whole = Region(0, 0, image.shape[1], image.shape[0])
    return PlaneCache(FramePair(Frame(0, 0.0, image), None)).planes(cue.needs, whole)


def learnt(cue: Cue, case: Case) -> Reference:
    """What it remembers of the case's target."""
    return cue.learn(planes_of(cue, case.first), case.box)


def surface(axes: Axes, cue: Cue, case: Case, step: int = 3) -> None:
    """The likelihood of a box of the target's size, by its centre."""
    height, width = case.image.shape[:2]
    xs, ys = np.arange(0.0, width, step), np.arange(0.0, height, step)
    centres = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    asked = np.column_stack([centres, np.tile(case.truth[2:], (len(centres), 1))])
    log = cue.log_likelihood(planes_of(cue, case.image), Hypotheses(asked), learnt(cue, case))
    half = step / 2
    drawn = axes.imshow(
        np.exp(log).reshape(len(ys), len(xs)),
        extent=(xs[0] - half, xs[-1] + half, ys[-1] + half, ys[0] - half),
        cmap=SURFACE,
        vmin=0.0,
        vmax=1.0,
        interpolation="nearest",
    )
    axes.plot(*case.truth[:2], "+", color=PEER, markersize=9)
    axes.set(xticks=[], yticks=[], title=f"likelihood, largest {np.exp(log.max()):.2f}")
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.figure.colorbar(drawn, ax=axes, shrink=0.75, ticks=[0, 0.5, 1])


def page(cue: Cue, cases: list[Case], explain: Callable[[list[Axes], Cue, Case], None]) -> Figure:
    """Top: how the cue works on the first case. Below, a row per case: picture and surface."""
    figure = plt.figure(figsize=(8, 2.5 + 2.75 * len(cases)), layout="constrained")
    top, rest = figure.subfigures(2, 1, height_ratios=[2.5, 2.75 * len(cases)])
    explain(list(top.subplots(1, 3)), cue, cases[0])
    for case, (left, right) in zip(cases, rest.subplots(len(cases), 2, squeeze=False), strict=True):
        show(left, case.image, case.title, with_ticks=False)
        boxes(left, case.truth, BEST, width=1.8)
        surface(right, cue, case)
    return figure


def crop(axes: Axes, case: Case, title: str) -> None:
    """The target as it was learnt."""
    show(axes, case.first, title, with_ticks=False)
    close(axes, case.box)
    boxes(axes, case.box, BEST, width=1.8)


def close(axes: Axes, box: Floats, grow: float = 1.6) -> None:
    """Show the surroundings of a box."""
    reach = grow * max(box[2:]) / 2
    axes.set_xlim(box[0] - reach, box[0] + reach)
    axes.set_ylim(box[1] + reach, box[1] - reach)


# ----------------------------------------------------------------------------------------- scenes


def still(sprites: tuple[Sprite, ...], seed: int = 1, noise_sd: float = 0.0) -> Image:
    """One picture of sprites on gray hills."""
    rng = np.random.Generator(np.random.Philox(seed))
    return Movie(smooth_background(320, 240, 110.0, 24.0, rng), sprites, noise_sd, seed)[0]


def two_halves(box: tuple[float, float, float, float], upper: Floats, lower: Floats) -> Sprite:
    """A box of one colour above and another below."""
    return Sprite(np.stack([upper, lower])[:, None, :], np.array([box]))


def case_of(title: str, first: Image, image: Image, box: tuple[float, ...], now: tuple[float, ...]) -> Case:
    """A case of boxes given as numbers."""
    return Case(title, first, np.array(box), image, np.array(now))


GREEN, BLUE, RED = (np.array(colour, dtype=float) for colour in ((70, 190, 60), (200, 90, 40), (50, 40, 205)))
START, HERE, THERE = (100.0, 120.0, 44.0, 60.0), (120.0, 110.0, 44.0, 60.0), (230.0, 130.0, 44.0, 60.0)
ORANGE_ = np.array(ORANGE)


def histogram_cases() -> list[Case]:
    """A green and blue target: among other colours; beside the same colours the other way up."""
    first, target = still((two_halves(START, GREEN, BLUE),)), two_halves(HERE, GREEN, BLUE)
    others = (two_halves(THERE, RED, ORANGE_), target)
    upside_down = (two_halves(THERE, BLUE, GREEN), target)
    return [
        case_of("good: other colours", first, still(others, 2), START, HERE),
        case_of("bad: the same colours, upside down", first, still(upside_down, 3), START, HERE),
    ]


def blobs_cases() -> list[Case]:
    """The same target: upside down beside it; and a target of many small patches of colour."""
    upside_down = histogram_cases()[1]
    rng = np.random.Generator(np.random.Philox(4))
    palette = np.array([GREEN, BLUE, RED, ORANGE_])

    def confetti(box: tuple[float, ...]) -> Sprite:
        return Sprite(palette[rng.integers(0, 4, (12, 9))], np.array([box]))

    start = confetti(START)
    moved, other = Sprite(start.cells, np.array([HERE])), confetti(THERE)
    return [
        replace(upside_down, title="good: the same colours, upside down"),
        case_of("bad: patches too small for blobs", still((start,)), still((other, moved), 5), START, HERE),
    ]


def intensity_cases() -> list[Case]:
    """A gray pattern among another; and the same turned by 30 degrees."""
    rng = np.random.Generator(np.random.Philox(6))
    pattern, foreign = (gray_cells(5, 4, 30, 225, rng) for _ in range(2))
    first = still((Sprite(pattern, np.array([START])),))
    other = Sprite(foreign, np.array([THERE]))
    good = still((other, Sprite(pattern, np.array([HERE]))), 2)
    turn = cv2.getRotationMatrix2D(HERE[:2], 30.0, 1.0)
    square = np.zeros(good.shape[:2])
    square[80:140, 98:142] = 1.0
    over = cv2.warpAffine(square, turn, (320, 240))[:, :, None]
    turned = cv2.warpAffine(good, turn, (320, 240))
    bad = np.rint(over * turned + (1 - over) * still((other,), 2)).astype(np.uint8)
    return [
        case_of("good: another pattern beside it", first, good, START, HERE),
        case_of("bad: turned by 30°", first, bad, START, HERE),
    ]


def shading_cases() -> list[Case]:
    """A ball that rolls among balls lit otherwise, on an even ground and on one with hills of brightness."""
    cases = []
    for title, hills in (("good: rolled on, even ground", 3.0), ("bad: hills of brightness", 40.0)):
        balls = Balls(3, opposite=True, rolling=True, hills=hills, noise_sd=0.0)
        box, now = (centre_from_corner(np.array([balls.truth(frame)]))[0] for frame in (0, 30))
        cases.append(Case(title, balls.image(0), box, balls.image(30), now))
    return cases


# ------------------------------------------------------------------------------- how each works


def hue_colour(degrees: Floats | float) -> NDArray[np.float64]:
    """RGB of fully saturated hues."""
    return mpl.colors.hsv_to_rgb(
        np.stack([np.mod(degrees, 360) / 360, 1 + 0 * degrees, 0.85 + 0 * degrees], -1)
    )


def explain_histogram(panels: list[Axes], cue: Cue, case: Case) -> None:
    """Thesis Figures 3.1 and 3.2: the histogram, and the likelihood against the distance."""
    reference = learnt(cue, case)
    crop(panels[0], case, "the target")
    shares = reference["shares"]
    middle = (np.arange(len(shares) - 1) + 0.5) * 360 / (len(shares) - 1)
    panels[1].bar(middle, shares[:-1], width=360 / len(middle), color=hue_colour(middle))
    panels[1].bar(400, shares[-1], width=25, color=COLOURS[2])
    panels[1].set_xticks([0, 120, 240, 360, 400], ["0°", "120°", "240°", "", "gray"])
    panels[1].set_title("share of the box by hue")
    distance, alpha = np.linspace(0.0, 0.5, 200), float(reference["alpha"])
    panels[2].plot(distance, (1 + np.exp(-4)) / (1 + np.exp(4 * (distance - alpha) / alpha)), color=CLOUD)
    panels[2].axvline(alpha, color=PEER, linestyle="--", linewidth=1)
    panels[2].set_title(f"likelihood by distance, α {alpha:.2f}")


def explain_blobs(panels: list[Axes], cue: Cue, case: Case) -> None:
    """Thesis Figure 3.4: the target, the hue of its samples, its blobs."""
    crop(panels[0], case, "the target")
    hue = planes_of(cue, case.first)[cue.needs[0]]
    cells = 8
    x = case.box[0] + case.box[2] * ((np.arange(cells) + 0.5) / cells - 0.5)
    y = case.box[1] + case.box[3] * ((np.arange(cells) + 0.5) / cells - 0.5)
    across, down = np.meshgrid(x, y)
    seen = hue[np.ix_(np.rint(y).astype(int), np.rint(x).astype(int))] >= 0
    pixels = case.first[np.rint(down[seen]).astype(int), np.rint(across[seen]).astype(int), ::-1] / 255.0
    panels[1].scatter(across[seen], down[seen], c=pixels, s=60, edgecolors="white", linewidths=0.5)
    panels[1].set(xticks=[], yticks=[], aspect="equal", title="8 × 8 samples with a hue")
    close(panels[1], case.box)
    boxes(panels[1], case.box, BEST, width=1.8)
    crop(panels[2], case, "blobs: place, hue, share")
    for dx, dy, degrees, share in learnt(cue, case)["blobs"]:
        place = case.box[:2] + [dx, dy] * case.box[2:]
        radius = np.sqrt(share * case.box[2] * case.box[3] / np.pi)
        shape = Ellipse(
            tuple(place), 2 * radius, 2 * radius, facecolor=hue_colour(degrees), edgecolor="white"
        )
        panels[2].add_patch(shape)
        panels[2].text(
            *place, f"{degrees:.0f}°\n{share:.2f}", ha="center", va="center", color="white", fontsize=8
        )


def explain_intensity(panels: list[Axes], cue: Cue, case: Case) -> None:
    """Thesis Figure 3.9: the target, its grid, the mask."""
    crop(panels[0], case, "the target")
    reference = learnt(cue, case)
    panels[1].imshow(reference["grid"], cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    panels[1].set(xticks=[], yticks=[], title="means of 10 × 10 cells")
    offset = (2.0 * np.arange(10) + 1.0) / 10 - 1.0
    line = np.exp(-0.5 * (offset / 0.5) ** 2)
    panels[2].imshow(np.outer(line, line), cmap=SURFACE, vmin=0, vmax=1, interpolation="nearest")
    panels[2].set(xticks=[], yticks=[], title="mask: weight of the cells")


def explain_shading(panels: list[Axes], cue: Cue, case: Case) -> None:
    """The target, its shading, the same target's shading in the later picture."""
    _, lines = polynomials(8, 3, 0.5)
    place, dense = (2 * np.arange(8) + 1) / 8 - 1, np.linspace(-1, 1, 60)
    fine = np.array([np.polyval(np.polyfit(place, line, 3), dense) for line in lines])

    def field(shading: Floats) -> Floats:
        total, column = np.zeros((60, 60)), 0
        for degree in range(1, 4):
            for b in range(degree + 1):
                total += shading[column] * np.outer(fine[b], fine[degree - b])
                column += 1
        return total

    crop(panels[0], case, "the target")
    later = cue.learn(planes_of(cue, case.image), case.truth)["shading"]
    for axes, shading, title in (
        (panels[1], learnt(cue, case)["shading"], "its shading, degree 3"),
        (panels[2], later, "30 frames later, rolled on"),
    ):
        axes.imshow(field(shading), cmap="RdBu_r", vmin=-80, vmax=80, interpolation="bilinear")
        axes.contour(field(shading), np.arange(-80, 81, 20), colors="k", linewidths=0.6)
        axes.set(xticks=[], yticks=[], title=title)


PAGES: Mapping[str, tuple[Callable[[], list[Case]], Callable[[list[Axes], Cue, Case], None]]] = {
    "color_histogram": (histogram_cases, explain_histogram),
    "color_blobs": (blobs_cases, explain_blobs),
    "intensity": (intensity_cases, explain_intensity),
    "shading": (shading_cases, explain_shading),
}


def own(name: str, frame: Path, box: str, later: Path | None) -> Figure:
    """The surface of a picture of one's own."""
    first, image = (cv2.imread(str(path)) for path in (frame, later or frame))
    if first is None or image is None:
        raise SystemExit("a picture cannot be read")
    start = centre_from_corner(tuple(float(value) for value in box.split(",")))
    case = Case(f"{(later or frame).name}; box as learnt", first, start, image, start)
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.5), layout="constrained")
    show(left, image, case.title)
    boxes(left, start, BEST, width=1.8)
    surface(right, made(name), case, step=max(2, image.shape[1] // 160))
    return figure


def main() -> None:
    """Draw the pages asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cues", nargs="*", default=[])
    parser.add_argument("--frame", type=Path)
    parser.add_argument("--later", type=Path)
    parser.add_argument("--box")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if options.frame:
        if not (options.box and options.out and len(options.cues) == 1):
            parser.error("--frame needs one CUE, --box and --out")
        save(own(options.cues[0], options.frame, options.box, options.later), options.out)
        return
    if unknown := set(options.cues) - set(PAGES):
        parser.error(f"no page of {', '.join(sorted(unknown))}; there are {', '.join(PAGES)}")
    for name in options.cues or PAGES:
        cases, explain = PAGES[name]
        save(page(made(name), cases(), explain), FOLDER / f"cue_{name}.png")


if __name__ == "__main__":
    main()
