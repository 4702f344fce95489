"""How much memory and how many open files a long run takes: tiny frames, a small net, everything recorded.

    python benchmarks/soak.py --frames 1000000

Prints resident memory, open files and frames a second as it goes, and the growth since the warm-up.
"""

from __future__ import annotations

import argparse
import gc
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.session import track

WIDTH, HEIGHT, SIDE = 64, 48, 10
GRAPH = {
    "name": "soak",
    "targets": {
        "square": {
            "nodes": {
                "square": {
                    "belief": {"particles": {"size": 20}},
                    "fuse": "product",
                    "motion": {"random_walk": {"sd_px": {"x": 2.0, "y": 2.0}}},
                    "adapt": {
                        "activate": {"above": {"ud_px2": 4.0}, "frames": 2},
                        "deactivate": {"below": {"ud_px2": 3.0}, "frames": 3, "drop": "largest_kl"},
                    },
                    "learn": {"below": {"ud_px2": 50.0}, "rate_max": 0.05},
                },
                "gray": {"parent": "square", "agent": "intensity"},
                "moves": {"parent": "square", "agent": "motion", "active": False},
            }
        }
    },
}
"""A net that reconfigures itself again and again, learns, and costs little."""


@dataclass
class Square:
    """A source: a bright square that goes round in a noisy picture, for so many frames."""

    count: int
    description: str = "soak"
    frame_interval_s: float = 0.04
    width: int = WIDTH
    height: int = HEIGHT
    end_reason: str = "end_of_source"

    @property
    def expected_frames(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Frame]:
        rng = np.random.default_rng(7)
        noise = rng.integers(0, 40, (16, HEIGHT, WIDTH, 3), dtype=np.uint8)
        for index in range(self.count):
            image = noise[index % 16].copy()
            x, y = place(index)
            image[y : y + SIDE, x : x + SIDE] = 200
            yield Frame(index, float(index), image, True, index * 0.04)


def place(index: int) -> tuple[int, int]:
    """Top-left corner of the square in a frame."""
    turn = 2 * np.pi * index / 200
    return round(27 + 15 * np.cos(turn)), round(19 + 10 * np.sin(turn))


@dataclass(frozen=True)
class Measured:
    """Memory and files at one frame."""

    frame: int
    resident_kb: int
    files: int
    seconds: float


def resident_kb() -> int:
    """Resident memory of this process, of its own (not of mapped files)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1])
    raise OSError("no RssAnon in /proc/self/status: Linux is needed")


def soak(frames: int, every: int, out: Path) -> Iterator[Measured]:
    """Track through `frames` frames, all recorded in `out`; measures every so many of them."""
    cv2.setNumThreads(1)  # a picture this small is done before a second thread wakes
    began = time.perf_counter()
    x, y = place(0)
    results = track(check_graph(GRAPH), Square(frames), (x, y, SIDE, SIDE), out=out, seed=1)
    for result in results:
        done = result.frame.index + 1
        if done % every == 0:
            gc.collect()
            files = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
            yield Measured(done, resident_kb(), files, time.perf_counter() - began)


def main() -> None:
    """Print as it goes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--every", type=int, default=10_000)
    options = parser.parse_args()
    first = None
    with tempfile.TemporaryDirectory() as folder:
        for now in soak(options.frames, options.every, Path(folder) / "run"):
            first = first or now
            growth = 100 * (now.resident_kb / first.resident_kb - 1)
            print(
                f"frame {now.frame:>8}: {now.resident_kb / 1024:.1f} MB ({growth:+.2f} %), "
                f"{now.files} files, {now.frame / now.seconds:.0f} frames/s",
                flush=True,
            )


if __name__ == "__main__":
    main()
