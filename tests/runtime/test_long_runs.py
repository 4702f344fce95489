"""A long run is read from its file line by line: every reader says of it what it says of one in memory."""

import numpy as np
import pytest

from bayesnet_track import Start, open_run, track
from bayesnet_track.journal.blocks import Blocks
from bayesnet_track.journal.codec import JournalError
from bayesnet_track.journal.reader import Measurements
from bayesnet_track.runtime.recording import run_reader
from bayesnet_track.sources.scenes.library import SceneSource


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("long") / "run"
    source = SceneSource.named("two_squares", 0, 8)
    box = source.scene.start_box
    list(track("two_squares", source, [Start(box), Start(box)], out=folder))
    return folder


@pytest.fixture
def both(folder, monkeypatch):
    """The run in memory, and read from its file."""
    kept = open_run(folder)
    monkeypatch.setattr(run_reader, "MOST_KEPT", 3)
    return kept, open_run(folder)


def test_its_lines_are_those_of_the_run_in_memory(both):
    kept, read = both
    assert isinstance(kept.metrics, tuple) and isinstance(read.metrics, Measurements)
    assert len(read.metrics) == len(kept.metrics) == 16
    assert tuple(read.metrics) == tuple(read.metrics) == kept.metrics
    assert [read.metrics[at] for at in (0, 7, 2, -1, -16)] == [kept.metrics[at] for at in (0, 7, 2, -1, -16)]
    assert read.metrics[3:12:2] == kept.metrics[3:12:2]
    with pytest.raises(IndexError):
        read.metrics[16]


def test_tables_pictures_and_pages_are_the_same(both):
    kept, read = both
    assert read.to_dict() == kept.to_dict() and read.agents_to_dict() == kept.agents_to_dict()
    assert read.timeline() == kept.timeline() and repr(read) == repr(kept)
    assert read._repr_html_() == kept._repr_html_()
    assert read.page().html == kept.page().html


def test_arrays_have_the_numbers_of_the_lines(both):
    kept, read = both
    arrays = read.arrays("box", "status", "region50", "time_s")
    fields = {"box": "centre_box"}
    assert {"frame", "target", "box", "status", "region50", "time_s"} <= arrays.keys()
    for name, column in arrays.items():
        values = [getattr(line, fields.get(name, name)) for line in kept.metrics]
        np.testing.assert_array_equal(column, np.array(values, dtype=column.dtype))
    with pytest.raises(ValueError, match=r"no frame has a column 'scor'; the first one has: .*score, "):
        read.arrays("scor", "box")


@pytest.fixture
def copied(folder, tmp_path):
    for path in folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def columns(run):
    return list(Blocks(run.metrics, ("box",)))


@pytest.mark.parametrize("read", [lambda run: list(run.metrics), columns])
@pytest.mark.parametrize("kept", [3, 10_000])
def test_a_damaged_frame_and_a_target_that_never_starts_are_named_when_they_are_read(
    copied, monkeypatch, kept, read
):
    monkeypatch.setattr(run_reader, "MOST_KEPT", kept)
    lines = (copied / "journal.jsonl").read_text().splitlines(keepends=True)
    starts = [line for line in lines if '"target_started"' in line]
    (copied / "journal.jsonl").write_text("".join(line for line in lines if line != starts[-1]))
    with pytest.raises(JournalError, match=r"frames.npy.gz: target '2' never starts in journal.jsonl"):
        read(open_run(copied))
    data = bytearray((copied / "frames.npy.gz").read_bytes())
    data[-20] ^= 0xFF
    (copied / "frames.npy.gz").write_bytes(data)
    (copied / "journal.jsonl").write_text("".join(lines))
    with pytest.raises(JournalError, match=r"frame 7 .* is damaged"):
        read(open_run(copied))
