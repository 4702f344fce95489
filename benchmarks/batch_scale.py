"""A batch of thousands of short clips: seconds, CPU and bytes a clip, and of each that is finished already.

    python benchmarks/batch_scale.py --clips 2000 --on here
    python benchmarks/batch_scale.py --clips 2000 --on ray --nodes 2
    python benchmarks/batch_scale.py --clips 2000 --parts 8

A clip is a video file of 20 frames (`--frames`) of 320x240 px, tracked with `general` from a given box. All
clips are links to a few files, so that decoding is real and making them is quick; and what is written of the
links to one file must be the same bytes, whichever process tracked them and after whatever else. The batch
is run once, or in parts, and again when all is finished. CPU time is that of all processes below this one,
looked at ten times a second; with `--nodes` a Ray cluster of so many nodes is started here, and its processes
count. Memory is the largest that one process held.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av
import numpy as np
from measuring import environment, table

FILES, SAMPLES_S = 8, 0.1
TICKS, PAGE = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")
CALL = "import sys; from bayesnet_track.cli.main import main; sys.exit(main(sys.argv[1:]))"


def clip(path: Path, seed: int, frames: int) -> None:
    """A textured square that walks over a textured background."""
    rng = np.random.default_rng(seed)
    scene = rng.integers(60, 180, (240, 320, 3), dtype=np.uint8)
    square = rng.integers(0, 255, (40, 40, 3), dtype=np.uint8)
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=25, options={"crf": "18", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for number in range(frames):
            image = scene.copy()
            image[100:140, 60 + 4 * number : 100 + 4 * number] = square
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)


class Usage:
    """CPU seconds, and the most bytes of one process, of all below this one, by looking often."""

    def __init__(self) -> None:
        self._seconds: dict[tuple[int, int], float] = {}
        self.most_bytes = 0
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    @property
    def seconds(self) -> float:
        """CPU seconds so far."""
        return sum(self._seconds.values())

    def _watch(self) -> None:
        while not self._over.wait(SAMPLES_S):
            below, parents = {os.getpid()}, {}
            for place in Path("/proc").iterdir():
                if place.name.isdigit():
                    try:
                        words = (place / "stat").read_text().rpartition(")")[2].split()
                    except OSError:
                        continue
                    parents[int(place.name)] = words
            size = 0
            while size != len(below):
                size = len(below)
                below |= {number for number, words in parents.items() if int(words[1]) in below}
            for number in below - {os.getpid()}:
                if number in parents:
                    words = parents[number]
                    self._seconds[number, int(words[19])] = (int(words[11]) + int(words[12])) / TICKS
                    self.most_bytes = max(self.most_bytes, int(words[21]) * PAGE)


@contextmanager
def cluster(nodes: int, jobs: int) -> Iterator[list[str]]:
    """Options of `batch` for a Ray cluster of nodes that is started here; none without nodes."""
    if not nodes:
        yield []
        return
    from ray.cluster_utils import Cluster

    started = Cluster()
    for _ in range(nodes):
        started.add_node(num_cpus=max(1, jobs // nodes), include_dashboard=False)
    try:
        yield ["--ray-address", started.address]
    finally:
        started.shutdown()


def turn(folder: Path, options: argparse.Namespace, out: Path, more: list[str]) -> None:
    """The batch once."""
    command = [sys.executable, "-P", "-c", CALL, "batch", options.graph, "--source", f"{folder}/*.mp4"]
    command += ["--init", "60,100,40,40", "--out", str(out), "--on", options.on, "-q", *more]
    command += ["--jobs", str(options.jobs)] if options.on == "here" else []
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=options.seconds)
    if done.returncode:
        raise SystemExit(f"exit {done.returncode}: {(done.stdout + done.stderr)[-1500:]}")


def different(out: Path) -> list[str]:
    """Files of clips that show the same and were written differently."""
    digests: dict[tuple[int, str], set[str]] = defaultdict(set)
    for name in ("frames.npy.gz", "tracks.txt"):
        for path in out.glob(f"*/{name}"):
            key = int(path.parent.name.split("-")[0]) % FILES, name
            digests[key].add(hashlib.sha256(path.read_bytes()).hexdigest())
    if len(digests) < 2:
        raise SystemExit("no run to compare")
    return [f"{name} of file {number}" for (number, name), found in digests.items() if len(found) > 1]


def main() -> None:
    """Make the clips, run the batch twice and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--clips", type=int, default=2000)
    parser.add_argument("--graph", default="general")
    parser.add_argument("--on", default="here", choices=("here", "ray"))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--frames", type=int, default=20, help="of a clip")
    parser.add_argument("--nodes", type=int, default=0, help="of a Ray cluster that is started for it")
    parser.add_argument("--parts", type=int, default=0, help="--part K/N for each K, and then the whole")
    parser.add_argument("--seconds", type=float, default=3600.0, help="after which it is given up")
    options = parser.parse_args()
    print(f"{environment()}; {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name) / "clips", Path(name) / "out"
        folder.mkdir()
        for number in range(options.clips):
            if number < FILES:
                clip(folder / f"{number:06}.mp4", number, options.frames)
            else:
                os.link(folder / f"{number % FILES:06}.mp4", folder / f"{number:06}.mp4")
        rows, usage = [], Usage()
        parts = [["--part", f"{part + 1}/{options.parts}"] for part in range(options.parts)]
        with cluster(options.nodes, options.jobs) as address:
            for what, turns in (("first", parts or [[]]), ("when all is finished", [[]])):
                began, before = time.monotonic(), usage.seconds
                for more in turns:
                    turn(folder, options, out, address + more)
                seconds, cpu = time.monotonic() - began, usage.seconds - before
                each = [
                    f"{seconds:.1f}",
                    f"{options.clips / seconds:.1f}",
                    f"{1e3 * cpu / options.clips:.1f}",
                ]
                rows.append([what, *each, f"{usage.most_bytes / 1e6:.0f}"])
                print(rows[-1], flush=True)
        with (out / "results.csv").open(encoding="utf-8") as file:
            states = Counter(row["status"] for row in csv.DictReader(file))
        size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
        print(table([options.on, "s", "clips/s", "CPU ms a clip", "largest process [MB]"], rows))
        print(f"\n{dict(states)}; {size / options.clips / 1000:.1f} kB a clip")
        print(f"clips that show the same and differ: {different(out) or 'none'}")


if __name__ == "__main__":
    main()
