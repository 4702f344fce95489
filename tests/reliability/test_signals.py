"""Row 16: SIGINT and SIGTERM at random times: valid files, exit 130 or 143, no process left after 2 s."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.journal.reader import read_events, read_metrics
from bayesnet_track.runtime.recording.rundir import RunDirectory

pytestmark = pytest.mark.reliability
TIMES, LATEST_S = 50, 2.0

# Before and after `main`, signals are the interpreter's.
RUN = """
import os, signal, sys
from bayesnet_track.cli.main import main
for each in (signal.SIGINT, signal.SIGTERM):
    signal.signal(each, lambda number, _: os._exit(128 + number))
print("ready", file=sys.stderr, flush=True)
code = main(sys.argv[1:])
os._exit(code)
"""


def of_group(group):
    """The live processes of a group."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, _, of = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
            except OSError:
                continue
            if int(of) == group and state != "Z":
                found.append(int(entry.name))
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("way", [[], ["--executor", "processes"]])
def test_signals_at_random_times(videos, graph, tmp_path, way):
    rng = np.random.default_rng([16, len(way)])
    stopped = 0
    for case in range(TIMES // 2):
        out, number = tmp_path / f"run{case}", (signal.SIGINT, signal.SIGTERM)[case % 2]
        line = ["run", str(graph), "--source", str(videos["h264.mkv"]), "--init", "5,18,12,12", *way]
        process = subprocess.Popen(
            [sys.executable, "-c", RUN, *line, "--out", str(out), "--quiet"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        assert process.stderr.readline() == b"ready\n"
        time.sleep(float(rng.uniform(0, LATEST_S)))
        process.send_signal(number)
        _, said = process.communicate(timeout=120)
        assert process.returncode in (128 + number, 0), said.decode()
        assert b"Traceback" not in said
        until = time.monotonic() + 2.0
        while (left := of_group(process.pid)) and time.monotonic() < until:
            time.sleep(0.02)
        for orphan in left:
            os.kill(orphan, signal.SIGKILL)
        assert left == []
        stopped += process.returncode != 0
        if not (out / "journal.jsonl").exists() or not (out / "journal.jsonl").stat().st_size:
            continue
        events = list(read_events(out / "journal.jsonl", pytest.fail))
        assert isinstance(events[-1], RunEnded)
        assert process.returncode == 0 or events[-1].reason in ("interrupted", "end_of_source")
        frames = [line.frame for line in read_metrics(RunDirectory.open(out).frames, pytest.fail)]
        assert frames == list(range(len(frames)))
    assert stopped > TIMES // 5
