"""The data of the run page: what is packed comes out again, and says what the journal says."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track import load_graph
from bayesnet_track.journal.events.faults import Quarantined, Readmitted
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.load import Shed, TakenBack, Toggled
from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.journal.events.statuses import IdentityDoubtful, StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.view.page_data import CLOUD_POINTS, read_timings, run_data
from bayesnet_track.view.page_tables import event_row, event_rows, pack, plates, short_floats, unpack
from bayesnet_track.view.run_page import Pictures, full_pictures, gather, one_file, with_folder

STARTED = RunStarted(1, "g", "0" * 64, 0, "video.mp4", 64, 48, True, 3, 0.04)


@pytest.fixture
def make_metrics(metrics):
    return partial(replace, metrics)


CAUSE = Cause("ud_px2", 200.0, 212.4, 3, 212.4, 212.4, 1.0)


# ------------------------------------------------------------------------------------ columns


def test_packed_columns_come_out_as_they_went_in():
    columns = {
        "a/b": np.array([1.5, np.nan, -np.inf], np.float32),
        "box": np.arange(8, dtype=np.int16).reshape(2, 4),
        "none": np.zeros((0, 4), np.float32),
        "codes": np.array([1, 2, 3], np.uint8),
    }
    data = pack({"x": ["é", None]}, columns)
    header, found = unpack(data)
    assert header == {"x": ["é", None]} and list(found) == list(columns)
    for name, column in columns.items():
        assert found[name].dtype == column.dtype
        np.testing.assert_array_equal(found[name], column)
    assert pack({"x": ["é", None]}, columns) == data


def test_columns_of_other_types_are_refused():
    with pytest.raises(ValueError, match="'x' is int64"):
        pack({}, {"x": np.arange(3)})


@given(st.floats(-(2.0**100), 2.0**100, width=32, allow_subnormal=False))
def test_short_floats_are_close(value):
    # Half a step of 14 bits of mantissa; the smallest numbers have fewer.
    assert abs(float(short_floats([value])[0]) - value) <= max(2.0**-15 * abs(value), 2.0**-140)


def test_short_floats_keep_what_is_no_number():
    np.testing.assert_array_equal(
        short_floats([np.inf, -np.inf, np.nan, 0.0]), [np.inf, -np.inf, np.nan, 0.0]
    )


# ------------------------------------------------------------------------------------ events


def test_a_switch_is_told_in_pieces():
    row = event_row(Activated(29, "1", "motion", "square", CAUSE))
    assert row == {
        "frame": 29,
        "kind": "activated",
        "sort": "switch",
        "what": "motion on",
        "why": "UD 212 px² > 200 for 3 frames",
        "unless": "would have stayed off at activate ≥ 213",
        "target": "1",
        "node": "motion",
        "on": True,
    }
    assert event_row(Deactivated(30, "1", "motion", "square", CAUSE, "largest_kl"))["on"] is False


@pytest.mark.parametrize(
    ("event", "on"),
    [
        (Quarantined(3, "1", "motion", "it raised"), False),
        (Readmitted(3, "1", "motion", True, 1, 50), True),
        (Readmitted(3, "1", "motion", False, 1, 50), False),
        (Toggled(3, "1", "motion", True), True),
        (Toggled(3, "1", "motion", False), False),
        (Shed(3, "1", "motion", 50.0, 40.0, 3, 10, 45.0, {"motion": 0.2}), False),
        (TakenBack(3, "1", "motion", 20.0, 30.0, 40.0, 50), True),
    ],
)
def test_every_decision_that_switches_an_agent_is_marked(event, on):
    row = event_row(event)
    assert (row["sort"], row["on"], row["node"]) == ("switch", on, "motion")


def test_a_start_has_no_cause_and_a_status_says_which():
    started = event_row(TargetStarted(0, "a", "square", (1.0, 2.0, 3.0, 4.0), ("color",)))
    assert started["sort"] == "life" and started["why"] == "" and started["what"].endswith("→ color on")
    lost = event_row(StatusChanged(5, "a", "lost", None, "no active agent saw it"))
    assert (lost["sort"], lost["status"], lost["why"]) == ("status", "lost", "no active agent saw it")


def test_the_run_itself_is_no_row():
    assert event_rows([STARTED]) == []


# ------------------------------------------------------------------------------------ net and levels


def test_levels_and_net_come_from_the_graph():
    plate = plates(load_graph("two_squares"), {"color_histogram": 2.0})["square"]
    assert plate["settings"]["square"].startswith("belief: particles\nmotion:\n  random_walk:")
    # All parameters of a cue, those that the graph leaves out, too.
    assert {"floor: 0.003", "bins: 32"} <= {line.strip() for line in plate["settings"]["color"].splitlines()}
    assert plate["root"] == "square"
    assert plate["agents"][0] == {"name": "color", "cue": "color_histogram", "cost_ms": 2.0}
    levels = {(rule["rule"], rule["unit"]): rule["level"] for rule in plate["rules"]}
    assert levels == {
        ("activate", "ud_px2"): 130,
        ("deactivate", "ud_px2"): 105,
        ("learn", "ud_px2"): 100,
        ("lost", "ud_box"): 1,
    }
    net = plate["net"]
    assert {edge["child"] for edge in net["edges"]} == {"color", "motion"}
    for node in net["nodes"]:
        assert node["w"] / 2 <= node["x"] <= net["width"] - node["w"] / 2
        assert node["h"] / 2 <= node["y"] <= net["height"] - node["h"] / 2


def test_the_level_of_agents_on_call_is_drawn():
    rules = plates(load_graph("deep"), {})["target"]["rules"]
    assert {"node": "target", "rule": "on_call", "unit": "ud_box", "level": 0.026, "frames": 1} in rules


@pytest.mark.parametrize("name", ["general", "person_parts", "two_people_color_stereo_shape", "crowd"])
def test_every_kind_of_graph_has_a_net(name):
    for plate in plates(load_graph(name), {}).values():
        names = {node["name"] for node in plate["net"]["nodes"]}
        assert {agent["name"] for agent in plate["agents"]} | {plate["root"]} <= names
        json.dumps(plate, allow_nan=False)


# ------------------------------------------------------------------------------------ run


def test_columns_hold_the_lines(make_metrics):
    lines = [
        make_metrics(frame=0, active=("color",), kl={}, cloud=()),
        make_metrics(frame=1, active=("color", "motion"), kl={"motion": 2.0}, cloud=((5, 6, 7, 8),)),
        make_metrics(frame=1, target="2", status="lost", quiet_px2=None),
    ]
    header, columns = run_data([STARTED], lines)
    assert [target["id"] for target in header["targets"]] == ["1", "2"]
    assert columns["0/frame"].tolist() == [0, 1]
    assert columns["0/agents/motion/state"].tolist() == [0, 1]
    np.testing.assert_array_equal(columns["0/agents/motion/kl"], [np.nan, 2.0])
    assert columns["0/cloud"].tolist() == [[5, 6, 7, 8]] and columns["0/cloud_end"].tolist() == [0, 1]
    assert columns["1/status"].tolist() == [2] and np.isnan(columns["1/quiet_px2"][0])
    pack(header, columns)


def test_a_long_run_shows_fewer_hypotheses_a_frame(make_metrics, monkeypatch):
    monkeypatch.setattr("bayesnet_track.view.page_data.CLOUD_POINTS", 20)
    lines = [make_metrics(frame=n, cloud=((1, 2, 3, 4),) * 48) for n in range(10)]
    assert len(run_data([STARTED], lines)[1]["0/cloud"]) == 20 < CLOUD_POINTS


def test_a_journal_without_its_start_is_refused():
    with pytest.raises(ValueError, match="run_started"):
        run_data([], [])


def test_timings_end_at_the_first_damaged_line(tmp_path):
    path = tmp_path / "timings.jsonl"
    path.write_text('{"frame": 0, "seconds": 0.5, "parts": {"a": 0.1}}\n{"frame": 1, "seco')
    assert read_timings(path) == [{"frame": 0, "seconds": 0.5, "parts": {"a": 0.1}}]
    assert read_timings(tmp_path / "none") == []


# ------------------------------------------------------------------------------------ pictures


def noise(count, size=(60, 80)):
    rng = np.random.default_rng(3)
    for frame in range(count):
        yield frame, {"": rng.integers(0, 255, (*size, 3), dtype=np.uint8)}


def test_pictures_keep_to_the_budget_and_to_the_frames_of_events():
    # Noise packs badly: far more than the budget at every size.
    pictures = gather(noise(40), 40, event_frames={7, 13}, budget=30_000)[""]
    assert sum(map(len, pictures.data)) <= 30_000
    assert {7, 13} <= set(pictures.frames) and list(pictures.frames) == sorted(pictures.frames)
    assert 2 < len(pictures.frames) < 40 and pictures.step > 1


def test_with_room_every_frame_has_a_picture_of_its_own_size():
    pictures = gather(noise(9), 9)[""]
    assert pictures.frames == tuple(range(9)) and pictures.step == 1
    image = cv2.imdecode(np.frombuffer(pictures.data[0], np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (60, 80, 3)


def test_a_source_without_frames_gives_no_pictures():
    assert gather(iter([]), 5) == {}


def test_whole_frames_are_close_to_what_was_seen():
    image = np.full((20, 30, 3), (40, 90, 200), np.uint8)
    ((frame, _, data),) = full_pictures([(4, {"": image})])
    shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert frame == 4 and np.abs(shown.astype(int) - image).max() < 6


# ------------------------------------------------------------------------------------ page


def test_the_policy_names_the_very_script_and_style_and_no_address(make_metrics):
    header, columns = run_data([STARTED], [make_metrics(frame=0)])
    page = "".join(one_file(header, columns, {"": Pictures((0,), (b"abc",))}))
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1).replace("&#x27;", "'")
    for tag in ("script", "style"):
        text = re.search(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL).group(1)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'") and "http" not in policy and "unsafe" not in policy
    assert '<script type="text/plain" id="run-pictures">YWJj</script>' in page
    packed = re.search(r'id="run-data">([^<]*)<', page).group(1)
    assert unpack(base64.b64decode(packed))[0]["pictures"]["step"] == 1


def test_names_are_escaped():
    hostile = "</title><script>alert('1')</script>"
    started = RunStarted(1, hostile, "0" * 64, 0, hostile, 64, 48, True, 3, 0.04)
    header, columns = run_data([started], [])
    for page in (one_file(header, columns, {}), with_folder(header, columns, {})):
        text = "".join(page)
        assert "alert(" in text and hostile not in text
        assert text.count("<script>") == 1


def test_probabilities_of_modes_are_columns_and_the_graph_says_which_hide(make_metrics):
    lines = [make_metrics(frame=0), make_metrics(frame=1, modes={"seen": 0.25, "behind": 0.75})]
    header, columns = run_data([STARTED], lines, graph=load_graph("hidden_ball"))
    assert header["targets"][0]["modes"] == ["behind", "seen"]
    assert header["plates"]["ball"]["hidden_modes"] == ["behind"]
    np.testing.assert_array_equal(columns["0/modes/behind"], [np.nan, 0.75])


def test_identities_are_columns_of_the_targets_that_may_have_them(make_metrics):
    shares = {"1": 0.71, "9": 0.29}
    lines = [make_metrics(frame=0), make_metrics(frame=1, identities=shares), make_metrics(frame=2)]
    header, columns = run_data([STARTED], lines)
    assert header["targets"][0]["identities"] == ["1", "9"]
    np.testing.assert_allclose(columns["0/identities/9"], [np.nan, 0.29, np.nan], atol=1e-4)


def test_a_doubtful_identity_says_since_when_and_how_probable():
    row = event_row(IdentityDoubtful(230, "4", "9", 211, 0.224, 0.776, 1.8, -0.5))
    assert row["doubt"] == {"since": 211, "probability": 0.224, "mutual": True}
    assert (row["target"], row["other"]) == ("4", "9")
    assert row["what"].endswith("; decided by appearance +1.8, motion -0.5 nats")


def test_answers_to_queries_are_columns_and_the_header_says_what_was_asked(make_metrics):
    lines = [make_metrics(frame=0), make_metrics(frame=1, queries={"crossed": 0.25, "speed_low": 3.0})]
    header, columns = run_data([STARTED], lines, graph=load_graph("people_counted"))
    assert set(header["targets"][0]["queries"]) == {"crossed", "speed_low"}
    np.testing.assert_array_equal(columns["0/queries/crossed"], [np.nan, 0.25])
    np.testing.assert_array_equal(columns["0/queries/speed_low"], [np.nan, 3])
    assert list(header["queries"]) == ["crossed", "on_grass", "speed"]
    crossed, grass, speed = header["queries"].values()
    assert (crossed["kind"], crossed["level"]) == ("crosses", 0.9)
    assert crossed["corners"] == [[300, 150], [300, 575]]
    assert (grass["asks"], len(grass["corners"])) == ("foot is in the polygon", 5)
    assert (speed["asks"], speed["unit"], speed["interval"]) == ("hypot(vx, vy) / frame_s", "px/s", 0.9)
