"""Row 18: 50,000 frames on a small graph, 20,000 in CI: neither memory nor files grow."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

FRAMES = [
    pytest.param(20_000, marks=pytest.mark.reliability),
    pytest.param(50_000, marks=pytest.mark.endurance),
]
SOAK = Path(__file__).parents[2] / "benchmarks" / "soak.py"
LINE = re.compile(r"frame +(\d+): ([\d.]+) MB \(([-+][\d.]+) %\), (\d+) files")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("frames", FRAMES)
def test_a_long_run_takes_no_more_and_more(frames):
    line = [sys.executable, str(SOAK), "--frames", str(frames), "--every", "10000"]
    said = subprocess.run(line, capture_output=True, text=True, timeout=1500, check=True).stdout
    print(said)
    found = [match.groups() for match in map(LINE.match, said.splitlines()) if match]
    assert [int(frame) for frame, *_ in found] == list(range(10_000, frames + 1, 10_000))
    assert max(float(growth) for _, _, growth, _ in found) < 1.0
    assert len({files for *_, files in found}) == 1
