"""Draw a net: one layout, painted as SVG or as pixels."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.view.graph_layout import (
    ADVANCE,
    MARGIN,
    NAME_SIZE,
    NOTE_SIZE,
    EdgeShape,
    Fork,
    GraphLayout,
    NodeShape,
    lay_out,
)
from bayesnet_track.view.svg import document, element, xml_text

FONT = "ui-monospace, SFMono-Regular, Menlo, Consolas, 'DejaVu Sans Mono', monospace"
INK, SOFT, PALE = "#1f2933", "#7b8794", "#cbd2d9"
INFERENCE_FILL, INFERENCE_LINE = "#e7effc", "#3866b5"
AGENT_FILL, AGENT_LINE = "#d9f2e3", "#1e8a53"
LEGEND = (("belief", False, True), ("active agent", True, True), ("inactive agent", True, False))


def graph_svg(target: CheckedTarget, active: Set[str]) -> str:
    """The net as an SVG file: inference nodes as ellipses, agents as boxes, inactive ones dashed and gray."""
    layout = lay_out(with_factors(target), active)
    body = [*map(_svg_edge, layout.edges), *map(_svg_fork, layout.forks), *map(_svg_node, layout.nodes)]
    body += [_svg_node(node) for node in _legend(layout)]
    active_agents = [agent for agent in target.agents if agent in active]
    description = (
        f"{target.root} above {', '.join(target.agents)}; active: {', '.join(active_agents) or 'none'}"
    )
    return document(layout.width, layout.height, f"Bayes net of {target.name}", description, body)


def graph_image(target: CheckedTarget, active: Set[str], scale: float = 2.0) -> Image:
    """The same picture as pixels: (rows, columns, 3) uint8 BGR, `scale` pixels per unit of the layout."""
    layout = lay_out(with_factors(target), active)
    painter = _Pixels(layout, scale)
    for edge in layout.edges:
        painter.edge(edge)
    for fork in layout.forks:
        painter.fork(fork)
    for node in (*layout.nodes, *_legend(layout)):
        painter.node(node)
    return painter.image


def _legend(layout: GraphLayout) -> list[NodeShape]:
    """Three small samples at the foot of the picture."""
    shapes, left = [], MARGIN
    for text, is_agent, active in LEGEND:
        width = ADVANCE * NOTE_SIZE * len(text) + 30.0
        shapes.append(
            NodeShape("", text, is_agent, active, left + width / 2, layout.height - MARGIN - 4.0, width, 28.0)
        )
        left += width + 16.0
    return shapes


def _colours(node: NodeShape) -> tuple[str, str, str]:
    """Fill, line and text colour."""
    if not node.active:
        return "#ffffff", PALE if not node.is_agent else SOFT, SOFT
    if node.is_factor:
        return "#ffffff", INK, INK
    return (AGENT_FILL, AGENT_LINE, INK) if node.is_agent else (INFERENCE_FILL, INFERENCE_LINE, INK)


def _lines(node: NodeShape) -> list[tuple[str, float, float, bool]]:
    """Lines of text in a node: text, size, middle of its line, whether it is the name."""
    if not node.name:
        return [(node.note, NOTE_SIZE, node.y, False)]
    if not node.note:
        return [(node.name, NAME_SIZE, node.y, True)]
    return [(node.name, NAME_SIZE, node.y - 8.0, True), (node.note, NOTE_SIZE, node.y + 11.0, False)]


# ------------------------------------------------------------------------------------ SVG


def _svg_node(node: NodeShape) -> str:
    fill, line, ink = _colours(node)
    look = {
        "fill": fill,
        "stroke": line,
        "stroke_width": 1.8,
        "stroke_dasharray": None if node.active else "5 4",
    }
    if node.is_agent or node.is_factor:
        left, top, radius = node.x - node.w / 2, node.y - node.h / 2, 10.0 if node.is_agent else 0.0
        shape = element("rect", x=left, y=top, width=node.w, height=node.h, rx=radius, **look)
    else:
        shape = element("ellipse", cx=node.x, cy=node.y, rx=node.w / 2, ry=node.h / 2, **look)
    texts = [
        _svg_text(
            text, node.x, y, size, ink if is_name else SOFT if node.name else INK, 600 if is_name else 400
        )
        for text, size, y, is_name in _lines(node)
    ]
    return element("g", shape + "".join(texts))


def _svg_text(text: str, x: float, y: float, size: float, fill: str, weight: int) -> str:
    return element(
        "text",
        xml_text(text),
        x=x,
        y=y + 0.35 * size,
        font_family=FONT,
        font_size=size,
        font_weight=weight,
        text_anchor="middle",
        fill=fill,
    )


def _svg_edge(edge: EdgeShape) -> str:
    (ax, ay), (bx, bend_y) = edge.bend()
    path = (
        f"M {edge.start[0]:.2f} {edge.start[1]:.2f} "
        f"C {ax:.2f} {ay:.2f}, {bx:.2f} {bend_y:.2f}, {edge.end[0]:.2f} {edge.end[1]:.2f}"
    )
    line = element(
        "path",
        d=path,
        fill="none",
        stroke=SOFT if edge.active else PALE,
        stroke_width=1.8,
        stroke_dasharray=None if edge.active else "5 4",
    )
    if not edge.label:
        return line
    x, y = edge.at(0.62)
    w = ADVANCE * NOTE_SIZE * len(edge.label) + 8.0
    plate = element("rect", x=x - w / 2, y=y - 8.0, width=w, height=16.0, rx=4.0, fill="#ffffff")
    return line + plate + _svg_text(edge.label, x, y, NOTE_SIZE, INK, 400)


def _svg_fork(fork: Fork) -> str:
    plate = element(
        "rect",
        x=fork.x - fork.w / 2,
        y=fork.y - fork.h / 2,
        width=fork.w,
        height=fork.h,
        rx=fork.h / 2,
        fill=INFERENCE_LINE,
    )
    stem = element(
        "line",
        x1=fork.x,
        y1=fork.y - fork.h / 2 - 8.0,
        x2=fork.x,
        y2=fork.y - fork.h / 2,
        stroke=SOFT,
        stroke_width=1.8,
    )
    return stem + plate + _svg_text(fork.text, fork.x, fork.y, NOTE_SIZE, "#ffffff", 600)


# ------------------------------------------------------------------------------------ pixels


class _Pixels:
    """Paints the shapes of a layout into an image with OpenCV."""

    def __init__(self, layout: GraphLayout, scale: float) -> None:
        self.scale = scale
        rows, columns = round(layout.height * scale), round(layout.width * scale)
        self.image: Image = np.full((rows, columns, 3), 255, dtype=np.uint8)

    def node(self, node: NodeShape) -> None:
        fill, line, ink = _colours(node)
        radius = 10.0 if node.is_agent else 0.0
        is_box = node.is_agent or node.is_factor
        outline = _rounded(node.x, node.y, node.w, node.h, radius) if is_box else _ellipse(node)
        self._fill(outline, fill)
        self._line(np.vstack([outline, outline[:1]]), line, dashed=not node.active)
        for text, size, y, is_name in _lines(node):
            self._text(text, node.x, y, size, ink if is_name else SOFT if node.name else INK, is_name)

    def edge(self, edge: EdgeShape) -> None:
        curve = np.array([edge.at(t) for t in np.linspace(0.0, 1.0, 40)])
        self._line(curve, SOFT if edge.active else PALE, dashed=not edge.active)
        if edge.label:
            x, y = edge.at(0.62)
            w = ADVANCE * NOTE_SIZE * len(edge.label) + 8.0
            self._fill(_rounded(x, y, w, 16.0, 4.0), "#ffffff")
            self._text(edge.label, x, y, NOTE_SIZE, INK, False)

    def fork(self, fork: Fork) -> None:
        top = fork.y - fork.h / 2
        self._line(np.array([[fork.x, top - 8.0], [fork.x, top]]), SOFT, dashed=False)
        self._fill(_rounded(fork.x, fork.y, fork.w, fork.h, fork.h / 2), INFERENCE_LINE)
        self._text(fork.text, fork.x, fork.y, NOTE_SIZE, "#ffffff", True)

    def _fixed(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """In sixteenths of a pixel, as OpenCV draws with shift=4."""
        return np.rint(points * self.scale * 16).astype(np.int32)

    def _fill(self, outline: NDArray[np.float64], colour: str) -> None:
        import cv2

        cv2.fillPoly(self.image, [self._fixed(outline)], _bgr(colour), cv2.LINE_AA, 4)

    def _line(self, points: NDArray[np.float64], colour: str, dashed: bool) -> None:
        import cv2

        weight = max(1, round(1.4 * self.scale))
        for piece in _dashes(points) if dashed else [points]:
            cv2.polylines(self.image, [self._fixed(piece)], False, _bgr(colour), weight, cv2.LINE_AA, 4)

    def _text(self, text: str, x: float, y: float, size: float, colour: str, bold: bool) -> None:
        """Centred on (x, y), no wider than the fixed-width letters that the layout reckons with."""
        import cv2

        font, weight = cv2.FONT_HERSHEY_SIMPLEX, max(1, round(self.scale * (0.9 if bold else 0.5)))
        unit = cv2.getTextSize("Mg", font, 1.0, weight)[0][1]
        room = ADVANCE * size * len(text) * self.scale
        factor = 0.9 * size * self.scale / unit
        width = cv2.getTextSize(text, font, factor, weight)[0][0]
        factor *= min(1.0, room / max(width, 1))
        (width, height), _ = cv2.getTextSize(text, font, factor, weight)
        origin = (round(x * self.scale - width / 2), round(y * self.scale + height / 2))
        cv2.putText(self.image, text, origin, font, factor, _bgr(colour), weight, cv2.LINE_AA)


def _ellipse(node: NodeShape) -> NDArray[np.float64]:
    turn = np.linspace(0.0, 2.0 * np.pi, 96, endpoint=False)
    return np.column_stack([node.x + node.w / 2 * np.cos(turn), node.y + node.h / 2 * np.sin(turn)])


def _rounded(x: float, y: float, w: float, h: float, radius: float) -> NDArray[np.float64]:
    """Outline of a rectangle with round corners."""
    corners = []
    for number, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        turn = np.pi / 2 * (number + np.linspace(0.0, 1.0, 10))
        cx, cy = x + sx * (w / 2 - radius), y + sy * (h / 2 - radius)
        corners.append(np.column_stack([cx + radius * np.cos(turn), cy + radius * np.sin(turn)]))
    return np.vstack(corners)


def _dashes(points: NDArray[np.float64], dash: float = 5.0, gap: float = 4.0) -> list[NDArray[np.float64]]:
    """The pieces of a polyline that a dash pattern leaves."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    pieces = []
    for start in np.arange(0.0, along[-1], dash + gap):
        distances = np.linspace(start, min(start + dash, along[-1]), 4)
        pieces.append(np.column_stack([np.interp(distances, along, points[:, k]) for k in (0, 1)]))
    return pieces


def _bgr(colour: str) -> tuple[int, int, int]:
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return blue, green, red


def with_factors(target: CheckedTarget) -> CheckedTarget:
    """The plate as it is drawn: its factors are leaves, behind the other children of the node above."""
    factors_of = {
        name: [factor_name for factor_name, factor in target.factors.items() if factor.parent == name]
        for name in target.order
    }
    return replace(
        target,
        order=(*target.order, *target.factors),
        parent={**target.parent, **{name: factor.parent for name, factor in target.factors.items()}},
        children={name: (*children, *factors_of[name]) for name, children in target.children.items()},
    )
