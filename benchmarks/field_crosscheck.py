"""The graphs `sort`, `bytetrack` and `oc_sort` beside the package `trackers`: agreement and speed.

    python benchmarks/field_crosscheck.py --peers-python PEERS/bin/python --data FOLDER [--sequences A,B]

FOLDER holds files of detections in MOT format, one a sequence. Agreement is IDF1 of one output against the
other, after a one-to-one matching of identities over the whole sequence. One rule of reporting for both: a
target has a box, the detection that it was given, in frames in which it was given one; of OC-SORT only from
the third such frame on end after a gap, as the package reports. OC-SORT is compared with the package's filter
of corners, whose state is the graph's, and with its default, a filter of area and aspect.

Frames per second are of CPU time on one thread, of the frames after the thirtieth, of the same call: `update`
of the peers and of our `DetectionsTracker`, which gives every detection its target. No pixel is read, no file
written. "Places of five" are those of each graph among itself, SORT, ByteTrack, OC-SORT and norfair.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from crowd_peers import FIELD, ask, rows_of
from measuring import environment, on_one_thread, table

from bayesnet_track import DetectionsTracker
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import Outcome, make_engine, step
from bayesnet_track.engine.targets import Targets
from bayesnet_track.evaluate.mot import score_mot_files
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.boxes import xyxy_from_centre
from bayesnet_track.observation.cue import OWN_DETECTION
from bayesnet_track.observation.detector import NOTHING
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.detection_files import FileDetector, file_detector

WARM_UP = 30
PAIRS = (
    ("sort", "SORT"),
    ("bytetrack", "ByteTrack"),
    ("oc_sort", "OC-SORT, corners"),
    ("oc_sort", "OC-SORT"),
)
FOUR = ("SORT", "ByteTrack", "OC-SORT", "norfair")
STREAK = {"oc_sort": 3}
"""Graph -> frames in a row with a detection, after a gap, from which on a target is reported."""
SIZE = (1920, 1080)

Tracks = list[list[list[float]]]
"""For every frame: id, left, top, right, bottom."""


def own_box(outcome: Outcome, line: FrameMetrics) -> list[float]:
    """The detection that a target was given, as left, top, right, bottom; its box where it starts."""
    state = outcome.state.targets[line.target]
    own = state.references["seen"].get(OWN_DETECTION, np.empty((0, 5)))
    box = own[0, :4] if len(own) else np.array(line.centre_box)
    return [float(value) for value in xyxy_from_centre(box)]


def ours(name: str, detector: FileDetector, count: int) -> tuple[Tracks, int]:
    """Tracks, and frames that went as rows."""
    graph = load_graph(name)
    engine = make_engine(graph, 0, detectors={"detections": detector})
    image, outcome = np.zeros((SIZE[1], SIZE[0], 3), np.uint8), None
    tracks: Tracks = []
    rows = 0
    for index in range(count):
        frame = Frame(index=index, time=float(index), time_s=index / 25, image=image)
        if outcome is None:
            outcome = start_targets(graph, engine, frame, ())
        else:
            outcome = step(engine, outcome.state, frame)
        rows += bool(Targets.of(outcome.state.targets).gaussians)
        live = [one for one in outcome.metrics if not one.silent and one.target in outcome.state.targets]
        tracks.append([[float(one.target), *own_box(outcome, one)] for one in live])
    return tracks, rows


def updates(name: str, detector: FileDetector, count: int) -> list[float]:
    """Seconds of each update."""
    tracker, seconds = DetectionsTracker(name, SIZE), []
    for index in range(count):
        found = detector.found.get(index, NOTHING)
        given = SimpleNamespace(xyxy=xyxy_from_centre(found.boxes), confidence=found.scores)
        started = time.process_time()
        tracker.update(given)
        seconds.append(time.process_time() - started)
    return seconds


def reported(tracks: Tracks, least: int) -> Tracks:
    """Without the first boxes after a gap, fewer than `least` frames on end; those of a start are kept."""
    before: dict[float, int] = {}
    known: set[float] = set()
    left = []
    for frame in tracks:
        before = {one[0]: before.get(one[0], 0) + 1 if one[0] in known else least for one in frame}
        known |= before.keys()
        left.append([one for one in frame if before[one[0]] >= least])
    return left


def idf1(own: Tracks, theirs: Tracks, folder: Path) -> float:
    """IDF1 of one output against the other."""
    for name, tracks in (("own", own), ("theirs", theirs)):
        lines = [
            f"{index + 1},{one[0] + 1:.0f},{one[1]},{one[2]},{one[3] - one[1]},{one[4] - one[2]},1,1,1\n"
            for index, frame in enumerate(tracks)
            for one in frame
        ]
        (folder / name).write_text("".join(lines))
    return float(score_mot_files(str(folder / "own"), str(folder / "theirs")).idf1)


def rate(seconds: Sequence[float]) -> float:
    """Frames per second of CPU time."""
    return len(seconds[WARM_UP:]) / sum(seconds[WARM_UP:])


def places(own: dict[str, float], others: dict[str, float]) -> str:
    """The place of each of our graphs among itself and the four peers."""
    return ", ".join(str(1 + sum(others[peer] > value for peer in FOUR)) for value in own.values())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--peers-python", required=True, help="environment with trackers and norfair")
    parser.add_argument("--data", required=True, type=Path, help="folder of MOT files of detections")
    parser.add_argument("--sequences", default="MOT17-04,MOT17-05,MOT17-09,MOT20-01", help="names of files")
    chosen = parser.parse_args()
    on_one_thread()
    print(f"{environment()}; load {os.getloadavg()[0]:.1f}")
    agreement, speed, names = [], [], []
    for sequence in chosen.sequences.split(","):
        detector = file_detector(chosen.data / f"{sequence}.txt")
        count = max(detector.found) + 1
        rows = [rows_of(detector.found.get(index, NOTHING)) for index in range(count)]
        answer, names = ask(chosen.peers_python, FIELD, [rows]), [*FIELD]
        figures = answer["figures"][0]
        own = {name: ours(name, detector, count) for name in dict.fromkeys(name for name, _ in PAIRS)}
        with tempfile.TemporaryDirectory() as folder:
            for name, other in PAIRS:
                tracks = reported(own[name][0], STREAK.get(name, 1))
                value = idf1(tracks, figures[other]["tracks"], Path(folder))
                agreement.append([sequence, name, other, f"{value:.4f}", f"{own[name][1]} of {count}"])
        rates = {name: rate(updates(name, detector, count)) for name in own}
        others = {name: rate(figures[name]["seconds"]) for name in names}
        speed.append(
            [
                sequence,
                *(f"{value:.0f}" for value in (rates | others).values()),
                places(rates, others),
                f"{os.getloadavg()[0]:.1f}",
            ]
        )
        print(f"{sequence}: {answer['versions']}", flush=True)
    print(table(["sequence", "graph", "reference", "IDF1", "frames as rows"], agreement))
    print(table(["frames/s", "sort", "bytetrack", "oc_sort", *names, "places of five", "load"], speed))


if __name__ == "__main__":
    main()
