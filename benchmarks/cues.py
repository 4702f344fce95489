"""What each installed cue costs: 1000 hypotheses of 60x60 px in 640x480, ms of CPU time on one core.

Run ``python benchmarks/cues.py``. The last column is the cost against one ``cv2.calcHist`` per box, measured
in the same run, so that figures of different machines can be compared. Each call sees another cloud of
hypotheses, as each frame does: on one and the same the processor learns the kernels' branches by heart.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import cycle

import cv2
import numpy as np
from measuring import environment, on_one_thread, table

from bayesnet_track.observation.cue import Hypotheses, MeasuringCue, installed_cues
from bayesnet_track.observation.planes import (
    Frame,
    FramePair,
    PlaneCache,
    RightEye,
    StereoGeometry,
    region_of_boxes,
)

WIDTH, HEIGHT, SIDE = 640, 480, 60.0


def milliseconds(work: Callable[[], object], repeats: int) -> float:
    """Median CPU time of one call, after one that is not counted."""
    work()
    taken = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return 1e3 * float(np.median(taken))


def picture(rng: np.random.Generator, shift: tuple[int, int]) -> np.ndarray:
    """Coloured texture in patches of about 25 px with grain; the target, moved by `shift`, is a patchwork."""
    coarse = rng.integers(40, 216, (HEIGHT // 25, WIDTH // 25, 3), dtype=np.uint8)
    image = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR).astype(np.int64)
    patch = np.repeat(np.repeat(rng.integers(0, 256, (4, 4, 3)), 15, axis=0), 15, axis=1)
    y, x = 210 + shift[1], 290 + shift[0]
    image[y : y + 60, x : x + 60] = patch
    return np.clip(image + rng.integers(-8, 9, image.shape), 0, 255).astype(np.uint8)


def frame(index: int, image: np.ndarray) -> Frame:
    """The picture with a right eye that sees all of it 30 px further left, 4 m away."""
    right = RightEye(np.roll(image, -30, axis=1), StereoGeometry(600.0, 0.2, WIDTH / 2, HEIGHT / 2))
    return Frame(index, float(index), image, True, index / 25, right)


def cloud(rng: np.random.Generator, box: np.ndarray, size: int, sd: float) -> np.ndarray:
    """(size, 4) hypotheses around `box`."""
    boxes = np.tile(box, (size, 1))
    boxes[:, :2] += rng.normal(0, sd, (size, 2))
    boxes[:, 2:] *= np.exp(rng.normal(0, 0.01, (size, 2)))
    return boxes


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cues", nargs="*", metavar="CUE", help="only these (default: all installed ones)")
    parser.add_argument("--hypotheses", type=int, default=1000)
    parser.add_argument("--sd", type=float, default=20.0, help="of the hypotheses' centres, px")
    parser.add_argument("--repeats", type=int, default=50)
    options = parser.parse_args()
    on_one_thread()

    previous, current = (
        frame(n, picture(np.random.default_rng(0), shift)) for n, shift in enumerate([(0, 0), (4, 2)])
    )
    frames = FramePair(current, previous)
    rng = np.random.default_rng(1)
    box = np.array([323.5, 241.5, SIDE, SIDE])
    clouds = [cloud(rng, box, options.hypotheses, options.sd) for _ in range(16)]
    regions = [region_of_boxes(boxes) for boxes in clouds]

    hue = np.ascontiguousarray(cv2.cvtColor(current.image, cv2.COLOR_BGR2HSV_FULL)[..., 0])
    corners = np.clip(clouds[0][:, :2] - clouds[0][:, 2:] / 2, 0, [WIDTH - SIDE, HEIGHT - SIDE]).astype(int)

    def opencv() -> None:
        for x, y in corners:
            cv2.calcHist([hue[y : y + int(SIDE), x : x + int(SIDE)]], [0], None, [32], [0, 256])

    equal = np.full(options.hypotheses, 1.0 / options.hypotheses)
    loop = milliseconds(opencv, options.repeats)
    rows = []
    chosen = {name: cue for name, cue in installed_cues().items() if name in options.cues or not options.cues}
    for name, declaration in chosen.items():
        cue = declaration.make(declaration.parameters())
        near = PlaneCache(frames).planes(cue.needs, region_of_boxes(box[None], 1.0))
        reference = cue.learn(near, box)
        # A tracker sees each frame once: every call has a frame of its own, as in a run.
        follows = isinstance(cue, MeasuringCue)
        pairs = [
            FramePair(replace(current, index=n, time=float(n), image=current.image.copy()), current)
            for n in range(2, options.repeats + 3)
        ]
        seen = [
            (PlaneCache(pair).planes(cue.needs, region), Hypotheses(boxes))
            for pair, region, boxes in zip(
                pairs if follows else [frames] * len(clouds), cycle(regions), cycle(clouds), strict=False
            )
        ]
        ready = cycle(seen)
        asked = cycle(regions)
        planes = milliseconds(
            lambda cue=cue, asked=asked: PlaneCache(frames).planes(cue.needs, next(asked)), options.repeats
        )

        def ask(cue=cue, ready=ready, reference=reference) -> None:
            planes, hypotheses = next(ready)
            if isinstance(cue, MeasuringCue):
                cue.measure(planes, hypotheses, equal, reference)
            else:
                cue.log_likelihood(planes, hypotheses, reference)

        likelihood = milliseconds(ask, options.repeats)
        learn = milliseconds(lambda cue=cue, near=near: cue.learn(near, box), options.repeats)
        total = planes + likelihood
        figures = (planes, likelihood, total, learn, declaration.cost_ms)
        rows.append([f"`{name}`", *(f"{value:.2f}" for value in figures), f"{total / loop:.1f}"])
    rows.append(["`cv2.calcHist` per box", "", f"{loop:.2f}", f"{loop:.2f}", "", "", "1.0"])
    size = f"{options.hypotheses} boxes of {SIDE:.0f}x{SIDE:.0f} px in {WIDTH}x{HEIGHT}, sd {options.sd:g} px"
    print(f"{environment()}\n{size}, CPU ms, median of {options.repeats}\n")
    print(table(["cue", "planes", "likelihood", "sum", "learn", "declared", "sum / calcHist"], rows))


if __name__ == "__main__":
    main()
