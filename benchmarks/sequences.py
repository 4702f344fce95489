"""Real sequences with ground truth: how well, how fast, with how many agents; MIL and mean shift beside.

    python benchmarks/sequences.py DATA_FOLDER [--graph general] [--seeds 3] [--peers MIL,"mean shift"]

DATA_FOLDER holds sequences in the layout of the OTB benchmark: NAME/img/*.jpg and NAME/groundtruth.txt with
x,y,w,h per frame. One pass from the first true box, never started again; figures of the engine are means
over seeds. AUC is the area under the success curve (OTB); a lost episode is at least five frames without
overlap; coverage is the share of frames whose true centre lies in the 50 % and 90 % region (mean of x and
y). Frames per CPU second count the tracker's work only, without decoding.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from measuring import Image, environment, on_one_thread, table
from numpy.typing import NDArray
from peers import Corner, Peer, peers

from bayesnet_track import Tracker
from bayesnet_track.evaluate.scores import Score, score
from bayesnet_track.evaluate.truth import read_truth

SUFFIXES = {".jpg", ".jpeg", ".png"}


@dataclass(frozen=True, eq=False)
class Sequence:
    """Pictures and true corner boxes (n, 4) of one target."""

    name: str
    files: list[Path]
    truth: NDArray[np.float64]

    def images(self) -> Iterator[Image]:
        """The pictures, BGR."""
        for file in self.files:
            image = cv2.imread(str(file), cv2.IMREAD_COLOR)
            if image is None:
                raise SystemExit(f"{file}: cannot be read")
            yield np.asarray(image, dtype=np.uint8)


@dataclass
class Pass:
    """What one pass gave, a row per frame."""

    boxes: list[Corner] = field(default_factory=list)
    lost: list[bool] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)
    active: list[int] = field(default_factory=list)
    region50: list[tuple[float, ...]] = field(default_factory=list)
    region90: list[tuple[float, ...]] = field(default_factory=list)

    def score(self, truth: NDArray[np.float64]) -> Score:
        """Its scores."""
        return score(
            self.boxes,
            self.lost,
            truth,
            seconds=self.cpu_seconds,
            active=self.active or None,
            region50=self.region50 or None,
            region90=self.region90 or None,
        )


def find_sequences(folder: Path, names: list[str], most: int | None) -> list[Sequence]:
    """Those below `folder` that have pictures and truth; with `most` only the first frames."""
    found = []
    for truth_file in sorted(folder.glob("*/groundtruth.txt")):
        name = truth_file.parent.name
        files = sorted(f for f in (truth_file.parent / "img").glob("*") if f.suffix.lower() in SUFFIXES)
        if files and (not names or name in names):
            truth = read_truth(truth_file)
            count = min(len(files), len(truth), most or len(files))
            found.append(Sequence(name, files[:count], truth[:count]))
    return found


def track(tracker: Peer | Tracker, sequence: Sequence) -> Pass:
    """One pass from the first true box."""
    done = Pass()
    x, y, w, h = (float(value) for value in sequence.truth[0])
    for index, image in enumerate(sequence.images()):
        started = time.process_time()
        ok, box = True, (x, y, w, h)
        if index == 0:
            tracker.init(image, box)
        else:
            ok, box = tracker.update(image)
        done.cpu_seconds.append(time.process_time() - started)
        done.boxes.append(box)
        done.lost.append(not ok)
        if isinstance(tracker, Tracker):
            done.active.append(len(tracker.metrics.active))
            done.region50.append(tracker.metrics.region50)
            done.region90.append(tracker.metrics.region90)
    return done


def mean_of(scores: list[Score], what: Callable[[Score], float | None]) -> float:
    """Mean of one figure over passes; NaN where none has it."""
    values = [value for value in map(what, scores) if value is not None]
    return float(np.mean(values)) if values else float("nan")


FIGURES: dict[str, tuple[str, Callable[[Score], float | None]]] = {
    "AUC": (".3f", lambda s: s.auc),
    "precision 20 px": (".3f", lambda s: s.precision20),
    "mean IoU": (".3f", lambda s: s.mean_iou),
    "lost episodes": (".1f", lambda s: s.lost_episodes),
    "frames / CPU s": (".0f", lambda s: s.fps),
    "agents": (".2f", lambda s: s.mean_active),
    "in 50 %": (".2f", lambda s: None if s.coverage50 is None else sum(s.coverage50) / 2),
    "in 90 %": (".2f", lambda s: None if s.coverage90 is None else sum(s.coverage90) / 2),
}


def cells(scores: list[Score]) -> list[str]:
    """The figures of several passes as text."""
    values = [(form, mean_of(scores, what)) for form, what in FIGURES.values()]
    return ["-" if np.isnan(value) else format(value, form) for form, value in values]


def main() -> None:
    """Print a table per tracker as it grows, then the means side by side."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graph", default="general")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--peers", default="MIL,mean shift", help="comma-separated; empty for none")
    parser.add_argument("--sequences", default="", help="comma-separated names; default all")
    parser.add_argument("--max-frames", type=int)
    options = parser.parse_args()
    on_one_thread()
    wanted = [name for name in options.sequences.split(",") if name]
    sequences = find_sequences(options.data, wanted, options.max_frames)
    if not sequences:
        raise SystemExit(f"{options.data}: no NAME/img/*.jpg with NAME/groundtruth.txt")
    known = peers()
    chosen = [name for name in options.peers.split(",") if name in known]

    print(environment() + "\n")
    head = ["sequence", "frames", *FIGURES, "AUC of each seed", *(f"AUC of {name}" for name in chosen)]
    print(table(head, []), flush=True)
    ours: list[Score] = []
    means: list[list[Score]] = []
    theirs: dict[str, list[Score]] = {name: [] for name in chosen}
    for sequence in sequences:
        passes = [track(Tracker(options.graph, seed), sequence) for seed in range(options.seeds)]
        scores = [one.score(sequence.truth) for one in passes]
        for name in chosen:
            cv2.setRNGSeed(0)
            theirs[name].append(track(known[name](), sequence).score(sequence.truth))
        means.append(scores)
        ours += scores
        seeds = " ".join(f"{one.auc:.3f}" for one in scores)
        beside = [f"{theirs[name][-1].auc:.3f}" for name in chosen]
        line = [sequence.name, str(len(sequence.files)), *cells(scores), seeds, *beside]
        print("| " + " | ".join(line) + " |", flush=True)
    rows = [[options.graph, *cells(ours)], *([name, *cells(theirs[name])] for name in chosen)]
    print("\nmeans over sequences\n\n" + table(["", *FIGURES], rows))


if __name__ == "__main__":
    main()
