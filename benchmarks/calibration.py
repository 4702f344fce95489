"""Is the score a probability, and do regions hold what they say? Leave-one-sequence-out, and two scenes.

    python benchmarks/calibration.py DATA_FOLDER [--graph general] [--seeds 1] [--max-frames 150]
                                     [--sequences Car1,Crossing] [--features log_ud_box,evidence]

DATA_FOLDER holds NAME/img/*.jpg and NAME/groundtruth.txt, as in benchmarks/sequences.py. The graph runs over
every sequence; then score and localization error are fitted to all sequences but one and judged on that one,
in turn (docs/calibration.md). Learning and statuses are those of the graph as it is. The scenes are run with
what is fitted to all sequences: how long is the target called tracked while the box is on something else?
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from measuring import Image, environment, on_one_thread
from sequences import find_sequences

from bayesnet_track.cli.fitting.written import calibration_table
from bayesnet_track.evaluate.calibration import HEAVY_TAIL, OFF_TARGET, longest_run
from bayesnet_track.evaluate.calibration_data import CalibrationData, calibration_data, with_features
from bayesnet_track.evaluate.fitting import USUAL_FEATURES, Fitted, fit, leave_one_out
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.scenes import make_scene

SCENES = ("two_squares", "occluder", "occluder_long")


def frames_of(images: Iterable[Image]) -> Iterator[Frame]:
    """Frames at a regular rate."""
    for index, image in enumerate(images):
        yield Frame(index, float(index), image, True, float(index))


def with_fitted(graph: CheckedGraph, fitted: Fitted) -> CheckedGraph:
    """The graph with what was fitted."""
    written = as_plain(graph.spec)
    for name, plate in graph.targets.items():
        root = written["targets"][name]["nodes"][plate.root]
        sd, lost_sd = fitted.localization_error
        before = root["score"]["logistic"]
        kept = {name: before[name] for name in ("memory_frames", "full_fit") if name in before}
        levels = fitted.levels
        root |= {
            "score": {"logistic": {**kept, **fitted.logistic}},
            "localization_error": {"sd_box": sd, "lost_sd_box": lost_sd, "heavy_tail": HEAVY_TAIL},
            "lost": {"score_below": levels.score_below, "uncertain_below": max(levels.uncertain_below, 0.51)},
        }
    return check_graph(written)


def wrongly_tracked(one: CalibrationData) -> tuple[int, int]:
    """Frames called tracking while off target (IoU below 0.1), and the longest stretch of them."""
    wrong = (one.iou < OFF_TARGET) & (np.array(one.status) == "tracking")
    return int(wrong.sum()), longest_run(wrong)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graph", default="general")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--sequences", default="", help="comma-separated names; default all")
    parser.add_argument("--features", default=",".join(USUAL_FEATURES))
    parser.add_argument("--max-frames", type=int)
    options = parser.parse_args()
    on_one_thread()
    wanted = [name for name in options.sequences.split(",") if name]
    features = tuple(options.features.split(","))
    graph = with_features(load_graph(options.graph))

    print(environment() + "\n")
    data = []
    for sequence in find_sequences(options.data, wanted, options.max_frames):
        for seed in range(options.seeds):
            frames = frames_of(sequence.images())
            data.append(calibration_data(graph, sequence.name, frames, sequence.truth, seed))
        sys.stderr.write(f"{sequence.name}: mean IoU {data[-1].iou.mean():.3f}\n")
    rows, everyone = leave_one_out(data, features)
    print(f"graph {options.graph}, {options.seeds} seeds, score by {', '.join(features)}\n")
    print(calibration_table(rows, everyone) + "\n")

    fitted = fit(data, features)
    print(
        f"fitted to all: {dict(fitted.logistic)}, localization error {fitted.localization_error}, "
        f"{fitted.levels}\n"
    )
    ready = with_fitted(graph, fitted)
    for name in SCENES:
        for seed in range(options.seeds):
            scene = make_scene(name, seed=seed)
            one = calibration_data(ready, name, frames_of(scene.frames), scene.truth, seed)
            total, longest = wrongly_tracked(one)
            print(
                f"{name}, seed {seed}: mean IoU {one.iou.mean():.3f}, off target in "
                f"{(one.iou < OFF_TARGET).sum()} of {one.frames} frames, "
                f"called tracking in {total} of them, at most {longest} in a row"
            )


if __name__ == "__main__":
    main()
