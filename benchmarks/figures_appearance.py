"""Pictures of the cues of appearance against surroundings: how they work, and likelihoods, good and bad.

    python benchmarks/figures_appearance.py [CUE ...]

With the extra `figures`; it writes docs/figures/cue_CUE.png. For a picture of one's own see figures_cues.py.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping

import cv2
import numpy as np
from figure_style import BEST, SURFACE, Axes, boxes, show
from figures_cues import (
    BLUE,
    FOLDER,
    GREEN,
    HERE,
    START,
    THERE,
    Case,
    case_of,
    close,
    crop,
    histogram_cases,
    intensity_cases,
    learnt,
    made,
    page,
    planes_of,
    save,
    still,
    two_halves,
)

from bayesnet_track.cues.foreground_color import ForegroundColor
from bayesnet_track.observation.cue import Cue
from bayesnet_track.vision.foreground import Cells


def foreground_cases() -> list[Case]:
    """A green and blue target beside a red one; beside another of its own colours."""
    return [
        histogram_cases()[0],
        case_of(
            "bad: another of the same colours",
            still((two_halves(START, GREEN, BLUE),)),
            still((two_halves(THERE, BLUE, GREEN), two_halves(HERE, GREEN, BLUE)), 3),
            START,
            HERE,
        ),
    ]


def explain_foreground(panels: list[Axes], cue: Cue, case: Case) -> None:
    """The target and its rings, the posterior of each pixel, the contrast by the size of the box."""
    assert isinstance(cue, ForegroundColor)
    p = cue.parameters
    crop(panels[0], case, "box, ring compared, ring learnt")
    for ring in (p.ring, p.surround):
        around = case.box + [0, 0, *np.full(2, ring * case.box[2:].sum())]
        boxes(panels[0], around, BEST, width=0.8)
    close(panels[0], case.box, 2.4)
    levels, adds = Cells(p.levels, False).layout.astype(int)
    cells = case.image.astype(int) * levels // 256 @ adds
    reference = learnt(cue, case)
    panels[1].imshow(reference["posterior"][cells] / 255.0, cmap=SURFACE, vmin=0, vmax=1)
    panels[1].set(xticks=[], yticks=[], title="the target's, by colour (later)")
    scales = np.geomspace(0.4, 2.5, 60)
    asked = np.column_stack([np.tile(case.truth[:2], (60, 1)), scales[:, None] * case.truth[2:]])
    plain = made("foreground_color")
    assert isinstance(plain, ForegroundColor)
    frame = planes_of(plain, case.image).frame
    panels[2].plot(scales, plain.contrasts(frame, asked, reference["posterior"]))
    panels[2].set(title="contrast by size", xlabel="sides, share of the target's")


def explain_texture(panels: list[Axes], cue: Cue, case: Case) -> None:
    """The target, its codes, how often each occurs in each cell."""
    crop(panels[0], case, "the target")
    codes = planes_of(cue, case.first)[cue.needs[0]]
    panels[1].imshow(np.where(codes == 8, np.nan, codes * 45.0), cmap="hsv", vmin=0, vmax=360)
    panels[1].set(xticks=[], yticks=[], title="direction of the gradient")
    close(panels[1], case.box)
    shares = learnt(cue, case)["shares"]
    rows = shares.reshape(-1, shares.shape[-1])
    panels[2].imshow(rows, cmap=SURFACE, vmin=0, vmax=rows.max(), aspect="auto")
    panels[2].set(title="share by cell", xlabel="direction, 8: flat", ylabel="cell")


def explain_embedding(panels: list[Axes], cue: Cue, case: Case) -> None:
    """The target, what the network gets, the same of a box a quarter off."""
    from bayesnet_track.vision.embedding import crops_at

    crop(panels[0], case, "the target")
    off = case.box + [case.box[2] / 4, 0, 0, 0]
    for axes, box, title in ((panels[1], case.box, "its crop"), (panels[2], off, "a quarter of a side off")):
        show(axes, crops_at(case.first, box[None], 16, 16)[0], title, with_ticks=False)


PAGES: Mapping[str, tuple[Callable[[], list[Case]], Callable[[list[Axes], Cue, Case], None]]] = {
    "foreground_color": (foreground_cases, explain_foreground),
    "texture": (intensity_cases, explain_texture),
    "embedding": (intensity_cases, explain_embedding),
}


def main() -> None:
    """Draw the pages asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cues", nargs="*", choices=[[], *PAGES], default=[])
    options = parser.parse_args()
    cv2.setNumThreads(1)
    for name in options.cues or PAGES:
        cases, explain = PAGES[name]
        save(page(made(name), cases(), explain), FOLDER / f"cue_{name}.png")


if __name__ == "__main__":
    main()
