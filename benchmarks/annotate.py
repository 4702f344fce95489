"""How many questions annotation takes: `annotate` beside CSRT, NanoTrack and the best linear interpolation.

    python benchmarks/annotate.py DATA_FOLDER [--max-frames 150] [--kept FOLDER]
                                  [--peers-python PYTHON --models FOLDER] [--only PATTERN]
                                  [--half A --why TEXT]

DATA_FOLDER is as for `real_video.py`. A simulated annotator answers with the true box ("correct" where the
box shown has IoU >= .7 with it, "gone" where there is none), and every answer counts as a question, the first
box, too. Each method gives a curve: questions per 100 frames against the share of frames with IoU >= .5 (and
.7) in the finished annotations. The tool never sees the truth; its threshold is chosen on one half of the
sequences (`real_video_coin.py`) and reported on the other, and the other way round. Beside it:

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
from typing import Any

import cv2
import numpy as np
from annotate_curves import CHOSEN_HEAD, HEAD, Done, annotator, best_lines, chosen_rows, curve_rows
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray
from real_video import Elsewhere, digest
from real_video_coin import HALVES
from real_video_halves import note
from sequences import Sequence, find_sequences

from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.runtime.annotation.answers import Answer, Box, by_target
from bayesnet_track.runtime.annotation.asking import Asking, annotate
from bayesnet_track.runtime.annotation.tracked import Found, TrackerRuns

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
    find: Callable[[int, Box, int, int], list[Found]]
    found: dict[str, list[Found]] = field(default_factory=dict)
    _changed: bool = False

    def __post_init__(self) -> None:
        if self.file is not None and self.file.is_file():
            kept = json.loads(self.file.read_text())
            self.found = {
                key: [Found(tuple(one[0]), one[1], tuple(one[2]), one[3]) for one in run]
                for key, run in kept.items()
            }

    def at(self, start: int, box: Box, frame: int) -> Found:
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

    def find(start: int, box: Box, needed: int, step: int) -> list[Found]:
        return [runs.at(start, box, start + step * ahead) for ahead in range(1, needed + 1)]

    name = f"{digest(checked.spec)}_{sequence.name}_{len(sequence.files)}.json"
    return Kept(None if folder is None else folder / name, find)


def peer_runs(sequence: Sequence, name: str, elsewhere: Elsewhere, folder: Path | None) -> Kept:
    """Those of a peer, forward."""
    begun: set[tuple[int, Box]] = set()

    def find(start: int, box: Box, needed: int, step: int) -> list[Found]:
        ahead = 2 * needed if (start, box) in begun else needed  # to go on it begins anew
        begun.add((start, box))
        end = start + ahead + 1
        answer = elsewhere.find(name, sequence.files[start:end:step], box)
        rows = zip(answer["boxes"], answer["lost"], answer["scores"], strict=True)
        return [
            Found(tuple(at), 0.0 if lost else score, (0.0, 0.0), "lost" if lost else "tracking")
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
        done = annotate(by_target(answers), runs, frames, asking)
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
    parser.add_argument("--looks", type=Path, default=Path(__file__).with_name("real_video_looks.jsonl"))
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
        elsewhere = Elsewhere(options.peers_python, [str(options.models)] if options.models else [])
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
