"""Lines come back whole and in order, from any place, while others are appended."""

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.runtime.live_view.feed import EventBuffer


@given(st.lists(st.binary(max_size=40), max_size=30), st.integers(0, 35), st.integers(0, 200))
def test_a_read_gives_consecutive_whole_lines_within_the_limit(lines, first, most):
    buffer = EventBuffer()
    for line in lines:
        buffer.append(line)
    found = buffer.read(first, most)
    assert found == lines[first : first + len(found)]
    assert (len(found) > 0) == (first < len(lines))
    assert len(found) <= 1 or sum(map(len, found)) <= most
    # It gives as many as fit.
    rest = lines[first + len(found) :]
    assert not rest or sum(map(len, [*found, rest[0]])) > most
    buffer.close()


def test_readers_see_every_line_once_while_a_run_writes():
    buffer, seen = EventBuffer(), []

    def read():
        while len(seen) < 3000:
            seen.extend(buffer.read(len(seen), 500))

    reader = threading.Thread(target=read)
    reader.start()
    for number in range(3000):
        buffer.append(b"%d" % number)
    reader.join(5)
    assert seen == [b"%d" % number for number in range(3000)]


class FullDisk:
    """Takes half of what is written, then nothing."""

    def __init__(self, file):
        self.file, self.is_full = file, False

    def seek(self, place):
        self.file.seek(place)

    def read(self, count):
        return self.file.read(count)

    def write(self, data):
        if self.is_full:
            raise OSError(28, "No space left on device")
        self.is_full = True
        return self.file.write(data[: len(data) // 2])


def test_a_line_that_a_full_disk_cut_off_is_not_there():
    buffer = EventBuffer()
    buffer.append(b"first")
    whole, buffer._file = buffer._file, FullDisk(buffer._file)
    with pytest.raises(OSError, match="No space"):
        buffer.append(b"second")
    buffer._file = whole
    buffer.append(b"third")
    assert buffer.read(0, 100) == [b"first", b"third"]
