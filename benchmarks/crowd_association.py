"""GOSPA of `jpda`, the assignment with existence, `kalman_detections` and peers on simulated crowds.

    python benchmarks/crowd_association.py [--seeds 100-119] [--sort-python P] [--stonesoup-python P]

The crowds are those of `simulate_crowd.py` with its defaults (1280x720 px, 300 frames, ten people who wander,
four crossings, two pairs side by side). Every tracker sees the same detections of the same seeds. A track
counts in every frame in which its tracker reports it: ours where the target is not lost (as in `tracks.txt`),
SORT where it gives a number, Stone-Soup's JPDA where a track was updated at least three times. GOSPA has
c = 50 px, p = 2 and alpha = 2, over box centres. Differences are paired by seeds, with 95 % intervals of
their mean. "Without overlaps" does not expect that one person hides another.

Settings of the graphs and the method were chosen on seeds 0 to 19; report on others.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from crowd_peers import STONE_SOUP, ask, rows_of
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import Outcome, State, make_engine, step
from bayesnet_track.evaluate.gospa import gospa
from bayesnet_track.evaluate.truth import Tracks, pair
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.detector import Detector
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.detection_files import FileDetector
from simulated.crowd_detector import DetectorSettings, detect_crowd
from simulated.walkers import Crowd, CrowdSettings, make_crowd

Floats = NDArray[np.float64]

CELLS: dict[str, dict[str, Any]] = {
    f"{100 * missed:.0f} % missed, clutter {clutter:g}": {"missed": missed, "clutter": clutter}
    for missed in (0.1, 0.3)
    for clutter in (0.5, 5.0, 20.0)
}
CELLS["merging, 10 % missed, clutter 5"] = {"missed": 0.1, "clutter": 5.0, "merging": "front"}
RUNS = {"missed": 0.05, "blind": 0.15, "blind_frames": 6.0}
CELLS["runs of misses, clutter 1"] = RUNS | {"clutter": 1.0}
CELLS["runs of misses and of false boxes"] = RUNS | {"clutter": 0.5, "doubles": 0.02, "spots": 0.1}
CELLS["the same, twice as many, merging"] = RUNS | {
    "clutter": 0.5,
    "blind": 0.25,
    "doubles": 0.04,
    "spots": 0.2,
    "merging": "front",
}
NO_OVERLAPS = {"covered": 0.99}
"""Covered targets are detected as surely as others: at most as surely as in the open."""

NEAR_PX = 25.0
"""A track is of a person whose centre is so near, the nearest one."""

BEFORE, AFTER = (-30, -12), (12, 30)
"""Frames about a crossing in which identities are counted before and after it."""

TOGETHER = 25
"""Frames before and after the middle of a run side by side in which two tracks may collapse."""


@dataclass(frozen=True)
class Scores:
    """What one tracker reached in one crowd.

    Attributes:
        gospa: px.
        localisation: its parts, px.
        missed: of missed people.
        false: of false tracks.
        kept: share of people who have the same identity after a crossing as before.
        collapsed: share of frames side by side in which tracks are closer than half of the pair's distance.
    """

    gospa: float
    localisation: float
    missed: float
    false: float
    kept: float
    collapsed: float


def graphs(changes: dict[str, Any]) -> dict[str, CheckedGraph]:
    """Those that are compared; `changes` to the settings of existence."""
    found = {}
    for name, graph, associate, own in (
        ("jpda", "jpda", "marginal", {}),
        ("jpda without overlaps", "jpda", "marginal", NO_OVERLAPS),
        ("assignment with existence", "jpda", "assignment", {}),
        ("assignment without overlaps", "jpda", "assignment", NO_OVERLAPS),
        ("kalman_detections", "kalman_detections", None, {}),
    ):
        written = load_graph(graph).spec.model_dump(exclude_unset=True)
        (plate,) = written["targets"].values()
        plate["birth"]["detector"] = {"detections": {"max_count": 200, "max_overlap": 1.0}}
        if associate is not None:
            plate["associate"] = associate
            plate["existence"] |= changes | own
        found[name] = load_graph(written)
    return found


def reported(outcome: Outcome) -> list[tuple[int, Floats]]:
    """Identities and centre boxes of targets that are not lost."""
    ids, boxes = outcome.metrics.held()
    return [(int(target), box) for target, box in zip(ids, boxes, strict=True)]


def tracked(graph: CheckedGraph, detector: Detector, frames: int, size: tuple[int, int]) -> Tracks:
    """What a graph makes of detections."""
    engine = make_engine(graph, 0, detectors={"detections": detector})
    image, state = np.zeros((size[1], size[0], 3), np.uint8), None
    rows: list[tuple[int, int, Floats]] = []
    for index in range(frames):
        frame = Frame(index=index, time=float(index), time_s=index / 25, image=image)
        outcome = _advance(graph, engine, state, frame)
        state = outcome.state
        rows += [(index, target, box) for target, box in reported(outcome)]
    return tracks_of(rows)


def _advance(graph: CheckedGraph, engine: Any, state: State | None, frame: Frame) -> Outcome:
    return start_targets(graph, engine, frame, ()) if state is None else step(engine, state, frame)


def tracks_of(rows: Sequence[tuple[int, int, Floats]]) -> Tracks:
    """Frames, identities and centre boxes as tracks."""
    boxes = np.array([box for _, _, box in rows], dtype=np.float64).reshape(-1, 4)
    frames, ids = ([row[k] for row in rows] for k in (0, 1))
    return Tracks(np.array(frames, np.int64), np.array(ids, np.int64), corner_from_centre(boxes))


def truth_of(crowd: Crowd) -> Tracks:
    """The ground truth as tracks."""
    frames, people = np.nonzero(np.isfinite(crowd.boxes[:, :, 0]))
    return Tracks(frames, people, corner_from_centre(crowd.boxes[frames, people]))


def whose(crowd: Crowd, tracks: Tracks) -> dict[tuple[int, int], tuple[int, Floats]]:
    """(frame, person) -> identity and centre of the nearest track, one to one, within `NEAR_PX`."""
    centres = tracks.boxes[:, :2] + tracks.boxes[:, 2:] / 2
    found = {}
    for frame in range(len(crowd.boxes)):
        own = np.flatnonzero(tracks.frames == frame)
        people = np.flatnonzero(np.isfinite(crowd.boxes[frame, :, 0]))
        apart = np.linalg.norm(crowd.boxes[frame, people][:, None, :2] - centres[own][None], axis=2)
        order = np.argsort(apart, axis=None)
        free = np.ones(len(people), bool), np.ones(len(own), bool)
        for row, column in zip(*np.unravel_index(order, apart.shape), strict=True):
            if apart[row, column] > NEAR_PX:
                break
            if free[0][row] and free[1][column]:
                free[0][row] = free[1][column] = False
                found[frame, int(people[row])] = int(tracks.ids[own[column]]), centres[own[column]]
    return found


def most_frequent(held: dict[tuple[int, int], tuple[int, Floats]], person: int, frames: range) -> int | None:
    """The identity that a person has in most of the frames."""
    ids = [held[frame, person][0] for frame in frames if (frame, person) in held]
    return max(set(ids), key=ids.count) if ids else None


def score(crowd: Crowd, tracks: Tracks) -> Scores:
    """The scores of tracks."""
    found = gospa(pair(truth_of(crowd), tracks))
    held, kept, near = whose(crowd, tracks), [], []
    for one in crowd.encounters:
        if one.kind == "crossing":
            for person in (one.first, one.second):
                spans = (range(one.frame + a, one.frame + b) for a, b in (BEFORE, AFTER))
                before, after = (most_frequent(held, person, span) for span in spans)
                if before is not None:
                    kept.append(before == after)
            continue
        for frame in range(one.frame - TOGETHER, one.frame + TOGETHER):
            both = [held.get((frame, person)) for person in (one.first, one.second)]
            true = crowd.boxes[frame, [one.first, one.second], :2]
            if both[0] is not None and both[1] is not None:
                apart = np.linalg.norm(both[0][1] - both[1][1])
                near.append(bool(apart < np.linalg.norm(true[0] - true[1]) / 2))
    parts = found.total_px, found.localisation_px, found.missed_px, found.false_px
    return Scores(*parts, float(np.mean(kept)), float(np.mean(near)) if near else 0.0)


def ask_peer(
    python: str, name: str, cells: list[Any], crowds: list[Crowd], settings: DetectorSettings
) -> list[Scores]:
    """The scores of a peer that runs elsewhere."""
    sequences = [[rows_of(frame.detections) for frame in one] for one in cells]
    size = [crowds[0].settings.width, crowds[0].settings.height]
    known = {"detected": 1.0 - settings.missed, "clutter": settings.clutter}
    answer = ask(python, [name], sequences, size=size, **known)
    return [
        score(crowd, tracks_of([row for k, one in enumerate(of[name]["tracks"]) for row in as_rows(k, one)]))
        for crowd, of in zip(crowds, answer["figures"], strict=True)
    ]


def as_rows(frame: int, tracks: list[list[float]]) -> list[tuple[int, int, Floats]]:
    """Frame, identity and centre box of each track of a frame."""
    found = np.array(tracks, float).reshape(-1, 5)
    boxes = np.hstack([(found[:, 1:3] + found[:, 3:]) / 2, found[:, 3:] - found[:, 1:3]])
    return [(frame, int(number), box) for number, box in zip(found[:, 0], boxes, strict=True)]


def interval(values: Sequence[float]) -> str:
    """Mean and half of a 95 % interval of it."""
    half = 1.96 * float(np.std(values, ddof=1)) / len(values) ** 0.5 if len(values) > 1 else float("nan")
    return f"{np.mean(values):.2f} ± {half:.2f}"


def run_cell(name: str, seeds: Sequence[int], chosen: argparse.Namespace) -> list[list[str]]:
    """The lines of a cell."""
    crowds = [make_crowd(CrowdSettings(frames=chosen.frames), seed) for seed in seeds]
    detector = DetectorSettings(**CELLS[name])
    several = [detect_crowd(crowd, detector, seed) for crowd, seed in zip(crowds, seeds, strict=True)]
    changes = json.loads(chosen.existence)
    results: dict[str, list[Scores]] = {}
    for tracker, graph in graphs(changes).items():
        if tracker not in chosen.only.split(",") and chosen.only:
            continue
        results[tracker] = []
        for crowd, found in zip(crowds, several, strict=True):
            says = FileDetector({index: one.detections for index, one in enumerate(found)})
            size = crowd.settings.width, crowd.settings.height
            results[tracker].append(score(crowd, tracked(graph, says, len(crowd.boxes), size)))
    for tracker, python in (("SORT", chosen.sort_python), (STONE_SOUP, chosen.stonesoup_python)):
        if python:
            results[tracker] = ask_peer(python, tracker, several, crowds, detector)
    first = next(iter(results.values()))
    lines = []
    for tracker, scores in results.items():
        means = [float(np.mean([getattr(one, key) for one in scores])) for key in Scores.__annotations__]
        apart = [own.gospa - other.gospa for own, other in zip(scores, first, strict=True)]
        less = "" if scores is first else interval(apart)
        cells = [f"{value:.1f}" for value in means[:4]] + [f"{value:.2f}" for value in means[4:]]
        lines.append([name, tracker, cells[0], less, *cells[1:]])
    return lines


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", default="100-119", help="first and last seed")
    parser.add_argument("--frames", type=int, default=300, help="frames of each crowd")
    parser.add_argument("--cells", default="", help="numbers of cells, from 0; default all")
    parser.add_argument("--only", default="", help="graphs of ours; default all")
    parser.add_argument("--existence", default="{}", help="JSON: other settings of existence")
    parser.add_argument("--sort-python", help="interpreter of an environment with `trackers`")
    parser.add_argument("--stonesoup-python", help="interpreter of an environment with `stonesoup`")
    chosen = parser.parse_args()
    on_one_thread()
    print(f"{environment()}; load {os.getloadavg()[0]:.1f}", flush=True)
    low, high = (int(word) for word in chosen.seeds.split("-"))
    names = list(CELLS)
    if chosen.cells:
        names = [names[int(word)] for word in chosen.cells.split(",")]
    rows = [line for name in names for line in run_cell(name, range(low, high + 1), chosen)]
    head = ["detections", "tracker", "GOSPA [px]", "more than the first"]
    head += ["localisation", "missed", "false", "identities kept", "collapsed"]
    print(table(head, rows))


if __name__ == "__main__":
    main()
