"""Cost of a target of a group, cue by cue: 1, 10 and 50 targets, against one; microseconds of CPU time.

    python benchmarks/cue_groups.py [CUE ...] [--hypotheses 200] [--side 24] [--repeats 30]

Each target has its own reference and hypotheses; planes are ready. A ratio of 1 is that of a loop over the
targets; a cue with a form for all (`GroupCue`) has a smaller one. "One box" is the share of a call that one
hypothesis takes: about the most that a form for all can save, since the rest is the boxes' own work. The
values in a group of 50 are compared with those of each target alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from measuring import environment, on_one_thread, table

from bayesnet_track.inference.asking import follow, score
from bayesnet_track.observation.cue import Hypotheses, MeasuringCue, context_of, installed_cues
from bayesnet_track.observation.planes import FramePair, PlaneCache, Region, region_of_boxes
from cues import HEIGHT, WIDTH, cloud, frame, picture

COUNTS, TARGETS = (1, 10, 50), 50


def microseconds(calls: dict[int, list[Callable[[], object]]], repeats: int) -> dict[int, float]:
    """Size of a group -> the least CPU time per target of all its calls; sizes take turns."""
    least = dict.fromkeys(calls, np.inf)
    for _ in range(repeats):
        for size, of_size in calls.items():
            start = time.process_time()
            for call in of_size:
                call()
            least[size] = min(least[size], 1e6 * (time.process_time() - start) / TARGETS)
    return least


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cues", nargs="*", metavar="CUE", help="only these (default: all that score)")
    parser.add_argument("--hypotheses", type=int, default=200)
    parser.add_argument("--side", type=float, default=24.0, help="of the targets, px")
    parser.add_argument("--repeats", type=int, default=30)
    options = parser.parse_args()
    on_one_thread()
    images = [picture(np.random.default_rng(0), shift) for shift in [(0, 0), (4, 2)]]
    previous, current = (frame(n, image) for n, image in enumerate(images))
    cache, rng, size = PlaneCache(FramePair(current, previous)), np.random.default_rng(1), options.hypotheses
    places = rng.uniform(
        2 * options.side, [WIDTH - 2 * options.side, HEIGHT - 2 * options.side], (TARGETS, 2)
    )
    boxes = np.hstack([places, np.full((TARGETS, 2), options.side)])
    clouds = [cloud(rng, box, size, 4.0) for box in boxes]
    rows = []
    for name, declaration in installed_cues().items():
        if options.cues and name not in options.cues:
            continue
        cue = declaration.make(declaration.parameters())
        if isinstance(cue, MeasuringCue):
            continue
        near = [cache.planes(cue.needs, region_of_boxes(box[None], context_of(cue))) for box in boxes]
        references = [cue.learn(planes, box) for planes, box in zip(near, boxes, strict=True)]
        whole = [cache.planes(cue.needs, Region(0, 0, WIDTH, HEIGHT))] * TARGETS
        own = [cache.planes(cue.needs, region_of_boxes(one)) for one in clouds]
        scoring, learning = ({count: [] for count in COUNTS} for _ in range(2))
        for count in COUNTS:
            starts, rates = np.arange(count + 1) * size, np.full(count, 0.05)
            seen = whole if count > 1 and hasattr(cue, "log_likelihood_of_each") else own
            known = whole if count > 1 and hasattr(cue, "follow_each") else near
            for first in range(0, TARGETS, count):
                some = slice(first, first + count)
                at = Hypotheses(np.concatenate(clouds[some]))
                scoring[count].append(partial(score, cue, seen[some], at, starts, references[some]))
                learning[count].append(
                    partial(follow, cue, known[some], boxes[some], references[some], rates)
                )
        one = [
            partial(
                score, cue, own[t : t + 1], Hypotheses(clouds[t][:1]), np.array([0, 1]), references[t : t + 1]
            )
            for t in range(TARGETS)
        ]
        values, _ = scoring[TARGETS][0]()
        for t in range(TARGETS):
            alone, _ = scoring[1][t]()
            assert alone.tobytes() == values[t * size : (t + 1) * size].tobytes(), f"{name}: target {t}"
        scored = microseconds({**scoring, 0: one}, options.repeats)
        learnt = microseconds(learning, options.repeats)
        cells = [f"`{name}`", f"{scored[1]:.0f}", *(f"{scored[k] / scored[1]:.2f}" for k in (0, *COUNTS[1:]))]
        cells += [f"{learnt[1]:.0f}", *(f"{learnt[count] / learnt[1]:.2f}" for count in COUNTS[1:])]
        rows.append(cells)
    print(f"{environment()}\n{size} boxes of {options.side:g} px a target, least of {options.repeats}\n")
    print(table(["cue", "score, us", "one box", "of 10", "of 50", "learn, us", "of 10", "of 50"], rows))


if __name__ == "__main__":
    main()
