"""Cameras that are chosen beside all, in turn and at random: places, identities and the frames decoded.

    python benchmarks/choosing_cameras.py --seeds 201-204

Three cameras look at five people of the demo room (200 steps), whose detections are drawn; the tracker
associates by itself. In each step the cameras of the policy give theirs, as many as the budget pays; the
first step has all. "Error" is the mean distance of people and tracks, assigned one to one, that are less than
2 m apart; "rms" counts people without such a track as 2 m away.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.optimize import linear_sum_assignment

from bayesnet_track import DetectionsTracker
from bayesnet_track.evaluate.world import GroundPlaces, score_world
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.scenes.people import room, write_room

FAR_M = 2.0
STEPS = 200
POLICIES = (
    ("all", 1.0),
    ("in turn", 1 / 6),
    ("at random", 1 / 6),
    ("chosen", 1 / 6),
    ("in turn", 0.5),
    ("chosen", 0.5),
)

Chooser = Callable[[DetectionsTracker, int], Sequence[str]]


@dataclass(frozen=True)
class Cost:
    """Of one run: share of the frames that were decoded, errors in m, IDF1."""

    decoded: float
    error_m: float
    rms_m: float
    idf1: float


def chooser(policy: str, names: Sequence[str], share: float, seed: int) -> Chooser:
    """The cameras of each step."""
    rng, turn = np.random.default_rng(seed), itertools.cycle(names)

    def choose(tracker: DetectionsTracker, step: int) -> Sequence[str]:
        if policy == "all" or step == 0:
            return names
        if policy == "chosen":
            return list(tracker.choose_cameras())
        paid = share * len(names)
        count = int(paid * step + 1e-9) - int(paid * (step - 1) + 1e-9)
        if policy == "in turn":
            return [next(turn) for _ in range(count)]
        return list(rng.choice(names, count, replace=False))

    return choose


def track_room(policy: str, share: float, seed: int) -> Cost:
    """One run of the room."""
    with tempfile.TemporaryDirectory() as folder:
        graph, files, _ = write_room(Path(folder), "", seed)
        if policy == "chosen":
            budget = f"adapt: {{cost_per_step: {share * len(files):g}}}\ntargets:\n"
            graph.write_text(graph.read_text().replace("targets:\n", budget, 1))
        rows = {name: np.loadtxt(path, delimiter=",") for name, path in files.items()}
        tracker = DetectionsTracker(graph, fps=10)
    truth = next(iter(room("", seed).values())).paths[..., :2]  # (people, steps, 2)
    choose, decoded = chooser(policy, list(rows), share, seed), 0
    times, ids, places, errors = [], [], [], []
    for step in range(STEPS):
        cameras = choose(tracker, step)
        decoded += len(cameras)
        tracker.update({name: detected(rows[name], step) for name in cameras} or None)
        shown = [
            one for one in tracker.targets if "x_m" in one.state and one.status not in ("lost", "hidden")
        ]
        at = np.array([[one.state["x_m"], one.state["y_m"]] for one in shown]).reshape(-1, 2)
        errors.append(distances(truth[:, step], at))
        times += [step / 10] * len(shown)
        ids += [one.target for one in shown]
        places.append(at)
    true_times = np.repeat(np.arange(STEPS) / 10, len(truth))
    true_ids = [str(person) for person in range(len(truth))] * STEPS
    score = score_world(
        claimed(true_times, true_ids, truth.transpose(1, 0, 2).reshape(-1, 2)),
        claimed(np.array(times), ids, np.concatenate(places)),
    )
    of_all = np.concatenate(errors)
    error = float(of_all[of_all < FAR_M].mean())
    return Cost(decoded / STEPS / len(rows), error, float(np.sqrt((of_all**2).mean())), score.idf1)


def detected(rows: Floats, step: int) -> SimpleNamespace:
    """Detections of a step, of MOT rows."""
    found = rows[rows[:, 0] == step + 1]
    corners = np.column_stack([found[:, 2:4], found[:, 2:4] + found[:, 4:6]])
    return SimpleNamespace(xyxy=corners, confidence=found[:, 6], data={})


def distances(truth: Floats, places: Floats) -> Floats:
    """(P,) m from each person to its place; `FAR_M` without one."""
    away = np.linalg.norm(truth[:, None] - places[None], axis=2).reshape(len(truth), len(places))
    away = np.minimum(away, FAR_M)
    errors = np.full(len(truth), FAR_M)
    people, tracks = linear_sum_assignment(away)
    errors[people] = away[people, tracks]
    return errors


def claimed(times: Floats, ids: Sequence[str], points: Floats) -> GroundPlaces:
    """Places without covariances."""
    return GroundPlaces(times, ids, points, np.full((len(points), 2, 2), np.nan))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", default="201-204", help="FIRST-LAST")
    first, last = map(int, parser.parse_args().seeds.split("-"))
    print("| | decoded | error, m | by seed | rms, m | IDF1 |\n|---|---:|---:|---|---:|---:|")
    for policy, share in POLICIES:
        costs = [track_room(policy, share, seed) for seed in range(first, last + 1)]
        decoded, error, rms, idf1 = (
            float(np.mean([getattr(cost, name) for cost in costs]))
            for name in ("decoded", "error_m", "rms_m", "idf1")
        )
        by_seed = " ".join(f"{cost.error_m:.3f}" for cost in costs)
        print(
            f"| {policy} | {decoded:.3f} | {error:.4f} | {by_seed} | {rms:.3f} | {100 * idf1:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
