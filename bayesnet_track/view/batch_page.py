"""The overview of a batch as one offline page: its mean, what failed, and its runs, the least sure first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayesnet_track.journal.text.wording import plural
from bayesnet_track.view.compare_page import static_page
from bayesnet_track.view.svg import element, text_of

Row = Mapping[str, str | int | float | None]

MOST_ROWS = 2000
"""Runs that are listed; a browser takes seconds for more."""


def batch_page(heading: str, runs: Sequence[tuple[str, Row]], mean: Row, table: str) -> str:
    """One HTML file about the runs of a batch; all text is escaped, nothing is loaded or run.

    Runs that are not finished come first, then those of the lowest mean score. Columns in which no run has a
    value are left out.

    Args:
        heading: its title.
        runs: folder and row of each run, as in the table of results.
        mean: of each measure over the finished runs.
        table: name of the table of results, beside which the page is.
    """
    rows = [row for _, row in runs]
    columns = [name for name in (rows[0] if rows else {}) if any(row[name] not in (None, "") for row in rows)]
    listed = sorted(runs, key=lambda run: _order(run[1]))[:MOST_ROWS]
    failed = sum(row["status"] != "finished" for row in rows)
    count = plural(len(rows), "run") + (f", {failed} not finished" if failed else "")
    surplus = len(runs) - len(listed)
    mean_line = _line(columns, {"video": "mean of finished runs", **mean}, "th") if mean else ""
    parts = [
        f"<header><h1>{text_of(heading)}</h1><p>{text_of(count)}; all in ",
        element("a", text_of(table), href=table),
        "</p></header><section>",
        '<div class="wide"><table><thead><tr>',
        *(element("th", text_of(name.replace("_", " ")), scope="col") for name in columns),
        f"</tr>{mean_line}</thead><tbody>",
        *(_line(columns, row, "td", folder) for folder, row in listed),
        "</tbody></table></div>",
        f'<p class="soft">{surplus} more, of higher scores, are in the table alone.</p>' if surplus else "",
        "</section>",
    ]
    return static_page(heading, parts)


def _order(row: Row) -> tuple[bool, float]:
    score = row["score_mean"]
    return row["status"] == "finished", float(score) if score not in (None, "") else 0.0


def _line(columns: Sequence[str], row: Row, cell: str, folder: str | None = None) -> str:
    texts = []
    for name in columns:
        value = row.get(name)
        text = text_of("" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value))
        is_link = name == "video" and folder is not None
        texts.append(element("a", text, href=f"./{folder}/") if is_link else text)
    return f"<tr>{''.join(element(cell, text) for text in texts)}</tr>"
