"""Runs in a notebook: graphs, plans and runs as HTML, and plots of a run into matplotlib axes.

Only `Page` has a script, in a frame of its own that can reach nothing of the notebook.

`run` is what `open_run` gives. matplotlib itself is not imported here: the caller has made the axis.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.compare import RunRecord
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import Switch, turns_on
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.journal.text.sentences import has_several_targets, kinds_of
from bayesnet_track.journal.text.story import narrate_all
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.view.graph_picture import graph_svg
from bayesnet_track.view.svg import element, xml_text
from bayesnet_track.view.timeline import draw_timeline

SHOWN_TARGETS, SHOWN_EVENTS = 3, 40


@dataclass(frozen=True, repr=False)
class Page:
    """The page of a run: as the last expression of a cell, a notebook shows it.

    Attributes:
        html: the whole page, which needs nothing else; `report` writes the same to a file.
        height: of the frame in which a notebook shows it, px.
        title: what it is of.
    """

    html: str
    height: int
    title: str

    def __repr__(self) -> str:
        return f"<page of {self.title}, {len(self.html) / 1e6:.1f} MB>"

    def _repr_html_(self) -> str:
        """The page in a frame: it may run its script, and is cut off from notebook and network."""
        return (
            f'<iframe title="{escape(self.title)}" sandbox="allow-scripts allow-downloads" '
            f'style="width:100%;height:{self.height}px;border:0" srcdoc="{escape(self.html)}"></iframe>'
        )


def graph_html(graph: CheckedGraph) -> str:
    """The picture of each plate's net, under the graph's name and what it is for."""
    head = f"<p><b>{xml_text(graph.spec.name)}</b> {xml_text(graph.spec.about)}</p>"
    return head + "".join(_frame(_plate_svg(graph, plate)) for plate in graph.targets)


def spec_html(spec: GraphSpec) -> str:
    """The same of a specification, or all its errors where it fails a check."""
    try:
        return graph_html(check_graph(spec))
    except GraphError as error:
        items = "".join(f"<li>{xml_text(message)}</li>" for message in error.errors)
        return f"<p><b>{xml_text(spec.name)}</b> cannot be run:</p><ul>{items}</ul>"


def graph_picture(graph: CheckedGraph) -> str:
    """The net of the graph's first plate as SVG."""
    return _plate_svg(graph, next(iter(graph.targets)))


def run_html(run: RunRecord) -> str:
    """Description of a run, its figures, timelines of its first targets, and its decisions as sentences."""
    starts = [event for event in run.events if isinstance(event, RunStarted)]
    ended = [event for event in run.events if isinstance(event, RunEnded)]
    frames = len({line.frame for line in run.metrics} | run.seconds.keys())
    targets = list(dict.fromkeys(line.target for line in run.metrics))
    seconds = sum(run.seconds.values())
    rows = [
        ("run", run.name),
        *(("graph", f"{start.graph}, seed {start.seed}") for start in starts),
        *(("source", f"{start.source}, {start.width}x{start.height}") for start in starts),
        ("frames", f"{frames}" + "".join(f", {end.reason.replace('_', ' ')}" for end in ended)),
        ("targets", str(len(targets))),
        ("reconfigurations", str(sum(isinstance(event, Switch) for event in run.events))),
        ("frames lost", str(sum(line.status == "lost" for line in run.metrics))),
        *([("seconds", f"{seconds:.3g} ({frames / seconds:.0f} frames per second)")] if seconds else []),
    ]
    timelines = [
        _frame(_inline(draw_timeline(run.events, run.metrics, target))) for target in targets[:SHOWN_TARGETS]
    ]
    if len(targets) > SHOWN_TARGETS:
        timelines.append(f"<p>and {plural(len(targets) - SHOWN_TARGETS, 'more target')}</p>")
    named, kinds = has_several_targets(run.events), kinds_of(run.events)
    sentences = list(narrate_all(run.events, kinds, named))
    items = [f"<li>{xml_text(line)}</li>" for line in sentences[:SHOWN_EVENTS]]
    hidden_count = len(sentences) - SHOWN_EVENTS
    items += [f"<li>and {hidden_count} more</li>"] if hidden_count > 0 else []
    summary = f"<summary>{plural(len(sentences), 'line')} of the journal</summary>"
    return table(rows) + "".join(timelines) + f"<details>{summary}<ul>{''.join(items)}</ul></details>"


def table(rows: Iterable[Sequence[object]], head: Sequence[str] = ()) -> str:
    """Plain rows as an HTML table; the first cell of a row is its heading where there is no `head`."""
    top = "".join(element("th", xml_text(cell), scope="col") for cell in head)
    body = [
        "".join(
            element("th", xml_text(cell), scope="row")
            if k == 0 and not head
            else element("td", xml_text(cell))
            for k, cell in enumerate(row)
        )
        for row in rows
    ]
    lines = "".join(f"<tr>{row}</tr>" for row in body)
    return f"<table>{f'<thead><tr>{top}</tr></thead>' if head else ''}<tbody>{lines}</tbody></table>"


def _plate_svg(graph: CheckedGraph, plate: str) -> str:
    target = graph.targets[plate]
    return _inline(graph_svg(target, {agent for agent in target.agents if target.agent(agent).active}))


def _frame(svg: str) -> str:
    return f'<div style="overflow-x:auto">{svg}</div>'


def _inline(svg: str) -> str:
    """The picture with ids of its own, for a page may hold several."""
    key = hashlib.sha256(svg.encode()).hexdigest()[:12]
    return (
        svg.replace('id="title"', f'id="title-{key}"')
        .replace('id="description"', f'id="description-{key}"')
        .replace('"title description"', f'"title-{key} description-{key}"')
        .strip()
    )


UP, DOWN, LOST = "#c43d2f", "#1e8a53", "#f1b4ab"


def plot_uncertainty(ax: Any, run: RunRecord, target: str | None = None) -> Any:
    """UD of one target (the first when None) over frames, px², with switches, their levels, and when lost.

    Raises:
        ValueError: no such target.
    """
    lines = _lines(run, target)
    target = lines[0].target
    finite = [line for line in lines if math.isfinite(line.ud_px2) and line.ud_px2 > 0]
    ax.semilogy([line.frame for line in finite], [line.ud_px2 for line in finite], lw=1.4, label="UD")
    ud = {line.frame: line.ud_px2 for line in finite}
    switches = [event for event in run.events if isinstance(event, Switch) and event.target == target]
    for is_on, mark, colour, name in ((True, "^", UP, "on"), (False, "v", DOWN, "off")):
        frames = [event.frame for event in switches if turns_on(event) is is_on and event.frame in ud]
        if frames:
            ax.plot(frames, [ud[frame] for frame in frames], mark, color=colour, label=f"agent {name}")
    for kind, colour in ((Activated, UP), (Deactivated, DOWN)):
        _level(ax, [event for event in switches if isinstance(event, kind)], lines, colour)
    _shade_lost(ax, lines)
    ax.set(xlabel="frame", ylabel="UD, px²")
    ax.legend(loc="best", fontsize="small")
    return ax


def plot_kl(ax: Any, run: RunRecord, target: str | None = None, agents: Sequence[str] | None = None) -> Any:
    """KL(belief || agent) of each agent over frames, nats; gaps where it was off.

    Raises:
        ValueError: no such target.
    """
    lines = _lines(run, target)
    for agent in agents if agents is not None else _agents(lines):
        values = [line.kl.get(agent, math.nan) for line in lines]
        ax.plot([line.frame for line in lines], values, lw=1.2, label=agent)
    ax.set(xlabel="frame", ylabel="KL(belief ‖ agent), nats")
    _name(ax)
    return ax


def plot_active(ax: Any, run: RunRecord, target: str | None = None) -> Any:
    """A bar for each agent over the frames in which it was active.

    Raises:
        ValueError: no such target.
    """
    lines = _lines(run, target)
    agents = _agents(lines)
    for row, agent in enumerate(agents):
        spans = _spans([line.frame for line in lines if agent in line.active])
        bars = [(first - 0.5, end - first + 1.0) for first, end in spans]
        ax.broken_barh(bars, (row - 0.35, 0.7), color=f"C{row % 10}")
    ax.set_yticks(range(len(agents)), agents)
    ax.set(
        xlabel="frame",
        xlim=(lines[0].frame - 0.5, lines[-1].frame + 0.5),
        ylim=(max(len(agents), 1) - 0.5, -0.5),
    )
    return ax


def plot_score(ax: Any, run: RunRecord, target: str | None = None) -> Any:
    """The score of one target over frames, 0..1, with the frames in which it was lost.

    Raises:
        ValueError: no such target.
    """
    lines = _lines(run, target)
    ax.plot([line.frame for line in lines], [line.score for line in lines], lw=1.4)
    _shade_lost(ax, lines)
    score_name = (
        "probability of being on target" if any(line.features for line in lines) else "score, uncalibrated"
    )
    ax.set(xlabel="frame", ylabel=score_name, ylim=(-0.02, 1.02))
    return ax


def plot_tracks(
    ax: Any, run: RunRecord, image: ArrayLike | None = None, truth: ArrayLike | None = None
) -> Any:
    """The paths of all targets' centres in the picture, px, y downwards.

    Args:
        ax: the axis.
        run: the run.
        image: (H, W, 3) uint8 BGR picture to lie under them.
        truth: (n, 4) true top-left corner boxes; rows of NaN where the target is absent.
    """
    if image is not None:
        picture = np.asarray(image)
        ax.imshow(picture[..., ::-1] if picture.ndim == 3 else picture, cmap="gray")
    for target in dict.fromkeys(line.target for line in run.metrics):
        lines = _lines(run, target)
        path = np.array([line.centre_box[:2] for line in lines], dtype=np.float64)
        visible = np.array([not line.is_gone for line in lines])
        curve = ax.plot(*np.where(visible[:, None], path, np.nan).T, lw=1.4, label=f"target {target}")
        ax.plot(*np.where(visible[:, None], np.nan, path).T, lw=1.0, ls=":", color=curve[0].get_color())
        x, y, w, h = corner_from_centre(lines[-1].centre_box)
        corners = np.array([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]) - 0.5
        ax.plot(*corners.T, lw=0.8, color=curve[0].get_color())
    if truth is not None:
        boxes = np.asarray(truth, dtype=np.float64)
        ax.plot(
            boxes[:, 0] + (boxes[:, 2] - 1) / 2,
            boxes[:, 1] + (boxes[:, 3] - 1) / 2,
            "k--",
            lw=0.9,
            label="truth",
        )
    if image is None and not ax.yaxis_inverted():
        ax.invert_yaxis()
    ax.set_aspect("equal")
    ax.set(xlabel="x, px", ylabel="y, px")
    _name(ax)
    return ax


def _lines(run: RunRecord, target: str | None) -> list[FrameMetrics]:
    target_name = target if target is not None else next((line.target for line in run.metrics), "")
    lines = [line for line in run.metrics if line.target == target_name]
    if not lines:
        targets = ", ".join(dict.fromkeys(line.target for line in run.metrics)) or "none"
        raise ValueError(f"no target {target_name!r} in this run; there are {targets}")
    return lines


def _agents(lines: Sequence[FrameMetrics]) -> list[str]:
    return list(dict.fromkeys(agent for line in lines for agent in line.active))


def _spans(frames: Sequence[int]) -> list[tuple[int, int]]:
    """Stretches of consecutive frames.

    >>> _spans([1, 2, 3, 7])
    [(1, 3), (7, 7)]
    """
    spans: list[tuple[int, int]] = []
    for frame in frames:
        joined = bool(spans) and spans[-1][1] == frame - 1
        spans = [*spans[:-1], (spans[-1][0], frame)] if joined else [*spans, (frame, frame)]
    return spans


def _level(ax: Any, events: Sequence[Switch], lines: Sequence[FrameMetrics], colour: str) -> None:
    """The level that a rule had whenever it fired, px²: a line, with steps where it follows the box or UD."""
    causes = [(event.frame, getattr(event, "cause", None)) for event in events]
    by_ud = [(frame, cause) for frame, cause in causes if isinstance(cause, Cause) and cause.unit != "score"]
    levels = [(frame, cause.level * cause.scale_px2) for frame, cause in by_ud]
    look = {"color": colour, "lw": 0.9, "ls": "--"}
    if len({level for _, level in levels}) == 1:
        ax.axhline(levels[0][1], **look)
    elif levels:
        frames = [lines[0].frame, *(frame for frame, _ in levels[1:]), lines[-1].frame]
        ax.step(frames, [*(level for _, level in levels), levels[-1][1]], where="post", **look)


def _name(ax: Any) -> None:
    """A legend, where anything has a name."""
    if ax.get_legend_handles_labels()[1]:
        ax.legend(loc="best", fontsize="small")


def _shade_lost(ax: Any, lines: Sequence[FrameMetrics]) -> None:
    for first, end in _spans([line.frame for line in lines if line.is_gone]):
        ax.axvspan(first - 0.5, end + 0.5, color=LOST, alpha=0.5, lw=0)
