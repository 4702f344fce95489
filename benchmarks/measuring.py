"""What the benchmarks share: one thread, a textured scene of any size, graphs without adaptation, tables."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.graph.settings.net import AGENT_RULES
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.sources.scenes import Scene
from bayesnet_track.sources.scenes.scene import ORANGE, Sprite, assemble, gray_cells, shaded_cells
from bayesnet_track.sources.scenes.shapes import bouncing

Image = NDArray[np.uint8]

FOUR_AGENTS = ("histogram", "blobs", "intensity", "motion")
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def on_one_thread() -> None:
    """Start this script again with one thread for every library, unless it runs so already."""
    if any(os.environ.get(name) != "1" for name in _ONE_THREAD):
        environment = {**os.environ, **dict.fromkeys(_ONE_THREAD, "1")}
        os.execve(sys.executable, [sys.executable, *sys.argv], environment)
    import cv2

    cv2.setNumThreads(1)


def moving_target(
    width: int = 640, height: int = 480, side: float = 60.0, frames: int = 120, seed: int = 0
) -> Scene:
    """A patterned orange square that bounces over a patterned gray background: corners everywhere."""
    rng = np.random.Generator(np.random.Philox(seed))
    cells = gray_cells(height // 10, width // 10, 60, 200, rng)
    background = np.repeat(np.repeat(cells, 10, axis=0), 10, axis=1)
    background = np.pad(
        background, ((0, height - len(background)), (0, width - background.shape[1]), (0, 0)), "edge"
    )
    path = bouncing((width * 0.3, height * 0.4), (3.3, 2.1), side, frames, width, height)
    target = Sprite(shaded_cells(8, 8, ORANGE, 0.35, rng), path)
    return assemble("moving_target", background, (target,), target=0, noise_sd=3.0, seed=seed)


def decoded(scene: Scene) -> list[Image]:
    """All frames of a scene in memory."""
    return list(scene.frames)


def always_on(
    graph: str = "general", agents: Sequence[str] = FOUR_AGENTS, particles: int | None = None
) -> GraphSpec:
    """An installed graph with only `agents`, all of them always on, and as many hypotheses as wanted.

    References are learnt in every frame whose UD is below 0.9 of the box's area, so that frames cost alike.
    """
    written = load_graph(graph).spec.model_dump(exclude_none=True)
    (plate,) = written["targets"].values()
    nodes = plate["nodes"]
    for name in [name for name, node in nodes.items() if "agent" in node and name not in agents]:
        del nodes[name]
    childless = [n for n, node in nodes.items() if "agent" not in node and not _children(nodes, n)]
    for name in childless:
        del nodes[name]
    for node in nodes.values():
        node.pop("adapt", None)
        for rule in AGENT_RULES:
            node.pop(rule, None)
        if "learn" in node:
            node["learn"]["below"] = {"ud_box": 0.9}
        if particles is not None and "belief" in node:
            node["belief"]["particles"]["size"] = particles
    return GraphSpec.model_validate(written)


def _children(nodes: dict[str, dict[str, object]], name: str) -> list[str]:
    return [child for child, node in nodes.items() if node.get("parent") == name]


def milliseconds(seconds: Sequence[float], digits: int = 2) -> str:
    """Median and 95th percentile, in ms."""
    values = np.asarray(seconds) * 1e3
    return f"{np.median(values):.{digits}f} (p95 {np.percentile(values, 95):.{digits}f})"


def table(head: Sequence[str], rows: Iterator[Sequence[str]] | Sequence[Sequence[str]]) -> str:
    """A Markdown table; all columns but the first are right-aligned."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def environment() -> str:
    """The machine and the libraries that a figure holds for."""
    import cv2

    cpu = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.exists():
        names = [line for line in information.read_text().splitlines() if line.startswith("model name")]
        cpu = names[0].partition(":")[2].strip() if names else cpu
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba"))
    return f"{cpu}; Python {platform.python_version()}, {versions}, OpenCV {cv2.__version__}"
