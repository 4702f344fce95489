"""How long a person waits: `--help`, `validate`, and the first tracked frame, in fresh processes.

    python benchmarks/startup.py [--runs 15] [--imports]

Medians over processes, the whole interpreter included; the first run of each, which fills caches (bytecode in
a folder of its own, Numba's kernels where they always are), is not counted. CPU time stands beside: on a busy
machine it says more. Asked for: --help 150 ms, validate 400 ms, first tracked frame 1500 ms. --imports lists
what the imports of each cost.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time

from measuring import environment, table

COMMAND_LINE = "import sys; from bayesnet_track.cli.main import main; sys.exit(main({arguments!r}))"

FIRST_FRAME = """
import sys
import numpy as np
image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
from bayesnet_track import Tracker
tracker = Tracker("general")
tracker.init(image, (300, 200, 60, 60))
tracker.update(np.roll(image, 2, axis=1))
"""

CASES = {
    "python -c pass": ("pass", None),
    "--help": (COMMAND_LINE.format(arguments=["--help"]), 150),
    "validate general": (COMMAND_LINE.format(arguments=["validate", "general"]), 400),
    "first tracked frame": (FIRST_FRAME, 1500),
}

_IMPORT = re.compile(r"import time:\s+(\d+) \|\s+(\d+) \| (\s*)(\S+)")


def once(code: str, environ: dict[str, str]) -> tuple[float, float]:
    """Wall and CPU milliseconds of one fresh interpreter."""
    before, started = _children_seconds(), time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL, env=environ)
    return (time.perf_counter() - started) * 1e3, (_children_seconds() - before) * 1e3


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def imports(code: str, environ: dict[str, str], most: int = 12) -> list[tuple[str, float]]:
    """The packages whose own modules cost most, ms, the largest first."""
    command = [sys.executable, "-X", "importtime", "-c", code]
    answer = subprocess.run(command, check=True, capture_output=True, text=True, env=environ)
    spent: dict[str, float] = {}
    for line in answer.stderr.splitlines():
        found = _IMPORT.match(line)
        if found:
            package = found[4].split(".")[0].removeprefix("_")
            spent[package] = spent.get(package, 0.0) + int(found[1]) / 1e3
    return sorted(spent.items(), key=lambda item: -item[1])[:most]


def main() -> None:
    """Print the table, and the imports on demand."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--imports", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as bytecode:
        environ = {**os.environ, "PYTHONPYCACHEPREFIX": bytecode}
        environ.pop("PYTHONDONTWRITEBYTECODE", None)
        print(environment() + "\n")
        print(report(options.runs, environ))
        for name, (code, _) in CASES.items() if options.imports else ():
            listed = ", ".join(f"{package} {ms:.0f}" for package, ms in imports(code, environ))
            print(f"\n{name}: ms of imports by package: {listed}")


def report(runs: int, environ: dict[str, str]) -> str:
    """The table; the cases take turns, so that a busy moment hits them alike."""
    for code, _ in CASES.values():
        once(code, environ)
    times = [[once(code, environ) for code, _ in CASES.values()] for _ in range(runs)]
    rows = []
    for k, (name, (_, limit)) in enumerate(CASES.items()):
        wall, cpu = zip(*(turn[k] for turn in times), strict=True)
        figures = [statistics.median(wall), min(wall), statistics.median(cpu)]
        rows.append([name, *(f"{value:.0f}" for value in figures), str(limit or "")])
    return table(["ms", "median", "least", "median of CPU time", "asked for"], rows)


if __name__ == "__main__":
    main()
