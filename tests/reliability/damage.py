"""Reads damaged videos, one after another, and tells of each what came of it: a line of JSON.

Run as a process of its own, so that a decoder that crashes ends only it; its parent starts another one for
the files that are left.
"""

import json
import sys

import numpy as np

from bayesnet_track.journal.events.runs import FramesMissing, SourceDamaged
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.sources import open_source


def damaged(data, seed):
    """The file with bits turned over, holes cut, blocks zeroed or swapped: what a seed says."""
    rng = np.random.default_rng([91, seed])
    found = np.frombuffer(data, np.uint8).copy()
    kind, size = seed % 5, len(found)
    if kind == 0:  # bytes
        where = rng.integers(0, size, rng.integers(1, 41))
        found[where] = rng.integers(0, 256, len(where))
    elif kind == 1:  # single bits, more of them
        where = rng.integers(0, size, rng.integers(1, 200))
        found[where] ^= (1 << rng.integers(0, 8, len(where))).astype(np.uint8)
    elif kind == 2:  # a hole
        low = rng.integers(0, size)
        found = np.delete(found, slice(low, low + rng.integers(1, size // 4)))
    elif kind == 3:  # zeroed blocks, as of a bad disk
        for low in rng.integers(0, size, rng.integers(1, 4)):
            found[low : low + rng.integers(16, 513)] = 0
    else:  # what belongs elsewhere
        low, high = rng.integers(0, size, 2)
        length = int(rng.integers(16, 600))
        part = found[low : low + length].copy()
        found[high : high + len(part)] = part[: len(found[high : high + len(part)])]
    return found.tobytes()


def outcome(path):
    """[frames, end reason, all gaps told, reported]."""
    last, reported, gaps, before = None, 0, True, None
    try:
        with open_source(str(path)) as source:
            for item in source:
                if isinstance(item, Frame):
                    if last is not None:
                        assert item.time > last.time and item.index > last.index
                        gap = item.time - last.time >= source._reader.gap_from
                        gaps = gaps and gap == isinstance(before, FramesMissing)
                    last = item
                reported += isinstance(item, SourceDamaged | FramesMissing)
                before = item
            return [source.frames, source.end_reason, gaps, reported]
    except SourceError:
        return [0, "refused", True, 1]


def main(original, folder, first, last):
    data = open(original, "rb").read()  # noqa: PTH123, SIM115
    path = f"{folder}/{first}-{original.rsplit('/', 1)[-1]}"
    for seed in range(int(first), int(last)):
        print(json.dumps({"begin": seed}), flush=True)
        with open(path, "wb") as file:  # noqa: PTH123
            file.write(damaged(data, seed))
        print(json.dumps({"seed": seed, "found": outcome(path)}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
