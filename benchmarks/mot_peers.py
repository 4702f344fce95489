"""TrackEval's MOTA, IDF1 and HOTA of MOT files: the peer of `benchmarks/mot_crosscheck.py`.

    python benchmarks/mot_peers.py TRUTH TRACKS [TRACKS ...]

Runs in an environment with `trackeval` and needs nothing else of the project; prints a JSON object: the
version, and of each tracks file its figures by their names here.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import trackeval

SEQUENCE = "sequence"


def rows_of(path: str, padding: list[str]) -> list[str]:
    """The lines of a MOT file with commas, filled up to the columns that TrackEval asks for."""
    rows = []
    for line in Path(path).read_text(encoding="utf-8-sig").splitlines():
        if line.strip():
            words = line.replace(",", " ").split()
            rows.append(",".join(words + padding[len(words) :]) + "\n")
    return rows


def last_frame(rows: list[str]) -> int:
    """The number of the last frame, 0 of none."""
    return max((int(float(row.split(",")[0])) for row in rows), default=0)


def figures(truth: list[str], tracks: list[str], folder: Path) -> dict[str, Any]:
    """TrackEval's figures of one sequence, read from files laid out as it wants them."""
    (folder / "gt" / SEQUENCE / "gt").mkdir(parents=True)
    (folder / "trackers" / "one" / "data").mkdir(parents=True)
    (folder / "gt" / SEQUENCE / "gt" / "gt.txt").write_text("".join(truth))
    (folder / "trackers" / "one" / "data" / f"{SEQUENCE}.txt").write_text("".join(tracks))
    dataset = trackeval.datasets.MotChallenge2DBox(
        {
            "GT_FOLDER": str(folder / "gt"),
            "TRACKERS_FOLDER": str(folder / "trackers"),
            "TRACKERS_TO_EVAL": ["one"],
            "BENCHMARK": "MOT15",
            "SKIP_SPLIT_FOL": True,
            "SEQ_INFO": {SEQUENCE: max(last_frame(truth), last_frame(tracks))},
            "PRINT_CONFIG": False,
        }
    )
    data = dataset.get_preprocessed_seq_data(dataset.get_raw_seq_data("one", SEQUENCE), "pedestrian")
    quiet = {"PRINT_CONFIG": False}
    clear = trackeval.metrics.CLEAR(quiet).eval_sequence(data)
    own = trackeval.metrics.Identity(quiet).eval_sequence(data)
    higher = trackeval.metrics.HOTA().eval_sequence(data)
    found: dict[str, Any] = {
        name: float(clear[key])
        for name, key in {
            "mota": "MOTA",
            "motp": "MOTP",
            "fp": "CLR_FP",
            "fn": "CLR_FN",
            "idsw": "IDSW",
        }.items()
    }
    found |= {name: float(own[name.upper()]) for name in ("idf1", "idp", "idr")}
    for name, key in {"hota": "HOTA", "deta": "DetA", "assa": "AssA", "loca": "LocA"}.items():
        found |= {name: float(higher[key].mean()), f"{name}_at": higher[key].tolist()}
    return found


def main() -> None:
    """Print the figures of the files in the arguments."""
    truth_path, *tracks_paths = sys.argv[1:]
    truth = rows_of(truth_path, ["0", "0", "0", "0", "0", "0", "1", "1", "1"])
    found = {}
    with contextlib.redirect_stdout(io.StringIO()):  # TrackEval tells how long it took
        for path in tracks_paths:
            with TemporaryDirectory() as folder:
                tracks = rows_of(path, ["0", "0", "0", "0", "0", "0", "1", "-1", "-1", "-1"])
                found[path] = figures(truth, tracks, Path(folder))
    print(json.dumps({"trackeval": version("trackeval"), "figures": found}))


if __name__ == "__main__":
    main()
