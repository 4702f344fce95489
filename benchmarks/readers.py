"""Memory and CPU time of every reader of a run of 50 people, by its length.

    python benchmarks/readers.py
    python benchmarks/readers.py --python OLD/.venv/bin/python .venv/bin/python

One run of 200 frames is tracked with `kalman_detections`; the records of its last 100 frames, and their
lines in tracks.txt, are repeated under the numbers of further frames, until it is as long as asked for.
Ground truth are the same lines, shifted by 3 px. Each reader is a process of its own; memory is its largest
resident size, and a reader that needs more than `--limit` is stopped and has none.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from crowd_speed import crowd, frames_of, graph_of
from measuring import environment, table

from bayesnet_track import track
from bayesnet_track.journal.frame_file import FrameFile, FrameWriter

TARGETS, TRACKED, REPEATED = 50, 200, 100
MB = 1_000_000

CALL = "import sys; from bayesnet_track.cli.main import main; sys.exit(main(sys.argv[1:]))"
OPEN = "import sys; from bayesnet_track import open_run; run = open_run(sys.argv[1]); "
READERS = {
    "log": (CALL, "log", "{run}"),
    "log --target": (CALL, "log", "{run}", "--target", "1"),
    "log --why": (CALL, "log", "{run}", "--why", "150"),
    "open_run": (OPEN, "{run}"),
    "open_run, lines": (OPEN + "print(sum(line.score for line in run.metrics))", "{run}"),
    "open_run, arrays": (OPEN + "print(run.arrays('box', 'score', 'status')['score'].sum())", "{run}"),
    "compare": (CALL, "compare", "{run}", "{run}"),
    "score": (CALL, "score", "{run}", "--truth", "{run}/truth_of_all.txt"),
    "diagnose": (CALL, "diagnose", "{run}"),
    "report --frames none": (CALL, "report", "{run}", "--frames", "none", "--out", "{run}/../report.html"),
}


class Crowd:
    """Black frames, as a source."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.width, self.height = size
        self.expected_frames, self.frame_interval_s = TRACKED, 0.04
        self.description, self.end_reason = "a crowd", "end_of_source"

    def __iter__(self):  # type: ignore[no-untyped-def]
        yield from frames_of((self.width, self.height), TRACKED)


def tracked(folder: Path) -> Path:
    """A run of 50 people."""
    size, found = crowd(TARGETS, TRACKED)
    lines = [
        ",".join(f"{value:g}" for value in (frame + 1, -1, x - w / 2, y - h / 2, w, h, score))
        for frame, one in found.items()
        for (x, y, w, h), score in zip(one.boxes, one.scores, strict=True)
    ]
    (folder / "detections.txt").write_text("\n".join(lines) + "\n")
    graph = graph_of("kalman_detections")
    for _ in track(graph, Crowd(size), out=folder / "run", detections=folder / "detections.txt"):
        pass
    return folder / "run"


def repeated(run: Path, frames: int) -> Path:
    """A copy of the run with so many frames."""
    longer = Path(shutil.copytree(run, run.with_name(f"run{frames}")))
    for name in ("manifest.json", "tracks.txt", "timings.jsonl"):
        (longer / name).unlink()
    file = FrameFile(longer / "frames.npy.gz")
    last = [dict(columns) for columns in file.columns(file.places[-REPEATED:])]
    with FrameWriter(longer / "frames.npy.gz", (run / "frames.npy.gz").stat().st_size) as writer:
        for frame in range(file.places[-1].frame + 1, frames):
            columns = last[frame % REPEATED]
            columns["frame"], columns["time_s"] = np.array(frame, "<i8"), np.array(frame / 25.0)
            writer.write_columns(columns)
    tracks = [line.split(",") for line in (run / "tracks.txt").read_text().splitlines()]
    start = file.places[-1].frame + 1
    repeated_lines = [[] for _ in range(REPEATED)]
    for words in tracks:
        if int(words[0]) > start - REPEATED:
            repeated_lines[(int(words[0]) - 1) % REPEATED].append(words[1:])
    with (longer / "tracks.txt").open("w") as boxes, (longer / "truth_of_all.txt").open("w") as truth:
        for frame in range(frames):
            lines = repeated_lines[frame % REPEATED]
            boxes.writelines(f"{frame + 1},{','.join(words)}\n" for words in lines)
            truth.writelines(
                f"{frame + 1},{words[0]},{float(words[1]) + 3:.3f},{','.join(words[2:5])},1,-1,-1,-1\n"
                for words in lines
            )
    return longer


def cost(python: str, reader: str, run: Path, limit_mb: int, seconds: float) -> str:
    """Megabytes and seconds of CPU of a reader; in words where it was stopped."""
    code, *words = READERS[reader]
    measure = (
        f"import resource, atexit; resource.setrlimit(resource.RLIMIT_AS, 2 * ({limit_mb * MB},))\n"
        "def tell():\n"
        "    use, status = resource.getrusage(resource.RUSAGE_SELF), open('/proc/self/status').read()\n"
        "    print('\\n', status.partition('VmHWM:')[2].split()[0], use.ru_utime + use.ru_stime)\n"
        "atexit.register(tell)\n"
    )
    command = [
        str(Path(python).absolute()),
        "-P",
        "-c",
        measure + code,
        *(word.format(run=run) for word in words),
    ]
    began = time.monotonic()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, cwd=run.parent)
    except subprocess.TimeoutExpired:
        return f"over {seconds:.0f} s"
    if "MemoryError" in done.stderr:
        return f"over {limit_mb} MB after {time.monotonic() - began:.0f} s"
    if done.returncode:
        return f"failed: {done.stderr.strip().splitlines()[-1][:60]}"
    kilobytes, spent = done.stdout.split()[-2:]
    taken = f"{int(kilobytes) * 1024 / MB:.0f} MB, {float(spent):.1f} s"
    print(f"{reader}, {run.name}: {taken}", file=sys.stderr, flush=True)
    return taken


def main() -> None:
    """Print a table for each interpreter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--frames", type=int, nargs="+", default=[1000, 10_000, 90_000])
    parser.add_argument("--python", nargs="+", default=[sys.executable])
    parser.add_argument("--readers", nargs="+", default=list(READERS), choices=READERS)
    parser.add_argument("--limit", type=int, default=6000, help="MB of address space of a reader")
    parser.add_argument("--seconds", type=float, default=600.0, help="after which a reader is stopped")
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print(environment())
    with tempfile.TemporaryDirectory() as folder:
        run = tracked(Path(folder))
        runs = [repeated(run, frames) for frames in options.frames]
        for python in options.python:
            rows = [
                [name, *(cost(python, name, one, options.limit, options.seconds) for one in runs)]
                for name in options.readers
            ]
            print(
                f"\n{python}\n\n"
                + table(["reader", *(f"{frames:,} frames" for frames in options.frames)], rows)
            )


if __name__ == "__main__":
    main()
