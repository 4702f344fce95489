"""What the boxes of a graph lose on real sequences: by their centre, area and shape.

    python benchmarks/real_video_errors.py DATA_FOLDER --half A --why WORDS
        [--graph general] [--seeds 1] [--first-seed 1] [--max-frames 150] [--looks FILE]

The success AUC of every frame's own box, and what it would be if a part of each box were the true one. Last,
the size of the first box around the true centres: what a tracker has that follows no size. Every call adds a
line to the file of looks.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray
from real_video_coin import HALVES
from real_video_halves import note
from sequences import find_sequences, track

from bayesnet_track import Tracker
from bayesnet_track.evaluate.scores import success_auc
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

Floats = NDArray[np.float64]


def _sized(centres: Floats, area: Floats, aspect: Floats) -> Floats:
    """Centre boxes (n, 4) with these areas and ratios of width to height."""
    return np.column_stack([centres[:, :2], np.sqrt(area * aspect), np.sqrt(area / aspect)])


def replaced(boxes: Floats, truth: Floats) -> dict[str, Floats]:
    """What is true -> centre boxes (n, 4) with that part of `truth` (n, 4) in place of their own."""
    area, true_area = boxes[:, 2] * boxes[:, 3], truth[:, 2] * truth[:, 3]
    aspect, true_aspect = boxes[:, 2] / boxes[:, 3], truth[:, 2] / truth[:, 3]
    return {
        "nothing": boxes,
        "centre": np.column_stack([truth[:, :2], boxes[:, 2:]]),
        "size": np.column_stack([boxes[:, :2], truth[:, 2:]]),
        "area": _sized(boxes, true_area, aspect),
        "aspect": _sized(boxes, area, true_aspect),
        "centre; first size": np.column_stack([truth[:, :2], np.tile(truth[0, 2:], (len(truth), 1))]),
    }


def aucs(boxes: Floats, truth: Floats) -> dict[str, float]:
    """The success AUC of each of `replaced`, over the frames in which the target is there."""
    present = np.isfinite(truth).all(axis=1) & (truth[:, 2:] > 0).all(axis=1)
    with_part = replaced(boxes[present], truth[present])
    return {what: success_auc(overlap(changed, truth[present])) for what, changed in with_part.items()}


def main() -> None:
    """Run the graph over a half and print a row per sequence."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--half", choices=("A", "B"), required=True)
    parser.add_argument("--why", required=True, help="what the look is for; goes into the record")
    parser.add_argument("--graph", default="general")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--max-frames", type=int, default=150)
    parser.add_argument("--looks", type=Path, default=Path(__file__).with_name("real_video_looks.jsonl"))
    options = parser.parse_args()
    on_one_thread()
    spec = load_graph(options.graph).spec
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    look = {"half": options.half, "graphs": options.graph, "seeds": str(seeds), "frames": options.max_frames}
    note(options.looks, **look, why=options.why)
    means: dict[str, dict[str, float]] = {}
    for sequence in find_sequences(options.data, list(HALVES[options.half]), options.max_frames):
        truth = centre_from_corner(np.asarray(sequence.truth, dtype=np.float64))
        passes = [track(Tracker(spec, seed), sequence) for seed in seeds]
        found = [aucs(centre_from_corner(np.asarray(one.boxes)), truth) for one in passes]
        means[sequence.name] = {what: float(np.mean([one[what] for one in found])) for what in found[0]}
    if not means:
        raise SystemExit(
            f"{options.data}: no NAME/img/*.jpg with NAME/groundtruth.txt of half {options.half}"
        )
    columns = list(next(iter(means.values())))
    means["mean"] = {what: float(np.mean([one[what] for one in means.values()])) for what in columns}
    rows = [[name, *(f"{one[what]:.3f}" for what in columns)] for name, one in means.items()]
    print(environment(), file=sys.stderr)
    print(table(["AUC if this were true", *columns], rows))


if __name__ == "__main__":
    main()
