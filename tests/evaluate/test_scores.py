"""Scores against hand-computed cases and against the definitions written out as loops."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.evaluate.scores import lost_episodes, score_pass

TRUE = (10.0, 10.0, 20.0, 20.0)


def test_a_perfect_pass():
    truth = np.tile(TRUE, (8, 1))
    got = score_pass(truth, np.zeros(8), truth)
    # IoU 1 is above 0, 0.05 .. 0.95 but not above 1: OTB's comparison is strict.
    assert got.auc == pytest.approx(20 / 21)
    assert (got.precision20, got.mean_iou, got.lost_episodes, got.first_lost) == (1.0, 1.0, 0, None)
    assert (got.lost_when_off, got.lost_when_on, got.reported_lost) == (None, 0.0, 0)
    assert got.fps is got.mean_active is got.coverage50 is None


def test_by_hand():
    half = (20.0, 10.0, 20.0, 20.0)  # overlaps by a half: IoU 200 / 600 = 1/3, above 0 .. 0.3: 7 thresholds
    away = (100.0, 10.0, 20.0, 20.0)
    far_enough = (26.0, 22.0, 20.0, 20.0)  # centre 16, 12 away: exactly 20 px; IoU 4 * 8 / 768 = 1/24
    boxes = np.array([TRUE, half, away, far_enough])
    got = score_pass(boxes, [False, True, True, False], np.tile(TRUE, (4, 1)))
    assert got.auc == pytest.approx((20 + 7 + 0 + 1) / (4 * 21))
    assert got.auc_strict == pytest.approx((20 + 0 + 0 + 1) / (4 * 21))
    assert got.mean_iou == pytest.approx((1 + 1 / 3 + 0 + 1 / 24) / 4)
    assert got.precision20 == 0.75
    assert got.lost_when_off == 1.0 and got.lost_when_on == pytest.approx(1 / 3)


def test_absent_frames_count_for_speed_only():
    truth = np.array([TRUE, [np.nan] * 4, TRUE])
    boxes = np.array([TRUE, (500.0, 0.0, 5.0, 5.0), TRUE])
    got = score_pass(boxes, [False, True, False], truth, seconds=[9.0, 0.25, 0.25], active=[1, 2, 3])
    assert (got.frames, got.scored_frames, got.mean_iou, got.reported_lost) == (3, 2, 1.0, 1)
    assert got.fps == 4.0 and got.mean_active == 2.0


def test_lost_episodes_are_maximal_stretches_of_five():
    pattern = [0] * 5 + [1] + [0] * 4 + [1] + [0] * 7
    assert lost_episodes(np.array(pattern, dtype=float)) == [0, 11]
    truth = np.tile(TRUE, (len(pattern), 1))
    got = score_pass(truth + np.outer(1 - np.array(pattern), [200, 0, 0, 0]), np.zeros(len(pattern)), truth)
    assert (got.lost_episodes, got.first_lost) == (2, 0)


def test_the_first_lost_frame_is_counted_from_the_start_of_the_pass():
    truth = np.tile(TRUE, (12, 1))
    truth[1:3] = np.nan
    boxes = np.tile(TRUE, (12, 1))
    boxes[6:, 0] += 200
    got = score_pass(boxes, np.zeros(12), truth)
    assert (got.lost_episodes, got.first_lost) == (1, 6)


def test_coverage_is_per_axis_and_leaves_out_the_start():
    truth = np.tile(TRUE, (5, 1))  # the centre is 19.5, 19.5
    region = [[0, 0, 0, 0], [19, 20, 19, 20], [19.5, 20, 0, 19], [20, 30, 19, 19.5], [0, 50, 25, 30]]
    got = score_pass(truth, np.zeros(5), truth, region50=region, region90=[[0, 99, 0, 99]] * 5)
    assert got.coverage50 == (0.75, 0.5)
    assert got.coverage90 == (1.0, 1.0)


def test_wrong_input_is_refused():
    truth = np.tile(TRUE, (3, 1))
    with pytest.raises(ValueError, match="must be"):
        score_pass(truth[:2], np.zeros(3), truth)
    with pytest.raises(ValueError, match="must be"):
        score_pass(truth, np.zeros(2), truth)
    with pytest.raises(ValueError, match="box of frame 1 is not finite"):
        score_pass(np.array([TRUE, [np.nan] * 4, TRUE]), np.zeros(3), truth)
    with pytest.raises(ValueError, match="no box in any"):
        score_pass(truth, np.zeros(3), truth * np.nan)


def test_a_row_without_a_box_is_lost():
    nothing = [np.nan] * 4
    boxes, truth = np.array([TRUE, TRUE, nothing, nothing]), np.tile(TRUE, (4, 1))
    got = score_pass(
        boxes, [False, False, True, True], truth, region50=[[0, 99, 0, 99]] * 4, active=[2, 2, 0, 0]
    )
    assert (got.scored_frames, got.mean_iou, got.precision20, got.lost_when_off) == (4, 0.5, 0.5, 1.0)
    assert (got.coverage50, got.mean_active) == ((1.0, 1.0), 2.0)
    with pytest.raises(ValueError, match="box of frame 3 is not finite"):
        score_pass(boxes, [False, False, True, False], truth)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("confidence", [0.5] * 4, r"confidence \(4,\): must be \(3,\)"),
        ("confidence", [[0.5]] * 3, r"confidence \(3, 1\): must be \(3,\)"),
        ("confidence", [0.5, np.nan, 0.5], "confidence of frame 1 is nan: a finite number is needed"),
        ("seconds", [1.0] * 2, r"seconds \(2,\): must be \(3,\)"),
        ("active", [1] * 4, r"active \(4,\): must be \(3,\)"),
        ("region50", [[0, 9, 0, 9]] * 4, r"region50 \(4, 4\): must be \(3, 4\)"),
        ("region90", [[0, 9]] * 3, r"region90 \(3, 2\): must be \(3, 4\)"),
    ],
)
def test_every_array_has_a_row_for_each_frame(name, values, message):
    truth = np.tile(TRUE, (3, 1))
    with pytest.raises(ValueError, match=message):
        score_pass(truth, np.zeros(3), truth, **{name: values})


def iou(a, b):
    across = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    down = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    shared = max(across, 0.0) * max(down, 0.0)
    return shared / (a[2] * a[3] + b[2] * b[3] - shared)


box = st.tuples(st.integers(0, 60), st.integers(0, 60), st.integers(1, 40), st.integers(1, 40))


@given(st.lists(st.tuples(box, box, st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_against_the_definitions_as_loops(rows):
    boxes = np.array([row[0] for row in rows], dtype=float)
    truth = np.array(
        [row[1] if i == 0 or row[3] else [np.nan] * 4 for i, row in enumerate(rows)], dtype=float
    )
    lost = [row[2] for row in rows]
    got = score_pass(boxes, lost, truth)
    seen = [(b, t, gone) for b, t, gone in zip(boxes, truth, lost, strict=True) if not np.isnan(t[0])]
    overlaps = [iou(b, t) for b, t, _ in seen]
    above = strict = near = 0
    for value, (b, t, gone) in zip(overlaps, seen, strict=True):
        above += sum(value > threshold for threshold in np.linspace(0, 1, 21))
        strict += sum((0 if gone else value) > threshold for threshold in np.linspace(0, 1, 21))
        near += np.hypot(b[0] + b[2] / 2 - t[0] - t[2] / 2, b[1] + b[3] / 2 - t[1] - t[3] / 2) <= 20
    n = len(seen)
    # An overlap within rounding of a threshold may fall on either side of it.
    close = sum(min(abs(value - np.linspace(0, 1, 21))) < 1e-9 and value > 0 for value in overlaps)
    assert abs(got.auc * 21 * n - above) <= close + 1e-6
    assert abs(got.auc_strict * 21 * n - strict) <= close + 1e-6
    assert got.precision20 == pytest.approx(near / n)
    assert got.mean_iou == pytest.approx(np.mean(overlaps))
    assert got.auc_strict <= got.auc + 1e-12
    runs = "".join("0" if value == 0 else "1" for value in overlaps).split("1")
    assert got.lost_episodes == sum(len(run) >= 5 for run in runs)


def test_text_and_json():
    truth = np.tile(TRUE, (3, 1))
    regions = [[0, 99, 0, 99]] * 3
    full = score_pass(
        truth, np.zeros(3), truth, seconds=[1, 1, 1], active=[1, 1, 2], region50=regions, region90=regions
    )
    back = json.loads(full.json())
    assert back["auc"] == full.auc and back["lost_when_off"] is None and back["coverage50"] == [1.0, 1.0]
    lines = dict(line.split(None, 1) for line in full.text().splitlines())
    assert list(lines) == [name for name in back if not name.startswith(("long_", "statuses"))]
    assert (lines["auc"], lines["lost_when_off"], lines["coverage90"]) == ("0.9524", "-", "1.00 1.00")


def test_frames_by_status_and_overlap():
    """A half that is shown is an overlap of a half, which is not above it."""
    truth = np.tile(TRUE, (5, 1)).astype(float)
    truth[4] = np.nan
    boxes = np.tile(TRUE, (5, 1)).astype(float)
    boxes[1, 2] *= 0.5
    boxes[2, 0] += 1000.0
    said = ["tracking", "tracking", "uncertain", "lost", "tracking"]
    found = score_pass(boxes, [one == "lost" for one in said], truth, statuses=said)
    assert found.statuses == {
        "tracking": {"above 0.5": 1, "up to 0.5": 1, "none": 0, "absent": 1},
        "uncertain": {"above 0.5": 0, "up to 0.5": 0, "none": 1, "absent": 0},
        "lost": {"above 0.5": 1, "up to 0.5": 0, "none": 0, "absent": 0},
    }
    assert found.misjudged == (2, 1)
    shown = found.text(explained=True).splitlines()
    assert [line.split() for line in shown[-3:]] == [
        ["tracking", "1", "1", "0", "1"],
        ["uncertain", "0", "0", "1", "0"],
        ["lost", "1", "0", "0", "0"],
    ]
    assert "status" not in found.text()
