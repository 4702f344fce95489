"""Each person of a MOT sequence as one target: `general` beside trackers of OpenCV.

    python benchmarks/each_person.py DATA/mot_TUD-Campus [--graphs general] [--seeds 3]
        [--peers CSRT,NanoTrack --peers-python PYTHON --models FOLDER]

A person is followed from the first true box to the last; those with fewer than 20 true boxes are left out.
Success AUC of each, means over seeds; while a target is lost, its last box counts.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from measuring import environment, on_one_thread, table
from real_video import Elsewhere
from real_video_halves import read_graph, run_graph, run_peer
from sequences import SUFFIXES, Sequence

from bayesnet_track.evaluate.mot_files import read_mot_truth

LEAST = 20


def people(folder: Path) -> list[Sequence]:
    """The targets of a MOT folder, each with the frames from its first to its last true box."""
    truth = read_mot_truth(folder / "gt" / "gt.txt")
    files = sorted(file for file in (folder / "img1").iterdir() if file.suffix.lower() in SUFFIXES)
    found = []
    for identity in np.unique(truth.ids):
        own = truth.ids == identity
        frames, boxes = truth.frames[own], truth.boxes[own]
        if len(frames) < LEAST:
            continue
        first, last = int(frames.min()), int(frames.max())
        rows = np.full((last - first + 1, 4), np.nan)
        rows[frames - first] = boxes
        found.append(Sequence(f"person {identity}", files[first : last + 1], rows))
    return found


def main() -> None:
    """Print a table with a row for each person."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graphs", default="general", help="names or files, with commas")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--peers", default="CSRT,NanoTrack")
    parser.add_argument("--peers-python", metavar="PYTHON", help="has OpenCV's contrib build")
    parser.add_argument("--models", metavar="FOLDER", help="NanoTrack's two model files")
    options = parser.parse_args()
    on_one_thread()
    sequences = people(options.data)
    figures: dict[str, list[float]] = {}
    for name, spec in map(read_graph, options.graphs.split(",")):
        figures[name] = [
            float(np.mean([run_graph(name, spec, one, seed).auc for seed in range(options.seeds)]))
            for one in sequences
        ]
    if options.peers_python:
        extra = [options.models] if options.models else []
        with Elsewhere(options.peers_python, extra) as elsewhere:
            for name in options.peers.split(","):
                if name in elsewhere.trackers:
                    figures[name] = [run_peer(elsewhere, name, one, 0).auc for one in sequences]
    rows = [
        [one.name, str(len(one.files)), *(f"{of[index]:.3f}" for of in figures.values())]
        for index, one in enumerate(sequences)
    ]
    rows.append(["mean", "", *(f"{np.mean(of):.3f}" for of in figures.values())])
    print(environment() + "\n")
    print(table(["", "frames", *figures], rows))


if __name__ == "__main__":
    main()
