"""Stone-Soup's GOSPA and OSPA of random tracks: the peer of `benchmarks/gospa_crosscheck.py`.

    python benchmarks/gospa_peers.py < cases.json

Runs in an environment with `stonesoup` and needs nothing else of the project. Reads a list of cases: truth
and tracks as rows (frame, identity, x, y), cut-off and order. Prints a JSON object: the version, and of each
case the figures.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Iterable, Sequence
from datetime import datetime, timedelta
from importlib.metadata import version
from typing import Any

import numpy as np
from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
from stonesoup.types.groundtruth import GroundTruthPath
from stonesoup.types.state import State
from stonesoup.types.track import Track

START = datetime(2000, 1, 1)


def at(frame: float) -> datetime:
    """The time of a frame, one a second."""
    return START + timedelta(seconds=int(frame))


def paths(rows: Iterable[Sequence[float]], kind: type) -> dict[int, Any]:
    """Paths by identity."""
    states: dict[int, list[State]] = defaultdict(list)
    for frame, identity, x, y in sorted(rows):
        states[int(identity)].append(State(np.array([[x], [y]]), timestamp=at(frame)))
    return {identity: kind(own) for identity, own in states.items()}


def gospa(truth: dict[int, Any], tracks: dict[int, Any], c: float, p: float) -> list[dict[str, float]]:
    """Stone-Soup's GOSPA of every frame with a state."""
    metric = GOSPAMetric(c=c, p=p)
    found = metric.compute_over_time(
        *metric.extract_states(tracks.values(), True), *metric.extract_states(truth.values(), True)
    )
    several = found.value if isinstance(found.value, list) else [found]
    return [{name: float(value) for name, value in one.value.items()} for one in several]


def ospa2(truth: dict[int, Any], tracks: dict[int, Any], c: float) -> float:
    """OSPA(2) of order 1 by Stone-Soup's OSPA, used for the base distance and once more for the sets."""
    metric = OSPAMetric(c=c, p=1)

    def apart(a: Any, b: Any) -> float:
        sides = [{one.timestamp: one for one in path} for path in (a, b)]
        times = sides[0].keys() | sides[1].keys()
        return float(
            np.mean(
                [
                    metric.compute_OSPA_distance(*([side[t]] if t in side else [] for side in sides)).value
                    for t in times
                ]
            )
        )

    left, right = list(tracks.values()), list(truth.values())
    costs = np.array([[apart(a, b) for b in right] for a in left])
    numbered = [[State(np.array([[k]]), timestamp=START) for k in range(len(side))] for side in (left, right)]
    whole = OSPAMetric(c=c, p=1, measure=lambda a, b: costs[int(a.state_vector[0]), int(b.state_vector[0])])
    return float(whole.compute_OSPA_distance(*numbered).value)


def figures(case: dict[str, Any]) -> dict[str, Any]:
    """All figures of a case."""
    truth, tracks = paths(case["truth"], GroundTruthPath), paths(case["tracks"], Track)
    return {
        "gospa": gospa(truth, tracks, case["c"], case["p"]),
        "ospa2": ospa2(truth, tracks, case["c"]),
    }


def main() -> None:
    """Print the figures of the cases on the standard input."""
    cases = json.load(sys.stdin)
    print(json.dumps({"stonesoup": version("stonesoup"), "figures": [figures(one) for one in cases]}))


if __name__ == "__main__":
    main()
