"""How fast `general` is on real sequences: beside NanoTrack, and beside an older version, turn by turn.

    python benchmarks/real_video_speed.py DATA_FOLDER [--half A] [--max-frames 150]
        [--before OLD/bin/python] [--peers-python PYTHON --models FOLDER]

Of each sequence of a half (`real_video_coin`) one pass follows the other, so that what else the machine does
falls on all of them. Frames per second of CPU time are those of `update`: reading pictures does not count,
nor do the first frame and what is loaded at the start of a process. For speed only: no box is looked at.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from measuring import environment, on_one_thread, table
from real_video import Elsewhere
from real_video_coin import HALVES
from sequences import Sequence, find_sequences, track

from bayesnet_track import Tracker

WARM_UP = 6
"""Frames of a pass before the one that counts."""


def measured(sequence: Sequence) -> float:
    """Seconds of CPU time of all updates."""
    track(Tracker("general"), Sequence("", sequence.files[:WARM_UP], sequence.truth[:WARM_UP]))
    return sum(track(Tracker("general"), sequence).cpu_seconds[1:])


def turn(python: str, data: Path, sequence: Sequence) -> float:
    """The same, in a process of its own."""
    command = [python, __file__, str(data), "--one", sequence.name, "--max-frames", str(len(sequence.files))]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--half", choices=("A", "B"), default="A")
    parser.add_argument("--max-frames", type=int, default=150)
    parser.add_argument("--before", help="interpreter of an environment with an older version")
    parser.add_argument("--peers-python", metavar="PYTHON", help="has OpenCV's contrib build")
    parser.add_argument("--models", metavar="FOLDER", help="NanoTrack's two model files")
    parser.add_argument("--one", metavar="SEQUENCE", help="measure one here, and print seconds")
    chosen = parser.parse_args()
    on_one_thread()
    names = [chosen.one] if chosen.one else [*HALVES[chosen.half]]
    sequences = find_sequences(chosen.data, names, chosen.max_frames)
    if chosen.one:
        print(measured(sequences[0]))
        return
    print(f"{environment()}; load {os.getloadavg()[0]:.1f}")
    pythons = {"before": chosen.before} if chosen.before else {}
    pythons["general"] = sys.executable
    rows: list[list[float]] = []
    with ExitStack() as stack:
        peers = Elsewhere(chosen.peers_python, [chosen.models]) if chosen.peers_python else None
        if peers is not None:
            stack.enter_context(peers)
        for sequence in sequences:
            seconds = [turn(python, chosen.data, sequence) for python in pythons.values()]
            if peers is not None:
                seconds.append(peers.run("NanoTrack", sequence, 0).cpu_s)
            rows.append([len(sequence.files) - 1, *seconds])
            rates = ", ".join(f"{rows[-1][0] / one:.0f}" for one in seconds)
            print(
                f"{sequence.name}: {rates} frames per CPU second; load {os.getloadavg()[0]:.1f}", flush=True
            )
    found = np.array(rows)
    rates = found[:, :1] / found[:, 1:]
    names = [*pythons, *(["NanoTrack"] if peers is not None else [])]
    own = names.index("general")
    lines = []
    for name, each, spent in zip(names, rates.T, found[:, 1:].T, strict=True):
        ratios = rates[:, own] / each
        span = f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})"
        lines.append([name, f"{np.median(each):.0f}", f"{found[:, 0].sum() / spent.sum():.0f}", span])
    print(table(["", "median of sequences", "all frames", "`general` is times as fast"], lines))


if __name__ == "__main__":
    main()
