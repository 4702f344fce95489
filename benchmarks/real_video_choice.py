"""Choose the settings of `general` on one half of the real sequences, without looking at the other.

    python benchmarks/real_video_choice.py DATA_FOLDER --half A --out chosen_on_A.yaml [--seeds 2]
    bayesnet-track fit chosen_on_A.yaml --what score --source A/img --truth A/groundtruth.txt ...
    python benchmarks/real_video_halves.py DATA_FOLDER --half B --graphs general,chosen_on_A.yaml --why ...

The first command goes through `SETTINGS` once, in their order. Of each setting every value is tried, with
what was chosen before it; the one with the largest mean success AUC of the half stays. It prints each trial,
and the `fit` for the chosen graph. Only numbers are chosen: which agents and rules `general` has was decided
earlier.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from measuring import environment, on_one_thread, table
from real_video_coin import HALVES
from real_video_halves import run_all
from sequences import Sequence, find_sequences

from bayesnet_track.graph.text.load import load_graph

GENERAL = Path(__file__).resolve().parents[1] / "graphs" / "general.yaml"
SETTINGS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("sd_box: {x: 0.1, y: 0.1} ", ("sd_box: {x: 0.07, y: 0.07} ", "sd_box: {x: 0.14, y: 0.14} ")),
    ("{weight: 0.5, factor: 4}", ("{weight: 0.3, factor: 4}", "{weight: 0.5, factor: 6}")),
    ("sd_log: {scale: 0.05} ", ("sd_log: {scale: 0.035} ", "sd_log: {scale: 0.07} ")),
    ("robust_mean: {box: 0.25}", ("robust_mean: {box: 0.15}", "robust_mean: {box: 0.4}")),
    ("context: 1.0,", ("context: 0.7,", "context: 1.4,")),
    ("signed: false", ("signed: false, sharpness: 8", "signed: false, sharpness: 18")),
    (
        "color: {parent: target, agent: foreground_color}",
        ("color: {parent: target, agent: foreground_color, temperature: 2}",),
    ),
    ("score_above: 0.3", ("score_above: 0.0", "score_above: 0.5")),
)
"""Text of the graph -> what may stand there instead."""


def auc_of(text: str, folder: Path, sequences: list[Sequence], seeds: range) -> float:
    """Mean success AUC of a graph over sequences and seeds."""
    file = folder / "trial.yaml"
    file.write_text(text, encoding="utf-8")
    spec = load_graph(str(file)).spec
    return float(np.mean([one.auc for one in run_all([("trial", spec)], sequences, seeds, 1)]))


def main() -> None:
    """Choose, and print what was tried."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--half", choices=("A", "B"), required=True)
    parser.add_argument("--out", type=Path, required=True, help="graph to write")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--max-frames", type=int, default=150)
    options = parser.parse_args()
    on_one_thread()
    sequences = find_sequences(options.data, list(HALVES[options.half]), options.max_frames)
    seeds, folder = range(options.seeds), options.out.resolve().parent

    text = GENERAL.read_text(encoding="utf-8")
    best = auc_of(text, folder, sequences, seeds)
    rows = [["as it ships", f"{best:.4f}"]]
    for setting, others in SETTINGS:
        if text.count(setting) != 1:
            raise SystemExit(f"{setting!r} does not stand once in {GENERAL}")
        trials = [(auc_of(text.replace(setting, other), folder, sequences, seeds), other) for other in others]
        rows += [[" ".join(other.split()), f"{auc:.4f}"] for auc, other in trials]
        auc, other = max(trials)
        if auc > best:
            best, text = auc, text.replace(setting, other)
        print(rows[-len(others) :], flush=True)
    (folder / "trial.yaml").unlink()
    options.out.write_text(text, encoding="utf-8")
    sources = " ".join(f"--source {options.data / one.name / 'img'}" for one in sequences)
    truths = " ".join(f"--truth {options.data / one.name / 'groundtruth.txt'}" for one in sequences)
    print(environment())
    print(table(["setting", f"AUC on half {options.half}"], rows))
    how = f"--what score --features log_fit,texture,earlier_color --end {options.max_frames}"
    print(f"bayesnet-track fit {options.out} {how} {sources} {truths}")


if __name__ == "__main__":
    main()
