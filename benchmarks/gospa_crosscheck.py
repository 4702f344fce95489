"""GOSPA and OSPA(2) beside Stone-Soup's figures of the same random tracks.

    python benchmarks/gospa_crosscheck.py --python PYTHON [--cases 100]

PYTHON is the interpreter of an environment with `stonesoup`. Targets walk at random in a square; tracks are
these with noise, cut at random into pieces with numbers of their own, with exchanged numbers, and clutter.
Ends with exit code 1 when a figure differs by more than 1e-9.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measuring import table
from numpy.typing import NDArray

from bayesnet_track.evaluate.gospa import gospa
from bayesnet_track.evaluate.mot_pairs import Pairs, Tracks, pair
from bayesnet_track.evaluate.ospa2 import ospa2

Floats = NDArray[np.float64]

TOLERANCE = 1e-9
ORDERS = (1.0, 2.0, 3.0)
CUTOFF = 20.0


def drawn(seed: int) -> tuple[Floats, Floats]:
    """Targets and tracks as rows (frame, identity, x, y)."""
    rng = np.random.default_rng(seed)
    frames, targets = int(rng.integers(5, 40)), int(rng.integers(1, 8))
    noise, cut, swap = rng.uniform(0, 8), rng.uniform(0, 0.2), rng.uniform(0, 0.1)
    side = rng.uniform(30, 150)
    paths = rng.uniform(0, side, (targets, 1, 2)) + rng.normal(0, 4, (targets, frames, 2)).cumsum(axis=1)
    born = rng.integers(0, frames // 2, targets)
    gone = rng.integers(born + 2, frames + 1)
    truth, found, names, fresh = [], [], np.arange(targets), targets
    for frame in range(frames):
        alive = np.flatnonzero((born <= frame) & (frame < gone))
        if len(alive) > 1 and rng.random() < swap:
            a, b = rng.choice(alive, 2, replace=False)
            names[[a, b]] = names[[b, a]]
        for one in alive:
            truth.append((frame, one, *paths[one, frame]))
            if rng.random() < cut:
                names[one], fresh = fresh, fresh + 1
                continue  # a frame missed, and a new number from then on
            found.append((frame, names[one], *(paths[one, frame] + rng.normal(0, noise, 2))))
    for _ in range(rng.integers(0, 6)):
        first, place = int(rng.integers(0, frames)), rng.uniform(0, side, 2)
        last = int(rng.integers(first, frames)) + 1
        found += [(frame, fresh, *(place + rng.normal(0, 4, 2))) for frame in range(first, last)]
        fresh += 1
    return np.array(truth, dtype=np.float64), np.array(found, dtype=np.float64).reshape(-1, 4)


def tracks_of(rows: Floats) -> Tracks:
    """As boxes of 1 px."""
    boxes = np.column_stack([rows[:, 2:], np.ones((len(rows), 2))])
    return Tracks(rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64), boxes)


def case(seed: int, sides: tuple[Floats, Floats]) -> dict[str, Any]:
    """The tracks, cut-off and order for Stone-Soup."""
    truth, tracks = (side.tolist() for side in sides)
    return {"truth": truth, "tracks": tracks, "c": CUTOFF, "p": ORDERS[seed % len(ORDERS)]}


def differences(pairs: Pairs, order: float, other: Mapping[str, Any]) -> dict[str, float]:
    """Figure -> how far it is from Stone-Soup's."""
    ours, share = gospa(pairs, CUTOFF, order), CUTOFF**order / 2
    sums = {name: sum(one[name] for one in other["gospa"]) for name in ("localisation", "missed", "false")}
    total = (sum(one["distance"] ** order for one in other["gospa"]) / pairs.length) ** (1 / order)
    return {
        "GOSPA": abs(ours.total_px - total),
        "localisation": abs(ours.localisation - sums["localisation"]) / max(sums["localisation"], 1.0),
        "missed": abs(ours.missed - sums["missed"] / share),
        "false": abs(ours.false - sums["false"] / share),
        "OSPA(2), p = 1": abs(ospa2(pairs, CUTOFF, 1.0) - other["ospa2"]),
    }


def spread(name: str, cases: Sequence[Mapping[str, float]]) -> list[str]:
    """In how many cases a figure differs, and by how much at most."""
    values = [one[name] for one in cases]
    return [str(sum(value > TOLERANCE for value in values)), f"{max(values):.2g}"]


def main() -> int:
    """Print the table; the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--python", required=True, help="interpreter of an environment with stonesoup")
    parser.add_argument("--cases", type=int, default=100, help="how many random cases")
    options = parser.parse_args()
    sides = [drawn(seed) for seed in range(options.cases)]
    sides = [one for one in sides if len(one[1])]
    pairs = [pair(*(tracks_of(rows) for rows in one)) for one in sides]
    cases = [case(seed, one) for seed, one in enumerate(sides)]
    script = str(Path(__file__).with_name("gospa_peers.py"))
    answer = subprocess.run(
        [options.python, script], input=json.dumps(cases), capture_output=True, text=True, check=True
    )
    theirs = json.loads(answer.stdout)
    triples = list(zip(pairs, cases, theirs["figures"], strict=True))
    apart = [differences(one, given["p"], other) for one, given, other in triples]
    print(
        table(
            ["figure", "cases that differ", "by at most"], [[name, *spread(name, apart)] for name in apart[0]]
        )
    )
    largest = max(max(one.values()) for one in apart)
    print(f"\nStone-Soup {theirs['stonesoup']}, {len(cases)} cases; the largest difference is {largest:.2g}")
    return int(largest > TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
