"""Whole sequences by strata: those that settings were chosen on apart from those that nobody had tuned on.

    python benchmarks/real_video_whole.py DATA_FOLDER --graphs general --first-seed 201 --seeds 3 --why WORDS
        [--peers CSRT,NanoTrack,KCF --peers-python PYTHON --models FOLDER] [--looks FILE] [--passes FILE]

Every tracker makes one pass over all frames from the first true box; every sequence weighs the same. Of each
stratum the means are printed, and differences with 95 % intervals of a paired bootstrap over sequences; then
every sequence.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
from measuring import environment, on_one_thread, table
from real_video import Elsewhere, digest
from real_video_coin import NEW, OLD
from real_video_frames import Pass
from real_video_halves import note, read_graph, run_all, run_peer
from sequences import find_sequences

CHOSEN_ON = (*OLD, *NEW)
UNTUNED = (
    "dtb_Surfing06",
    "otb_Coke",
    "otb_MountainBike",
    "otb_Skating1",
    "otb_Soccer",
    "otb_Suv",
    "uav_bike1",
    "uav_building4",
    "uav_building5",
    "uav_car14",
    "uav_person11",
    "uav_wakeboard4",
    "uav_wakeboard5",
)
"""On these nothing had been chosen or fitted by the end of version 0.2."""
STRATA = {"chosen on": CHOSEN_ON, "untuned": UNTUNED}
DRAWS = 10_000


def means_of(passes: list[Pass]) -> dict[str, dict[str, float]]:
    """Tracker -> sequence -> mean success AUC over seeds."""
    found: dict[str, dict[str, list[float]]] = {}
    for one in passes:
        found.setdefault(one.tracker, {}).setdefault(one.sequence, []).append(one.auc)
    return {
        tracker: {name: float(np.mean(values)) for name, values in by_name.items()}
        for tracker, by_name in found.items()
    }


def describe_difference(first: dict[str, float], second: dict[str, float], names: list[str]) -> str:
    """Mean difference over the sequences with its 95 % interval, and on how many the first is ahead."""
    each = np.array([first[name] - second[name] for name in names])
    drawn = each[np.random.default_rng(0).integers(len(each), size=(DRAWS, len(each)))].mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return f"{each.mean():+.3f} [{low:+.3f}, {high:+.3f}], ahead on {int((each > 0).sum())} of {len(each)}"


def report(passes: list[Pass]) -> Iterator[str]:
    """The tables."""
    found = means_of(passes)
    trackers = list(found)
    strata = {
        stratum: [name for name in names if all(name in found[one] for one in trackers)]
        for stratum, names in STRATA.items()
    }
    head = ["success AUC", *(f"{stratum} ({len(names)})" for stratum, names in strata.items())]
    rows = [
        [one, *(f"{np.mean([found[one][name] for name in names]):.3f}" for names in strata.values())]
        for one in trackers
    ]
    yield table(head, rows)
    pairs = [(first, second) for k, first in enumerate(trackers) for second in trackers[k + 1 :]]
    rows = [
        [
            f"{first} - {second}",
            *(describe_difference(found[first], found[second], n) for n in strata.values()),
        ]
        for first, second in pairs
    ]
    yield table(["difference", *strata], rows)
    rows = [
        [name, stratum, *(f"{found[one][name]:.3f}" for one in trackers)]
        for stratum, names in strata.items()
        for name in names
    ]
    yield table(["sequence", "stratum", *trackers], rows)


def main() -> None:
    """Run what was asked for, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graphs", default="general", help="names or files, with commas")
    parser.add_argument("--why", required=True, help="what the look is for; goes into the record")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--peers", default="CSRT,NanoTrack,KCF")
    parser.add_argument("--peers-python", metavar="PYTHON", help="has OpenCV's contrib build")
    parser.add_argument("--models", metavar="FOLDER", help="NanoTrack's two model files")
    parser.add_argument("--looks", type=Path, default=Path(__file__).with_name("real_video_looks.jsonl"))
    parser.add_argument("--passes", type=Path, metavar="FILE", help="write every pass, a JSON object a line")
    options = parser.parse_args()
    on_one_thread()
    names = [name for stratum in STRATA.values() for name in stratum]
    sequences = find_sequences(options.data, names, None)
    if not sequences:
        raise SystemExit(f"{options.data}: none of the sequences is there")
    specs = [read_graph(name) for name in options.graphs.split(",")]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    shown = ", ".join(f"{name} {digest(spec)}" for name, spec in specs)
    note(options.looks, half="whole", graphs=shown, seeds=str(seeds), frames=None, why=options.why)
    passes = list(run_all(specs, sequences, seeds, options.processes))
    if options.peers_python:
        with Elsewhere(options.peers_python, [options.models] if options.models else []) as elsewhere:
            for name in options.peers.split(","):
                if name in elsewhere.trackers:
                    passes += [run_peer(elsewhere, name, one, 0) for one in sequences]
    if options.passes:
        with options.passes.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(asdict(one)) + "\n" for one in passes)
    print(environment(), file=sys.stderr)
    print("\n\n".join(report(passes)))


if __name__ == "__main__":
    main()
