"""What was measured of a frame as columns: nothing is lost, torn ends are dropped, damage is named."""

from __future__ import annotations

import gzip
import math
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayesnet_track.journal.codec import JournalError, to_json
from bayesnet_track.journal.frame_columns import ABSENT, columns_of, lines_of
from bayesnet_track.journal.frame_file import FrameFile, FrameWriter, record, unpacked
from bayesnet_track.journal.metrics import FrameMetrics, JoinMetrics, PartMetrics
from bayesnet_track.journal.reader import read_metrics


def line(frame: int = 3, target: str = "1", **changed: Any) -> FrameMetrics:
    """A line whose numbers single precision holds."""
    values: dict[str, Any] = {
        "frame": frame, "time_s": frame / 25.0, "target": target, "centre_box": (10.5, 20.25, 4.0, 8.0),
        "map": (10.75, 20.0, 4.0, 8.0), "sd": (1.0, 2.0, 0.5, 0.25), "ud_px2": 5.0,
        "ud_nodes": {"person": 5.0}, "quiet_px2": None, "status": "tracking", "score": 0.5,
        "log_evidence": -3.0, "surprise": 0.25, "ess": 100.0, "particles": 200, "active": ("color", "motion"),
        "kl": {"color": 0.5, "motion": math.nan}, "contribution": {"color": 0.125}, "agent_ud_px2": {},
        "strength": {"color": 1.5, "shape": math.inf}, "learn_rate": 0.0625,
        "region50": (9.0, 11.0, 18.0, 22.0), "region90": (8.0, 12.0, 17.0, 23.0),
        "cloud": ((10, 20, 4, 8), (-11, 21, 4, 9)),
    }  # fmt: skip
    return FrameMetrics(**{**values, **changed})


FULL = line(
    target='Zoë, "2"',
    quiet_px2=math.nan,
    silent=("motion",),
    features={"most": 0.5},
    parts={"head": PartMetrics((1.0, 2.0, 3.0, 4.0), (0.5, 0.5, 0.5, 0.5), 2.0, "seen")},
    angle=-12.5,
    join=JoinMetrics(("2", "3"), 0.1, "2", {"2": 0.3, "3": 0.7}, None, 17.3),
    existence=0.75,
    modes={"seen": 0.25, "behind": 0.75},
    modes_predicted={"seen": 0.5, "behind": 0.5},
    hidden=0.75,
    category={"team=red": 0.125, "team=blue": 0.875},
    category_predicted={"team=red": 0.5, "team=blue": 0.5},
    e_value=1e200,
    log_predictive={"radar": -3.5},
    p_values={"color": 1e-60},
    queries={"near/2": 0.5, "speed_sd": 1.5},
    state={"vx": -1.5, "vx_sd": 0.25},
    identities={"4": 0.71, "9": 0.22, "new": 0.07},
)


def same(one: FrameMetrics, other: FrameMetrics) -> bool:
    return to_json(one) == to_json(other)


def test_every_field_comes_back_whatever_the_others_have() -> None:
    lines = [line(), FULL, line(target="3", cloud=(), kl={}, active=(), ud_nodes={"child": 1.0})]
    back = list(lines_of(columns_of(lines)))
    assert len(back) == 3 and all(map(same, back, lines))
    assert {f.name for f in fields(FULL) if getattr(FULL, f.name) in ((), {}, None, 0.0)} == {"agent_ud_px2"}


def test_numbers_have_seven_digits_and_times_all() -> None:
    (back,) = lines_of(columns_of([line(time_s=0.1, centre_box=(1234.56789, 1.0, 2.0, 3.0))]))
    assert back.time_s == 0.1
    assert back.centre_box == (float(np.float32(1234.56789)), 1.0, 2.0, 3.0)


def test_a_gaussian_region_takes_no_room_and_comes_back() -> None:
    reach = 0.6744897501960817
    region = (10.75 - reach, 10.75 + reach, 20.0 - 2 * reach, 20.0 + 2 * reach)
    columns = columns_of([line(region50=region)])
    assert "region50" not in columns and "region90" in columns
    (back,) = lines_of(columns)
    assert back.region50 == pytest.approx(region, abs=1e-4)


def test_numpy_and_gzip_read_it_without_us(tmp_path: Path) -> None:
    path = tmp_path / "frames.npy.gz"
    with FrameWriter(path) as writer:
        for frame in range(3):
            writer.write([line(frame), line(frame, "2")])
    with gzip.open(path) as file:
        frames = [np.load(file) for _ in range(3)]  # type: ignore[no-untyped-call,unused-ignore]
        assert file.read() == b""
    assert [int(one["frame"]) for one in frames] == [0, 1, 2]
    assert frames[1]["target"].tolist() == [b"1", b"2"] and frames[1]["box"][:, 0].tolist() == [
        10.5,
        20.25,
        4,
        8,
    ]


def test_without_hypotheses_they_are_left_out() -> None:
    assert "cloud" not in columns_of([line()], hypotheses=False)
    assert [one.cloud for one in lines_of(columns_of([line()], False))] == [()]


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "frames.npy.gz"
    with FrameWriter(path) as writer:
        for frame in (4, 6, 7):
            writer.write([line(frame)])
            writer.flush()
        writer.write([])
    return path


def test_one_frame_is_read_alone(written: Path) -> None:
    file = FrameFile(written)
    assert [(place.frame, place.targets) for place in file.places] == [(4, 1), (6, 1), (7, 1)]
    data = bytearray(written.read_bytes())
    data[file.places[0].start + 50] ^= 1  # in another frame
    written.write_bytes(data)
    (found,) = FrameFile(written).lines(file.places[1:2])
    assert found.frame == 6


@pytest.mark.slow
def test_whatever_is_torn_off_leaves_whole_frames(written: Path) -> None:
    data, ends = written.read_bytes(), [place.start + place.size for place in FrameFile(written).places]
    for size in range(len(data)):
        written.write_bytes(data[:size])
        said: list[str] = []
        frames = [one.frame for one in read_metrics(written, said.append)]
        whole = sum(end <= size for end in ends)
        assert frames == [4, 6, 7][:whole]
        assert len(said) == (size not in (0, *ends)) and all("torn" in text for text in said)


def test_zeros_at_the_end_are_a_torn_frame(written: Path) -> None:
    written.write_bytes(written.read_bytes() + bytes(4096))
    said: list[str] = []
    assert len(list(read_metrics(written, said.append))) == 3 and "torn (4096 bytes)" in said[0]


def test_any_changed_byte_is_found_or_changes_nothing(written: Path) -> None:
    """The first frame's bytes, one after another: an error that names the file, never another value."""
    data = written.read_bytes()
    want = list(read_metrics(written))
    for at in range(FrameFile(written).places[0].size):
        changed = bytearray(data)
        changed[at] ^= 0xFF
        written.write_bytes(changed)
        try:
            lines = list(read_metrics(written))
        except JournalError as error:
            assert str(written) in str(error)
        else:
            assert all(map(same, lines, want[: len(lines)])), at


def test_a_record_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "frames.npy.gz"
    columns = columns_of([line()])
    for strange in (
        {**columns, "box": columns["box"][:3]},
        {**columns, "status": np.array([b"a", b"b"])},
        {name: column for name, column in columns.items() if name != "particles"},
        {**columns, "cloud_count": np.array([7], dtype="<i4")},
        {**columns, "score": columns["score"].astype(complex)},
        {**columns, "particles": np.array([-1], dtype="<i4")},
    ):
        path.write_bytes(record(strange))
        with pytest.raises(JournalError, match=r"frames\.npy\.gz: frame 3"):
            list(read_metrics(path))


def test_absent_is_no_other_nan() -> None:
    values = np.array([ABSENT, math.nan, -math.nan, 1.0])
    assert [math.isnan(value) for value in values] == [True, True, True, False]
    (back,) = lines_of(columns_of([line(quiet_px2=None, existence=math.nan)]))
    assert back.quiet_px2 is None and math.isnan(back.existence or 0.0)


def test_a_frame_of_a_thousand_columns(tmp_path: Path) -> None:
    many = {f"node_{number}": float(number) for number in range(1000)}
    (back,) = lines_of(unpacked(record(columns_of([replace(line(), ud_nodes=many)]))))
    assert back.ud_nodes == many


@pytest.mark.parametrize("target", ["1", FULL.target, "3", "nobody"])
def test_the_lines_of_one_target_are_those_among_all(tmp_path: Path, target: str) -> None:
    frames = [
        [line(0), replace(FULL, frame=0), line(0, "3", cloud=(), kl={}, active=())],
        [line(1, "3"), line(1, cloud=())],
        [replace(FULL, frame=2)],
    ]
    path = tmp_path / "frames.npy.gz"
    with FrameWriter(path) as writer:
        for lines in frames:
            writer.write(lines)
    expected = [one for one in read_metrics(path) if one.target == target]
    assert len(expected) == sum(one.target == target for lines in frames for one in lines)
    found = list(read_metrics(path, target=target))
    assert len(found) == len(expected) and all(map(same, found, expected))
