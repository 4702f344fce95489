"""Times of frames are read, and lines that are none are named."""

import pytest

from bayesnet_track.journal.encoder import JournalError
from bayesnet_track.journal.reader import read_seconds


def test_times_are_read_up_to_a_torn_line(tmp_path):
    path = tmp_path / "timings.jsonl"
    assert list(read_seconds(path)) == []
    path.write_bytes(
        b'{"frame": 0, "seconds": 0.5, "agents": {}}\n{"frame": 2, "seconds": 0}\n{"frame": 3, "sec'
    )
    assert list(read_seconds(path)) == [(0, 0.5), (2, 0.0)]


@pytest.mark.parametrize(
    "line",
    [
        "",
        "[]",
        "{",
        '{"frame": 1}',
        '{"frame": -1, "seconds": 1}',
        '{"frame": 1, "seconds": -1}',
        '{"frame": 1, "seconds": Infinity}',
        '{"frame": 1, "seconds": NaN}',
        '{"frame": 1e400, "seconds": 1}',
        '{"frame": 99999999999999999999, "seconds": 1}',
        '{"frame": null, "seconds": 1}',
    ],
)
def test_a_line_that_is_none_is_named(tmp_path, line):
    path = tmp_path / "timings.jsonl"
    path.write_text(f'{{"frame": 0, "seconds": 1}}\n{line}\n')
    with pytest.raises(JournalError, match=r"timings\.jsonl:2: expected an object with frame and seconds"):
        list(read_seconds(path))
