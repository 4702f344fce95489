"""A batch of thousands of short clips: seconds, CPU and bytes a clip, and of each that is finished already.

    python benchmarks/batch_scale.py --clips 2000 --on here
    python benchmarks/batch_scale.py --clips 2000 --on ray

A clip is 20 frames of 320x240 px as a video file, tracked with `general` from a given box. All clips are
links to a few files, so that decoding is real and making them is quick. The batch is run once, and again when
all is finished; CPU time is that of all processes of the batch, with Ray of those that are its children.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import av
import numpy as np
from measuring import environment, table

FRAMES, FILES = 20, 8
CALL = "import sys; from bayesnet_track.cli.main import main; sys.exit(main(sys.argv[1:]))"


def clip(path: Path, seed: int) -> None:
    """A textured square that walks over a textured background."""
    rng = np.random.default_rng(seed)
    scene = rng.integers(60, 180, (240, 320, 3), dtype=np.uint8)
    square = rng.integers(0, 255, (40, 40, 3), dtype=np.uint8)
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=25, options={"crf": "18", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for number in range(FRAMES):
            image = scene.copy()
            image[100:140, 60 + 4 * number : 100 + 4 * number] = square
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)


def spent() -> float:
    """CPU seconds of children that have ended."""
    use = resource.getrusage(resource.RUSAGE_CHILDREN)
    return use.ru_utime + use.ru_stime


def turn(folder: Path, options: argparse.Namespace, out: Path) -> tuple[float, float]:
    """Seconds and CPU seconds of the batch."""
    command = [sys.executable, "-P", "-c", CALL, "batch", options.graph, "--source", f"{folder}/*.mp4"]
    command += ["--init", "60,100,40,40", "--out", str(out), "--on", options.on, "-q"]
    command += ["--jobs", str(options.jobs)] if options.on == "here" else []
    began, before = time.monotonic(), spent()
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=options.seconds)
    if done.returncode:
        raise SystemExit(f"exit {done.returncode}: {(done.stdout + done.stderr)[-1500:]}")
    return time.monotonic() - began, spent() - before


def main() -> None:
    """Make the clips, run the batch twice and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--clips", type=int, default=2000)
    parser.add_argument("--graph", default="general")
    parser.add_argument("--on", default="here", choices=("here", "ray"))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seconds", type=float, default=3600.0, help="after which it is given up")
    options = parser.parse_args()
    print(f"{environment()}; {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name) / "clips", Path(name) / "out"
        folder.mkdir()
        for number in range(options.clips):
            if number < FILES:
                clip(folder / f"{number:06}.mp4", number)
            else:
                os.link(folder / f"{number % FILES:06}.mp4", folder / f"{number:06}.mp4")
        rows = []
        for what in ("first", "when all is finished"):
            seconds, cpu = turn(folder, options, out)
            rows.append(
                [
                    what,
                    f"{seconds:.1f}",
                    f"{options.clips / seconds:.1f}",
                    f"{1e3 * cpu / options.clips:.1f}",
                ]
            )
        with (out / "results.csv").open(encoding="utf-8") as file:
            states = Counter(row["status"] for row in csv.DictReader(file))
        size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
        print(table([options.on, "s", "clips/s", "CPU ms a clip"], rows))
        print(f"\n{dict(states)}; {size / options.clips / 1000:.1f} kB a clip")


if __name__ == "__main__":
    main()
