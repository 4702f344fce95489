"""What joins are worth: a carried box while it is hidden, and identities in a crowd, with and without joins.

python benchmarks/joins.py box [--seeds 20]
python benchmarks/joins.py crowd [--first 0] [--seeds 5] [--count 10] [--frames 200]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.starts import Start, start_targets
from bayesnet_track.engine.step import State, first_look, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.scenes.carried import carried_box
from bayesnet_track.sources.scenes.crowd import SIDE, crowd
from bayesnet_track.sources.scenes.scene import Scene

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tracked:
    """A run of a scene: (T, n, 4) estimates as centre boxes, events, seconds of steps and of joins."""

    boxes: Floats
    events: tuple[object, ...]
    seconds: float
    joins_seconds: float


def graph_of(name: str, joins: bool) -> CheckedGraph:
    """The graph of that name, or the same without its joins."""
    graph = load_graph(name)
    return graph if joins else check(graph.spec.model_copy(update={"joins": ()}))


def tracked(scene: Scene, graph: CheckedGraph, seed: int) -> Tracked:
    """Every start of `scene` followed by `graph`."""
    engine = make_engine(graph, seed)
    starts = [Start(box, plate) for plate, box in scene.starts]
    state: State | None = None
    boxes, events = [], []
    spent = joins = 0.0
    for index, picture in enumerate(scene.frames):
        frame = Frame(index, float(index), picture, True, float(index))
        began = time.perf_counter()
        if state is None:
            outcome = first_look(engine, start_targets(graph, engine, frame, starts), frame)
        else:
            outcome = step(engine, state, frame)
            spent += time.perf_counter() - began
            joins += outcome.seconds.get("joins", 0.0)
        state = outcome.state
        boxes.append([metrics.centre_box for metrics in outcome.metrics])
        events += outcome.events
    return Tracked(np.array(boxes).swapaxes(0, 1), tuple(events), spent, joins)


def hidden_error(scene: Scene, run: Tracked) -> float:
    """Median distance of the first target's centre from the truth, px, while it is hidden."""
    hidden = scene.visible == 0
    true = centre_from_corner(scene.truth)
    return float(np.median(np.linalg.norm(run.boxes[0, hidden, :2] - true[hidden, :2], axis=1)))


def switches(scene: Scene, run: Tracked) -> tuple[int, int]:
    """Crossings after which a net is not on its own target, and all crossings.

    A crossing is a stretch of frames in which the true boxes of two overlap by a twentieth of their area at
    some time; it is judged when they are apart by a quarter of a box, and only for a net that was on its own
    target, the nearest one, when the stretch began.
    """
    true = centre_from_corner(np.array([scene.truth, *scene.others]))[:, :, :2]
    away = np.linalg.norm(run.boxes[:, None, :, :2] - true[None], axis=-1)
    on = np.argmin(away, axis=1)  # (net, frame): the true one that it is nearest to
    errors = crossings = 0
    count, frames = len(true), true.shape[1]
    for a in range(count):
        for b in range(a + 1, count):
            gap = np.abs(true[a] - true[b])
            shared = np.prod(np.clip(SIDE - gap, 0.0, None), axis=1) / SIDE**2
            apart = gap.max(axis=1) > 1.25 * SIDE
            began, deep = None, False
            for frame in range(frames):
                if apart[frame]:
                    if began is not None and deep:
                        judged = [one for one in (a, b) if on[one, began] == one]
                        crossings += bool(judged)
                        errors += any(on[one, frame] != one for one in judged)
                    began, deep = None, False
                elif began is None:
                    began = max(frame - 1, 0)
                deep = deep or (not apart[frame] and shared[frame] > 0.05)
    return errors, crossings


def _box(seeds: range) -> None:
    print("seed  joined  alone   median error of the hidden box, px")
    found = []
    for seed in seeds:
        scene = carried_box(seed)
        errors = [
            hidden_error(scene, tracked(scene, graph_of("carried_box", on), seed)) for on in (True, False)
        ]
        found.append(errors)
        print(f"{seed:4d}  {errors[0]:6.1f}  {errors[1]:6.1f}", flush=True)
    middle = np.median(found, axis=0)
    better = sum(joined <= alone / 2 for joined, alone in found)
    print(
        f"median of seeds {middle[0]:.1f} against {middle[1]:.1f}; at most half in {better} of {len(found)}"
    )


def _crowd(seeds: range, count: int, frames: int) -> None:
    print("seed  crossings  switches joined  alone   ms per frame joined (of it joins)  alone")
    total = np.zeros(4)
    for seed in seeds:
        scene = crowd(seed, count, frames)
        runs = [tracked(scene, graph_of("crowd", on), seed) for on in (True, False)]
        scored = [switches(scene, run) for run in runs]
        total += [*scored[0], *scored[1]]
        ms = [1e3 * s / len(scene.frames) for s in (runs[0].seconds, runs[0].joins_seconds, runs[1].seconds)]
        print(
            f"{seed:4d}  {scored[1][1]:9d}  {scored[0][0]:8d} of {scored[0][1]:3d}  {scored[1][0]:5d}  "
            f"{ms[0]:8.1f} ({ms[1]:.1f})  {ms[2]:.1f}",
            flush=True,
        )
    print(
        f"{count} targets: {total[0] / max(total[1], 1):.3f} switches per crossing with joins, "
        f"{total[2] / max(total[3], 1):.3f} without"
    )


def main() -> None:
    """Run one of the two."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("which", choices=["box", "crowd"])
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--frames", type=int, default=200)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    if options.which == "box":
        _box(seeds)
    else:
        _crowd(seeds, options.count, options.frames)


if __name__ == "__main__":
    main()
