"""What do parts buy while one of them is hidden? A person of head and torso behind a counter and an awning.

    python benchmarks/parts.py [--seeds 20] [--only levels] [--figure docs/figures/parts.png]

Three nets with the same motion and the same two cues, colour and pattern, in the scene `person_parts`: the
library graph with parts; one net that sees the person's whole box, by both cues or by colour with a floor of
0.02, its best form, so that a part is where it belongs in the estimate; two nets that know nothing of each
other, one for the head and one for the torso. Prints the error of the hidden part's centre and of the part
that is seen meanwhile, and in how many seeds both parts are within half of their own size of the truth in the
last ten frames. Then parts with a `given` half and twice as wide, and the graph of three levels, whose parts
remember where they are, beside the same graph with parts drawn anew in each frame; and the graph of two
targets that a factor relates.
With `--figure` it draws three frames of seed 0 instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track import Start, track
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.runtime.results import Result
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.view.overlay import draw_overlay

Floats = NDArray[np.float64]

HIDDEN_BELOW = 0.05
LAST = 10
SHOWN = (4, 50, 118)
"""Frames of the figure."""
VIEW_WIDTH = 190


@dataclass(frozen=True)
class Errors:
    """Distances of a part's centre from the truth, px, over the frames in which one part is hidden."""

    hidden: Floats
    seen: Floats
    held: bool


def with_parts(noise: float = 1.0) -> GraphSpec:
    """The library graph, the sds of `given` times `noise`."""
    written = load_graph("person_parts").spec.model_dump(exclude_none=True)
    for name in ("head", "torso"):
        given = written["targets"]["person"]["nodes"][name]["fuse"]["latent"]["given"]
        given["sd_px"] = {axis: noise * sd for axis, sd in given["sd_px"].items()}
    return GraphSpec.model_validate(written)


def held_as(represented: str, hypotheses: int = 300) -> GraphSpec:
    """The library graph, its parts as one draw each, by the kernel, as a grid or as a Gaussian."""
    written = load_graph("person_parts").spec.model_dump(exclude_none=True)
    nodes = written["targets"]["person"]["nodes"]
    nodes["person"]["belief"] = {"particles": {"size": hypotheses}}
    for name in ("head", "torso"):
        if represented in ("one", "kernel"):
            nodes[name]["fuse"]["latent"]["draw"] = represented
        else:
            del nodes[name]["fuse"]["latent"]["draw"]
            nodes[name]["belief"] = {represented: {}}
    return GraphSpec.model_validate(written)


def with_levels(moving: bool = True) -> GraphSpec:
    """The library graph of three levels; its parts remember where they are, or are drawn anew."""
    written = load_graph("person_levels").spec.model_dump(exclude_none=True)
    for name in ("torso", "head"):
        if not moving:
            del written["targets"]["person"]["nodes"][name]["motion"]
    return GraphSpec.model_validate(written)


def alone(*plates: str, pattern: bool = True, floor: float = 0.001) -> GraphSpec:
    """A net for each plate: the same belief, motion and cues (or colour alone), and no parts."""
    written = load_graph("person_parts").spec.model_dump(exclude_none=True)
    nodes = written["targets"]["person"]["nodes"]
    root = {**nodes["person"], "fuse": "product"}
    agents = {"color": {"parent": "root", "agent": {"color_histogram": {"floor": floor}}}}
    if pattern:
        agents["pattern"] = {"parent": "root", "agent": {"intensity": {"floor": floor}}}
    written["targets"] = {plate: {"nodes": {"root": root, **agents}} for plate in plates}
    return GraphSpec.model_validate(written)


def places(scene: Scene, results: list[Result]) -> Mapping[str, Floats]:
    """Part -> (n, 2) where its centre is believed: its own estimate, or its place in the person's box."""
    found: dict[str, list[Floats]] = {name: [] for name in scene.parts}
    body = centre_from_corner(scene.truth[0])
    for result in results:
        metrics_of = {metrics.target: metrics for metrics in result.targets}
        for number, (name, part) in enumerate(scene.parts.items(), start=1):
            first = centre_from_corner(part.truth[0])
            whole = metrics_of["1"]
            if whole.parts:
                box = np.array(whole.parts[name].centre_box)
            elif len(metrics_of) > 1:
                box = np.array(metrics_of[str(number)].centre_box)
            else:
                box = np.array(whole.centre_box) + (first - body) * [1.0, 1.0, 0.0, 0.0]
            found[name].append(box[:2])
    return {name: np.array(rows) for name, rows in found.items()}


def run(graph: GraphSpec, seed: int) -> dict[str, Errors]:
    """Part -> errors over the frames in which it is the one that is hidden."""
    scene = make_scene("person_parts", seed)
    if len(graph.targets) == 1:
        starts = [Start(scene.start_box)]
    else:
        starts = [Start(tuple(float(v) for v in part.truth[0]), name) for name, part in scene.parts.items()]
    source = SceneSource(scene, "scene:person_parts")
    at = places(scene, list(track(graph, source, starts, seed=seed)))
    away = {
        name: np.hypot(*(at[name] - centre_from_corner(part.truth)[:, :2]).T)
        for name, part in scene.parts.items()
    }
    near = {name: np.sqrt(np.prod(part.truth[0, 2:])) / 2 for name, part in scene.parts.items()}
    held = all(bool((away[name][-LAST:] < near[name]).all()) for name in away)
    errors = {}
    for name, part in scene.parts.items():
        (other,) = set(scene.parts) - {name}
        frames = part.visible < HIDDEN_BELOW
        errors[name] = Errors(away[name][frames], away[other][frames], held)
    return errors


def row(text: str, graph: GraphSpec, seeds: int) -> list[str]:
    """One line of the table."""
    runs = [run(graph, seed) for seed in range(seeds)]
    cells = [text]
    for name in ("torso", "head"):
        hidden, seen = (
            np.concatenate([getattr(one[name], kind) for one in runs]) for kind in ("hidden", "seen")
        )
        cells += [f"{hidden.mean():.1f} ({np.quantile(hidden, 0.9):.1f})", f"{seen.mean():.1f}"]
    cells.append(f"{sum(one['head'].held for one in runs)} of {seeds}")
    print(" | ".join(cells), flush=True)
    return cells


def draw(path: Path) -> None:
    """Three frames side by side: both parts seen, the torso hidden, the head hidden."""
    scene = make_scene("person_parts")
    source = SceneSource(scene, "scene:person_parts")
    results = list(track(with_parts(), source, [Start(scene.start_box)]))
    views = []
    for index in SHOWN:
        view = draw_overlay(scene.frames[index], results[index].targets[0])
        left = int(min(max(scene.truth[index, 0] - 45, 0), scene.width - VIEW_WIDTH))
        views.append(view[:, left : left + VIEW_WIDTH] // 8 * 8)  # the file need not hold the noise
    if not cv2.imwrite(str(path), np.hstack(views)):
        raise SystemExit(f"cannot write {path}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--only", default="", metavar="TEXT", help="the rows whose names hold it")
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    on_one_thread()
    if options.figure:
        draw(options.figure)
        return
    print(environment() + "\n")
    graphs = {
        "with parts": with_parts(),
        "one net, the whole box": alone("person"),
        "one net, colour of the whole box": alone("person", pattern=False, floor=0.02),
        "two independent nets": alone("head", "torso"),
        "two nets and a factor": load_graph("head_and_torso").spec,
        "parts, `given` half as wide": with_parts(0.5),
        "parts, `given` twice as wide": with_parts(2.0),
        "three levels that move": with_levels(),
        "three levels, drawn anew": with_levels(moving=False),
    }
    graphs |= {
        f"300 hypotheses, each part as {text}": held_as(kind)
        for text, kind in {
            "one draw each": "one", "by the kernel": "kernel", "a grid": "grid", "a Gaussian": "gaussian",
        }.items()
    }  # fmt: skip
    rows = [row(text, one, options.seeds) for text, one in graphs.items() if options.only in text]
    head = [
        "",
        "hidden torso, px (90 %)",
        "head meanwhile",
        "hidden head, px (90 %)",
        "torso meanwhile",
        "held",
    ]
    print("\n" + table(head, rows))


if __name__ == "__main__":
    main()
