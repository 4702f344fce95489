"""Journal files: whole lines, torn ends, damage, and a full disk."""

import signal
import subprocess
import sys

import pytest

from bayesnet_track.journal.codec import JournalError
from bayesnet_track.journal.events.runs import FramesMissing, RunEnded, SourceDamaged
from bayesnet_track.journal.reader import read_events, read_metrics
from bayesnet_track.journal.writer import JournalWriter, LineFile, OutputError

EVENTS = [FramesMissing(3, 2.0), SourceDamaged(5, "naïve \udc80\n"), RunEnded(6, None, True, "end_of_source")]


def written(path, events=EVENTS):
    with JournalWriter(path) as journal:
        for event in events:
            journal.write(event)
            journal.flush()
    return path


def test_events_come_back_in_order(tmp_path):
    assert list(read_events(written(tmp_path / "j"))) == EVENTS


def test_the_same_events_give_the_same_bytes(tmp_path):
    assert written(tmp_path / "a").read_bytes() == written(tmp_path / "b").read_bytes()


def test_a_torn_last_line_is_dropped_with_a_notice_at_any_length(tmp_path):
    path = written(tmp_path / "j")
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        notices = []
        whole = data[:size].count(b"\n")
        assert list(read_events(path, notices.append)) == EVENTS[:whole]
        torn = size > 0 and data[size - 1 : size] != b"\n"
        assert len(notices) == torn
        assert all(f"{path}:{whole + 1}: " in notice for notice in notices)


@pytest.mark.parametrize("damage", [b"{}\n", b"\n", b"\xff\xfe\n", b'{"event": "boom"}\n'])
def test_a_damaged_line_is_an_error_with_file_and_line(tmp_path, damage):
    path = written(tmp_path / "j")
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + damage + lines[2])
    events = read_events(path)
    assert next(events) == EVENTS[0]
    with pytest.raises(JournalError, match=f"^{path}:2: "):
        next(events)


def test_metrics_and_events_do_not_mix(tmp_path):
    with pytest.raises(JournalError, match="byte 0: no frame begins there"):
        list(read_metrics(written(tmp_path / "j")))


def test_nothing_reaches_the_file_before_flush_and_everything_after(tmp_path):
    journal = JournalWriter(tmp_path / "j")
    journal.write(EVENTS[0])
    assert (tmp_path / "j").stat().st_size == 0
    journal.flush()
    assert list(read_events(tmp_path / "j")) == EVENTS[:1]
    journal.close()
    journal.close()


def test_a_folder_that_does_not_exist_is_a_clear_error(tmp_path):
    with pytest.raises(OutputError, match="cannot write: No such file"):
        JournalWriter(tmp_path / "none" / "j")


# Runs in a child, since the size limit would strike the test runner's own files too.
FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from bayesnet_track.journal.writer import LineFile, OutputError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
file = LineFile(Path(sys.argv[1]))
try:
    for number in range(100):
        file.append(f"{number:029d}")
        file.append(f"{number:029d}")
        file.flush()
except OutputError as error:
    print(number, error)
"""


def test_a_full_disk_is_an_error_and_leaves_whole_flushes(tmp_path):
    path = tmp_path / "j"
    child = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path)], capture_output=True, text=True, check=True
    )
    assert "cannot write: File too large" in child.stdout
    # Two lines of 30 bytes a flush: 16 flushes fit into 1000 bytes, the 17th does not.
    assert child.stdout.startswith("16 ")
    assert path.read_bytes() == b"".join((b"%029d\n" % number) * 2 for number in range(16))


def test_a_killed_writer_leaves_what_it_flushed(tmp_path):
    path = tmp_path / "j"
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from bayesnet_track.journal.writer import LineFile\n"
        "f = LineFile(Path(sys.argv[1])); f.append('kept'); f.flush(); f.append('lost')\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    child = subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert child.returncode == -signal.SIGKILL
    assert path.read_bytes() == b"kept\n"


def test_line_file_writes_utf8_and_plain_newlines(tmp_path):
    with LineFile(tmp_path / "t") as file:
        file.append("px²")
    assert (tmp_path / "t").read_bytes() == "px²\n".encode()
    assert [entry.name for entry in tmp_path.iterdir()] == ["t"]
