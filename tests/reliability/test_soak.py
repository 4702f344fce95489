"""Row 18: 50,000 frames on a small graph: memory does not grow, files stay as many."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.reliability
SOAK = Path(__file__).parents[2] / "benchmarks" / "soak.py"
LINE = re.compile(r"frame +(\d+): ([\d.]+) MB \(([-+][\d.]+) %\), (\d+) files")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_long_run_takes_no_more_and_more():
    line = [sys.executable, str(SOAK), "--frames", "50000", "--every", "10000"]
    said = subprocess.run(line, capture_output=True, text=True, timeout=1500, check=True).stdout
    print(said)
    found = [match.groups() for match in map(LINE.match, said.splitlines()) if match]
    assert [int(frame) for frame, *_ in found] == [10_000, 20_000, 30_000, 40_000, 50_000]
    assert max(float(growth) for _, _, growth, _ in found) < 1.0
    assert len({files for *_, files in found}) == 1
