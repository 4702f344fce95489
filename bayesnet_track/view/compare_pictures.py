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
ROOM = 4.0
"""How much larger than the two boxes a part of the frame is; larger boxes show the whole frame."""
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
    """At most four frames of the pair that is farthest apart, in order; none where no estimate differs."""
    lines = {pair: line for pair, line in compared.distances.items() if any(one.px > 0 for one in line)}
    if not lines:
        return ()
    pair, line = max(lines.items(), key=lambda item: max(one.px for one in item[1]))
    far = max(line, key=lambda one: one.px)
    found = {far.frame: f"they are farthest apart, {far.px:.3g} px"}
    for level, what in LEVELS.items():
        first = next((one.frame for one in line if one.iou < level), far.frame)
        found.setdefault(first, what)
    decided = next((moment.frame for moment in compared.moments if moment.pair == pair), None)
    if decided is not None and any(one.frame == decided for one in line):
        also = f"; {found[decided]}" if decided in found else ""
        found[decided] = f"their decisions first diverge{also}"
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
    sides = [(letter, line) for letter, line in (("a", first), ("b", second)) if line is not None]
    left, top, columns, rows = _window(image, [line for _, line in sides])
    part = image[top : top + rows, left : left + columns]
    drawn = [
        element("image", href=_data(part), x=left, y=top, width=columns, height=rows),
        *(_box(line, letter, columns) for letter, line in sides),
    ]
    closer = "" if columns == image.shape[1] else f" (a part of the frame, {columns} × {rows} px)"
    said = f"Frame {one.frame}, {whose_text(one.pair)}: {one.what}{closer}"
    view = f"{left} {top} {columns} {rows}"
    svg = element("svg", "".join(drawn), viewBox=view, role="img", aria_label=said, class_="picture")
    return f"<figure>{svg}<figcaption>{text_of(said)}</figcaption></figure>"


def _window(image: NDArray[np.uint8], lines: Sequence[FrameMetrics]) -> tuple[int, int, int, int]:
    """Left, top, width and height (px) of what is shown: all of it, or the part around two small boxes."""
    rows, columns = image.shape[:2]
    boxes = np.array([line.centre_box for line in lines]).reshape(-1, 4)
    low, high = (boxes[:, :2] - boxes[:, 2:] / 2).min(0), (boxes[:, :2] + boxes[:, 2:] / 2).max(0)
    share = float(((high - low) / (columns, rows)).max()) * ROOM
    if not 0 < share < 0.5:
        return 0, 0, columns, rows
    w, h = round(share * columns), round(share * rows)
    x, y = (low + high) / 2 - (w / 2, h / 2)
    return round(min(max(x, 0), columns - w)), round(min(max(y, 0), rows - h)), w, h


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
