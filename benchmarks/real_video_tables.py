"""Tables of `benchmarks/real_video.py`: means, each sequence, and differences with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from measuring import table
from numpy.typing import NDArray

Floats = NDArray[np.float64]
DRAWS = 10_000


@dataclass(frozen=True)
class Line:
    """What one pass of one tracker over one sequence gave.

    Attributes:
        tracker: name of the tracker or of the variant of a graph.
        graph: digest of the graph as run; empty for peers.
        auc: area under the success curve (OTB), frame 0 counted; the last box held counts while it is lost.
        auc_every: the same where every frame's own box counts, lost or not.
        cpu_s: CPU seconds of all frames but the first.
        agents: active agents per frame; 0 for peers, and so are the next three.
        switches: agents switched on or off per 100 frames.
        in50: share of frames whose true centre lies in the belief's 50 % region, mean of x and y.
        in90: the same of the 90 % region.
    """

    tracker: str
    graph: str
    sequence: str
    frames: int
    seed: int
    auc: float
    precision20: float
    lost_episodes: int
    cpu_s: float
    agents: float = 0.0
    switches: float = 0.0
    in50: float = 0.0
    in90: float = 0.0
    auc_every: float = float("nan")


def names_of(lines: Sequence[Line], field: str) -> list[str]:
    """The names in a field, in the order of their first line."""
    return list(dict.fromkeys(getattr(line, field) for line in lines))


def by_sequence(
    lines: Sequence[Line], tracker: str, what: Callable[[Line], float]
) -> dict[str, dict[int, float]]:
    """Sequence -> seed -> figure of one tracker."""
    found: dict[str, dict[int, float]] = {}
    for line in lines:
        if line.tracker == tracker:
            found.setdefault(line.sequence, {})[line.seed] = what(line)
    return found


def mean(lines: Sequence[Line], tracker: str, what: Callable[[Line], float]) -> float:
    """Mean over sequences of the mean over seeds."""
    each = by_sequence(lines, tracker, what).values()
    return float(np.mean([np.mean(list(seeds.values())) for seeds in each])) if each else float("nan")


def rate(lines: Sequence[Line], tracker: str) -> float:
    """Frames per CPU second over everything that it tracked."""
    own = [line for line in lines if line.tracker == tracker]
    return sum(line.frames - 1 for line in own) / sum(line.cpu_s for line in own)


def paired(lines: Sequence[Line], one: str, other: str, what: Callable[[Line], float]) -> list[Floats]:
    """Differences of a figure, an array per sequence, paired by seed; a peer's one pass meets all seeds."""
    ours, theirs = (by_sequence(lines, name, what) for name in (one, other))
    found = []
    for sequence in ours:
        beside = theirs.get(sequence, {})
        if len(beside) == 1:
            (only,) = beside.values()
            beside = dict.fromkeys(ours[sequence], only)
        both = [ours[sequence][seed] - beside[seed] for seed in ours[sequence] if seed in beside]
        if both:
            found.append(np.array(both))
    return found


def interval(differences: Sequence[Floats], sequences: bool, draws: int = DRAWS) -> tuple[float, float]:
    """95 % bootstrap interval of the mean over sequences of the mean over seeds.

    Seeds are drawn anew within each sequence; with `sequences` these are drawn anew first, which asks what
    would be found on other sequences like these.
    """
    rng = np.random.Generator(np.random.Philox(1))
    means = np.array([[rng.choice(one, len(one)).mean() for one in differences] for _ in range(draws // 10)])
    rows = rng.integers(len(means), size=draws)
    if sequences:
        columns = rng.integers(len(differences), size=(draws, len(differences)))
        drawn = means[rows[:, None], columns].mean(axis=1)
    else:
        drawn = means.mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)


def total_time(lines: Sequence[Line], one: str, other: str) -> float:
    """CPU time of one tracker over that of another, a frame, over everything that each tracked."""
    return rate(lines, other) / rate(lines, one)


def relative_time(lines: Sequence[Line], one: str, other: str) -> float:
    """CPU time of one tracker over that of another: the median over sequences of the ratio of means."""
    ours, theirs = (
        by_sequence(lines, name, lambda line: line.cpu_s / (line.frames - 1)) for name in (one, other)
    )
    return float(
        np.median(
            [
                np.mean(list(ours[name].values())) / np.mean(list(theirs[name].values()))
                for name in ours
                if name in theirs
            ]
        )
    )


FIGURES: Mapping[str, tuple[str, Callable[[Line], float]]] = {
    "AUC": (".3f", lambda line: line.auc),
    "AUC, every box": (".3f", lambda line: line.auc_every),
    "precision 20 px": (".3f", lambda line: line.precision20),
    "lost episodes": (".1f", lambda line: line.lost_episodes),
    "agents": (".2f", lambda line: line.agents),
    "switches / 100 frames": (".1f", lambda line: line.switches),
    "in 50 %": (".2f", lambda line: line.in50),
    "in 90 %": (".2f", lambda line: line.in90),
}


def means_table(lines: Sequence[Line]) -> str:
    """A row for each tracker, means over sequences and seeds."""
    rows = []
    for tracker in names_of(lines, "tracker"):
        peer = not any(line.graph for line in lines if line.tracker == tracker)
        seeds = len({line.seed for line in lines if line.tracker == tracker})
        cells = [
            "-"
            if peer and label in ("agents", "switches / 100 frames", "in 50 %", "in 90 %")
            else format(mean(lines, tracker, what), form)
            for label, (form, what) in FIGURES.items()
        ]
        rows.append([tracker, str(seeds), *cells, f"{rate(lines, tracker):.0f}"])
    return table(["tracker", "seeds", *FIGURES, "frames / CPU s"], rows)


def sequences_table(lines: Sequence[Line]) -> str:
    """AUC of every tracker on every sequence, and from seed to seed for the first tracker."""
    trackers = names_of(lines, "tracker")
    each = {tracker: by_sequence(lines, tracker, lambda line: line.auc) for tracker in trackers}
    rows = []
    for sequence in names_of(lines, "sequence"):
        row = [sequence]
        for tracker in trackers:
            seeds = list(each[tracker].get(sequence, {}).values())
            spread = (
                f" ({min(seeds):.2f}–{max(seeds):.2f})" if len(seeds) > 1 and tracker == trackers[0] else ""
            )
            row.append(f"{np.mean(seeds):.3f}{spread}" if seeds else "-")
        rows.append(row)
    rows.append(["**mean**", *(f"**{mean(lines, name, lambda line: line.auc):.3f}**" for name in trackers)])
    return table(["AUC", *trackers], rows)


def differences_table(lines: Sequence[Line]) -> str:
    """The first tracker against every other: difference of AUC with its intervals, and time."""
    first, *others = names_of(lines, "tracker")
    rows = []
    for other in others:
        found = paired(lines, first, other, lambda line: line.auc)
        if not found:
            continue
        every = paired(lines, first, other, lambda line: line.auc_every)
        rows.append(
            [
                f"{first} − {other}",
                f"{_middle(found):+.3f}",
                _range(interval(found, sequences=False)),
                _range(interval(found, sequences=True)),
                f"{_middle(every):+.3f}",
                _range(interval(every, sequences=False)),
                f"{relative_time(lines, first, other):.2f}",
                f"{total_time(lines, first, other):.2f}",
            ]
        )
    head = [
        "",
        "AUC",
        "95 %, these sequences",
        "95 %, sequences like these",
        "AUC, every box",
        "95 %, these sequences",
        "time, median",
        "time, all frames",
    ]
    return table(head, rows)


def _middle(differences: Sequence[Floats]) -> float:
    return float(np.mean([one.mean() for one in differences]))


def _range(bounds: tuple[float, float]) -> str:
    return f"{bounds[0]:+.3f} .. {bounds[1]:+.3f}"
