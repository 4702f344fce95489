"""What do pools with a learned correlation say, beside products and equal pools? Simulated and on video.

    python benchmarks/fusion.py
    python benchmarks/fusion.py DATA_FOLDER --halves Car1,Crossing Couple,Girl [--max-frames 100] [--seeds 1]
    python benchmarks/fusion.py DATA_FOLDER --halves Car1,Crossing Couple,Girl --own-boxes

Without a folder: the closed form of the model with a shared latent state (per coordinate, in two
dimensions: h of sd 20, c = h + e of sd 6 or less, two colour agents c + e of sd 3, an intensity agent h + e
of sd 6): how often the regions that each fusion reports hold h. With a folder (NAME/img/*.jpg,
NAME/groundtruth.txt): the graph's learned pools beside equal pools and products. Temperatures of agents and
correlations are fitted to the first list of sequences and judged on the second, then the other way round.
Coverage is that of the belief itself, without `localization_error`, over frames on target, mean of x and y.
With `--own-boxes` the correlation by ground truth, and by the tracker's own boxes in its place: what an
estimate while tracking would know.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from calibration import frames_of
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray
from sequences import Sequence as Video
from sequences import find_sequences

from bayesnet_track import track
from bayesnet_track.evaluate.calibration_data import (
    TEMPERATURES,
    CalibrationData,
    calibration_data,
    with_features,
)
from bayesnet_track.evaluate.fusion import Correlation, fit_correlation, learned_pools, residuals_of
from bayesnet_track.evaluate.scores import success_auc
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.settings.nodes import pool_exponents
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.sources.sources import open_source

Floats = NDArray[np.float64]
FUSIONS = ("product", "pool", "learned")
PRIOR, COLOR, INTENSITY = 20.0, 3.0, 6.0
SHARED = (6.0, 3.0, 1.5)
"""Sds of the latent state: the larger, the more the colour agents' errors have in common."""


def closed_form(shared: float, weight: float) -> tuple[float, float, float]:
    """Coverage of the 50 % and 90 % regions, and squared error over claimed variance, by colour's weight."""
    single = shared**2 + COLOR**2
    parts = np.array([1.0 / PRIOR**2, 2.0 * weight / single, 1.0 / INTENSITY**2])
    claimed = 1.0 / parts.sum()
    # The errors of prior, mean of both colours and intensity, which are independent.
    actual = float((parts * claimed) ** 2 @ np.array([PRIOR**2, shared**2 + COLOR**2 / 2, INTENSITY**2]))
    ratio = claimed / actual
    return 1.0 - 0.5**ratio, 1.0 - 0.1**ratio, 1.0 / ratio


def simulated() -> str:
    """The table of the closed form."""
    rows = []
    for shared in SHARED:
        correlation = shared**2 / (shared**2 + COLOR**2)
        learned = pool_exponents({"hue": 1.0, "blobs": 1.0}, correlation)["hue"]
        for name, weight in zip(FUSIONS, (1.0, 0.5, learned), strict=True):
            fifty, ninety, ratio = closed_form(shared, weight)
            cells = [f"{correlation:.2f}", name, f"{weight:.3f}", f"{fifty:.3f}", f"{ninety:.3f}"]
            rows.append([*cells, f"{ratio:.2f}"])
    return table(["correlation", "fusion", "weight of each", "50 %", "90 %", "mse / claimed"], rows)


def with_fusion(
    graph: CheckedGraph, fusion: str, correlation: Correlation, temperatures: dict[str, float]
) -> CheckedGraph:
    """The graph with its learned pools as `fusion` says, and with temperatures of its agents."""
    written = as_plain(graph.spec)
    for name, plate in graph.targets.items():
        nodes = written["targets"][name]["nodes"]
        for pool in learned_pools(plate):
            nodes[pool].pop("correlation", None)
            nodes[pool]["fuse"] = {"pool": "learned"} if fusion == "learned" else fusion
            if fusion == "learned":
                nodes[pool]["correlation"] = correlation.value
        for agent, value in temperatures.items():
            nodes[agent]["temperature"] = value
    return check_graph(written)


def runs(
    graph: CheckedGraph, videos: Sequence[Video], seeds: int, temperatures: bool = False
) -> list[CalibrationData]:
    """The graph over every sequence."""
    found = []
    for video in videos:
        for seed in range(seeds):
            frames = frames_of(video.images())
            found.append(calibration_data(graph, video.name, frames, video.truth, seed, temperatures))
        sys.stderr.write(f"{video.name}: mean IoU {found[-1].iou.mean():.3f}\n")
    return found


def fitted_temperatures(data: Sequence[CalibrationData]) -> dict[str, float]:
    """Agent -> the temperature that gives the true centres the highest likelihood."""
    agents = {agent for one in data for agent in one.surprise}
    curves = {a: np.mean([one.surprise[a] for one in data if a in one.surprise], axis=0) for a in agents}
    return {agent: float(TEMPERATURES[curve.argmin()]) for agent, curve in curves.items()}


def judged(data: Sequence[CalibrationData]) -> list[str]:
    """Coverage, width of the 90 % region and AUC, mean over sequences."""
    rows = []
    for one in data:
        below = (one.offsets > 0).mean(axis=1)[one.iou > 0.5]
        off = np.abs(below - 0.5)
        spread = np.diff(np.quantile(one.offsets, [0.05, 0.95], axis=1), axis=0)[0][one.iou > 0.5]
        rows.append(
            [
                np.mean(off <= 0.25),
                np.mean(off <= 0.45),
                np.median(spread),
                success_auc(one.iou),
                len(one.iou),
            ]
        )
    mean = np.nanmean(np.array(rows), axis=0)
    return [*(f"{value:.3f}" for value in mean[:4])]


def on_video(graph: CheckedGraph, halves: Sequence[Sequence[Video]], seeds: int) -> str:
    """The table of the fusions, fitted on one half and judged on the other."""
    plate = next(iter(graph.targets.values()))
    (pool,) = learned_pools(plate)
    found: dict[str, list[CalibrationData]] = {fusion: [] for fusion in FUSIONS}
    for own, others in (halves, halves[::-1]):
        temperatures = fitted_temperatures(runs(with_features(graph), own, 1, temperatures=True))
        residuals = [residuals_of(graph, frames_of(video.images()), video.truth) for video in own]
        correlation = fit_correlation([one[pool] for one in residuals])
        print(f"fitted to {', '.join(v.name for v in own)}: {correlation}, temperatures {temperatures}")
        for fusion in FUSIONS:
            found[fusion] += runs(
                with_features(with_fusion(graph, fusion, correlation, temperatures)), others, seeds
            )
    head = ["fusion", "50 %", "90 %", "width of 90 %, box sides", "AUC"]
    return table(head, [[fusion, *judged(data)] for fusion, data in found.items()])


def own_boxes(graph: CheckedGraph, halves: Sequence[Sequence[Video]]) -> str:
    """The table of correlations by ground truth, and by the boxes of a run in its place."""
    (pool,) = learned_pools(next(iter(graph.targets.values())))
    rows, found = [], []
    for video in (video for half in halves for video in half):
        x, y, w, h = (float(value) for value in video.truth[0])
        with open_source(str(video.files[0].parent), end=len(video.files)) as source:
            boxes = np.array([one.targets[0].xywh for one in track(graph, source, (x, y, w, h))])
        each = [residuals_of(graph, frames_of(video.images()), one)[pool] for one in (video.truth, boxes)]
        found.append(each)
        rows.append([video.name, *(_correlation([one]) for one in each)])
        sys.stderr.write(" ".join(rows[-1]) + "\n")
    rows.append(["all", *(_correlation(one) for one in zip(*found, strict=True))])
    return table(["sequence", "by ground truth", "by its own boxes"], rows)


def _correlation(videos: Sequence[Floats]) -> str:
    try:
        return f"{fit_correlation(videos).value:.2f}"
    except ValueError:  # too few frames in which both say something
        return "-"


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--graph", default="two_colors")
    parser.add_argument("--halves", nargs=2, metavar="NAMES", help="two lists, comma-separated")
    parser.add_argument("--max-frames", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--own-boxes", action="store_true", help="compare two ways to estimate r")
    options = parser.parse_args()
    if options.data is None:
        print(simulated())
        return
    on_one_thread()
    print(environment() + "\n")
    halves = [find_sequences(options.data, names.split(","), options.max_frames) for names in options.halves]
    if options.own_boxes:
        print(own_boxes(load_graph(options.graph), halves))
        return
    print(on_video(load_graph(options.graph), halves, options.seeds))


if __name__ == "__main__":
    main()
