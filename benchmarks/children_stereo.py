"""Section 5.6 of the thesis with its agents and thresholds, beside ours (Figures 5.9 to 5.15).

    python benchmarks/children_stereo.py [--seeds 10]

Two children throw a ball before a stereo pair. Ball and child start with colour and stereo and drop what they
can do without. Thesis: equation (5.10) with an error of 0.1 and 95 % confidence, at least 1000 hypotheses,
the importance function adapted above a KL of 2 nats. Ours: at least 500, above 3 nats. Prints which agents
are left after the first frames, and a row for each with and without an adaptive importance function:
hypotheses of the ball while it is held and while it flies, those of the child, KL, the share of frames above
the threshold, errors, and runs in which the targets were held to the end.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from ball_between_children import HELD, IN_FLIGHT
from measuring import table
from numpy.typing import NDArray

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.read import read_graph
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.runtime.run import Start
from bayesnet_track.runtime.session import track
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import Scene
from bayesnet_track.sources.scenes.children import BALL, CHILD, HEIGHT, WIDTH, ball_between_children
from bayesnet_track.sources.scenes.render import Movie, Sprite
from bayesnet_track.sources.scenes.room import Room
from bayesnet_track.sources.scenes.scene import assemble
from bayesnet_track.sources.scenes.stereo import GEOMETRY, room_texture
from bayesnet_track.sources.scenes.stereo_view import StereoView
from bayesnet_track.sources.scenes.texture import ORANGE, gray_cells, shaded_cells

Floats = NDArray[np.float64]
CHILD_M, BALL_M, WALL_M, CAMERA_HEIGHT_M = 3.0, 2.8, 7.0, 0.975
"""Distances, so that children of 130 px are 1.3 m tall and stand on the floor."""

SETTLED = 10
"""Frame in which the agents are counted."""

GRAPH = """
bayesnet: 1
name: children_stereo
targets:
  ball:
    nodes:
      ball:
        belief: {{particles: {{size: {size}, min: {least}, max: 5000, proposal: {proposal}}}}}
        motion: {{random_walk: {{sd_px: {{x: 20, y: 20, w: 0.5, h: 0.5}}}}}}
        fuse: product
        ud_fields: [x, y]
        adapt:
          activate: {{above: {{ud_px2: 1200}}, frames: 2}}
          deactivate: {{below: {{ud_px2: 600}}, frames: 3}}
      color: {{parent: ball, agent: {{color_histogram: {{floor: 0.00001}}}}}}
      stereo: {{parent: ball, agent: {{stereo: {{floor: 0.003, max_depth_m: 6.5}}}}}}
  child:
    nodes:
      child:
        belief: {{particles: {{size: {size}, min: {least}, max: 5000, proposal: {proposal}}}}}
        motion: {{random_walk: {{sd_px: {{x: 20, y: 20, w: 0.5, h: 0.5}}}}}}
        fuse: product
        ud_fields: [x, y]
        adapt:
          activate: {{above: {{ud_px2: 1200}}, frames: 2}}
          deactivate: {{below: {{ud_px2: 600}}, frames: 3}}
      color: {{parent: child, agent: {{color_histogram: {{floor: 0.003}}}}}}
      stereo:
        parent: child
        agent: {{stereo: {{floor: 0.003, max_depth_m: 6.5, camera_height_m: 0.975}}}}
"""
SIZE = "{kld_revised: {error: 0.1, confidence: 0.95, bin_px: 10}}"
VARIANTS = {
    "thesis, number": (1000, "bootstrap"),
    "thesis, number and importance": (1000, "{second_pass: {above_kl: 2}}"),
    "ours, number": (500, "bootstrap"),
    "ours, number and importance": (500, "{second_pass: {above_kl: 3}}"),
}


@dataclass(frozen=True, eq=False)
class Traced:
    """One run, frame by frame; ball and child in rows 0 and 1.

    Attributes:
        particles: (2, n) hypotheses asked about.
        surprise: (2, n) KL(posterior || prior), nats.
        error: (2, n) distance of the estimate's centre from the true one, px.
        settled: the active agents of ball and child in frame `SETTLED`.
    """

    particles: Floats
    surprise: Floats
    error: Floats
    settled: tuple[str, str]


def stereo_scene(seed: int) -> Scene:
    """The library's scene in a room, with a second eye: children at 3 m, the ball at 2.8 m."""
    rng = np.random.Generator(np.random.Philox(seed + (1 << 40)))
    flat = ball_between_children(seed)
    left, right, ball = (centre_from_corner(path) for path in (flat.others[0], flat.others[1], flat.truth))
    gray = (110.0, 110.0, 110.0)
    room = Room(WALL_M, CAMERA_HEIGHT_M, room_texture(rng, gray), room_texture(rng, gray), 0.1)
    shirts = ((90.0, 150.0, 70.0), (190.0, 110.0, 60.0))
    cells = [0.8 * shaded_cells(26, 10, c, 0.6, rng) + 0.2 * gray_cells(26, 10, 20, 235, rng) for c in shirts]
    sprites = (
        Sprite(cells[0], left),
        Sprite(cells[1], right),
        Sprite(shaded_cells(6, 6, ORANGE, 0.75, rng), ball, is_round=True),
    )
    depths = tuple(np.full(len(left), at) for at in (CHILD_M, CHILD_M, BALL_M))
    views = [room.seen(GEOMETRY, eye, WIDTH, HEIGHT) for eye in (0.0, GEOMETRY.baseline_m)]
    shift = GEOMETRY.focal_px * GEOMETRY.baseline_m
    others = tuple(
        replace(one, path=one.path - np.column_stack([shift / depth, np.zeros((len(depth), 3))]))
        for one, depth in zip(sprites, depths, strict=True)
    )
    scene = assemble("children_stereo", views[0][0], sprites, 2, 2.0, seed, plates=("ball", "child"))
    paths = tuple(sprite.path for sprite in sprites)
    view = StereoView(Movie(views[1][0], others, 2.0, seed + (1 << 32)), GEOMETRY, views[0][1], paths, depths)
    return replace(scene, stereo=view)


def traced(graph: GraphSpec, scene: Scene, seed: int) -> Traced:
    """Run a graph on the scene."""
    starts = [Start(box, plate) for plate, box in scene.starts]
    truth = [centre_from_corner(path) for path in (scene.truth, scene.others[0])]
    rows, settled = [], ("", "")
    for result in track(graph, SceneSource(scene, scene.name), starts, seed=seed):
        at = result.frame.index
        if at == SETTLED:
            ball, child = (" ".join(line.active) for line in result.targets)
            settled = ball, child
        rows.append(
            [
                (line.particles, line.surprise, np.hypot(*(np.array(line.centre_box[:2]) - truth[k][at, :2])))
                for k, line in enumerate(result.targets)
            ]
        )
    return Traced(*np.array(rows, dtype=np.float64).transpose(2, 1, 0), settled=settled)


def report(runs: dict[str, list[Traced]]) -> str:
    """One row for each variant: means over runs and frames."""
    rows = []
    for name, found in runs.items():
        number, surprise, error = (
            np.array([getattr(run, key) for run in found]) for key in ("particles", "surprise", "error")
        )
        limit = 2.0 if name.startswith("thesis") else 3.0
        rows.append(
            [
                name,
                f"{number[:, 0][:, HELD].mean():.0f}",
                f"{number[:, 0][:, IN_FLIGHT].mean():.0f}",
                f"{number[:, 1, 1:].mean():.0f}",
                f"{surprise[:, 0][:, HELD].mean():.2f}",
                f"{surprise[:, 0][:, IN_FLIGHT].mean():.2f}",
                f"{np.mean(surprise[:, 0][:, HELD] > limit):.2f}",
                f"{np.mean(surprise[:, 0][:, IN_FLIGHT] > limit):.2f}",
                f"{error[:, 0][:, IN_FLIGHT].mean():.2f}",
                f"{error[:, 1, 1:].mean():.2f}",
                f"{sum(run.error[0, -5:].max() < BALL / 2 for run in found)}/{len(found)}",
                f"{sum(run.error[1, -5:].max() < CHILD[0] / 2 for run in found)}/{len(found)}",
            ]
        )
        for k, target in enumerate(("ball", "child")):
            print(f"{name}: {target} in frame {SETTLED}:", dict(Counter(run.settled[k] for run in found)))
    heads = [
        "",
        "N held",
        "N in flight",
        "N child",
        "KL held",
        "KL in flight",
        "above, held",
        "above, in flight",
    ]
    return table([*heads, "error in flight px", "of child px", "ball held", "child held"], rows)


def main() -> None:
    """Run all variants and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    options = parser.parse_args()
    scenes = [stereo_scene(seed) for seed in range(options.seeds)]
    runs = {}
    for name, (least, proposal) in VARIANTS.items():
        graph = read_graph(GRAPH.format(size=SIZE, least=least, proposal=proposal), "children_stereo")[0]
        runs[name] = [traced(graph, scene, seed) for seed, scene in enumerate(scenes)]
    print(report(runs))


if __name__ == "__main__":
    main()
