"""Damaged network files: none ends the process that loads them."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

pytestmark = pytest.mark.reliability

FILES = 60

LOAD = """
import json, sys
from bayesnet_track.observation.detector import DetectorError
from bayesnet_track.vision.detectors.onnx import DETECTOR, OnnxParameters

for path in sys.argv[1:]:
    try:
        DETECTOR.make(OnnxParameters(model=path, layout="yolo", input_width=32, input_height=32))
        print("loaded", flush=True)
    except DetectorError as error:
        assert path in str(error), error
        print("crashed" if "where the network was tried" in str(error) else "refused", flush=True)
"""


def damaged(data: bytes, rng: random.Random) -> bytes:
    """`data` cut, with bits or a byte changed, or with a part in the place of another."""
    made, at = bytearray(data), rng.randrange(len(data))
    match rng.randrange(4):
        case 0:
            del made[at:]
        case 1:
            for _ in range(rng.choice([1, 3, 10])):
                made[rng.randrange(len(made))] ^= 1 << rng.randrange(8)
        case 2:
            made[at] = rng.randrange(256)
        case 3:
            other = rng.randrange(len(data))
            made[at : at + 50] = made[other : other + 50]
    return bytes(made)


def test_no_damaged_network_ends_the_process(
    network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them in one process, as a batch or a notebook loads them."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    whole, rng = Path(network(after=(0.25,))).read_bytes(), random.Random(20261127)
    paths = [tmp_path / f"{k}.onnx" for k in range(FILES)]
    for path in paths:
        path.write_bytes(damaged(whole, rng))
    done = subprocess.run([sys.executable, "-c", LOAD, *map(str, paths)], capture_output=True, check=False)
    counted = Counter(done.stdout.decode().split())
    sys.stdout.write(json.dumps(counted) + "\n")
    assert done.returncode == 0, done.stderr.decode("utf-8", "replace")[-2000:]
    assert sum(counted.values()) == FILES
    assert counted["loaded"] and counted["refused"]
