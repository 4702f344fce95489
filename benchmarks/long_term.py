"""Long-term tracking on real sequences from which the target is away for a while.

    python benchmarks/long_term.py DATA_FOLDER [--half A] [--graphs general,FILE] [--seeds 1] [--before 60]
                                   [--away 40] [--after 60] [--elsewhere 4] [--why WORDS]
                                   [--peers-python PYTHON] [--models FOLDER]

A sequence is cut after its first frames (`--before`), followed by `--away` frames of the next sequence of
the same half, scaled to its size, in which the target is absent, and continued with up to `--after` frames.
Printed are precision, recall and F of VOT-LT at the confidence with the largest F (docs/scores.md), the share
of absent frames that are called tracking, and in how many sequences the box overlaps the true one by more
than half within the first 20 frames after the return, of those in which it did at the cut. With
`--elsewhere` the view has turned meanwhile: the target returns so many roots of its box's area away, or as
far as the frame allows, and what leaves the frame at one side comes in at the other. With `--why` the look is
recorded. With
`--peers-python`, the interpreter of an environment with OpenCV's contrib build, CSRT runs beside, and
NanoTrack v2 with `--models`. CSRT has no score: its confidence is 1 while its update succeeds, else 0.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from measuring import Image, environment, on_one_thread, table
from numpy.typing import NDArray
from real_video import LOOKS, Elsewhere, note
from sequences import HALVES, Sequence, find_sequences

from bayesnet_track import Tracker
from bayesnet_track.evaluate.scores import Confident, long_term
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

RETURN_FRAMES = 20


@dataclass(frozen=True, eq=False)
class Made:
    """A sequence with frames of another one in between."""

    own: Sequence
    other: Sequence
    before: int
    away: int
    after: int
    shift: tuple[int, int] = (0, 0)

    @property
    def truth(self) -> NDArray[np.float64]:
        """(n, 4) true boxes, NaN while the target is away."""
        gone = np.full((self.away, 4), np.nan)
        back = self.own.truth[self.before :][: self.after] + [*self.shift, 0, 0]
        return np.concatenate([self.own.truth[: self.before], gone, back])

    def images(self) -> Iterator[Image]:
        """The frames, all of the size of the first."""
        size: tuple[int, int] | None = None
        others = list(self.other.images())[: self.away]
        for index, image in enumerate(self.own.images()):
            if index >= self.before + self.after:
                return
            size = size or (image.shape[1], image.shape[0])
            if index == self.before:
                yield from (np.asarray(cv2.resize(one, size), np.uint8) for one in others)
            yield image if index < self.before else np.roll(image, self.shift, axis=(1, 0))


def turned(made: Made, sides: float) -> Made:
    """The same, the view having turned along the axis with more room, by `sides` of the box at most."""
    boxes = made.own.truth[made.before :][: made.after]
    height, width = next(made.own.images()).shape[:2]
    low, high = boxes[:, :2].min(axis=0), (boxes[:, :2] + boxes[:, 2:]).max(axis=0)
    room = np.concatenate([-low, np.array([width, height]) - high])
    most = int(np.argmax(np.abs(room)))
    far = min(abs(room[most]), sides * float(np.sqrt(np.prod(boxes[0, 2:]))))
    step = max(int(far), 0) * (-1 if most < 2 else 1)
    return replace(made, shift=(step, 0) if most % 2 == 0 else (0, step))


def make(sequences: list[Sequence], before: int, away: int, after: int) -> list[Made]:
    """Every sequence that is long enough, with frames of the next one."""
    found = []
    for index, own in enumerate(sequences):
        other = sequences[(index + 1) % len(sequences)]
        count = min(away, len(other.files))
        if len(own.files) >= before + RETURN_FRAMES:
            found.append(Made(own, other, before, count, after))
    return found


def run(made: Made, tracker: Tracker) -> tuple[Confident, list[str]]:
    """Overlap and confidence of each frame after the first, and statuses."""
    truth = made.truth
    boxes, confidence, status = [], [], []
    for index, image in enumerate(made.images()):
        if index == 0:
            tracker.init(image, tuple(float(v) for v in truth[0]))
            continue
        _, box = tracker.update(image)
        boxes.append(tuple(float(v) for v in box))
        confidence.append(float(tracker.getTrackingScore()))
        status.append(tracker.status)
    return confident(truth, boxes, confidence), status


def confident(truth: NDArray[np.float64], boxes: list[tuple[float, ...]], sure: list[float]) -> Confident:
    """Overlap and confidence of each frame after the first."""
    true = truth[1 : len(boxes) + 1]
    present = np.isfinite(true).all(axis=1)
    iou = np.zeros(len(true))
    iou[present] = overlap(centre_from_corner(np.array(boxes)[present]), centre_from_corner(true[present]))
    return Confident(iou, np.array(sure), present)


def run_peer(elsewhere: Elsewhere, name: str, made: Made) -> tuple[Confident, list[str]]:
    """The same, by a tracker of the other environment."""
    truth = made.truth
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for index, image in enumerate(made.images()):
            files.append(Path(folder) / f"{index:04}.bmp")
            cv2.imwrite(str(files[-1]), image)
        found = elsewhere.find(name, files, truth[0].tolist())
    status = ["lost" if gone else "tracking" for gone in found["lost"][1:]]
    scores = found["scores"] if name == "NanoTrack" else [1.0] * len(files)
    sure = [0.0 if gone else score for gone, score in zip(found["lost"], scores, strict=True)]
    return confident(truth, found["boxes"][1:], sure[1:]), status


def row(name: str, made: list[Made], runs: list[tuple[Confident, list[str]]]) -> list[str]:
    """Figures of one tracker."""
    found = long_term([one for one, _ in runs])
    assert found is not None
    absent = [
        np.mean([s == "tracking" for s, there in zip(status, one.present, strict=True) if not there])
        for one, status in runs
    ]
    per = len(runs) // len(made)
    held = back = 0
    for index, (one, _) in enumerate(runs):
        cut = made[index // per]
        if one.iou[cut.before - 2] <= 0.5:
            continue
        held += 1
        first = cut.before + cut.away - 1
        back += bool((one.iou[first : first + RETURN_FRAMES] > 0.5).any())
    figures = [f"{v:.3f}" for v in (found.f, found.precision, found.recall, found.threshold)]
    return [name, *figures, f"{np.mean(absent):.2f}", f"{back} of {held}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--half", choices=("A", "B"), default="A")
    parser.add_argument("--graphs", default="general")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--before", type=int, default=60)
    parser.add_argument("--away", type=int, default=40)
    parser.add_argument("--after", type=int, default=60)
    parser.add_argument("--elsewhere", type=float, default=0.0, metavar="SIDES")
    parser.add_argument("--why", help="what the look is for; goes into the record of looks")
    parser.add_argument("--looks", type=Path, default=LOOKS)
    parser.add_argument("--peers-python", metavar="PYTHON", help="has OpenCV's contrib build")
    parser.add_argument("--models", metavar="FOLDER", help="NanoTrack's two model files")
    options = parser.parse_args()
    on_one_thread()
    cv2.setNumThreads(1)
    sequences = find_sequences(options.data, list(HALVES[options.half]), None)
    made = make(sequences, options.before, options.away, options.after)
    if options.elsewhere:
        made = [turned(one, options.elsewhere) for one in made]
    if options.why:
        lengths = f"{options.before}, {options.away}, {options.after}"
        what = {"half": options.half, "graphs": options.graphs, "seeds": f"{range(options.seeds)}"}
        note(options.looks, **what, frames=f"long_term.py {lengths}, {options.elsewhere:g}", why=options.why)
    rows = []
    for graph in options.graphs.split(","):
        runs = [run(one, Tracker(graph, seed)) for one in made for seed in range(options.seeds)]
        rows.append(row(Path(graph).stem, made, runs))
    if options.peers_python:
        with Elsewhere(options.peers_python, options.models) as elsewhere:
            for name in [one for one in ("CSRT", "NanoTrack") if one in elsewhere.trackers]:
                rows.append(row(name, made, [run_peer(elsewhere, name, one) for one in made]))
    print(environment() + "\n")
    head = ["", "F", "precision", "recall", "at", "absent called tracking", "back within 20 frames"]
    print(f"half {options.half}, {len(made)} sequences\n\n" + table(head, rows))


if __name__ == "__main__":
    main()
