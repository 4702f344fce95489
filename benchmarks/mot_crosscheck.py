"""MOTA, IDF1 and HOTA beside TrackEval's figures of the same files.

    python benchmarks/mot_crosscheck.py --python PYTHON --truth gt.txt [--tracks tracks.txt ...]

PYTHON is the interpreter of an environment with `trackeval`. Without --tracks, tracks are drawn from the
truth at several levels of noise: misses, jitter, clutter, switched identities. Ends with exit code 1 when any
figure or point of a curve differs by more than 1e-9.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from measuring import table

from bayesnet_track.evaluate.mot import score_mot_files
from bayesnet_track.evaluate.mot_files import read_mot_truth
from bayesnet_track.evaluate.mot_pairs import Tracks

TOLERANCE = 1e-9
SHOWN = ("mota", "motp", "fp", "fn", "idsw", "idf1", "idp", "idr", "hota", "deta", "assa", "loca")


@dataclass(frozen=True)
class Noise:
    """How tracks differ from the truth.

    Attributes:
        miss: probability that a box is missing.
        jitter: sd of each corner coordinate and size, share of the size.
        clutter: false boxes per frame, on average; each is a track of its own with probability 1/2, else it
            belongs to one that flickers.
        switch: probability per frame that two targets in it exchange their identities from there on.
    """

    miss: float
    jitter: float
    clutter: float
    switch: float


LEVELS = {
    "exact": Noise(0.0, 0.0, 0.0, 0.0),
    "slight": Noise(0.05, 0.05, 0.2, 0.02),
    "strong": Noise(0.2, 0.12, 1.0, 0.1),
    "hopeless": Noise(0.5, 0.3, 4.0, 0.5),
}


def drawn(truth: Tracks, noise: Noise, rng: np.random.Generator) -> list[str]:
    """Lines of a tracks file."""
    names = {int(one): int(one) for one in np.unique(truth.ids)}
    fresh, lines = max(names) + 2, []
    for frame in range(int(truth.frames.max()) + 1):
        rows = np.flatnonzero(truth.frames == frame)
        if len(rows) > 1 and rng.random() < noise.switch:
            a, b = (int(one) for one in truth.ids[rng.choice(rows, 2, replace=False)])
            names[a], names[b] = names[b], names[a]
        found = [(names[int(truth.ids[row])], truth.boxes[row]) for row in rows if rng.random() >= noise.miss]
        used = {one for one, _ in found}
        for _ in range(rng.poisson(noise.clutter)):
            box = truth.boxes[rng.integers(len(truth))] + np.append(rng.normal(0, 60, 2), (0, 0))
            flickering = max(names) + 1
            if rng.random() < 0.5 and flickering not in used:
                found.append((flickering, box))
                used.add(flickering)
            else:
                found.append((fresh, box))
                fresh += 1
        for identity, box in found:
            size = np.tile(box[2:], 2)
            shaken = box + noise.jitter * size * rng.standard_normal(4)
            shaken[2:] = np.maximum(shaken[2:], 1.0)
            numbers = ",".join(f"{value:.3f}" for value in shaken)
            lines.append(f"{frame + 1},{identity},{numbers},1,-1,-1,-1\n")
    return lines


def draw(truth_path: str, folder: Path, seeds: int) -> list[str]:
    """Paths of the files drawn."""
    truth, paths = read_mot_truth(truth_path), []
    for name, noise in LEVELS.items():
        for seed in range(seeds):
            path = folder / f"{name}_{seed}.txt"
            path.write_text("".join(drawn(truth, noise, np.random.default_rng(seed))))
            paths.append(str(path))
    return paths


def main() -> int:
    """Print the table; the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--python", required=True, help="interpreter of an environment with trackeval")
    parser.add_argument("--truth", required=True, help="MOT ground truth")
    parser.add_argument("--tracks", nargs="+", help="MOT tracks (default: drawn from the truth)")
    parser.add_argument("--seeds", type=int, default=5, help="files drawn per level of noise")
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        paths = options.tracks or draw(options.truth, Path(folder), options.seeds)
        script = str(Path(__file__).with_name("mot_peers.py"))
        answer = subprocess.run(
            [options.python, script, options.truth, *paths], capture_output=True, text=True, check=True
        )
        theirs = json.loads(answer.stdout)
        ours = {path: asdict(score_mot_files(path, options.truth)) for path in paths}
    rows, differences = [], []
    for path, other in theirs["figures"].items():
        differences.append(max(float(np.abs(np.subtract(ours[path][k], other[k])).max()) for k in other))
        rows.append([Path(path).stem, *shown(ours[path]), f"{differences[-1]:.1g}"])
        rows.append(["TrackEval", *shown(other), ""])
    print(table(["tracks", *SHOWN, "difference"], rows))
    print(f"\nTrackEval {theirs['trackeval']}: largest difference {max(differences):.2g}, curves included")
    return int(max(differences) > TOLERANCE)


def shown(figures: Mapping[str, Any]) -> list[str]:
    """The figures as cells."""
    return [f"{figures[name]:.4f}".removesuffix(".0000") for name in SHOWN]


if __name__ == "__main__":
    sys.exit(main())
