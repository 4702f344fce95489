"""Real sequences by strata: those that settings were chosen on apart from those that nobody had tuned on.

    python benchmarks/real_video_whole.py DATA_FOLDER --graphs general --first-seed 201 --seeds 3 --why WORDS
        [--strata "chosen on,untuned"] [--max-frames 150]
        [--peers CSRT,NanoTrack,KCF --peers-python PYTHON --models FOLDER] [--looks FILE] [--passes FILE]

Every tracker makes one pass over all frames (or the first of them) from the first true box; every sequence
weighs the same. The strata are those of `sequences.STRATA`; of the halves A and B one is for choosing, and
the other for reporting. Printed are, of each stratum, mean AUC, what the score and the status are worth, how
often regions hold the true centre (mean and quartiles over sequences), and differences with 95 % intervals of
a paired bootstrap over sequences; then every sequence. Every call adds a line to the file of looks. With
`--passes` a pass is written as soon as it is made.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from itertools import chain
from pathlib import Path

import numpy as np
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray
from real_video import LOOKS, Elsewhere, Pass, digest, note, read_graph, run_all
from sequences import STRATA, find_sequences

DRAWS = 10_000
GOOD, POOR = 0.5, 0.1
"""IoU above which a frame is on target, and below which it is off."""


def means_of(passes: Sequence[Pass]) -> dict[str, dict[str, float]]:
    """Tracker -> sequence -> mean success AUC over seeds."""
    values: dict[str, dict[str, list[float]]] = {}
    for one in passes:
        values.setdefault(one.tracker, {}).setdefault(one.sequence, []).append(one.auc)
    return {
        tracker: {name: float(np.mean(of_seeds)) for name, of_seeds in by_name.items()}
        for tracker, by_name in values.items()
    }


def describe_difference(first: Mapping[str, float], second: Mapping[str, float], names: Sequence[str]) -> str:
    """Mean difference over the sequences with its 95 % interval, and on how many the first is ahead."""
    each = np.array([first[name] - second[name] for name in names])
    drawn = each[np.random.default_rng(0).integers(len(each), size=(DRAWS, len(each)))].mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return f"{each.mean():+.3f} [{low:+.3f}, {high:+.3f}], ahead on {int((each > 0).sum())} of {len(each)}"


def share(passes: Sequence[Pass], of: Callable[[float, str], bool], among: Callable[[float], bool]) -> float:
    """Share of the frames `among` (by IoU) of which `of` (by IoU and status) holds, sequences alike."""
    shares = []
    for sequence in sorted({one.sequence for one in passes}):
        frames = [one.frames for one in passes if one.sequence == sequence]
        own = [pair for one in frames for pair in zip(one.iou, one.status, strict=True)]
        chosen = [of(iou, status) for iou, status in own if among(iou)]
        if chosen:
            shares.append(float(np.mean(chosen)))
    return float(np.mean(shares)) if shares else float("nan")


def auroc(passes: Sequence[Pass]) -> float:
    """Probability that a good frame has a larger score than a poor one; each sequence has the same weight.

    Frames of all sequences are compared with each other.
    """
    scores: dict[bool, list[NDArray[np.float64]]] = {True: [], False: []}
    weights: dict[bool, list[NDArray[np.float64]]] = {True: [], False: []}
    for sequence in {one.sequence for one in passes}:
        frames = [one.frames for one in passes if one.sequence == sequence]
        iou = np.concatenate([np.array(one.iou) for one in frames])
        score = np.concatenate([np.array(one.score) for one in frames])
        for good, chosen in ((True, score[iou > GOOD]), (False, score[iou < POOR])):
            if len(chosen):
                scores[good].append(chosen)
                weights[good].append(np.full(len(chosen), 1.0 / len(iou)))
    if not scores[True] or not scores[False]:
        return float("nan")
    high, low = np.concatenate(scores[True]), np.concatenate(scores[False])
    of_high, of_low = np.concatenate(weights[True]), np.concatenate(weights[False])
    order = np.argsort(low)
    below = np.concatenate([[0.0], np.cumsum(of_low[order])])
    less = below[np.searchsorted(low[order], high, side="left")]
    same = below[np.searchsorted(low[order], high, side="right")] - less
    return float(np.sum(of_high * (less + 0.5 * same)) / of_high.sum() / of_low.sum())


BINS = 10
"""Of the score, for its expected calibration error."""


def calibration_error(passes: Sequence[Pass]) -> float:
    """Expected calibration error: mean over frames of |mean score - share on target| of the score's bin.

    Every sequence has the same weight.
    """
    sums = np.zeros((BINS, 2))
    names = {one.sequence for one in passes}
    for name in names:
        frames = [one.frames for one in passes if one.sequence == name]
        score = np.concatenate([np.array(one.score) for one in frames])
        good = np.concatenate([np.array(one.iou) for one in frames]) > GOOD
        own = np.minimum((score * BINS).astype(np.int64), BINS - 1)
        for column, value in enumerate((score, good)):
            sums[:, column] += np.bincount(own, value, BINS) / len(score) / len(names)
    return float(np.abs(sums[:, 0] - sums[:, 1]).sum())


def mean_of(passes: Sequence[Pass], value: Callable[[Pass], float]) -> float:
    """Mean over sequences of the mean over seeds."""
    names = sorted({one.sequence for one in passes})
    return float(
        np.mean([np.mean([value(one) for one in passes if one.sequence == name]) for name in names])
        if names
        else np.nan
    )


HEAD = [
    "",
    "AUC",
    "every box",
    "AUROC",
    "doubt while good",
    "tracking at IoU 0, of all",
    "of these",
    "in 50 / 90 %",
    "switches / 100, mean / most",
    "agents evaluated",
    "frames / CPU s",
    "ms, median / worst",
]


def row_of(name: str, own: Sequence[Pass]) -> list[str]:
    """The means of one tracker over the sequences of a stratum."""
    cpu = np.concatenate([np.array(one.frames.cpu_s) for one in own])
    row = [
        name,
        f"{mean_of(own, lambda one: one.auc):.3f}",
        f"{mean_of(own, lambda one: one.auc_every):.3f}",
        f"{auroc(own):.3f}",
        f"{share(own, lambda _, s: s != 'tracking', lambda iou: iou > GOOD):.3f}",
        f"{share(own, lambda iou, s: s == 'tracking' and iou == 0, lambda _: True):.4f}",
        f"{share(own, lambda _, s: s == 'tracking', lambda iou: iou == 0):.3f}",
    ]
    if own[0].graph:
        row += [
            f"{mean_of(own, lambda one: one.in50):.2f} / {mean_of(own, lambda one: one.in90):.2f}",
            f"{mean_of(own, lambda one: one.switches):.1f} / {max(one.switches for one in own):.1f}",
            f"{mean_of(own, lambda one: one.agents):.2f}",
        ]
    else:
        row += ["-"] * 3
    return [*row, f"{len(cpu) / cpu.sum():.0f}", f"{1000 * np.median(cpu):.1f} / {1000 * cpu.max():.0f}"]


CALIBRATION_HEAD = [
    "",
    "AUROC",
    "doubt while good",
    "tracking at IoU 0",
    "below .1",
    "up to .5",
    "ECE",
    "in 50 %, quartiles",
    "in 90 %, quartiles",
]


def calibration_row(name: str, own: Sequence[Pass]) -> list[str]:
    """What score, status and regions of one tracker are worth over the sequences of a stratum."""
    row = [
        name,
        f"{auroc(own):.3f}",
        f"{share(own, lambda _, s: s != 'tracking', lambda iou: iou > GOOD):.3f}",
        f"{share(own, lambda iou, s: s == 'tracking' and iou == 0, lambda _: True):.4f}",
        f"{share(own, lambda iou, s: s == 'tracking' and iou < POOR, lambda _: True):.4f}",
        f"{share(own, lambda iou, s: s == 'tracking' and iou <= GOOD, lambda _: True):.3f}",
    ]
    if not own[0].graph:
        return [*row, "-", "-", "-"]
    row.append(f"{calibration_error(own):.3f}")
    for inside in (lambda one: one.in50, lambda one: one.in90):
        of = [
            mean_of([one for one in own if one.sequence == n], inside) for n in {one.sequence for one in own}
        ]
        low, high = np.percentile(of, [25, 75])
        row.append(f"{np.mean(of):.2f}, {low:.2f} to {high:.2f}")
    return row


def report(passes: Sequence[Pass], strata: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """The tables."""
    means = means_of(passes)
    trackers = list(means)
    everywhere = {
        stratum: [name for name in names if all(name in means[one] for one in trackers)]
        for stratum, names in strata.items()
    }
    everywhere = {stratum: names for stratum, names in everywhere.items() if names}
    for stratum, names in everywhere.items():
        own = [one for one in passes if one.sequence in names]
        rows = [row_of(one, [p for p in own if p.tracker == one]) for one in trackers]
        yield f"{stratum}: {len(names)} sequences\n\n" + table(HEAD, rows)
        rows = [calibration_row(one, [p for p in own if p.tracker == one]) for one in trackers]
        yield table(CALIBRATION_HEAD, rows)
    pairs = [(first, second) for k, first in enumerate(trackers) for second in trackers[k + 1 :]]
    rows = [
        [
            f"{first} - {second}",
            *(describe_difference(means[first], means[second], names) for names in everywhere.values()),
        ]
        for first, second in pairs
    ]
    if rows:
        yield table(["difference", *everywhere], rows)
    rows = [
        [name, stratum, *(f"{means[one][name]:.3f}" for one in trackers)]
        for stratum, names in everywhere.items()
        for name in names
    ]
    yield table(["sequence", "stratum", *trackers], rows)


def main() -> None:
    """Run the passes, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graphs", default="general", help="names or files, with commas")
    parser.add_argument("--why", required=True, help="what the look is for; goes into the record")
    parser.add_argument("--strata", default="chosen on,untuned", help=f"of {', '.join(STRATA)}")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--max-frames", type=int)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--peers", default="CSRT,NanoTrack,KCF")
    parser.add_argument("--peers-python", metavar="PYTHON", help="has OpenCV's contrib build")
    parser.add_argument("--models", metavar="FOLDER", help="NanoTrack's two model files")
    parser.add_argument("--looks", type=Path, default=LOOKS)
    parser.add_argument("--passes", type=Path, metavar="FILE", help="write every pass, a JSON object a line")
    options = parser.parse_args()
    strata = {name: STRATA[name] for name in options.strata.split(",") if name in STRATA}
    if len(strata) < len(options.strata.split(",")):
        parser.error(f"--strata {options.strata}: allowed are {', '.join(STRATA)}")
    on_one_thread()
    names = sorted({name for of_stratum in strata.values() for name in of_stratum})
    sequences = find_sequences(options.data, names, options.max_frames)
    if not sequences:
        raise SystemExit(f"{options.data}: none of the sequences is there")
    specs = [read_graph(name) for name in options.graphs.split(",")]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    shown = ", ".join(f"{name} {digest(spec)}" for name, spec in specs)
    look = {"half": options.strata, "graphs": shown, "seeds": str(seeds), "frames": options.max_frames}
    note(options.looks, **look, why=options.why)
    passes = []
    with ExitStack() as stack:
        made = run_all(specs, sequences, seeds, options.processes)
        if options.peers_python:
            elsewhere = stack.enter_context(Elsewhere(options.peers_python, options.models))
            peers = [name for name in options.peers.split(",") if name in elsewhere.trackers]
            made = chain(made, (elsewhere.run(name, one) for name in peers for one in sequences))
        for one in made:
            passes.append(one)
            if options.passes:
                with options.passes.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(one)) + "\n")
    print(environment(), file=sys.stderr)
    print("\n\n".join(report(passes, strata)))


if __name__ == "__main__":
    main()
