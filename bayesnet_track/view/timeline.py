"""A run at a glance, as SVG: UD over frames with its thresholds, and below it which agents were active."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.load import Shed
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import Switch, turns_on
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.view.page_data import History, histories
from bayesnet_track.view.svg import decades, document, element, thin, ticks, xml_text

WIDTH, LEFT, RIGHT, TOP = 960.0, 148.0, 128.0, 58.0
PLOT_HEIGHT, BAR, BAR_GAP, FOOT = 230.0, 15.0, 8.0, 46.0
FONT = "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif"
INK, SOFT, GRID = "#1f2933", "#66727f", "#e4e7eb"
UD_LINE, UP, DOWN, QUIET, LOST = "#2457a7", "#c43d2f", "#1e8a53", "#8a5fbf", "#f1b4ab"
BAR_COLOURS = ("#2f7ab8", "#d9822b", "#3a9d74", "#9a6cc4", "#c2548b", "#7c8a2e", "#4aa3a8", "#a0654a")


@dataclass(frozen=True)
class Axes:
    """From frames and px^2 to the picture: frames linear, UD logarithmic."""

    first: int
    last: int
    low: float
    high: float

    def x(self, frame: float) -> float:
        """Column of a frame, px."""
        return LEFT + (frame - self.first) / max(self.last - self.first, 1) * (WIDTH - LEFT - RIGHT)

    def y(self, ud_px2: float) -> float:
        """Row of a UD, px; what lies beyond the scale is drawn at its end."""
        clamped = min(max(ud_px2, self.low), self.high)
        share = math.log(clamped / self.low) / math.log(self.high / self.low)
        return TOP + PLOT_HEIGHT * (1.0 - share)


def draw_timeline(events: Iterable[Event], metrics: Sequence[FrameMetrics], target: str | None = None) -> str:
    """The picture of one target's run (the first target when None) as an SVG file.

    Shows UD at the root, each threshold that a decision of the journal names, the measured baseline, the
    frames in which the target counted as lost (shaded), a bar for every agent while it was active, and the
    frame number at each switch. Hovering over a mark shows the decision's sentence.

    Raises:
        ValueError: `metrics` has no line of the target.
    """
    target = target if target is not None else next((line.target for line in metrics), "")
    lines = histories(metrics, [target])[target]
    if not len(lines):
        raise ValueError(f"no metrics of target {target!r}")
    mine = [event for event in events if getattr(event, "target", None) == target]
    switches = [event for event in mine if isinstance(event, Switch)]
    agents = _agents(mine, lines)
    axes = _axes(lines, mine)
    bars_top = TOP + PLOT_HEIGHT + 44.0
    bottom = bars_top + len(agents) * (BAR + BAR_GAP)
    body = [
        *_grid(axes, bottom),
        *_lost(lines, axes),
        *_levels(lines, mine, axes),
        *_curves(lines, axes),
        *_bars(lines, agents, axes, bars_top),
        *_marks(switches, agents, lines, axes, bars_top),
        _text(f"Uncertainty (UD) and active agents, target {target}", LEFT, 26.0, 15.0, INK, weight=600),
        _text("UD, px²", LEFT, TOP - 10.0, 11.5, SOFT),
        _text("frame", WIDTH - RIGHT, bottom + 32.0, 11.5, SOFT, anchor="end"),
    ]
    caption = f"{len(lines)} frames, {len(switches)} switches of {len(agents)} agents"
    return document(WIDTH, bottom + FOOT, f"Timeline of target {target}", caption, body)


# ------------------------------------------------------------------------------------ what there is


def _agents(events: Sequence[Event], lines: History) -> list[str]:
    initial = [name for event in events if isinstance(event, TargetStarted) for name in event.active]
    switched = [event.node for event in events if isinstance(event, Switch)]
    return list(dict.fromkeys([*initial, *switched, *lines.agents]))


def _thresholds(events: Sequence[Event]) -> list[tuple[str, str, list[tuple[int, float]]]]:
    """Rule, colour, and its level in px^2 at each frame it fired."""
    thresholds: dict[tuple[str, str], list[tuple[int, float]]] = {}
    for event in events:
        cause = getattr(event, "cause", None)
        if not isinstance(cause, Cause) or cause.unit == "score":
            continue
        rule = {Activated: ("activate", UP), Deactivated: ("deactivate", DOWN), StatusChanged: ("lost", SOFT)}
        key = rule.get(type(event))
        if key is not None:
            thresholds.setdefault(key, []).append((getattr(event, "frame", 0), cause.level * cause.scale_px2))
    return [(name, colour, levels) for (name, colour), levels in thresholds.items()]


def _axes(lines: History, events: Sequence[Event]) -> Axes:
    values = lines.ud_px2.tolist() + [level for _, _, levels in _thresholds(events) for _, level in levels]
    positive = sorted(value for value in values if 1e-6 < value < 1e15) or [1.0]
    # The first frames start from certainty: a few of them must not stretch the scale.
    low = positive[min(len(positive) // 50 + 1, len(positive) - 1)] / 1.6
    high = max(positive[-1] * 1.25, low * 10)
    return Axes(int(lines.frame[0]), int(lines.frame[-1]), low, high)


# ------------------------------------------------------------------------------------ what is drawn


def _lost(lines: History, axes: Axes) -> list[str]:
    elements = []
    for first, end in lines.stretches(lines.is_lost):
        left, right = _edges(first, end, axes)
        tip = element("title", xml_text(f"lost in frames {first} to {end}"))
        look = {"fill": LOST, "fill_opacity": 0.4}
        elements.append(element("rect", tip, x=left, y=TOP, width=right - left, height=PLOT_HEIGHT, **look))
        if right - left > 30:
            elements.append(
                _text(
                    "lost", (left + right) / 2, TOP + PLOT_HEIGHT - 6.0, 10.5, UP, anchor="middle", halo=True
                )
            )
    return elements


def _grid(axes: Axes, bottom: float) -> list[str]:
    elements = []
    for value in decades(axes.low, axes.high, 9):
        y = axes.y(value)
        elements.append(element("line", x1=LEFT, y1=y, x2=WIDTH - RIGHT, y2=y, stroke=GRID))
        elements.append(_text(f"{value:g}", LEFT - 8.0, y + 4.0, 10.5, SOFT, anchor="end"))
    for frame in ticks(axes.first, axes.last):
        x = axes.x(frame)
        elements.append(element("line", x1=x, y1=TOP, x2=x, y2=bottom, stroke=GRID))
        elements.append(_text(str(frame), x, bottom + 15.0, 10.5, SOFT, anchor="middle"))
    return elements


def _levels(lines: History, events: Sequence[Event], axes: Axes) -> list[str]:
    """Dashed lines of the thresholds, held from one firing to the next; their names stand at the right."""
    elements, names = [], []
    for name, colour, levels in _thresholds(events):
        starts = [axes.first, *(frame for frame, _ in levels[1:])]
        ends = [*(frame for frame, _ in levels[1:]), axes.last]
        points = [
            point
            for (_, level), start, end in zip(levels, starts, ends, strict=True)
            for point in ((axes.x(start), axes.y(level)), (axes.x(end), axes.y(level)))
        ]
        elements.append(_polyline(points, colour, 1.3, dash="6 4"))
        names.append((axes.y(levels[-1][1]), f"{name} {_number(levels[-1][1])}", colour))
    has_baseline = lines.quiet_px2 > 0
    if has_baseline.any():
        quiet = lines.quiet_px2[has_baseline].tolist()
        points = _points(lines.frame[has_baseline].tolist(), quiet, axes)
        elements.append(_polyline(points, QUIET, 1.3, dash="2 3"))
        names.append((points[-1][1], f"quiet {_number(quiet[-1])}", QUIET))
    current_ud = float(lines.ud_px2[-1])
    names.append((axes.y(current_ud), f"UD {_number(current_ud)}", UD_LINE))
    row = -math.inf
    for y, name, colour in sorted(names):
        row = max(y + 4.0, row + 13.0)
        elements.append(_text(name, WIDTH - RIGHT + 8.0, row, 10.5, colour, weight=600))
    return elements


def _curves(lines: History, axes: Axes) -> list[str]:
    curves = []
    for first, end in lines.stretches(np.isfinite(lines.ud_px2)):
        rows = slice(*np.searchsorted(lines.frame, [first, end + 1]))
        points = _points(lines.frame[rows].tolist(), lines.ud_px2[rows].tolist(), axes)
        curves.append(_polyline(points, UD_LINE, 1.8))
    return curves


def _points(frames: Sequence[int], values: Sequence[float], axes: Axes) -> list[tuple[float, float]]:
    """Points of a curve; of a long one the lowest and the highest of each column of the picture."""
    points = [(axes.x(frame), axes.y(value)) for frame, value in zip(frames, values, strict=True)]
    return thin(points)


def _bars(lines: History, agents: Sequence[str], axes: Axes, top: float) -> list[str]:
    elements = []
    for number, agent in enumerate(agents):
        y, colour = top + number * (BAR + BAR_GAP), BAR_COLOURS[number % len(BAR_COLOURS)]
        ground = element("rect", x=LEFT, y=y, width=WIDTH - LEFT - RIGHT, height=BAR, rx=3.0, fill="#f2f4f7")
        is_active = lines.is_active(agent)
        runs, share = lines.stretches(is_active), float(is_active.mean())
        elements += [
            ground,
            _text(_cut(agent), LEFT - 8.0, y + BAR - 4.0, 11.0, INK, anchor="end", tip=agent),
        ]
        for first, end in runs:
            left, right = _edges(first, end, axes)
            tip = element("title", xml_text(f"{agent}: frames {first} to {end}"))
            elements.append(
                element("rect", tip, x=left, y=y, width=right - left, height=BAR, rx=3.0, fill=colour)
            )
        elements.append(_text(f"{share:.0%} of frames", WIDTH - RIGHT + 8.0, y + BAR - 4.0, 10.5, SOFT))
    return elements


def _marks(
    switches: Sequence[Switch], agents: Sequence[str], lines: History, axes: Axes, top: float
) -> list[str]:
    """A triangle on the curve (up: on, down: off), a stem to the agent's bar, and the frame number."""
    is_usable = np.isfinite(lines.ud_px2)
    ud = dict(zip(lines.frame[is_usable].tolist(), lines.ud_px2[is_usable].tolist(), strict=True))
    elements, free = [], -math.inf
    for event in sorted(switches, key=lambda event: event.frame):
        x, y = axes.x(event.frame), axes.y(ud.get(event.frame, axes.low))
        colour, tip = (
            (UP, -6.0) if turns_on(event) else (DOWN if isinstance(event, Deactivated | Shed) else INK, 6.0)
        )
        bar = top + agents.index(event.node) * (BAR + BAR_GAP)
        stem = element(
            "line", x1=x, y1=y, x2=x, y2=bar + BAR / 2, stroke=colour, stroke_width=0.9, opacity=0.55
        )
        sign = element(
            "path",
            d=f"M {x - 5:.2f} {y:.2f} L {x + 5:.2f} {y:.2f} L {x:.2f} {y + 1.6 * tip:.2f} Z",
            fill=colour,
        )
        parts = [element("title", xml_text(explain(event))), stem, sign]
        if x >= free:
            parts.append(
                _text(str(event.frame), x, top - 12.0, 10.5, colour, anchor="middle", weight=600, halo=True)
            )
            free = x + 26.0
        elements.append(element("g", "".join(parts)))
    return elements


# ------------------------------------------------------------------------------------ small things


def _edges(first: int, end: int, axes: Axes) -> tuple[float, float]:
    """A frame is drawn half a frame to either side, inside the plot."""
    return max(axes.x(first - 0.5), LEFT), min(axes.x(end + 0.5), WIDTH - RIGHT)


def _polyline(
    points: Sequence[tuple[float, float]], colour: str, width: float, dash: str | None = None
) -> str:
    path = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
    return element(
        "polyline",
        points=path,
        fill="none",
        stroke=colour,
        stroke_width=width,
        stroke_linejoin="round",
        stroke_linecap="round" if dash is None else None,
        stroke_dasharray=dash,
    )


def _text(
    text: str,
    x: float,
    y: float,
    size: float,
    colour: str,
    anchor: str = "start",
    weight: int = 400,
    tip: str | None = None,
    halo: bool = False,
) -> str:
    content = xml_text(text) + ("" if tip is None else element("title", xml_text(tip)))
    return element(
        "text",
        content,
        x=x,
        y=y,
        font_family=FONT,
        font_size=size,
        font_weight=weight,
        text_anchor=anchor,
        fill=colour,
        stroke="#ffffff" if halo else None,
        stroke_width=3.0 if halo else None,
        paint_order="stroke" if halo else None,
    )


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 or not math.isfinite(value) else f"{value:.0f}"


def _cut(name: str, longest: int = 20) -> str:
    return name if len(name) <= longest else name[: longest - 1] + "…"
