"""Files of what sensors measured: what is read, and what is said of files that cannot be."""

import warnings

import numpy as np
import pytest

from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.scan_files import ScanReader, SensorColumns, parse_scans
from bayesnet_track.sources.sources import open_source

RADAR = SensorColumns(
    ("range", "bearing"),
    np.array([0.0, -np.pi]),
    np.array([500.0, np.pi]),
    np.array([np.inf, 2 * np.pi]),
    frozenset({"range"}),
)
GPS = SensorColumns(("x", "y"), np.full(2, -100.0), np.full(2, 100.0), np.full(2, np.inf))
BOTH = {"radar": RADAR, "gps": GPS}


def parsed(text, sensors=None):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return parse_scans(text, sensors or {"radar": RADAR}, "f.csv")


def test_frames_of_several_detections_and_of_none():
    found = parsed("frame,range,bearing,score\n0,5,0.1,0.9\n0,7,-0.2,\n3,,,\n").found
    assert found[0]["radar"].values.tolist() == [[5.0, 0.1], [7.0, -0.2]]
    assert found[0]["radar"].scores.tolist() == [0.9, 1.0]
    assert len(found[3]["radar"]) == 0
    assert 1 not in found


def test_times_are_frames_in_their_order_and_sensors_come_at_their_own():
    text = "time_s,sensor,x,y,range,bearing\n0,gps,1,2,,\n0.5,radar,,,5,0\n0.5,gps,3,4,,\n2,radar,,,,\n"
    file = parsed(text, BOTH)
    assert file.by_time
    assert [sorted(one) for one in file.found.values()] == [["gps"], ["gps", "radar"], ["radar"]]
    assert len(file.found[2]["radar"]) == 0


def test_without_a_column_of_sensors_quantities_say_whose_a_row_is():
    found = parsed("frame,x,y,range,bearing\n0,1,2,,\n0,,,5,0\n1,1,2,5,0\n", BOTH).found
    assert sorted(found[0]) == sorted(found[1]) == ["gps", "radar"]


def test_semicolons_and_decimal_commas():
    found = parsed("frame;range;bearing\n0;5,5;0,25\n").found
    assert found[0]["radar"].values.tolist() == [[5.5, 0.25]]


def test_an_angle_may_be_any_turn():
    assert len(parsed("frame,range,bearing\n0,5,3.3\n").found[0]["radar"]) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "f.csv: empty; a header with frame or time_s and the quantities is needed"),
        ("frame,range,bearing\n", "f.csv: no row below the header"),
        (
            "range,bearing\n5,0\n",
            "f.csv:1: neither a column 'frame' nor 'time_s'; one of them is needed; there are range, bearing",
        ),
        (
            "frame,time_s,range,bearing\n0,0,5,0\n",
            "f.csv:1: both columns 'frame' and 'time_s'; one of them is needed; there are frame, time_s, "
            "range, bearing",
        ),
        (
            "frame,range\n0,5\n",
            "f.csv:1: no column 'bearing', which radar measures; there are frame, range",
        ),
        ("frame,range,range,bearing\n0,5,5,0\n", "f.csv:1:2: 2 columns 'range'"),
        (
            "frame,range,bearing\n0,5,0,9\n",
            "f.csv:2:4: 4 cells under 3 columns; numbers have a decimal point, or cells are separated by "
            "semicolons",
        ),
        ("frame,range,bearing\n0,5,far\n", "f.csv:2:3: bearing 'far'; a number, or nothing"),
        ("frame,range,bearing\n0,5,\n", "f.csv:2:3: bearing is empty, and range is given"),
        ("frame,range,bearing\n0,-5,0\n", "f.csv:2:2: range is -5; its measure is never negative"),
        (
            "frame,range,bearing\n0,5,0\n0,5,170\n",
            "f.csv:3:3: bearing is 170; angles are in radians, as its measure has them",
        ),
        ("frame,range,bearing\n0.5,5,0\n", "f.csv:2:1: frame '0.5'; a whole number from 0 on"),
        ("frame,range,bearing\n-1,5,0\n", "f.csv:2:1: frame '-1'; a whole number from 0 on"),
        ("time_s,range,bearing\nnow,5,0\n", "f.csv:2:1: time_s 'now'; seconds, a finite number"),
        (
            "time_s,range,bearing\n2,5,0\n1,5,0\n",
            "f.csv:3:1: time_s 1 after 2; rows are in the order of their times",
        ),
        ("frame,range,bearing,score\n0,5,0,7\n", "f.csv:2:4: score '7'; a number from 0 to 1, or nothing"),
        ("frame,sensor,range,bearing\n0,lidar,5,0\n", "f.csv:2:2: sensor 'lidar'; the graph has radar"),
    ],
)
def test_wrong_files(text, said):
    with pytest.raises(ValueError) as error:
        parsed(text)
    assert str(error.value) == said


def test_two_sensors_of_the_same_quantities_need_names():
    with pytest.raises(ValueError, match="east and west both measure 'bearing'; a column 'sensor' has"):
        parsed("frame,range,bearing\n0,5,0\n", {"east": RADAR, "west": RADAR})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "frame,range,bearing\n0,nan,0\n0,5,0\n",
            "f.csv: 1 row has a number that is not finite, and left out: line 2",
        ),
        (
            "frame,range,bearing\n0,501,0\n0,5,0\n",
            "f.csv: 1 of 2 detections of radar lie outside of its `within`, and are left out: line 2",
        ),
        ("frame,range,bearing\n0,,\n", "f.csv: no detection of radar"),
        ("frame,range,bearing,speed\n0,5,0,3\n", "f.csv: 1 column is not used: speed"),
    ],
)
def test_what_is_not_used_is_said(text, said):
    with pytest.warns(InputNotice) as notices:
        parse_scans(text, {"radar": RADAR}, "f.csv")
    assert [str(one.message) for one in notices] == [said]


def test_a_sensor_without_rows_is_said_beside_one_with_some():
    with pytest.warns(InputNotice, match="no detection of gps"):
        parse_scans("frame,sensor,x,y,range,bearing\n0,radar,,,5,0\n", BOTH, "f.csv")


def test_the_times_of_a_file_are_a_source(tmp_path):
    path = tmp_path / "radar.csv"
    path.write_text("time_s,range,bearing\n10,5,0\n10,6,0\n10.5,5,0\n13,5,0\n")
    with open_source(str(path)) as source:
        frames = list(source)
    assert [one.time for one in frames] == [0.0, 0.5, 3.0]
    assert [one.time_s for one in frames] == [10.0, 10.5, 13.0]
    assert source.frame_interval_s == 1.0
    assert ScanReader(str(path)).declared_frames == 3
