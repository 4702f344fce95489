"""Compare what two installations compute: decisions, boxes and moments of beliefs, over all graphs.

    python benchmarks/same_results.py --before OLD/bin/python --after NEW/bin/python [--seeds 2] [--only A,B]
    python benchmarks/same_results.py --print [--seeds 2]

For a change that must not change results, however they are stored: equality is a hash of what `track` hands
out, not of files. Both environments need the same versions of everything else. Crowds of detections are drawn
here, with misses and false alarms, and given to every graph that takes detections. Exit code 1 where a hash
differs. Where modules that this file imports have moved in between, let each version print with its own copy,
and compare the lines.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

SCENES = {
    "ball_between_children": ("ball_between_children", 50),
    "bouncing_square": ("two_squares", 60),
    "carried_box": ("carried_box", 60),
    "color_fusion": ("two_squares", 40),
    "crowd": ("crowd", 25),
    "falling_ball": ("flying_ball", 80),
    "general": ("two_squares", 60),
    "gray_square": ("gray_square", 60),
    "grid_displacement": ("two_squares", 20),
    "head_and_torso": ("person_parts", 30),
    "hidden_ball": ("flying_ball", 80),
    "kalman_ball": ("flying_ball", 80),
    "orange_and_gray": ("orange_and_gray", 60),
    "orange_and_gray_detected": ("orange_and_gray", 60),
    "people_by_depth": ("person_stereo", 30),
    "people_by_outline": ("two_people_color_stereo_shape", 30),
    "person_color_stereo": ("person_color_stereo", 30),
    "person_leaning": ("person_parts", 30),
    "person_levels": ("person_parts", 30),
    "person_parts": ("person_parts", 30),
    "person_same_clothes": ("person_same_clothes", 30),
    "person_shape": ("person_and_board", 40),
    "person_stereo": ("person_stereo", 30),
    "road": ("two_squares", 40),
    "two_colors": ("two_squares", 40),
    "two_people_color_stereo_shape": ("two_people_color_stereo_shape", 30),
    "two_squares": ("two_squares", 80),
    "two_squares_velocity": ("two_squares", 60),
}
"""Graph -> scene and frames."""
DETECTED = ("bytetrack", "jpda", "kalman_detections", "oc_sort", "people_detections", "sort")
"""Graphs that track a crowd of detections. `deep`, `people`, `radar_ball` and `road_mask` need files."""
COUNT, FRAMES, SIZE = 12, 80, (640, 480)


def draw_detections(seed: int) -> str:
    """A MOT file of people that walk, cross, are missed for some frames, with false alarms."""
    rng = np.random.default_rng(seed)
    places = rng.uniform((40, 60), (600, 420), (COUNT, 2))
    steps, sizes = rng.normal(0, 2.5, (COUNT, 2)), rng.uniform((18, 45), (28, 70), (COUNT, 2))
    hidden = rng.integers(10, FRAMES - 15, COUNT)
    lines = []
    for frame in range(FRAMES):
        places += steps
        steps = np.where((places < (40, 60)) | (places > (600, 420)), -steps, steps)
        for k in range(COUNT):
            if rng.random() < 0.06 or hidden[k] <= frame < hidden[k] + 10 * (k % 3 == 0):
                continue
            box = np.concatenate([places[k] + rng.normal(0, 1, 2), sizes[k] * rng.normal(1, 0.03, 2)])
            lines.append(_line(frame, box, rng.uniform(0.4, 1)))
        for _ in range(rng.poisson(0.5)):
            box = np.concatenate([rng.uniform((40, 60), (600, 420)), rng.uniform((18, 45), (28, 70))])
            lines.append(_line(frame, box, rng.uniform(0.2, 0.8)))
    return "\n".join(lines) + "\n"


def _line(frame: int, box: np.ndarray, score: float) -> str:
    x, y, w, h = box
    return f"{frame + 1},-1,{x - w / 2:.3f},{y - h / 2:.3f},{w:.3f},{h:.3f},{score:.4f},-1,-1,-1"


def results_of(graph: str, seed: int, folder: Path) -> Iterator[Any]:
    """What `track` hands out of one graph and seed."""
    import cv2

    from bayesnet_track import track
    from bayesnet_track.engine.starts import Start, has_births
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.sources.scenes import make_scene
    from bayesnet_track.sources.scenes.library import SceneSource

    if graph in DETECTED:
        images = folder / "blank"
        if not images.exists():
            images.mkdir()
            for frame in range(FRAMES):
                noise = np.random.default_rng(frame).integers(0, 256, (*SIZE[::-1], 3)).astype(np.uint8)
                cv2.imwrite(str(images / f"{frame:05d}.png"), noise)
        detections = folder / f"{seed}.txt"
        detections.write_text(draw_detections(seed), encoding="utf-8")
        yield from track(graph, images, seed=seed, detections=detections)
        return
    name, frames = SCENES[graph]
    scene, checked = make_scene(name, seed), load_graph(graph)
    plates = list(checked.targets)
    places = scene.starts or [(plates[0], scene.start_box)]
    starts = [Start(box, plate if plate in plates else plates[0]) for plate, box in places]
    given = None if has_births(checked) else starts
    yield from track(graph, SceneSource(scene, name, frames), given, seed=seed)


def hashes_of(graph: str, seed: int, folder: Path) -> dict[str, str]:
    """Hashes of decisions, boxes and moments; of an error its text."""
    parts = {name: hashlib.sha256() for name in ("decisions", "boxes", "moments")}
    try:
        for result in results_of(graph, seed, folder):
            parts["decisions"].update(repr(result.decisions).encode())
            for one in result.targets:
                parts["boxes"].update(f"{result.frame.index} {one.target} {one.status}".encode())
                parts["boxes"].update(np.asarray(one.xywh, np.float64).tobytes())
                moments = [*one.sd, one.ud_px2, one.score, *(one.kl[agent] for agent in sorted(one.kl))]
                parts["moments"].update(np.asarray(moments, np.float64).tobytes())
            for target in sorted(result.covariances):
                parts["moments"].update(np.asarray(result.covariances[target], np.float64).tobytes())
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}"}
    return {name: part.hexdigest()[:16] for name, part in parts.items()}


def print_hashes(seeds: int, only: list[str]) -> None:
    """A JSON line for each graph and seed."""
    with tempfile.TemporaryDirectory() as folder:
        for graph in sorted({*SCENES, *DETECTED}):
            for seed in range(seeds):
                if not only or graph in only:
                    found = hashes_of(graph, seed, Path(folder))
                    print(json.dumps({"graph": graph, "seed": seed, **found}), flush=True)


def ask(python: str, arguments: list[str]) -> list[dict[str, Any]]:
    """The hashes by another interpreter, in a folder where no checkout shadows its installation."""
    with tempfile.TemporaryDirectory() as folder:
        call = [python, "-P", str(Path(__file__).resolve()), "--print", *arguments]
        done = subprocess.run(call, capture_output=True, text=True, check=True, cwd=folder)
    return [json.loads(line) for line in done.stdout.splitlines()]


def main() -> int:
    """Print or compare; the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--before", help="interpreter of the older installation")
    parser.add_argument("--after", default=sys.executable, help="of the newer one (default: this one)")
    parser.add_argument("--print", action="store_true", help="only print this installation's hashes")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", default="", help="graphs, with commas (default: all)")
    options = parser.parse_args()
    only = [name for name in options.only.split(",") if name]
    if options.print or options.before is None:
        print_hashes(options.seeds, only)
        return 0
    arguments = ["--seeds", str(options.seeds), "--only", options.only]
    before, after = ask(options.before, arguments), ask(options.after, arguments)
    different = 0
    for old, new in zip(before, after, strict=True):
        parts = [name for name in new if name not in ("graph", "seed") and new.get(name) != old.get(name)]
        different += bool(parts)
        said = f"differs in {', '.join(parts)}" if parts else new.get("error", "equal")
        if "error" in old and "error" not in new:
            said = f"the older one failed: {old['error']}"
        print(f"{new['graph']:30} seed {new['seed']}: {said}")
    print(f"{different} of {len(after)} differ")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
