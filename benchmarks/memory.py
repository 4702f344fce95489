"""Whether a long run stays flat: memory and open files over 10,000 frames through engine and recorder.

    python benchmarks/memory.py [--frames 10000] [--graph general]

Frames are generated (320x240, played to and fro), everything is written to a run directory that is removed
afterwards. Resident memory is read from /proc (Linux). Asked for: growth below 1 % between frame 1,000 and
the last, and the same number of open files.
"""

from __future__ import annotations

import argparse
import gc
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from measuring import Image, decoded, environment, moving_target, on_one_thread, table

from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.run import Start
from bayesnet_track.runtime.session import track
from bayesnet_track.sources.frames import EndReason


@dataclass(frozen=True, eq=False)
class ToAndFro:
    """Pictures played forward and backward, for as many frames as wanted: motion without a jump."""

    images: list[Image]
    expected_frames: int
    description: str = "generated"
    frame_interval_s: float = 0.04
    end_reason: EndReason = "end_of_source"

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.images[0].shape[1])

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.images[0].shape[0])

    def __iter__(self) -> Iterator[Frame]:
        turn = 2 * (len(self.images) - 1)
        for index in range(self.expected_frames):
            place = index % turn
            image = self.images[min(place, turn - place)]
            yield Frame(index, float(index), image.copy(), True, index * self.frame_interval_s)


def resident_kb() -> int:
    """Resident memory of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1])


def open_files() -> int:
    """Open file handles of this process."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--graph", default="general")
    options = parser.parse_args()
    on_one_thread()
    scene = moving_target(320, 240, 40.0, frames=300)
    source = ToAndFro(decoded(scene), options.frames)
    marks = {min(1000, options.frames), *(options.frames * k // 10 for k in range(1, 11))}
    rows, decisions, started = [], 0, time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for result in track(options.graph, source, [Start(scene.start_box)], out=Path(folder) / "run"):
            decisions += len(result.decisions)
            if result.frame.index + 1 in marks:
                gc.collect()
                rows.append((result.frame.index + 1, resident_kb(), open_files()))
        written = sum(file.stat().st_size for file in (Path(folder) / "run").iterdir())
    spent = time.perf_counter() - started
    at_first = next(row for row in rows if row[0] >= min(1000, options.frames))
    growth = rows[-1][1] / at_first[1] - 1.0
    print(environment() + "\n")
    cells = [[str(n), f"{kb / 1024:.1f}", str(files)] for n, kb, files in rows]
    print(table(["frames", "resident MB", "open files"], cells))
    print(f"\ngrowth from frame {at_first[0]} to {rows[-1][0]}: {growth:+.2%} (asked for: below 1 %)")
    print(
        f"{decisions} decisions, {written / 1e6:.1f} MB written, {options.frames / spent:.0f} frames/s in all"
    )


if __name__ == "__main__":
    main()
