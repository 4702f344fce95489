"""Charts and pictures of a comparison: UD, distance of the estimates, active agents, and diverging frames.

Colours are classes of the page's style, so that it can be light or dark.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.compare import Comparison, Moment, RunRecord
from bayesnet_track.journal.compare_measures import Distances
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import Switch
from bayesnet_track.journal.reader import lines_of_frame
from bayesnet_track.journal.text.compare_text import whose_text
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.view.page_data import History
from bayesnet_track.view.svg import Points, decades, element, thin, ticks, xml_text

WIDTH, LEFT, RIGHT = 960.0, 120.0, 16.0
UD_TOP, UD_HEIGHT, APART_HEIGHT, ROW, GAP, FOOT = 44.0, 200.0, 90.0, 11.0, 40.0, 30.0
MOST_MOMENTS = 2000
"""Largest number of partings on the page; the text lists all of them with --all."""


def draw_pair(
    first: RunRecord,
    second: RunRecord,
    compared: Comparison,
    pair: tuple[str, str],
    sides: Sequence[History],
) -> str:
    """The chart of one target, given as its ids and its histories in both runs, for a page.

    Raises:
        ValueError: neither run has a line of it.
    """
    frames = [int(frame) for side in sides for frame in side.frame[[0, -1]] if len(side)]
    if not frames:
        raise ValueError(f"neither run has measurements of target {pair[0]}")
    x = _Scale(min(frames), max(max(frames), min(frames) + 1), LEFT, WIDTH - RIGHT)
    agents = _agents((first, second), pair, sides)
    apart_top = UD_TOP + UD_HEIGHT + GAP
    bars_top = apart_top + APART_HEIGHT + GAP
    bottom = bars_top + len(agents) * (2 * ROW + 10.0)
    body = [
        *_grid(x, bottom),
        *_ud(sides, x),
        *_distances(compared.distances.get(pair), x, apart_top),
        *_bars(sides, agents, x, bars_top),
        *_marks(compared.moments, pair, x, bottom),
    ]
    height = bottom + FOOT
    caption = f"UD, distance of the estimates and active agents of target {pair[0]} in both runs"
    return (
        f'<svg class="chart" role="group" viewBox="0 0 {WIDTH:g} {height:g}">'
        + element("title", xml_text(caption))
        + "".join(body)
        + "</svg>"
    )


class _Scale:
    """Linear from values to px."""

    def __init__(self, low: float, high: float, start: float, end: float) -> None:
        self.low, self.high, self.start, self.end = low, high, start, end

    def __call__(self, value: float) -> float:
        clamped = min(max(value, self.low), self.high)
        return self.start + (clamped - self.low) / (self.high - self.low) * (self.end - self.start)


def _agents(runs: Iterable[RunRecord], pair: tuple[str, str], sides: Sequence[History]) -> list[str]:
    agents: dict[str, None] = {}
    for run, target in zip(runs, pair, strict=True):
        for event in run.events:
            if isinstance(event, TargetStarted) and event.target == target:
                agents |= dict.fromkeys(event.active)
            if isinstance(event, Switch):
                agents |= {event.node: None} if event.target == target else {}
    return list(agents | dict.fromkeys(name for side in sides for name in side.agents))


# ------------------------------------------------------------------------------------ what is drawn


def _grid(x: _Scale, bottom: float) -> list[str]:
    elements = []
    for frame in ticks(int(x.low), int(x.high)):
        elements.append(_line(x(frame), UD_TOP, x(frame), bottom, "grid"))
        elements.append(_text(str(frame), x(frame), bottom + 15.0, "soft", "middle"))
    return [*elements, _text("frame", LEFT - 8.0, bottom + 15.0, "soft", "end")]


def _ud(sides: Sequence[History], x: _Scale) -> list[str]:
    uds = np.concatenate([side.ud_px2 for side in sides])
    values = np.sort(uds[(uds > 1e-6) & (uds < 1e15)]).tolist() or [1.0]
    # The first frames start from certainty: a few of them must not stretch the scale.
    low = values[min(len(values) // 50 + 1, len(values) - 1)] / 1.6
    high = max(values[-1] * 1.2, low * 10)
    y = _Scale(math.log10(low), math.log10(high), UD_TOP + UD_HEIGHT, UD_TOP)
    elements = [_text("UD, px²", LEFT - 8.0, UD_TOP - 10.0, "soft", "end")]
    for value in decades(low, high):
        row = y(math.log10(value))
        elements += [
            _line(LEFT, row, WIDTH - RIGHT, row, "grid"),
            _text(f"{value:g}", LEFT - 8.0, row + 4.0, "soft", "end"),
        ]
    for side, name in zip(sides, "ab", strict=True):
        top = UD_TOP if name == "a" else UD_TOP + UD_HEIGHT - 8.0
        for start, end in side.stretches(side.is_lost):
            tip = element("title", xml_text(f"{name.upper()} lost in frames {start} to {end}"))
            left, right = x(start - 0.5), x(end + 0.5)
            elements.append(
                element("rect", tip, x=left, y=top, width=right - left, height=8.0, class_=f"lost {name}")
            )
    for side, name in zip(sides, "ab", strict=True):
        is_usable = np.isfinite(side.ud_px2) & (side.ud_px2 > 0)
        for start, end in side.stretches(is_usable):
            rows = slice(*np.searchsorted(side.frame, [start, end + 1]))
            points = [
                (x(frame), y(math.log10(ud)))
                for frame, ud in zip(side.frame[rows].tolist(), side.ud_px2[rows].tolist(), strict=True)
            ]
            elements.append(_curve(points, f"curve {name}"))
    return elements


def _distances(distances: Distances | None, x: _Scale, top: float) -> list[str]:
    head = _text("estimates apart, px", LEFT, top - 10.0, "soft")
    values = [] if distances is None else [*zip(distances.frame.tolist(), distances.px.tolist(), strict=True)]
    high = max((px for _, px in values), default=0.0)
    y = _Scale(0.0, high if high > 0 else 1.0, top + APART_HEIGHT, top)
    elements = [head, _line(LEFT, y(0.0), WIDTH - RIGHT, y(0.0), "grid")]
    elements.append(_text("0", LEFT - 8.0, y(0.0) + 4.0, "soft", "end"))
    if high == 0.0:
        return [*elements, _text("never", LEFT + 8.0, top + APART_HEIGHT / 2, "soft")]
    elements.append(_text(f"{high:.3g}", LEFT - 8.0, y(high) + 4.0, "soft", "end"))
    points = thin([(x(frame), y(px)) for frame, px in values])
    outline = [(points[0][0], y(0.0)), *points, (points[-1][0], y(0.0))]
    return [*elements, element("polygon", points=_path(outline), class_="apart")]


def _bars(sides: Sequence[History], agents: Sequence[str], x: _Scale, top: float) -> list[str]:
    elements = [_text("active agents, A above B", LEFT, top - 10.0, "soft")]
    for number, agent in enumerate(agents):
        row = top + number * (2 * ROW + 10.0)
        name = xml_text(agent if len(agent) <= 15 else f"{agent[:14]}…") + element("title", xml_text(agent))
        elements.append(
            element("text", name, x=LEFT - 8.0, y=row + ROW + 4.0, class_="ink", text_anchor="end")
        )
        for side, letter in zip(sides, "ab", strict=True):
            y = row + (ROW if letter == "b" else 0.0)
            elements.append(
                element("rect", x=LEFT, y=y, width=WIDTH - LEFT - RIGHT, height=ROW - 1.0, class_="ground")
            )
            for start, end in side.stretches(side.is_active(agent)):
                left, right = x(start - 0.5), x(end + 0.5)
                tip = element("title", xml_text(f"{letter.upper()}: {agent} in frames {start} to {end}"))
                elements.append(
                    element(
                        "rect", tip, x=left, y=y, width=right - left, height=ROW - 1.0, class_=f"bar {letter}"
                    )
                )
    return elements


def _marks(moments: Sequence[Moment], pair: tuple[str, str], x: _Scale, bottom: float) -> list[str]:
    """A line at each parting, dashed but for the first of all; it leads to the moment's row in the page."""
    elements, free = [], -math.inf
    for number, moment in enumerate(moments[:MOST_MOMENTS]):
        if moment.pair != pair:
            continue
        x_px = x(moment.frame)
        caption = [
            f"{name} {explain(event)}"
            for name, side in (("A", moment.first), ("B", moment.second))
            for event in side
        ]
        parts = [element("title", xml_text("\n".join(caption)))]
        parts.append(_line(x_px, UD_TOP - 28.0, x_px, bottom, "hit"))
        parts.append(_line(x_px, UD_TOP - 12.0, x_px, bottom, "parting first" if number == 0 else "parting"))
        if x_px >= free:
            parts.append(_text(str(moment.frame), x_px, UD_TOP - 18.0, "mark", "middle"))
            free = x_px + 34.0
        elements.append(element("a", "".join(parts), href=f"#moment-{number}"))
    return elements


# ------------------------------------------------------------------------------------ small things


def _curve(points: Points, look: str) -> str:
    return element("polyline", points=_path(thin(points)), class_=look)


def _path(points: Points) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _line(x1: float, y1: float, x2: float, y2: float, look: str) -> str:
    return element("line", x1=x1, y1=y1, x2=x2, y2=y2, class_=look)


def _text(text: str, x: float, y: float, look: str, anchor: str = "start") -> str:
    return element("text", xml_text(text), x=x, y=y, class_=look, text_anchor=anchor)


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
    differing = {pair: line for pair, line in compared.distances.items() if (line.px > 0).any()}
    if not differing:
        return ()
    pair, line = max(differing.items(), key=lambda item: float(item[1].px.max()))
    frames, farthest = line.frame.tolist(), line.farthest
    reasons = {frames[farthest]: f"they are farthest apart, {line.px[farthest]:.3g} px"}
    for level, reason in LEVELS.items():
        rows = np.flatnonzero(line.iou < level)
        reasons.setdefault(frames[rows[0] if len(rows) else farthest], reason)
    decided = next((moment.frame for moment in compared.moments if moment.pair == pair), None)
    if decided is not None and (line.frame == decided).any():
        also = f"; {reasons[decided]}" if decided in reasons else ""
        reasons[decided] = f"their decisions first diverge{also}"
    return tuple(TellingFrame(frame, pair, reasons[frame]) for frame in sorted(reasons))


def draw_pictures(
    images: Iterable[tuple[int, NDArray[np.uint8]]],
    telling: Sequence[TellingFrame],
    first: RunRecord,
    second: RunRecord,
) -> Iterator[str]:
    """HTML figures: the image of each frame, the first run's box solid and the second one's dashed."""
    pending = {frame_reason.frame: frame_reason for frame_reason in telling}
    boxes = [_lines_of(run, telling, side) for side, run in enumerate((first, second))]
    for frame, image in images:
        telling_frame = pending.pop(frame, None)
        if telling_frame is not None:
            yield _figure(image, telling_frame, boxes[0].get(frame), boxes[1].get(frame))
        if not pending:
            return


def _lines_of(run: RunRecord, telling: Sequence[TellingFrame], side: int) -> Mapping[int, FrameMetrics]:
    ids = {frame_reason.frame: frame_reason.pair[side] for frame_reason in telling}
    lines = chain.from_iterable(lines_of_frame(run.metrics, frame) for frame in ids)
    return {line.frame: line for line in lines if ids[line.frame] == line.target}


def _figure(
    image: NDArray[np.uint8],
    telling_frame: TellingFrame,
    first: FrameMetrics | None,
    second: FrameMetrics | None,
) -> str:
    sides = [(letter, line) for letter, line in (("a", first), ("b", second)) if line is not None]
    left, top, columns, rows = _window(image, [line for _, line in sides])
    part = image[top : top + rows, left : left + columns]
    elements = [
        element("image", href=_data(part), x=left, y=top, width=columns, height=rows),
        *(_box(line, letter, columns) for letter, line in sides),
    ]
    closer = "" if columns == image.shape[1] else f" (a part of the frame, {columns} × {rows} px)"
    caption = f"Frame {telling_frame.frame}, {whose_text(telling_frame.pair)}: {telling_frame.what}{closer}"
    view = f"{left} {top} {columns} {rows}"
    svg = element("svg", "".join(elements), viewBox=view, role="img", aria_label=caption, class_="picture")
    return f"<figure>{svg}<figcaption>{xml_text(caption)}</figcaption></figure>"


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
    label_y = place["y"] - 2 * stroke if letter == "a" else place["y"] + h + 2 * stroke + 0.8 * size
    return (
        element("rect", **place, class_="halo", stroke_width=2.2 * stroke)
        + element("rect", **place, class_=f"box {letter}", stroke_width=stroke)
        + element("text", letter.upper(), x=place["x"], y=label_y, font_size=size)
    )


def _data(image: NDArray[np.uint8]) -> str:
    import cv2

    rows, columns = image.shape[:2]
    if columns > WIDEST:
        size = (WIDEST, max(1, round(rows * WIDEST / columns)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
