"""Row 18: 50,000 frames on a small graph, 20,000 in CI, and crowds: neither memory nor files grow."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

FRAMES = [
    pytest.param(20_000, marks=pytest.mark.reliability),
    pytest.param(50_000, marks=pytest.mark.endurance),
]
CROWDS = [
    pytest.param(60, 450, ("--record",), marks=pytest.mark.reliability),
    pytest.param(500, 5000, (), marks=pytest.mark.endurance),
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


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(("targets", "frames", "options"), CROWDS)
def test_a_crowd_takes_no_more_and_more(targets, frames, options):
    """Targets end and others start throughout; little remains of each, and allocators keep some room."""
    numbers = ["--targets", str(targets), "--frames", str(frames), "--every", str(frames // 3)]
    line = [sys.executable, str(SOAK), *numbers, *options]
    said = subprocess.run(line, capture_output=True, text=True, timeout=1500, check=True).stdout
    print(said)
    found = [match.groups() for match in map(LINE.match, said.splitlines()) if match]
    assert len(found) >= 3 and int(found[-1][0]) >= frames - 2
    assert max(float(growth) for _, _, growth, _ in found) < 2.0
    assert len({files for *_, files in found}) == 1
    assert int(re.findall(r"live of (\d+) started", said)[-1]) > targets
