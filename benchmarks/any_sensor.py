"""Ships by radar and by reported places, simulated: what `radar_crowd` finds of them.

    python benchmarks/any_sensor.py [--seeds 20] [--ships 10] [--false 5]

For each way of tracking: the share of ship-seconds with a target within 30 m of the ship, targets a second
without a ship there, changes of a ship's number, and the root mean square distance. Ways: both sensors, the
radar alone, the reports alone, and both with the best assignment instead of probabilities.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from bayesnet_track import DetectionsTracker
from bayesnet_track.graph.text.load import load_graph

STATION = np.array([200.0, -300.0])
SECONDS, NEAR_M, DETECTED = 120, 30.0, 0.9


def simulate(seed: int, ships: int, false: float) -> tuple[np.ndarray, list[dict[str, np.ndarray]]]:
    """(S, T, 2) places of ships, and sensor -> (N, 2) measurements for each second."""
    rng = np.random.default_rng(seed)
    start, speed = rng.uniform(-900, 900, (ships, 2)), rng.normal(0, 5, (ships, 2))
    turns = np.cumsum(rng.normal(0, 0.3, (SECONDS, ships, 2)), axis=0)
    places = start + np.cumsum(speed + turns, axis=0)
    looks: list[dict[str, np.ndarray]] = []
    for second, at in enumerate(places):
        look = {}
        if second % 2 == 0:
            away = at - STATION
            polar = np.stack([np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])], axis=1)
            polar += rng.normal(size=polar.shape) * [8.0, 0.01]
            extra = rng.uniform([0, -np.pi], [2000, np.pi], (rng.poisson(false), 2))
            look["radar"] = np.concatenate([polar[rng.random(ships) < DETECTED], extra])
            look["radar"][:, 1] = (look["radar"][:, 1] + np.pi) % (2 * np.pi) - np.pi
        if second % 5 == 0:
            reports = at + rng.normal(0, 10, at.shape)
            extra = rng.uniform(-2000, 2000, (rng.poisson(false / 5), 2))
            look["report"] = np.concatenate([reports[rng.random(ships) < DETECTED], extra])
        looks.append(look)
    return places, looks


def graph(associate: str) -> Any:
    """`radar_crowd` with this association."""
    written = load_graph("radar_crowd").spec.model_dump(exclude_unset=True)
    written["targets"]["ship"]["associate"] = associate
    return load_graph(written)


def score(tracker: DetectionsTracker, places: np.ndarray, looks: list[dict[str, np.ndarray]]) -> list[float]:
    """Share found, targets without a ship a second, changes of number, rms distance (m)."""
    columns = {"radar": ("range", "bearing"), "report": ("east", "north")}
    found, extra, changes, squares = 0, 0, 0, list[float]()
    known: dict[int, str] = {}
    for second, (at, look) in enumerate(zip(places, looks, strict=True)):
        given = {name: dict(zip(columns[name], z.T, strict=True)) for name, z in look.items()}
        tracker.update(given, time_s=second / 25)
        held = [one for one in tracker.targets if one.status != "lost"]
        if second < 20:
            continue
        spots = np.array([one.centre_box[:2] for one in held]).reshape(-1, 2)
        away = np.hypot(*np.moveaxis(at[:, None] - spots[None], 2, 0))
        pairs = [
            (ship, row)
            for ship, row in zip(*linear_sum_assignment(away), strict=True)
            if away[ship, row] < NEAR_M
        ]
        found, extra = found + len(pairs), extra + len(held) - len(pairs)
        for ship, row in pairs:
            squares.append(away[ship, row] ** 2)
            changes += known.get(ship, held[row].target) != held[row].target
            known[ship] = held[row].target
    counted = len(places) - 20
    share = found / (counted * places.shape[1])
    rms = float(np.sqrt(np.mean(squares))) if squares else float("nan")
    return [share, extra / counted, changes, rms]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--ships", type=int, default=10)
    parser.add_argument("--false", type=float, default=5.0)
    options = parser.parse_args()
    ways = {
        "both, by probability": ("marginal", {"radar", "report"}),
        "radar alone": ("marginal", {"radar"}),
        "reports alone": ("marginal", {"report"}),
        "both, best assignment": ("assignment", {"radar", "report"}),
    }
    print("| sensors | found | extra targets | changes of number | rms, m |")
    for way, (associate, used) in ways.items():
        rows = []
        for seed in range(options.seeds):
            places, looks = simulate(seed, options.ships, options.false)
            kept = [{name: z for name, z in look.items() if name in used} for look in looks]
            rows.append(score(DetectionsTracker(graph(associate)), places, kept))
        mean = np.mean(rows, axis=0)
        print(f"| {way} | {mean[0]:.3f} | {mean[1]:.2f} | {mean[2]:.1f} | {mean[3]:.1f} |", flush=True)


if __name__ == "__main__":
    main()
