"""The comparison of two runs as one offline page: no script, no network, light or dark, printable."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence

from bayesnet_track.journal.compare import Comparison, RunRecord, Total
from bayesnet_track.journal.text.compare_text import (
    change,
    estimate_lines,
    figure,
    parting_lines,
    place,
    sides,
    whose_text,
)
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.view.compare_charts import MOST_MOMENTS, draw_pair
from bayesnet_track.view.svg import element, text_of

OPEN_CHARTS = 3

STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1f2933; --soft: #5f6b78; --grid: #e4e7eb;
  --ground: #f2f4f7; --a: #2457a7; --b: #b4541a; --apart: #8a5fbf; --mark: #c43d2f; --card: #f7f8fa; }
@media (prefers-color-scheme: dark) { :root { --paper: #14181d; --ink: #e6eaef; --soft: #9aa6b2;
  --grid: #2c343d; --ground: #1d232a; --a: #7aa7f0; --b: #f0a060; --apart: #b79ae6; --mark: #ff8f80;
  --card: #1b2027; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem 1rem 3rem; max-width: 66rem;
  background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif;
  overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; margin: 0 0 .6rem; line-height: 1.25; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; }
a { color: inherit; } .a { color: var(--a); } .b { color: var(--b); }
.soft { color: var(--soft); } b.side { font-weight: 700; margin-right: .5em; }
dl { display: grid; grid-template-columns: auto 1fr; gap: .1rem .7rem; margin: 0; } dt { font-weight: 700; }
dd { margin: 0; }
.first { border-left: 4px solid var(--mark); background: var(--card); padding: .6rem .9rem; margin: .6rem 0; }
.first p, .moment p { margin: .15rem 0; }
.moment { border-top: 1px solid var(--grid); padding: .5rem 0; } .moment h3 { font-size: 1rem; margin: 0; }
.moment:target { background: var(--card); outline: 2px solid var(--mark); outline-offset: 4px; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .2rem .7rem; border-bottom: 1px solid var(--grid); white-space: nowrap; }
th:first-child { text-align: left; font-weight: 400; white-space: normal; overflow-wrap: normal; }
thead th, .better { font-weight: 700; }
@media (max-width: 34rem) { table { font-size: .85rem; } th, td { padding: .2rem .25rem; } }
ul { margin: .3rem 0; padding-left: 1.2rem; }
summary { cursor: pointer; margin: .8rem 0 .3rem; font-weight: 600; }
.chart { display: block; width: 100%; min-width: 44rem; height: auto; }
.chart text { font: 11px system-ui, "DejaVu Sans", sans-serif; fill: var(--ink); }
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
    digest = base64.b64encode(hashlib.sha256(STYLE.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    policy += "; img-src data:" if pictures else ""
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{text_of(heading)}</title>",
            f"<style>{STYLE}</style></head><body><main>",
            f"<h1>{text_of(heading)}</h1>",
            *_runs(first, second, settings),
            *_first_parting(first, second, compared),
            *(['<div class="pictures">', *pictures, "</div>"] if pictures else []),
            "<h2>What each cost</h2>",
            _table(compared.totals),
            '<p class="soft">Bold is better. Measured times are a clock’s: equal runs differ, too.</p>',
            *(f'<p class="soft">{text_of(line)}</p>' for line in estimate_lines(compared)[:12]),
            *_charts(first, second, compared),
            *_moments(first, second, compared),
            "</main></body></html>",
            "",
        ]
    )


def _runs(first: RunRecord, second: RunRecord, settings: Sequence[str]) -> list[str]:
    rows = [
        f'<dt class="{letter.lower()}">{letter}</dt><dd>{text_of(run.name)}</dd>'
        for letter, run in (("A", first), ("B", second))
    ]
    if not settings:
        return ["<dl>", *rows, "</dl>", "<p>The same graph and settings.</p>"]
    said = [f"<li>{text_of(one)}</li>" for one in settings]
    return ["<dl>", *rows, "</dl>", "<p>They differ in</p><ul>", *said, "</ul>"]


def _first_parting(first: RunRecord, second: RunRecord, compared: Comparison) -> list[str]:
    head, *parts = parting_lines(first, second, compared)
    lines = [_mark_sides(line.strip()) for line in parts]
    return [
        "<h2>Where they first diverge</h2>",
        '<div class="first">',
        f"<p><b>{text_of(_capital(head))}</b></p>",
        *lines,
        "</div>",
    ]


def _mark_sides(line: str) -> str:
    """A line that begins with A or B in that run's colour."""
    letter, _, rest = line.partition("  ")
    if letter in ("A", "B") and rest:
        return f'<p><b class="side {letter.lower()}">{letter}</b>{text_of(rest)}</p>'
    return f'<p class="soft">{text_of(_capital(line))}</p>'


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _table(totals: Sequence[Total]) -> str:
    rows = []
    for one in totals:
        better = _better(one)
        cells = [
            element("td", text_of(figure(value)), class_="better" if better == letter else None)
            for letter, value in (("a", one.first), ("b", one.second))
        ]
        rows.append(
            "<tr>"
            + element("th", text_of(one.name), scope="row")
            + "".join(cells)
            + f"<td>{text_of(change(one))}</td></tr>"
        )
    head = (
        '<thead><tr><th></th><th scope="col" class="a">A</th><th scope="col" class="b">B</th>'
        '<th scope="col">B − A</th></tr></thead>'
    )
    return f'<div class="wide"><table>{head}<tbody>{"".join(rows)}</tbody></table></div>'


def _better(one: Total) -> str:
    if one.less_is_better is None or one.first is None or one.second is None or one.first == one.second:
        return ""
    return "a" if (one.first < one.second) == one.less_is_better else "b"


def _charts(first: RunRecord, second: RunRecord, compared: Comparison) -> list[str]:
    """The targets that differ the most first; some of them open."""
    apart = {
        pair: sum(one.px for one in line) + 1e6 * sum(m.pair == pair for m in compared.moments)
        for pair, line in compared.distances.items()
    }
    ordered = sorted(compared.pairs, key=lambda pair: -apart[pair])
    drawn = [
        "<h2>Over each other</h2>",
        '<p class="soft"><b class="side a">A</b>solid, <b class="side b">B</b>dashed. Red lines: decisions '
        "that only one took, or that came later in one; they lead to the reasons below. Blocks along the "
        "edge of UD: lost (A above, B below).</p>",
    ]
    for number, pair in enumerate(ordered):
        name = _capital(whose_text(pair))
        chart = f'<div class="wide">{draw_pair(first, second, compared, pair)}</div>'
        if len(ordered) == 1:
            drawn.append(chart)
        else:
            is_open = " open" if number < OPEN_CHARTS else ""
            drawn.append(f"<details{is_open}><summary>{text_of(name)}</summary>{chart}</details>")
    return drawn


def _moments(first: RunRecord, second: RunRecord, compared: Comparison) -> list[str]:
    if not compared.moments:
        return []
    parts = [f"<h2>{_capital(plural(len(compared.moments), 'parting'))}</h2>"]
    for number, moment in enumerate(compared.moments[:MOST_MOMENTS]):
        head = f"<h3>{text_of(_capital(place(moment, compared)))}</h3>"
        body = "".join(_mark_sides(line) for line in sides(first, second, moment))
        parts.append(f'<div class="moment" id="moment-{number}">{head}{body}</div>')
    if len(compared.moments) > MOST_MOMENTS:
        parts.append(f"<p>… and {len(compared.moments) - MOST_MOMENTS} more.</p>")
    return parts
