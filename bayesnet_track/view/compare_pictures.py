"""Pictures of a comparison: the frames in which two runs diverge, with the boxes of both."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.compare import Comparison, RunRecord
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.text.compare_text import whose_text
from bayesnet_track.view.svg import element, text_of

WIDEST = 640
"""Pixels; wider images are scaled down."""
QUALITY = 70
LEVELS = {0.9: "they begin to diverge", 0.5: "they overlap by less than a half"}
"""Overlap (IoU) of the two boxes -> what the first frame below it shows."""


@dataclass(frozen=True)
class TellingFrame:
    """A frame that shows how two runs differ.

    Attributes:
        frame: its index.
        pair: target ids, of the first run and of the second.
        what: what it shows, in words.
    """

    frame: int
    pair: tuple[str, str]
    what: str


def telling_frames(compared: Comparison) -> tuple[TellingFrame, ...]:
    """At most three frames of the pair that is farthest apart, in order; none where no estimate differs."""
    lines = {pair: line for pair, line in compared.distances.items() if any(one.px > 0 for one in line)}
    if not lines:
        return ()
    pair, line = max(lines.items(), key=lambda item: max(one.px for one in item[1]))
    far = max(line, key=lambda one: one.px)
    found = {far.frame: f"they are farthest apart, {far.px:.3g} px"}
    for level, what in LEVELS.items():
        first = next((one.frame for one in line if one.iou < level), far.frame)
        found.setdefault(first, what)
    return tuple(TellingFrame(frame, pair, found[frame]) for frame in sorted(found))


def draw_pictures(
    images: Iterable[tuple[int, NDArray[np.uint8]]],
    telling: Sequence[TellingFrame],
    first: RunRecord,
    second: RunRecord,
) -> Iterator[str]:
    """HTML figures: the image of each frame, the first run's box solid and the second one's dashed."""
    wanted = {one.frame: one for one in telling}
    boxes = [_lines_of(run, telling, side) for side, run in enumerate((first, second))]
    for frame, image in images:
        one = wanted.pop(frame, None)
        if one is not None:
            yield _figure(image, one, boxes[0].get(frame), boxes[1].get(frame))
        if not wanted:
            return


def _lines_of(run: RunRecord, telling: Sequence[TellingFrame], side: int) -> Mapping[int, FrameMetrics]:
    ids = {one.frame: one.pair[side] for one in telling}
    return {line.frame: line for line in run.metrics if ids.get(line.frame) == line.target}


def _figure(
    image: NDArray[np.uint8], one: TellingFrame, first: FrameMetrics | None, second: FrameMetrics | None
) -> str:
    rows, columns = image.shape[:2]
    drawn = [
        element("image", href=_data(image), width=columns, height=rows),
        *(_box(line, letter, columns) for letter, line in (("a", first), ("b", second)) if line is not None),
    ]
    said = f"Frame {one.frame}, {whose_text(one.pair)}: {one.what}"
    svg = element(
        "svg", "".join(drawn), viewBox=f"0 0 {columns} {rows}", role="img", aria_label=said, class_="picture"
    )
    return f"<figure>{svg}<figcaption>{text_of(said)}</figcaption></figure>"


def _box(line: FrameMetrics, letter: str, columns: int) -> str:
    x, y, w, h = line.centre_box
    # The centre of a pixel has whole coordinates; those of a drawing are its corners.
    place = {"x": x + 0.5 - w / 2, "y": y + 0.5 - h / 2, "width": w, "height": h}
    stroke, size = max(1.0, columns / 240), columns / 24
    # The names of two boxes in one place do not cover each other.
    above = place["y"] - 2 * stroke if letter == "a" else place["y"] + h + 2 * stroke + 0.8 * size
    return (
        element("rect", **place, class_="halo", stroke_width=2.2 * stroke)
        + element("rect", **place, class_=f"box {letter}", stroke_width=stroke)
        + element("text", letter.upper(), x=place["x"], y=above, font_size=size)
    )


def _data(image: NDArray[np.uint8]) -> str:
    import cv2

    rows, columns = image.shape[:2]
    if columns > WIDEST:
        size = (WIDEST, max(1, round(rows * WIDEST / columns)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
