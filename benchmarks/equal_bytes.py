"""Compare two installations byte by byte: the same five runs by each, journal, metrics and tracks.

    python benchmarks/equal_bytes.py --before OLD/bin/python --after NEW/bin/python

For a change that must not change results: install the code before it and after it in two environments, with
the same versions of everything else. Each `--rename OLD=NEW` is applied to the older run's files before they
are compared; `--renamed` applies all words of `RENAMED`. The graph's own text is compared, its hash is not,
nor are the versions that the journal records.
Exit code 1 where a byte differs.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import subprocess
import sys
import tempfile
from pathlib import Path

RUNS = {
    "two_squares": ("two_squares", "--end", "80"),
    "carried_box": ("carried_box", "--end", "60"),
    "crowd": ("crowd", "--end", "25"),
    "flying_ball": ("flying_ball", "--end", "80"),
    "person_parts": ("person_parts", "--end", "40"),
}
FILES = ("journal.jsonl", "frames.jsonl", "tracks.txt", "tracks.csv", "graph.yaml")
LEFT_OUT = re.compile(rb'"graph_sha256": "[0-9a-f]{64}"|"versions": {[^}]*}')
RENAMED = {
    '"journal": 1,': '"journal": 2,',
    '"glance": ': '"sample_every": ',
    '"rival_seen"': '"distractor_seen"',
    '"least_probability"': '"min_probability"',
    '"drop": "least_': '"drop": "min_',
    '"drop": "dearest"': '"drop": "most_expensive"',
    '"drop": "dearest_dispensable"': '"drop": "most_expensive_redundant"',
    '"unit": "ud_quiet"': '"unit": "ud_baseline"',
    "wide: {share: ": "heavy_tail: {weight: ",
}
"""Words of format 1 of the journal and of the graphs of these runs -> words since."""


def run(python: str, arguments: tuple[str, ...], out: Path) -> None:
    """Run one demo in a folder of its own, so that no checkout shadows the installation."""
    command = [python, "-P", "-m", "bayesnet_track", "demo", *arguments, "--quiet", "--out", str(out)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=out.parent)


def digest(path: Path, renames: dict[str, str]) -> str:
    """SHA-256 of a file with the words renamed and without what is left out."""
    content = path.read_bytes()
    for old, new in renames.items():
        content = content.replace(old.encode(), new.encode())
    return hashlib.sha256(LEFT_OUT.sub(b"", content)).hexdigest()


def main() -> int:
    """Compare the runs; the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--before", required=True, metavar="PYTHON", help="interpreter of the older environment"
    )
    parser.add_argument("--after", required=True, metavar="PYTHON", help="interpreter of the newer one")
    parser.add_argument("--rename", action="append", default=[], metavar="OLD=NEW")
    parser.add_argument("--renamed", action="store_true", help="apply the words that were renamed")
    options = parser.parse_args()
    renames = dict(one.split("=", 1) for one in options.rename)
    renames |= RENAMED if options.renamed else {}
    different = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in RUNS.items():
            outs = [Path(folder) / side / name for side in ("before", "after")]
            for python, out in zip((options.before, options.after), outs, strict=True):
                out.parent.mkdir(exist_ok=True)
                run(python, arguments, out)
            for file in FILES:
                old, new = digest(outs[0] / file, renames), digest(outs[1] / file, {})
                different += old != new
                print(f"{name:14} {file:14} {'equal' if old == new else 'DIFFERENT'}  {new[:16]}")
    print(f"{different} of {len(RUNS) * len(FILES)} files differ")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
