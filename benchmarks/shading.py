"""Does shading see what intensity does not? Balls of equal mean brightness, and real sequences.

    python benchmarks/shading.py [--seeds 10] [--data DATA_FOLDER --names Crossing,Girl,Human7 --frames 200]

The target is a ball lit from the upper left among three others that are flat, or lit from the lower right. It
is plain, or speckled and rolling, so that its texture is another in every frame; the light may change in
strength and level. All balls have the same mean. Prints, for intensity (also as sharp as two cues), shading
and both, the share of frames within half a radius of the truth and the runs held to the end. With `--data` it
prints the AUC of the library graph `general`, of it with shading as a further agent, and of either cue alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from measuring import Image, environment, on_one_thread, table
from sequences import find_sequences
from sequences import track as track_sequence

from bayesnet_track import Tracker
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph

WIDTH, HEIGHT, SIDE, MEAN, SWING = 320, 240, 41, 110.0, 28.0
LIT, OPPOSITE = (-1.0, -1.0, 0.8), (1.0, 1.0, 0.8)
LAST = 10


def lambert(light: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """(SIDE, SIDE) brightness of a ball in that light, of mean MEAN and sd SWING, and where the ball is."""
    place = (2.0 * np.arange(SIDE) + 1.0) / SIDE - 1.0
    x, y = np.meshgrid(place, place)
    inside = x * x + y * y <= 1.0
    towards = np.array(light) / np.linalg.norm(light)
    height = np.sqrt(np.clip(1.0 - x * x - y * y, 0.0, 1.0))
    value = np.clip(towards[0] * x + towards[1] * y + towards[2] * height, 0.0, 1.0)
    return MEAN + SWING * (value - value[inside].mean()) / value[inside].std(), inside


@dataclass(frozen=True)
class Balls:
    """Four balls on smooth ways, the first of them the target.

    Attributes:
        seed: of the ways, the background, the speckles and the noise.
        opposite: the others are lit from the other side; otherwise they are flat.
        rolling: the balls are speckled, and the speckles move over them.
        light_changes: gain 0.65 .. 1.35 and offset -25 .. 25 over the frames.
        frames: number of frames.
        hills: how much brighter and darker the hills of the background are, gray levels.
        noise_sd: of the camera, gray levels.
    """

    seed: int
    opposite: bool = False
    rolling: bool = False
    light_changes: bool = False
    frames: int = 80
    hills: float = 40.0
    noise_sd: float = 4.0

    def centres(self, frame: int) -> np.ndarray:
        """(4, 2) whole px."""
        rng = np.random.default_rng((self.seed, 1))
        across, down = rng.uniform(0.0, 2.0 * np.pi, (2, 4))
        rate = 1.0 + 0.2 * np.arange(4)
        x = WIDTH / 2 + 110.0 * np.sin(0.035 * rate * frame + across)
        y = HEIGHT / 2 + 75.0 * np.sin(0.045 * rate * frame + down)
        return np.rint(np.column_stack([x, y])).astype(int)

    def truth(self, frame: int) -> tuple[float, float, float, float]:
        """The target's corner box."""
        x, y = self.centres(frame)[0]
        return float(x - SIDE // 2), float(y - SIDE // 2), float(SIDE), float(SIDE)

    def image(self, frame: int) -> Image:
        """(HEIGHT, WIDTH, 3) gray picture."""
        still = np.random.default_rng((self.seed, 2))
        picture = cv2.resize(still.uniform(MEAN - self.hills, MEAN + self.hills, (16, 21)), (WIDTH, HEIGHT))
        speckles = still.uniform(0.75, 1.25, (40, 40)).repeat(6, axis=0).repeat(6, axis=1)
        for ball in (1, 2, 3, 0):
            value, inside = lambert(LIT if ball == 0 else OPPOSITE)
            if ball and not self.opposite:
                value = np.full_like(value, MEAN)
            if self.rolling:
                row, column = (5 * frame + 43 * ball) % 199, (3 * frame + 31 * ball) % 199
                albedo = speckles[row : row + SIDE, column : column + SIDE]
                value = value * albedo * value[inside].mean() / (value * albedo)[inside].mean()
            x, y = self.centres(frame)[ball] - SIDE // 2
            picture[y : y + SIDE, x : x + SIDE][inside] = value[inside]
        if self.light_changes:
            picture = picture * (1.0 + 0.35 * np.sin(0.15 * frame)) + 25.0 * np.sin(0.07 * frame)
        noise = np.random.default_rng((self.seed, 3, frame)).normal(0.0, self.noise_sd, picture.shape)
        gray = np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)
        return np.repeat(gray[:, :, None], 3, axis=2)

    def images(self) -> Iterator[Image]:
        """All pictures."""
        return (self.image(frame) for frame in range(self.frames))


def graph_of(*cues: str, sharpness: float | None = None) -> GraphSpec:
    """The cues alone, always on, nothing learnt after the first frame."""
    more = {} if sharpness is None else {"sharpness": sharpness}
    node: dict[str, object] = {
        "belief": {"particles": {"size": 500}},
        "motion": {"random_walk": {"sd_px": {"x": 8, "y": 8}}},
        "ud_fields": ["x", "y"],
    }
    if len(cues) > 1:
        node["fuse"] = "product"
    nodes: dict[str, object] = {"ball": node}
    nodes |= {f"by_{cue}": {"parent": "ball", "agent": {cue: {"floor": 0.005, **more}}} for cue in cues}
    return GraphSpec.model_validate(
        {"bayesnet": 1, "name": "balls", "about": "Balls.", "targets": {"ball": {"nodes": nodes}}}
    )


def general_with(shading: bool) -> GraphSpec:
    """The library graph `general`, if wanted with shading as a further agent."""
    written = load_graph("general").spec.model_dump(exclude_none=True)
    if shading:
        written["targets"]["target"]["nodes"]["shading"] = {
            "parent": "target",
            "agent": {"shading": {"floor": 0.005}},
        }
    return GraphSpec.model_validate(written)


def only(cue: str) -> GraphSpec:
    """The library graph `general` with one cue in the place of all agents."""
    written = load_graph("general").spec.model_dump(exclude_none=True)
    (plate,) = written["targets"].values()
    root = plate["nodes"]["target"]
    for key in ("fuse", "adapt"):
        root.pop(key, None)
    plate["nodes"] = {"target": root, cue: {"parent": "target", "agent": {cue: {"floor": 0.005}}}}
    return GraphSpec.model_validate(written)


def run_balls(graph: GraphSpec, balls: Balls, seed: int) -> tuple[float, bool]:
    """Share of frames within half a radius, and whether the last ones are."""
    tracker, near = Tracker(graph, seed=seed), []
    for frame, image in enumerate(balls.images()):
        if frame == 0:
            tracker.init(image, balls.truth(0))
            continue
        _, box = tracker.update(image)
        x, y, w, h = balls.truth(frame)
        away = np.hypot(box[0] + box[2] / 2 - x - w / 2, box[1] + box[3] / 2 - y - h / 2)
        near.append(away < SIDE / 4)
    return float(np.mean(near)), bool(np.mean(near[-LAST:]) > 0.5)


def balls_table(seeds: int) -> str:
    """Rows: what the balls are; columns: cues."""
    graphs = {
        "intensity": graph_of("intensity"),
        "intensity, sharpness 2": graph_of("intensity", sharpness=2.0),
        "shading": graph_of("shading"),
        "both": graph_of("intensity", "shading"),
    }
    rows = []
    for text, kind in (
        ("plain, the others flat", {}),
        ("plain, the others lit from the other side", {"opposite": True}),
        ("plain, flat, the light changes", {"light_changes": True}),
        ("rolling, the others flat", {"rolling": True}),
        ("rolling, the others lit from the other side", {"rolling": True, "opposite": True}),
        ("rolling, flat, the light changes", {"rolling": True, "light_changes": True}),
    ):
        row = [text]
        for graph in graphs.values():
            runs = [run_balls(graph, Balls(seed, **kind), seed) for seed in range(seeds)]
            near, held = (np.array(part) for part in zip(*runs, strict=True))
            row.append(f"{near.mean():.2f} ({held.sum()} of {seeds})")
        rows.append(row)
        print(" | ".join(row), flush=True)
    return table(["balls", *graphs], rows)


def sequences_table(folder: Path, names: list[str], frames: int, seeds: int) -> str:
    """Rows: sequences; columns: graphs; mean AUC over seeds."""
    graphs = {
        "intensity": only("intensity"),
        "shading": only("shading"),
        "`general`": general_with(False),
        "`general` with shading": general_with(True),
    }
    rows = []
    for sequence in find_sequences(folder, names, frames):
        row = [sequence.name]
        for graph in graphs.values():
            passes = [track_sequence(Tracker(graph, seed=seed), sequence) for seed in range(seeds)]
            aucs = [one.score(sequence.truth).auc for one in passes]
            row.append(f"{np.mean([auc for auc in aucs if auc is not None]):.2f}")
        rows.append(row)
        print(" | ".join(row), flush=True)
    return table(["", *graphs], rows)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--names", default="Crossing,Girl,Human7")
    parser.add_argument("--frames", type=int, default=200)
    options = parser.parse_args()
    on_one_thread()
    print(environment() + "\n")
    if options.data:
        names = options.names.split(",")
        print(sequences_table(options.data, names, options.frames, options.seeds))
    else:
        print(balls_table(options.seeds))


if __name__ == "__main__":
    main()
