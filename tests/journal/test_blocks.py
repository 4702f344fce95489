"""Measurements as columns: the same numbers from the file and from the lines, whatever frames share."""

from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track.journal import blocks as blocks_module
from bayesnet_track.journal.blocks import Blocks, spans
from bayesnet_track.journal.codec import JournalError
from bayesnet_track.journal.frame_file import FrameWriter
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.reader import Measurements

NAMES = ("box", "ud_px2", "status", "active", "silent", "particles", "log_evidence", "kl/", "region50")


@pytest.fixture
def metrics():
    box, sd = (10.0, 5.0, 4.0, 4.0), (1.0, 1.0, 0.5, 0.5)
    return FrameMetrics(
        frame=0, time_s=0.0, target="1", centre_box=box, map=box, sd=sd, ud_px2=3.5, ud_nodes={},
        quiet_px2=None, status="tracking", score=0.5, log_evidence=-1.5, surprise=0.0, ess=90.0,
        particles=100, active=(), kl={}, contribution={}, agent_ud_px2={}, strength={}, learn_rate=0.0,
        region50=(9.0, 4.0, 11.0, 6.0), region90=(8.0, 3.0, 12.0, 7.0), cloud=(),
    )  # fmt: skip


@pytest.fixture
def written(metrics, tmp_path):
    """Frames whose targets, agents and texts differ, in a file and as lines."""
    lines = []
    frames = (0, 1, 2, 5, 6, 9)  # the record of 6 has the columns of that of 0, and a target that comes last
    for frame in frames:
        names = ["7"] if frame == 6 else ["1", "22", "333"][: 1 + frame % 3]
        lines += [
            replace(
                metrics,
                frame=frame,
                target=name,
                centre_box=(10.0 * frame, 5.0, 4.0, 4.0 + len(name)),
                status="lost" if frame == 5 else "tracking",
                active=("color", "motion") if frame % 2 else ("color",),
                silent=("color",) if frame == 1 else (),
                kl={"color": 0.5} | ({"motion": 0.25} if frame % 2 else {}),
                region50=(1.0, 2.0, 3.0, 4.0) if frame == 2 else metrics.region50,
                cloud=(),
            )
            for name in names
        ]
    with FrameWriter(tmp_path / "frames.npy.gz") as writer:
        for frame in frames:
            writer.write([line for line in lines if line.frame == frame])
            writer.flush()
    return tmp_path / "frames.npy.gz", lines


@pytest.mark.parametrize("rows", [1, 3, 40_000])
def test_file_and_lines_give_the_same_columns(written, rows, monkeypatch):
    monkeypatch.setattr(blocks_module, "ROWS", rows)
    path, lines = written
    sides = [Blocks(Measurements(path), NAMES), Blocks(lines, NAMES)]
    read = [list(side) for side in sides]
    for name in ("frame", "box", "ud_px2", "particles", "log_evidence", "kl/color", "kl/motion", "region50"):
        columns = [
            np.concatenate([b.frame if name == "frame" else b.numbers(name) for b in of_side], axis=-1)
            for of_side in read
        ]
        np.testing.assert_allclose(*columns, rtol=1e-6, equal_nan=True)
    for name in ("target", "status", "active", "silent"):
        texts = [
            [side.texts[name].texts[code] for block in of_side for code in block.codes(name)]
            for side, of_side in zip(sides, read, strict=True)
        ]
        assert texts[0] == texts[1]
        assert texts[0] == [
            value if isinstance(value := getattr(line, name), str) else " ".join(value) for line in lines
        ]
    assert [side.texts["target"].texts for side in sides] == [["1", "22", "333", "7"]] * 2


def test_blocks_of_two_runs_cover_the_frames_of_both(written, monkeypatch):
    monkeypatch.setattr(blocks_module, "ROWS", 1)
    path, lines = written
    sides = [Blocks(Measurements(path), ()), Blocks(lines[-2:], ())]
    assert [*spans(sides, 9)] == [(0, 1), (1, 2), (2, 3), (5, 6), (6, 7)]
    assert [*spans(sides[1:], 99)][-1] == (9, 10)


def test_a_damaged_record_is_named(written):
    path, _ = written
    data = bytearray(path.read_bytes())
    place = Measurements(path).file.places[2]
    data[place.start + place.size // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.raises(JournalError, match=r"frame 2 \(byte \d+\) is damaged"):
        list(Blocks(Measurements(path), ("box",)))
