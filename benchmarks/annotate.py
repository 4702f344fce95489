"""How many questions annotation takes: `annotate` beside CSRT, NanoTrack and the best linear interpolation.

    python benchmarks/annotate.py DATA_FOLDER [--max-frames 150] [--kept FOLDER]
                                  [--peers-python PYTHON --models FOLDER] [--only PATTERN]
                                  [--half A --why TEXT]

DATA_FOLDER is as for `sequences.py`. A simulated annotator answers with the true box ("correct" where the
box shown has IoU >= .7 with it, "gone" where there is none), and every answer counts as a question, the first
box, too. Each method gives a curve: questions per 100 frames against the share of frames with IoU >= .5 (and
.7) in the finished annotations. The tool never sees the truth; its threshold is chosen on one half of the
sequences (`sequences.py`) and reported on the other, and the other way round. Beside it:

- oracle: linear interpolation between true boxes at the best frames, found with all of the truth;
- NAME every k: CSRT or NanoTrack started again with a true box every k frames;
- NAME asks: it asks when its own score falls below a threshold (CSRT: when it is not ok), and every k frames.

PYTHON has `opencv-contrib-python-headless`; `--models` is NanoTrack's folder. What trackers found is kept in
FOLDER, and not computed again. PATTERN is a regular expression such as "CSRT|annotate 0.8" for some
methods and settings; the oracle is always there.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray
from real_video import LOOKS, Elsewhere, digest, note
from sequences import HALVES, Sequence, find_sequences

from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.runtime.annotation.answers import Answer, Box
from bayesnet_track.runtime.annotation.asking import Asking, TrackedBox, TrackerRuns, annotate_video, iou
from bayesnet_track.runtime.annotation.session import by_target

Floats = NDArray[np.float64]
CONFIRMED_IOU = 0.7
"""A box that overlaps the true one by as much is answered with "correct"."""

LEVELS = (0.95, 0.99)
COSTS = (0.3, 0.5, 0.7, 0.9, 1.2, 1.5, 2, 2.5, 3, 4, 5, 7, 10, 15, 25, 50)
"""Frames that one more box of the oracle must win: each gives a point of its curve."""


@dataclass(frozen=True)
class Done:
    """A finished annotation of a sequence: counts of answers, and of frames.

    Attributes:
        unasked: frames that nobody was asked about.
        wrong: of these, those with IoU below .5.
    """

    sequence: str
    frames: int
    boxes: int
    gone: int
    correct: int
    good50: int
    good70: int
    unasked: int
    wrong: int

    @classmethod
    def of(cls, sequence: Sequence, answers: list[Answer], boxes: list[Box | None]) -> Done:
        """Count."""
        pairs = list(zip(boxes, map(true_box, sequence.truth), strict=True))
        overlaps = [1.0 if a is None and b is None else overlap(a, b) for a, b in pairs]
        asked = {one.frame for one in answers}
        unasked = [value for frame, value in enumerate(overlaps) if frame not in asked]
        kinds = [one.kind for one in answers]
        return cls(
            sequence.name,
            len(boxes),
            kinds.count("box"),
            kinds.count("gone"),
            kinds.count("correct"),
            sum(value >= 0.5 for value in overlaps),
            sum(value >= 0.7 for value in overlaps),
            len(unasked),
            sum(value < 0.5 for value in unasked),
        )


def true_box(row: Floats) -> Box | None:
    """The true box of a frame; None where there is none."""
    x, y, w, h = (float(value) for value in row)
    return (x, y, w, h) if np.isfinite(row).all() and w > 0 and h > 0 else None


def overlap(one: Box | None, other: Box | None) -> float:
    """IoU; 0 where one of them is none."""
    return 0.0 if one is None or other is None else iou(one, other)


class Annotator(Protocol):
    """Answers a question about a frame, where a box is shown; without `may_confirm` with a box always."""

    def __call__(self, frame: int, shown: Box | None, may_confirm: bool = True) -> Answer:
        """The answer."""
        ...


def annotator(truth: Floats) -> Annotator:
    """The simulated annotator, who knows the truth."""

    def answer(frame: int, shown: Box | None, may_confirm: bool = True) -> Answer:
        true = true_box(truth[frame])
        if true is None:
            return Answer("gone", frame, "1")
        if may_confirm and shown is not None and overlap(shown, true) >= CONFIRMED_IOU:
            return Answer("correct", frame, "1", shown)
        return Answer("box", frame, "1", true)

    return answer


def best_lines(sequence: Sequence) -> Iterator[tuple[str, Done]]:
    """The oracle: boxes where they win most; for each cost of a box in frames."""
    truth = sequence.truth
    seen = np.array([true_box(row) is not None for row in truth])
    good = _good_between(truth, seen)
    for cost in COSTS:
        frames = _best_frames(good, cost)
        boxes = [*_lines(truth, frames)]
        answers = [
            Answer("box", one, "1", true_box(truth[one])) if seen[one] else Answer("gone", one, "1")
            for one in frames
        ]
        yield f"a box wins {cost:g} frames", Done.of(sequence, answers, boxes)


def _good_between(truth: Floats, seen: NDArray[np.bool_]) -> Floats:
    """(n, n + 1): good frames from i + 1 to j with boxes in i and j; the last column: i holds to the end."""
    count = len(truth)
    good = np.full((count, count + 1), -np.inf)
    for one in range(count):
        for then in range(one + 1, count + 1):
            last = min(then, count - 1)
            weight = (np.arange(one + 1, last + 1) - one) / (then - one) if then < count else 0.0
            end = truth[then] if then < count else truth[one]
            lines = truth[one] + np.reshape(weight, (-1, 1)) * (end - truth[one])
            lines = np.broadcast_to(lines, (last - one, 4))
            good[one, then] = np.sum(_overlaps(lines, truth[one + 1 : last + 1]) >= 0.5)
    return good


def _best_frames(good: Floats, cost: float) -> list[int]:
    """The frames of the boxes with the most good frames, less the cost of each."""
    count = len(good)
    best, back = np.full(count + 1, -np.inf), np.zeros(count + 1, dtype=int)
    best[0] = 1.0 - cost
    for then in range(1, count + 1):
        values = best[:then] + good[:then, then] - (cost if then < count else 0.0)
        back[then] = int(np.argmax(values))
        best[then] = values[back[then]]
    frames, at = [], int(back[count])
    while at > 0:
        frames.append(at)
        at = int(back[at])
    return [0, *reversed(frames)]


def _lines(truth: Floats, frames: list[int]) -> Iterator[Box | None]:
    for frame in range(len(truth)):
        row = np.array([np.interp(frame, frames, truth[frames, column]) for column in range(4)])
        yield true_box(row)


def _overlaps(boxes: Floats, others: Floats) -> Floats:
    low = np.maximum(boxes[:, :2], others[:, :2])
    high = np.minimum(boxes[:, :2] + boxes[:, 2:], others[:, :2] + others[:, 2:])
    both = np.prod(np.clip(high - low, 0, None), axis=1)
    whole = np.prod(boxes[:, 2:], axis=1) + np.prod(others[:, 2:], axis=1) - both
    return np.asarray(both / np.maximum(whole, 1e-9), dtype=np.float64)


Rows = list[tuple[str, str, Done]]
COUNTS = ["boxes", "gone", "correct", "questions / 100", "IoU >= .5", ">= .7", "wrong unasked"]
HEAD = ["method", "setting", *COUNTS]
CHOSEN_HEAD = ["method", "share asked for", "reported on", "setting", *COUNTS]


def curve_rows(found: Rows) -> list[list[str]]:
    """A row for each setting, over all frames."""
    return [[family, label, *_cells(own)] for (family, label), own in _groups(found).items()]


def chosen_rows(found: Rows) -> list[list[str]]:
    """For each method and level: the setting with the fewest questions on one half, on the other half."""
    rows = []
    for level in LEVELS:
        for family in dict.fromkeys(one[0] for one in found):
            for half, other in (("A", "B"), ("B", "A")):
                label = _fewest(found, family, HALVES[half], level)
                if label is None:
                    rows.append([family, f"{level:.0%}", other, "none reaches it", *[""] * 7])
                    continue
                own = [d for f, s, d in found if (f, s) == (family, label) and d.sequence in HALVES[other]]
                rows.append([family, f"{level:.0%}", other, label, *_cells(own)])
    return rows


def _fewest(found: Rows, family: str, names: tuple[str, ...], level: float) -> str | None:
    kept = [one for one in found if one[0] == family and one[2].sequence in names]
    reached = {
        label: _rate(own, lambda d: d.boxes + d.gone + d.correct)
        for (_, label), own in _groups(kept).items()
        if _rate(own, lambda d: d.good50) >= level
    }
    return min(reached, key=lambda label: reached[label]) if reached else None


def _groups(found: Rows) -> dict[tuple[str, str], list[Done]]:
    groups: dict[tuple[str, str], list[Done]] = {}
    for family, label, done in found:
        groups.setdefault((family, label), []).append(done)
    return groups


def _rate(own: list[Done], of: Callable[[Done], int]) -> float:
    return sum(map(of, own)) / max(1, sum(one.frames for one in own))


def _cells(own: list[Done]) -> list[str]:
    if not own:
        return [""] * 7
    counts = [100 * _rate(own, of) for of in (lambda d: d.boxes, lambda d: d.gone, lambda d: d.correct)]
    wrong = sum(one.wrong for one in own) / max(1, sum(one.unasked for one in own))
    return [
        *(f"{value:.1f}" for value in counts),
        f"{sum(counts):.1f}",
        f"{_rate(own, lambda d: d.good50):.3f}",
        f"{_rate(own, lambda d: d.good70):.3f}",
        f"{wrong:.3f}",
    ]


THRESHOLDS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95)
PATIENCES = (10, 20)
EVERY = (32, 16, 8, 4, 2)
"""Frames between two boxes; each a multiple of the next, so that what was found is used again."""

ASKS_EVERY = (16, 4)
OWN_SCORES = {"CSRT": (0.5,), "NanoTrack": (0.8, 0.9, 0.95)}


@dataclass
class Pictures:
    """The frames of a sequence."""

    sequence: Sequence

    def __len__(self) -> int:
        return len(self.sequence.files)

    def image(self, frame: int) -> NDArray[np.uint8]:
        """Decoded."""
        return np.asarray(cv2.imread(str(self.sequence.files[frame]), cv2.IMREAD_COLOR), dtype=np.uint8)


@dataclass
class Kept:
    """Runs that are kept in a file; more of one is found by `find(start, box, frames, step)`."""

    file: Path | None
    find: Callable[[int, Box, int, int], list[TrackedBox]]
    found: dict[str, list[TrackedBox]] = field(default_factory=dict)
    _changed: bool = False

    def __post_init__(self) -> None:
        if self.file is not None and self.file.is_file():
            kept = json.loads(self.file.read_text())
            self.found = {
                key: [TrackedBox(tuple(one[0]), one[1], tuple(one[2]), one[3]) for one in run]
                for key, run in kept.items()
            }

    def at(self, start: int, box: Box, frame: int) -> TrackedBox:
        """As `Runs`."""
        step = 1 if frame > start else -1
        key = json.dumps([start, *(round(value, 6) for value in box), step])
        needed = abs(frame - start)
        if len(self.found.get(key, ())) < needed:
            self.found[key] = self.find(start, box, needed, step)
            self._changed = True
        return self.found[key][needed - 1]

    def save(self) -> None:
        """Write the file."""
        if self.file is not None and self._changed:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self.file.write_text(json.dumps({key: [*map(astuple, run)] for key, run in self.found.items()}))
            self._changed = False


def own_runs(sequence: Sequence, graph: str, folder: Path | None) -> Kept:
    """Those of the engine."""
    checked = load_graph(graph)
    runs = TrackerRuns(checked, Pictures(sequence))

    def find(start: int, box: Box, needed: int, step: int) -> list[TrackedBox]:
        return [runs.at(start, box, start + step * ahead) for ahead in range(1, needed + 1)]

    name = f"{digest(checked.spec)}_{sequence.name}_{len(sequence.files)}.json"
    return Kept(None if folder is None else folder / name, find)


def peer_runs(sequence: Sequence, name: str, elsewhere: Elsewhere, folder: Path | None) -> Kept:
    """Those of a peer, forward."""
    begun: set[tuple[int, Box]] = set()

    def find(start: int, box: Box, needed: int, step: int) -> list[TrackedBox]:
        ahead = 2 * needed if (start, box) in begun else needed  # to go on it begins anew
        begun.add((start, box))
        end = start + ahead + 1
        answer = elsewhere.find(name, sequence.files[start:end:step], box)
        rows = zip(answer["boxes"], answer["lost"], answer["scores"], strict=True)
        return [
            TrackedBox(tuple(at), 0.0 if lost else score, (0.0, 0.0), "lost" if lost else "tracking")
            for at, lost, score in rows
        ][1:]

    file = None if folder is None else folder / f"{name}_{sequence.name}_{len(sequence.files)}.json"
    return Kept(file, find)


def ask_ours(sequence: Sequence, runs: Kept, asking: Asking) -> Done:
    """Annotate a sequence with the simulated annotator."""
    frames = len(sequence.files)
    answer = annotator(sequence.truth)
    answers = [answer(0, None)]
    while True:
        done = annotate_video(by_target(answers), runs, frames, asking)
        if not done.questions or len(answers) > frames:
            break
        question = done.questions[0]
        answers.append(answer(question.frame, question.shown.box))
    marks = done.marks["1"]
    return Done.of(sequence, answers, [marks[frame].box for frame in range(frames)])


def ask_peer(sequence: Sequence, runs: Kept, every: int, own_score: float) -> Done:
    """A peer with a box every so many frames, and whenever its score is below its own."""
    answer = annotator(sequence.truth)
    answers: list[Answer] = []
    boxes: list[Box | None] = []
    start = since = 0
    for frame in range(len(sequence.files)):
        begun = answers and answers[start].box is not None
        held = answers[start].box if begun else None
        found = runs.at(answers[start].frame, held, frame) if begun and held is not None else None
        is_due = frame - since >= every or (found is not None and found.probability < own_score)
        if frame == 0 or is_due:
            answers.append(answer(frame, None if found is None else found.box, own_score > 0))
            since = frame
            if answers[-1].kind != "correct":
                start = len(answers) - 1
            boxes.append(answers[-1].box)
            ahead, from_box = min(frame + every, len(sequence.files)) - 1, answers[start].box
            if from_box is not None and ahead > answers[start].frame:
                runs.at(answers[start].frame, from_box, ahead)  # at once, not a frame more each time
        else:
            boxes.append(None if found is None else found.box)
    return Done.of(sequence, answers, boxes)


def methods_of(elsewhere: Elsewhere | None) -> dict[str, dict[str, Any]]:
    """Family -> setting -> how a sequence is annotated by it."""
    ours = {
        f"{threshold:g}, patience {patience}": ("ours", Asking(threshold, patience))
        for patience in PATIENCES
        for threshold in THRESHOLDS
    }
    found: dict[str, dict[str, Any]] = {"annotate": ours}
    for name in ("CSRT", "NanoTrack"):
        if elsewhere is None or name not in elsewhere.trackers:
            continue
        found[f"{name} every k"] = {f"k {k}": (name, k, 0.0) for k in EVERY}
        found[f"{name} asks"] = {
            f"score {own:g}, k {k}": (name, k, own) for own in OWN_SCORES[name] for k in ASKS_EVERY
        }
    return found


def measure(
    sequence: Sequence, methods: Mapping[str, Mapping[str, Any]], runs: Mapping[str, Kept]
) -> Iterator[tuple[str, str, Done]]:
    """Every setting of every method on one sequence."""
    for family, settings in methods.items():
        for label, (name, *rest) in settings.items():
            done = ask_ours if name == "ours" else ask_peer
            yield family, label, done(sequence, runs[name], *rest)
            runs[name].save()


def main() -> None:
    """Print the curves, and the settings chosen on the other half."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graph", default="general", help="name or file (general)")
    parser.add_argument("--max-frames", type=int, default=150, help="of each sequence (150)")
    parser.add_argument("--sequences", default="", help="names, separated by commas; default all")
    parser.add_argument("--peers-python", metavar="PYTHON", help="interpreter with OpenCV's contrib build")
    parser.add_argument("--models", type=Path, help="NanoTrack's models")
    parser.add_argument("--only", default="", metavar="PATTERN", help="methods to measure; default all")
    parser.add_argument("--kept", type=Path, metavar="FOLDER", help="where what is found is kept")
    parser.add_argument("--half", choices=(*HALVES, "both"), default="both", help="of the recorded coin")
    parser.add_argument("--why", help="what the look is for; goes into the record of looks")
    parser.add_argument("--looks", type=Path, default=LOOKS)
    options = parser.parse_args()
    on_one_thread()
    names = [name for name in options.sequences.split(",") if name]
    if options.half != "both":
        names = [name for name in HALVES[options.half] if not names or name in names]
    if options.why:
        look = {"half": options.half, "graphs": options.graph, "seeds": "range(0, 1)"}
        note(options.looks, **look, frames=f"annotate.py {options.max_frames}", why=options.why)
    sequences = find_sequences(options.data, names, options.max_frames)
    print(environment(), flush=True)
    elsewhere = None
    if options.peers_python:
        elsewhere = Elsewhere(options.peers_python, options.models)
    methods = {
        family: {
            label: one for label, one in settings.items() if re.search(options.only, f"{family} {label}")
        }
        for family, settings in methods_of(elsewhere).items()
    }
    found: list[tuple[str, str, Done]] = []
    for sequence in sequences:
        runs = {"ours": own_runs(sequence, options.graph, options.kept)}
        for name in ("CSRT", "NanoTrack") if elsewhere is not None else ():
            runs[name] = peer_runs(sequence, name, elsewhere, options.kept)
        for one in measure(sequence, methods, runs):
            found.append(one)
        found += [("oracle", label, done) for label, done in best_lines(sequence)]
        print(sequence.name, end=" ", flush=True)
    print("\n\n" + table(HEAD, curve_rows(found)))
    print("\nchosen on one half, reported on the other\n\n" + table(CHOSEN_HEAD, chosen_rows(found)))
    if elsewhere is not None:
        elsewhere.__exit__()


if __name__ == "__main__":
    main()
