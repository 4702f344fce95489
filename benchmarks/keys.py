"""What the keys of `which_key.md` change on real sequences, beside what another seed changes.

    python benchmarks/keys.py DATA_FOLDER [--graph general] [--frames 150] [--seed 5]

DATA_FOLDER holds sequences in the layout of the OTB benchmark. Every sequence is tracked once with
the graph as it is, once with each key of the table that the graph takes, and once with the next
seed. AUC counts every box, also of lost frames. What `diagnose` finds in the first run is printed
beside its AUC.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from measuring import Image, environment, on_one_thread, table
from sequences import Sequence, find_sequences

from bayesnet_track import Tracker
from bayesnet_track.cli.diagnose.advice import names_of
from bayesnet_track.cli.diagnose.findings import find
from bayesnet_track.cli.diagnose.remedies import REMEDIES
from bayesnet_track.evaluate.scores import score
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.change import ChangeError, change_graph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.metrics import FrameMetrics

REPORTING = ("alike", "false_alarm", "unreported", "regions", "slow", "late", "flicker")
"""Rows that change what is reported or what it costs, not the box."""


def variants(graph: CheckedGraph) -> dict[str, CheckedGraph]:
    """`KEY=VALUE` -> the graph with it, of the rows that the graph takes."""
    ((plate, target),) = graph.spec.targets.items()
    agents = [name for name, node in target.nodes.items() if hasattr(node, "agent")]
    found: dict[str, CheckedGraph] = {}
    for name, remedy in REMEDIES.items():
        if name in REPORTING:
            continue
        for agent in agents if "AGENT" in remedy.key else agents[:1]:
            setting = remedy.setting(names_of(graph.text, plate, agent))
            try:
                found[setting] = change_graph(graph.text, [setting])
            except (ChangeError, GraphError):
                continue
    return found


def follow(
    graph: CheckedGraph, sequence: Sequence, images: list[Image], seed: int
) -> tuple[float, list[FrameMetrics]]:
    """AUC of one pass, and its lines."""
    x, y, w, h = (float(value) for value in sequence.truth[0])
    tracker = Tracker(graph, seed)
    tracker.init(images[0], (x, y, w, h))
    boxes: list[tuple[float, ...]] = [(x, y, w, h)]
    lines = [tracker.metrics]
    for image in images[1:]:
        boxes.append(tracker.update(image)[1])
        lines.append(tracker.metrics)
    return score(boxes, [False] * len(boxes), sequence.truth).auc, lines


def main() -> None:
    """Measure and print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graph", default="general")
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args()
    on_one_thread()
    graph = load_graph(options.graph)
    changed = variants(graph)
    change: dict[str, list[float]] = {"another seed": [], **{setting: [] for setting in changed}}
    found = []
    for sequence in find_sequences(options.data, [], options.frames):
        images = list(sequence.images())
        auc, lines = follow(graph, sequence, images, options.seed)
        found.append([sequence.name, f"{auc:.3f}", "; ".join(one.what for one in find(lines))])
        change["another seed"].append(follow(graph, sequence, images, options.seed + 1)[0] - auc)
        for setting, other in changed.items():
            change[setting].append(follow(other, sequence, images, options.seed)[0] - auc)
    print(environment())
    print(table(["sequence", "AUC", "what diagnose finds"], found))
    rows = [
        [name, f"{np.mean(one):+.3f}", f"{max(one):+.3f}", f"{min(one):+.3f}"] for name, one in change.items()
    ]
    print(table(["change", "AUC, mean", "most", "least"], rows))


if __name__ == "__main__":
    main()
