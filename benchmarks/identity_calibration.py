"""How often targets swapped when the tracker said with which probability they did: drawn crowds.

    python benchmarks/identity_calibration.py [--seeds 100-109] [--graphs kalman_detections,jpda]
    python benchmarks/identity_calibration.py --graphs people_detections --looks different,alike

People move through each other; detections have errors, are missed, and in *merges* become one box where two
people overlap. Every meeting that is settled is one decision: the probability that who is who has changed,
beside whether it did. By kinds of crowds: expected and true number of swaps, log loss in nats a decision
beside those of always being sure that nobody swapped (held to 1e-3) and of saying the share of swaps, and ten
bins. With `--looks` there are images, for graphs that compare appearance: people in two colours each, or all
in the same ones; who is nearer to the lower edge hides the others. Settings were chosen on seeds below 50,
the share of lapses after seeds 100 to 103 had been seen.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product, repeat
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any

import numpy as np
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track import DetectionsTracker
from bayesnet_track.adapt.meetings import Meeting, Placing
from bayesnet_track.engine.lifecycle import identities as stage

SIZE, FRAMES = (640, 480), 150
GRAPHS = ("kalman_detections", "jpda")
FOLDER = Path(__file__).parents[1] / "graphs"


@dataclass(frozen=True)
class Crowd:
    """How a crowd moves and is detected.

    Attributes:
        count: people.
        speed: px a frame.
        agility: sd of the change of velocity in a frame, px.
        noise: sd of a detection's place and size, in its side.
        seen: probability of a detection.
        merges: whether people that overlap give one box around both.
        turns: probability that a person turns round when it meets another.
    """

    count: int = 14
    speed: float = 3.0
    agility: float = 0.3
    noise: float = 0.04
    seen: float = 0.95
    merges: bool = False
    turns: float = 0.0


CROWDS = {
    "crossings": Crowd(),
    "fast": Crowd(speed=6.0),
    "slow and agile": Crowd(speed=1.5, agility=0.6),
    "misses": Crowd(seen=0.7),
    "noise": Crowd(noise=0.1),
    "merges": Crowd(merges=True),
}


def draw_crowd(
    crowd: Crowd, seed: int, frames: int = FRAMES, size: tuple[int, int] = SIZE
) -> tuple[NDArray[np.float64], list[tuple[NDArray[np.float64], list[int]]]]:
    """(F, N, 4) centre boxes, and of every frame detections (M, 4) with the person of each; -1 of two."""
    rng = np.random.default_rng(seed)
    extent = np.array(size, float)
    at = rng.uniform(0.1, 0.9, (crowd.count, 2)) * extent
    angle = rng.uniform(0.0, 2.0 * np.pi, crowd.count)
    velocity = crowd.speed * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sizes = np.array([24.0, 48.0]) * rng.uniform(0.85, 1.15, (crowd.count, 1))
    boxes, detections = np.empty((frames, crowd.count, 4)), []
    for frame in range(frames):
        boxes[frame] = np.concatenate([at, sizes], axis=1)
        detections.append(_detect(crowd, boxes[frame], rng))
        velocity = velocity + rng.normal(0.0, crowd.agility, velocity.shape)
        fast = np.maximum(np.hypot(*velocity.T) / (2.0 * crowd.speed), 1.0)
        velocity = velocity / fast[:, None]
        at = at + velocity
        beyond = (at < 30) | (at > extent - 30)
        velocity = np.where(beyond, np.where(at < 30, 1, -1) * np.abs(velocity), velocity)
    return boxes, detections


def _detect(
    crowd: Crowd, boxes: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], list[int]]:
    groups = [[person] for person in range(len(boxes))]
    if crowd.merges:
        for a in range(len(boxes)):
            for b in range(a):
                away = np.abs(boxes[a, :2] - boxes[b, :2]) / ((boxes[a, 2:] + boxes[b, 2:]) / 2)
                if away.max() < 0.5:
                    one, other = (next(group for group in groups if person in group) for person in (a, b))
                    if one is not other:
                        groups.remove(other)
                        one += other
    rows, of = [], []
    for group in groups:
        if rng.random() > crowd.seen:
            continue
        low = (boxes[group, :2] - boxes[group, 2:] / 2).min(axis=0)
        high = (boxes[group, :2] + boxes[group, 2:] / 2).max(axis=0)
        side = np.sqrt(np.prod(high - low))
        box = np.concatenate([(low + high) / 2, high - low]) + rng.normal(0.0, crowd.noise * side, 4)
        rows.append(np.maximum(box, [-1e9, -1e9, 4, 4]))
        of.append(group[0] if len(group) == 1 else -1)
    order = rng.permutation(len(rows))
    return np.array(rows)[order].reshape(-1, 4), [of[k] for k in order]


def draw_images(
    boxes: NDArray[np.float64], looks: str, seed: int, size: tuple[int, int] = SIZE
) -> Iterator[NDArray[np.uint8]]:
    """A BGR image (H, W, 3) for each frame of people (F, N, 4): a shirt and trousers before a noisy wall."""
    rng = np.random.default_rng([seed, 1])
    wall = rng.integers(70, 130, (size[1] // 8, size[0] // 8, 3)).repeat(8, axis=0).repeat(8, axis=1)
    colors = rng.uniform(20, 235, (1 if looks == "alike" else boxes.shape[1], 2, 3))
    colors = np.broadcast_to(colors, (boxes.shape[1], 2, 3)) + rng.normal(0.0, 4.0, (boxes.shape[1], 2, 3))
    for people in boxes:
        image = wall.astype(np.float64)
        for person in np.argsort(people[:, 1] + people[:, 3] / 2):
            x, y, w, h = people[person]
            left, right = max(round(x - w / 2), 0), max(round(x + w / 2), 0)
            edges = [max(round(value), 0) for value in (y - h / 2, y, y + h / 2)]
            for part, color in enumerate(colors[person]):
                image[edges[part] : edges[part + 1], left:right] = color
        yield np.clip(image + rng.normal(0.0, 6.0, image.shape), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Decision:
    """One meeting that was settled.

    Attributes:
        probability: that who is who has changed.
        swapped: whether it has.
        right: probability of what is true.
    """

    probability: float
    swapped: bool
    right: float


def graph_with_identity(name: str, keys: str = "{}") -> Path:
    """A graph of the library with `identity`, as a file of its own."""
    text = (FOLDER / f"{name}.yaml").read_text(encoding="utf-8")
    path = Path(mkdtemp()) / f"{name}.yaml"
    path.write_text(text.replace("    birth:\n", f"    identity: {keys}\n    birth:\n", 1), encoding="utf-8")
    return path


class Observed:
    """Whose person each track follows, and every meeting that is settled."""

    def __init__(self) -> None:
        self.persons: dict[str, dict[int, int]] = defaultdict(dict)
        self.decisions: list[Decision] = []
        self.unknown = 0
        self.settled: list[tuple[int, Meeting, Placing]] = []

    def judge(self) -> None:
        """Compare what was settled with the persons."""
        for frame, meeting, placing in self.settled:
            before = {
                name: self._person(name, meeting.since - 6, meeting.since - 1) for name in meeting.members
            }
            now = {name: self._person(name, frame - 3, frame) for name in placing.tracks}
            people = [person for person in before.values() if person is not None]
            if None in before.values() or None in now.values() or len({*people}) < len(people):
                self.unknown += 1
                continue
            of = {person: name for name, person in before.items()}
            true = tuple(of.get(person, name) for name, person in now.items())
            shares = placing.shares
            probability = 1.0 - shares.get(placing.tracks, 0.0)
            swapped = true != placing.tracks
            self.decisions.append(Decision(min(max(probability, 0.0), 1.0), swapped, shares.get(true, 0.0)))
        self.settled = []

    def _person(self, name: str, first: int, last: int) -> int | None:
        persons = [
            self.persons[name][k] for k in range(first, last + 1) if self.persons[name].get(k, -1) >= 0
        ]
        return Counter(persons).most_common(1)[0][0] if persons else None


def observe(graph: Path, crowd: Crowd, seed: int, observed: Observed, looks: str = "") -> DetectionsTracker:
    """Track a crowd, noting what is settled."""
    people, detections = draw_crowd(crowd, seed)
    images = draw_images(people, looks, seed) if looks else repeat(None)
    tracker = DetectionsTracker(graph, size=SIZE, fps=25)
    original = stage.Identifying._doubts

    def noted(self: Any, meeting: Meeting, placing: Placing, refused: Any) -> Any:
        observed.settled.append((self.work.frame.index, meeting, placing))
        return original(self, meeting, placing, refused)

    stage.Identifying._doubts = noted  # type: ignore[method-assign]
    try:
        for frame, ((boxes, of), image) in enumerate(zip(detections, images, strict=False)):
            xyxy = np.concatenate([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2], axis=1)
            given = SimpleNamespace(xyxy=xyxy, confidence=np.full(len(boxes), 0.9))
            ids = tracker.update(given, image).tracker_id
            for track, person in zip(ids.tolist(), of, strict=True):
                if track >= 0:
                    observed.persons[str(track)][frame] = person
    finally:
        stage.Identifying._doubts = original  # type: ignore[method-assign]
    observed.judge()
    observed.persons.clear()
    return tracker


def log_loss(probability: NDArray[np.float64], happened: NDArray[np.bool_]) -> float:
    """Mean of -log of what was said of what happened, nats."""
    held = np.clip(probability, 1e-3, 1.0 - 1e-3)
    return float(-np.mean(np.log(np.where(happened, held, 1.0 - held))))


def rows_of(decisions: Sequence[Decision]) -> tuple[Mapping[str, Any], list[list[str]]]:
    """Numbers of decisions, and their ten bins."""
    said = np.array([one.probability for one in decisions])
    happened = np.array([one.swapped for one in decisions], dtype=bool)
    base = float(np.clip(happened.mean(), 1e-3, 1 - 1e-3))
    bins = []
    for low in np.arange(10) / 10:
        inside = (said >= low) & (said < low + 0.1 + 1e-9 * (low > 0.85))
        count = int(inside.sum())
        if not count:
            continue
        expected, true = said[inside].sum(), int(happened[inside].sum())
        sd = np.sqrt(max(np.sum(said[inside] * (1 - said[inside])), 1e-12))
        z = (true - expected) / max(sd, 1e-6)
        bins.append(
            [
                f"{low:.1f}-{low + 0.1:.1f}",
                str(count),
                f"{expected / count:.3f}",
                f"{true / count:.3f}",
                f"{z:+.1f}",
            ]
        )
    numbers = {
        "decisions": len(decisions),
        "swaps": int(happened.sum()),
        "expected": f"{said.sum():.1f}",
        "log loss": f"{log_loss(said, happened):.3f}",
        "always sure": f"{log_loss(np.zeros(len(said)), happened):.3f}",
        "constant": f"{log_loss(np.full(len(said), base), happened):.3f}",
    }
    return numbers, bins


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", default="100-109", help="first-last")
    parser.add_argument("--graphs", default=",".join(GRAPHS))
    parser.add_argument("--crowds", default=",".join(CROWDS))
    parser.add_argument("--looks", default="", help="different, alike: with images of people who look so")
    parser.add_argument("--identity", default="{}", help="the key's settings")
    arguments = parser.parse_args()
    first, last = map(int, arguments.seeds.split("-"))
    print(environment(), f"seeds {arguments.seeds}, identity: {arguments.identity}", sep="\n")
    for name in arguments.graphs.split(","):
        graph = graph_with_identity(name, arguments.identity)
        lines, every = [], list[Decision]()
        for kind, looks in product(arguments.crowds.split(","), arguments.looks.split(",")):
            observed = Observed()
            for seed in range(first, last + 1):
                observe(graph, CROWDS[kind], seed, observed, looks)
            numbers, _ = rows_of(observed.decisions)
            lines.append(
                [f"{kind}, {looks}" if looks else kind, *map(str, numbers.values()), str(observed.unknown)]
            )
            every += observed.decisions
        numbers, bins = rows_of(every)
        lines.append(["all", *map(str, numbers.values()), ""])
        print(f"\n{name}\n" + table(["crowd", *numbers, "not known"], lines))
        print("\n" + table(["said", "decisions", "mean said", "swapped", "z"], bins))


if __name__ == "__main__":
    on_one_thread()
    main()
