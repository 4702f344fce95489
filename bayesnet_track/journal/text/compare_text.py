"""A comparison of two runs in words: the same sentences for the terminal and for the page."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bayesnet_track.journal.compare import Comparison, Moment, RunRecord
from bayesnet_track.journal.compare_measures import Total
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.net import Decision
from bayesnet_track.journal.reader import lines_of_frame
from bayesnet_track.journal.text.sentences import explain, kinds_of, name_targets
from bayesnet_track.journal.text.wording import plural

SHOWN_MOMENTS = 5
LONGEST_SETTING = 160
"""Characters of a difference of settings; a longer one is cut, unless everything is asked for."""


def settings_apart(first: RunStarted, second: RunStarted) -> list[str]:
    """Differences of the two journals' first lines, besides the graph's text."""
    differences = []
    if first.graph != second.graph:
        differences.append(f"graph: {first.graph} → {second.graph}")
    if first.seed != second.seed:
        differences.append(f"seed: {first.seed} → {second.seed}")
    if first.smoothed != second.smoothed:
        differences.append("estimates: " + " → ".join(_estimates_of(run) for run in (first, second)))
    costs = dict.fromkeys([*first.costs_ms, *second.costs_ms])
    shared = [cue for cue in costs if cue in first.costs_ms and cue in second.costs_ms]
    differences += [
        f"declared cost of {cue}: {first.costs_ms[cue]:g} → {second.costs_ms[cue]:g} ms"
        for cue in shared
        if first.costs_ms[cue] != second.costs_ms[cue]
    ]
    differences += [
        f"{library}: {first.versions.get(library, 'none')} → {second.versions.get(library, 'none')}"
        for library in dict.fromkeys([*first.versions, *second.versions])
        if first.versions.get(library) != second.versions.get(library)
    ]
    return differences


def _estimates_of(event: RunStarted) -> str:
    return "smoothed" if event.smoothed else "filtered"


def compare_text(
    first: RunRecord,
    second: RunRecord,
    comparison: Comparison,
    settings: Sequence[str],
    shown: int = SHOWN_MOMENTS,
    hint: str = "",
) -> str:
    """The whole comparison as plain text; `hint` says where those are that `shown` leaves out."""
    lines = [
        " ".join([letter, "", run.name, *(f"({line_text})" for line_text in marks_of(run))])
        for letter, run in (("A", first), ("B", second))
    ] + [""]
    setting_lines = settings if shown > SHOWN_MOMENTS else [shortened(line_text) for line_text in settings]
    lines += (
        ["differ in", *(f"  {line_text}" for line_text in setting_lines)]
        if settings
        else ["the same graph and settings"]
    )
    # What came of it before how: the moments are many.
    lines += ["", *totals_lines(comparison.totals), "", *estimate_lines(comparison)]
    lines += ["", *parting_lines(first, second, comparison)]
    later_moments = comparison.moments[1:]
    if later_moments:
        lines += ["", f"after that they diverge {plural(len(later_moments), 'more time')}"]
        for moment in later_moments[:shown]:
            lines += [
                f"  {moment_text(moment, comparison)}",
                *(f"    {line_text}" for line_text in sides(first, second, moment)),
            ]
        if len(later_moments) > shown:
            lines.append(f"  ... and {len(later_moments) - shown} more{hint}")
    return name_targets("\n".join(lines), common_kinds(first, second, comparison))


def common_kinds(first: RunRecord, second: RunRecord, comparison: Comparison) -> dict[str, str]:
    """Target id -> its type in both runs; empty where an id does not mean the same target in both."""
    if any(comparison.alone) or any(a != b for a, b in comparison.pairs):
        return {}
    theirs = kinds_of(second.events)
    return {target: kind for target, kind in kinds_of(first.events).items() if theirs.get(target) == kind}


def marks_of(run: RunRecord) -> list[str]:
    """Remarks beside the name of a run: that it was smoothed, and why it is only a part of its source."""
    start_event = next((event for event in run.events if isinstance(event, RunStarted)), None)
    ended = next((event for event in reversed(run.events) if isinstance(event, RunEnded)), None)
    if start_event is None:
        return []
    marks = ["smoothed"] if start_event.smoothed else []
    if ended is None or not ended.complete:
        why = "not ended" if ended is None else ended.reason.replace("_", " ")
        marks.append(f"partial run: {why}")
    return marks


def shortened(setting: str) -> str:
    """A difference of settings in one line: a whole target is only named."""
    return setting if len(setting) <= LONGEST_SETTING else setting[: LONGEST_SETTING - 1] + "…"


def parting_lines(first: RunRecord, second: RunRecord, comparison: Comparison) -> list[str]:
    """The point where the runs first diverge, with both causes."""
    agreed = f"{plural(comparison.agreed, 'decision')} taken by both in the same frame"
    parting_frame = comparison.first_apart
    numbers = (
        "the estimates never differ"
        if parting_frame is None
        else f"the estimates differ from frame {parting_frame} on"
    )
    a, b = comparison.last_frames
    if a != b:
        numbers += f"; {'A' if a > b else 'B'} continues after frame {min(a, b)}, which is not compared"
    if not comparison.moments:
        return [f"their decisions never diverge: {agreed}; {numbers}"]
    moment = comparison.moments[0]
    return [
        f"they first diverge at {moment_text(moment, comparison)}",
        *(f"  {side}" for side in sides(first, second, moment)),
        f"  {agreed}; {numbers}",
    ]


def moment_text(moment: Moment, comparison: Comparison) -> str:
    """``frame 25, motion``, with the target where there are several."""
    has_several = len(comparison.pairs) + sum(map(len, comparison.alone)) > 1
    whose = f", {whose_text(moment.pair)}" if has_several else ""
    return f"frame {moment.frame}{whose}" + (f", {moment.node}" if moment.node else "")


def whose_text(pair: tuple[str, str]) -> str:
    """``target 2``, or how it is called in which run."""
    a, b = pair
    if a == b:
        return f"target {a}"
    return "target " + ", ".join(f"{name} of {run}" for name, run in ((a, "A"), (b, "B")) if name)


def sides(first: RunRecord, second: RunRecord, moment: Moment) -> tuple[str, str]:
    """Decisions of each run and their causes; the state of the run if it decided nothing."""
    return (
        f"A  {_decision_text(first, moment.first, moment, moment.pair[0])}",
        f"B  {_decision_text(second, moment.second, moment, moment.pair[1])}",
    )


def _decision_text(run: RunRecord, decided: Sequence[Decision], moment: Moment, target: str) -> str:
    if decided:
        return "; ".join(explain(event) for event in decided)
    return f"frame {moment.frame}: {_standing(run, moment, target)}"


def _standing(run: RunRecord, moment: Moment, target: str) -> str:
    """The reason why nothing was decided, as far as the measurements tell."""
    if not target:
        return "it has no such target"
    of_frame = lines_of_frame(run.metrics, moment.frame)
    line = next((measured for measured in of_frame if measured.target == target), None)
    if line is None:
        return f"target {target} is not live"
    ud = f"UD {line.ud_px2:{'.3g' if abs(line.ud_px2) < 1000 else '.0f'}} {line.ud_unit}"
    if not moment.node or not _is_agent(run, moment.node):
        return f"no such decision; {ud}, {line.status}"
    switch = "on" if moment.node in line.active else "off"
    later = _next(run, moment, target)
    continuation = f"; {explain(later)}" if later is not None else "; it stays so to the end"
    return f"no such decision, {moment.node} is {switch} at {ud}{continuation}"


def _is_agent(run: RunRecord, node: str) -> bool:
    return any(
        getattr(event, "node", None) == node or node in getattr(event, "active", ()) for event in run.events
    )


def _next(run: RunRecord, moment: Moment, target: str) -> Decision | None:
    for event in run.events:
        if (
            isinstance(event, Decision)
            and event.frame > moment.frame
            and event.target == target
            and getattr(event, "node", "") == moment.node
        ):
            return event
    return None


def totals_lines(totals: Sequence[Total]) -> list[str]:
    """The table of figures: A, B, and B - A."""
    rows = [("", "A", "B", "B - A")]
    rows += [(total.name, figure(total.first), figure(total.second), change(total)) for total in totals]
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    return [
        "  ".join(
            cell.ljust(w) if k == 0 else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def figure(value: float | None) -> str:
    """Three or four significant digits, whole numbers whole."""
    if value is None or math.isnan(value):
        return "-"
    is_whole = abs(value) >= 1000 or value == int(value)
    return (f"{value:.0f}" if is_whole else f"{value:.4g}").replace("-", "−")


def change(total: Total) -> str:
    """B - A, with its sign."""
    if total.first is None or total.second is None:
        return "-"
    difference = total.second - total.first
    return "0" if difference == 0 else f"{'+' if difference > 0 else '−'}{figure(abs(difference))}"


def estimate_lines(comparison: Comparison) -> list[str]:
    """Distance of the estimates of each target, in a line; the farthest first."""
    lines = []
    for (a, b), distances in comparison.distances.items():
        name = whose_text((a, b))
        if not len(distances):
            lines.append((math.inf, f"{name}: never live in the same frame"))
            continue
        farthest = distances.farthest
        mean = float(distances.px.mean())
        missed = int((distances.iou < 0.5).sum())
        lines.append(
            (
                -mean,
                f"{name}: estimates {mean:.3g} px apart on average over {plural(len(distances), 'frame')}, "
                f"{distances.px[farthest]:.3g} px at most (frame {distances.frame[farthest]}); "
                f"overlap below 0.5 in {plural(missed, 'frame')}",
            )
        )
    texts = [line for _, line in sorted(lines)]
    for run, targets in zip("AB", comparison.alone, strict=True):
        if targets:
            texts.append(f"only in {run}: target {', '.join(targets)}")
    return texts
