"""The comparison of two runs as one offline page: no script, no network, light or dark, printable."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence

from bayesnet_track.journal.compare import Comparison, RunRecord
from bayesnet_track.journal.compare_measures import Total
from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.journal.text.compare_text import (
    change,
    common_kinds,
    estimate_lines,
    figure,
    marks_of,
    moment_text,
    parting_lines,
    shortened,
    sides,
    whose_text,
)
from bayesnet_track.journal.text.sentences import name_targets
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.view.compare_charts import MOST_MOMENTS, draw_pair
from bayesnet_track.view.page_data import histories
from bayesnet_track.view.svg import element, xml_text

OPEN_CHARTS = 3

STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #17202b; --soft: #66727f; --grid: #e2e6eb;
  --page: #f4f5f7; --ground: #f1f3f6; --a: #1f4e9c; --b: #c2410c; --apart: #7c4fb0; --mark: #c0304a;
  --card: #eef3fb; --doubt: #7a5500; --dash: #e0a100; --focus: #1d5fd1; }
@media screen and (prefers-color-scheme: dark) { :root { --paper: #171c22; --ink: #e8edf2; --soft: #8f9ba8;
  --grid: #2a323b; --page: #0e1216; --ground: #1e252c; --a: #7fb2ff; --b: #ff9457; --apart: #b695e6;
  --mark: #e8607a; --card: #1d2937; --doubt: #f1c65c; --dash: #e3ab2a; --focus: #79aefc; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 20px 24px 32px; max-width: 1480px; background: var(--page); color: var(--ink);
  font: 14px/1.45 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif;
  font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
h1 { font-size: 26px; margin: 0; line-height: 1.15; letter-spacing: -.015em; font-weight: 680; }
h2 { font-size: 13px; margin: 0 0 8px; font-weight: 650; }
header { margin-bottom: 16px; } header p { margin: 3px 0 8px; }
section { background: var(--paper); border: 1px solid var(--grid); border-radius: 10px; padding: 14px 16px;
  margin-bottom: 16px; min-width: 0; }
.columns { display: grid; grid-template-columns: 3fr 2fr; gap: 0 16px; align-items: start; }
@media (max-width: 60rem) { .columns { grid-template-columns: minmax(0, 1fr); } }
@media (max-width: 34rem) { body { padding: 14px 10px 24px; } section { padding: 12px 10px; } }
a { color: inherit; } .a { color: var(--a); } .b { color: var(--b); }
:focus-visible { outline: 2.5px solid var(--focus); outline-offset: 2px; border-radius: 4px; }
.soft { color: var(--soft); } b.side { font-weight: 700; margin-right: .5em; }
dl { display: grid; grid-template-columns: auto 1fr; gap: .1rem .7rem; margin: 0; } dt { font-weight: 700; }
dd { margin: 0; }
.badge { font-size: 12.5px; font-weight: 620; color: var(--doubt); border: 1.5px dashed var(--dash);
  border-radius: 99px; padding: 1px 9px; margin-left: .4em; display: inline-block; }
.first { border-left: 4px solid var(--mark); background: var(--card); padding: 8px 12px;
  margin-bottom: 12px; }
.first p, .moment p { margin: .15rem 0; }
.moment { border-top: 1px solid var(--grid); padding: .5rem 0; }
.moment h3 { font-size: 14px; font-weight: 650; margin: 0; }
.moment h3 a { text-decoration-color: var(--soft); text-underline-offset: .2em; }
.moment:target { background: var(--card); outline: 2px solid var(--mark); outline-offset: 4px; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .2rem .7rem; border-bottom: 1px solid var(--grid); white-space: nowrap; }
th:first-child { text-align: left; font-weight: 400; white-space: normal; overflow-wrap: normal; }
thead th, .better { font-weight: 700; }
@media (max-width: 34rem) { th, td { padding: .2rem .25rem; } }
ul { margin: .3rem 0; padding-left: 1.2rem; }
summary { cursor: pointer; margin: .3rem 0; } .charts summary { font-weight: 600; }
.chart { display: block; width: 100%; min-width: 52rem; max-width: 72rem;
  height: auto; margin: 0 auto; }
.chart text { font: 12px system-ui, "DejaVu Sans", sans-serif; fill: var(--ink); }
.chart .soft { fill: var(--soft); } .chart .mark { fill: var(--mark); font-weight: 600; }
.chart .grid { stroke: var(--grid); } .chart .ground { fill: var(--ground); }
.chart .curve { fill: none; stroke-width: 1.6; stroke-linejoin: round; }
.chart .curve.a { stroke: var(--a); } .chart .curve.b { stroke: var(--b); stroke-dasharray: 5 2.5; }
.chart .bar.a, .chart .lost.a { fill: var(--a); } .chart .bar.b, .chart .lost.b { fill: var(--b); }
.chart .lost { opacity: .55; } .chart .apart { fill: var(--apart); opacity: .75; }
.chart .parting { stroke: var(--mark); stroke-width: .9; stroke-dasharray: 2 3; }
.chart .hit { stroke: transparent; stroke-width: 12; }
.chart a:focus { outline: none; }
.chart a:focus .hit, .chart a:hover .hit { stroke: var(--mark); opacity: .25; }
.chart .parting.first { stroke-width: 1.8; stroke-dasharray: none; }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(18rem, 100%), 1fr));
  gap: .8rem; }
figure { margin: 0; } figcaption { color: var(--soft); font-size: .85rem; }
.picture { display: block; width: 100%; height: auto; background: var(--ground); }
.picture text { fill: #fff; stroke: #000; stroke-width: .15em; paint-order: stroke; font-weight: 700; }
.picture .halo { fill: none; stroke: #000; stroke-opacity: .7; } .picture .box { fill: none; }
.picture .box.a { stroke: #4c8bf5; }
.picture .box.b { stroke: #ff9a3c; stroke-dasharray: 6 3; }
@media print { body { max-width: none; font-size: 11pt; } .chart { min-width: 0; }
  .wide { overflow: visible; } .moment, .first, tr { break-inside: avoid; } }
"""


def compare_page(
    first: RunRecord,
    second: RunRecord,
    compared: Comparison,
    settings: Sequence[str],
    title: str = "",
    pictures: Sequence[str] = (),
) -> str:
    """One HTML file that shows two runs over each other. All text is escaped; nothing is loaded or run.

    `pictures` are figures from `draw_pictures`.
    """
    heading = title or f"{first.name} and {second.name}"
    # The words of a body name targets by their type; those of a hostile journal are escaped, as all others.
    kinds = {target: xml_text(kind) for target, kind in common_kinds(first, second, compared).items()}
    parts = [
        f"<header><h1>{xml_text(heading)}</h1>",
        *_runs(first, second),
        '</header><div class="columns"><section>',
        *_first_parting(first, second, compared),
        *(['<div class="pictures">', *pictures, "</div>"] if pictures else []),
        "</section><section><h2>What each cost</h2>",
        _table(compared.totals),
        '<p class="soft">Bold is better. Measured times are a clock’s: equal runs differ, too.</p>',
        *(f'<p class="soft">{xml_text(line)}</p>' for line in estimate_lines(compared)[:12]),
        '</section></div><section class="charts">',
        *_charts(first, second, compared),
        "</section>",
        *_moments(first, second, compared),
        *_settings(settings),
    ]
    return name_targets(static_page(heading, parts, bool(pictures)), kinds)


def static_page(heading: str, parts: Sequence[str], has_pictures: bool = False) -> str:
    """An HTML file of parts that are escaped already, in this page's style; it loads and runs nothing."""
    digest = base64.b64encode(hashlib.sha256(STYLE.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    policy += "; img-src data:" if has_pictures else ""
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{xml_text(heading)}</title>",
            f"<style>{STYLE}</style></head><body><main>",
            *parts,
            "</main></body></html>",
            "",
        ]
    )


def _runs(first: RunRecord, second: RunRecord) -> list[str]:
    """Graph and source of both runs, and which run was smoothed or is only a part."""
    rows = []
    for letter, run in (("A", first), ("B", second)):
        start = next((event for event in run.events if isinstance(event, RunStarted)), None)
        run_text = "" if start is None else f" · {start.graph} · seed {start.seed}"
        badges = "".join(f'<span class="badge">{xml_text(mark)}</span>' for mark in marks_of(run))
        rows.append(
            f'<dt class="{letter.lower()}">{letter}</dt>'
            f'<dd>{xml_text(run.name)}<span class="soft">{xml_text(run_text)}</span>{badges}</dd>'
        )
    first_start = next((event for event in first.events if isinstance(event, RunStarted)), None)
    size = (
        ""
        if first_start is None
        else f'<p class="soft">on {xml_text(first_start.source)} · '
        f"{first_start.width} × {first_start.height} px</p>"
    )
    return [size, "<dl>", *rows, "</dl>"]


def _settings(settings: Sequence[str]) -> list[str]:
    """Differences in graph and versions; long ones folded."""
    if not settings:
        return ["<section><h2>They differ in</h2><p>The same graph and settings.</p></section>"]
    items = [
        f"<li>{text}</li>"
        if short == text
        else f"<li><details><summary>{short}</summary>{text}</details></li>"
        for text, short in ((xml_text(setting), xml_text(shortened(setting))) for setting in settings)
    ]
    return ["<section><h2>They differ in</h2><ul>", *items, "</ul></section>"]


def _first_parting(first: RunRecord, second: RunRecord, compared: Comparison) -> list[str]:
    head, *parts = parting_lines(first, second, compared)
    lines = [_mark_sides(line.strip()) for line in parts]
    return [
        "<h2>Where they first diverge</h2>",
        '<div class="first">',
        f"<p><b>{xml_text(_capital(head))}</b></p>",
        *lines,
        "</div>",
    ]


def _mark_sides(line: str) -> str:
    """A line that begins with A or B in that run's colour."""
    letter, _, text = line.partition("  ")
    if letter in ("A", "B") and text:
        return f'<p><b class="side {letter.lower()}">{letter}</b>{xml_text(text)}</p>'
    return f'<p class="soft">{xml_text(_capital(line))}</p>'


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _table(totals: Sequence[Total]) -> str:
    rows = []
    for total in totals:
        better = _better(total)
        cells = [
            element("td", xml_text(figure(value)), class_="better" if better == letter else None)
            for letter, value in (("a", total.first), ("b", total.second))
        ]
        rows.append(
            "<tr>"
            + element("th", xml_text(total.name), scope="row")
            + "".join(cells)
            + f"<td>{xml_text(change(total))}</td></tr>"
        )
    head = (
        '<thead><tr><th></th><th scope="col" class="a">A</th><th scope="col" class="b">B</th>'
        '<th scope="col">B − A</th></tr></thead>'
    )
    return f'<div class="wide"><table>{head}<tbody>{"".join(rows)}</tbody></table></div>'


def _better(total: Total) -> str:
    if (
        total.less_is_better is None
        or total.first is None
        or total.second is None
        or total.first == total.second
    ):
        return ""
    return "a" if (total.first < total.second) == total.less_is_better else "b"


def _charts(first: RunRecord, second: RunRecord, compared: Comparison) -> list[str]:
    """The targets that differ the most first; some of them open."""
    divergence = {
        pair: float(line.px.sum()) + 1e6 * sum(m.pair == pair for m in compared.moments)
        for pair, line in compared.distances.items()
    }
    ordered = sorted(compared.pairs, key=lambda pair: -divergence[pair])
    parts = [
        "<h2>Over each other</h2>",
        '<p class="soft"><b class="side a">A</b>solid, <b class="side b">B</b>dashed. Red lines: decisions '
        "that only one took, or that came later in one; they lead to the reasons below. Blocks along the "
        "edge of UD: lost (A above, B below).</p>",
    ]
    by_target = [
        histories(run.metrics, [pair[side] for pair in ordered]) for side, run in enumerate((first, second))
    ]
    for number, pair in enumerate(ordered):
        name = _capital(whose_text(pair))
        sides = [of_run[target] for of_run, target in zip(by_target, pair, strict=True)]
        chart = f'<div class="wide">{draw_pair(first, second, compared, pair, sides)}</div>'
        if len(ordered) == 1:
            parts.append(chart)
        else:
            is_open = " open" if number < OPEN_CHARTS else ""
            parts.append(f"<details{is_open}><summary>{xml_text(name)}</summary>{chart}</details>")
    return parts


def _moments(first: RunRecord, second: RunRecord, compared: Comparison) -> list[str]:
    if not compared.moments:
        return []
    parts = [f"<section><h2>{_capital(plural(len(compared.moments), 'parting'))}</h2>"]
    for number, moment in enumerate(compared.moments[:MOST_MOMENTS]):
        head = f'<h3><a href="#moment-{number}">{xml_text(_capital(moment_text(moment, compared)))}</a></h3>'
        body = "".join(_mark_sides(line) for line in sides(first, second, moment))
        parts.append(f'<div class="moment" id="moment-{number}">{head}{body}</div>')
    if len(compared.moments) > MOST_MOMENTS:
        parts.append(f"<p>… and {len(compared.moments) - MOST_MOMENTS} more.</p>")
    return [*parts, "</section>"]
