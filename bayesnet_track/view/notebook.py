"""Graphs, plans and runs as HTML for notebooks: SVG and plain tables, all text escaped, no script.

Only `Page` has a script, in a frame of its own that can reach nothing of the notebook.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.compare import RunRecord
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.net.net import Switch
from bayesnet_track.journal.text.sentences import has_several_targets, kinds_of
from bayesnet_track.journal.text.story import narrate_all
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.view.graph_picture import graph_svg
from bayesnet_track.view.svg import element, text_of
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
    head = f"<p><b>{text_of(graph.spec.name)}</b> {text_of(graph.spec.about)}</p>"
    return head + "".join(_frame(_plate_svg(graph, plate)) for plate in graph.targets)


def spec_html(spec: GraphSpec) -> str:
    """The same of a specification, or all its errors where it fails a check."""
    try:
        return graph_html(check_graph(spec))
    except GraphError as error:
        items = "".join(f"<li>{text_of(message)}</li>" for message in error.errors)
        return f"<p><b>{text_of(spec.name)}</b> cannot be run:</p><ul>{items}</ul>"


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
    items = [f"<li>{text_of(line)}</li>" for line in sentences[:SHOWN_EVENTS]]
    hidden_count = len(sentences) - SHOWN_EVENTS
    items += [f"<li>and {hidden_count} more</li>"] if hidden_count > 0 else []
    summary = f"<summary>{plural(len(sentences), 'line')} of the journal</summary>"
    return table(rows) + "".join(timelines) + f"<details>{summary}<ul>{''.join(items)}</ul></details>"


def table(rows: Iterable[Sequence[object]], head: Sequence[str] = ()) -> str:
    """Plain rows as an HTML table; the first cell of a row is its heading where there is no `head`."""
    top = "".join(element("th", text_of(cell), scope="col") for cell in head)
    body = [
        "".join(
            element("th", text_of(cell), scope="row") if k == 0 and not head else element("td", text_of(cell))
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
