"""The timeline: thresholds, curve, bars and marks where the journal puts them."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.view.timeline import BAR_COLOURS, LEFT, RIGHT, WIDTH, Axes, draw_timeline

SVG = "{http://www.w3.org/2000/svg}"


def cause(level, value):
    return Cause("ud_px2", level, value, 3, value, value, 1.0)


@pytest.fixture
def run(metrics):
    started = TargetStarted(0, "1", "square", (0.0, 0.0, 4.0, 4.0), ("hue", "motion"))
    off = Deactivated(9, "1", "motion", "square", cause(130, 81), "largest_kl", {})
    on = Activated(29, "1", "motion", "square", cause(200, 400))
    lost = StatusChanged(60, "1", "lost", cause(1600, 2000))
    lines = [
        replace(
            metrics,
            frame=n,
            ud_px2=400.0 if n == 29 else 90.0,
            active=("hue",) if 9 < n <= 29 else ("hue", "motion"),
            status="lost" if 60 < n <= 70 else "tracking",
        )
        for n in range(101)
    ]
    return [started, off, on, lost], lines


def test_marks_bars_and_levels(run):
    events, lines = run
    root = ET.fromstring(draw_timeline(events, lines))
    assert root.find(f"{SVG}title").text == "Timeline of target 1"
    tips = [title.text for title in root.iter(f"{SVG}title")]
    assert explain(events[1]) in tips and explain(events[2]) in tips
    assert "hue: frames 0 to 100" in tips and "lost in frames 61 to 70" in tips
    assert [tip for tip in tips if tip.startswith("motion:")] == [
        "motion: frames 0 to 9",
        "motion: frames 30 to 100",
    ]
    words = [text.text for text in root.iter(f"{SVG}text")]
    for word in (
        "activate 200",
        "deactivate 130",
        "lost 1600",
        "quiet 94",
        "UD 90",
        "9",
        "29",
        "hue",
        "motion",
    ):
        assert word in words
    assert "100% of frames" in words and "80% of frames" in words
    axes = Axes(0, 100, 1.0, 2.0)
    second = [bar for bar in root.iter(f"{SVG}rect") if bar.attrib["fill"] == BAR_COLOURS[1]]
    assert [float(bar.attrib["x"]) for bar in second] == [LEFT, pytest.approx(axes.x(29.5), abs=0.01)]


def test_the_scale_is_logarithmic():
    axes = Axes(0, 10, 1.0, 10_000.0)
    assert axes.y(1) - axes.y(10) == pytest.approx(axes.y(100) - axes.y(1000))
    assert axes.y(0.0) == axes.y(1.0) and axes.y(float("inf")) == axes.y(10_000.0)


def test_other_targets_are_left_out(run):
    events, lines = run
    other = [replace(line, target="2", active=("shape",)) for line in lines]
    assert draw_timeline(events, [*lines, *other], "1") == draw_timeline(events, lines)
    assert "shape" in draw_timeline(events, [*lines, *other], "2")
    with pytest.raises(ValueError, match="no metrics of target '3'"):
        draw_timeline(events, lines, "3")
    with pytest.raises(ValueError, match="no metrics"):
        draw_timeline([], [])


name = st.text(min_size=1, max_size=40)
ud = st.one_of(st.floats(0, 1e12), st.sampled_from([float("inf"), float("nan"), 0.0]))


@given(
    agents=st.lists(name, unique=True, max_size=5),
    values=st.lists(ud, min_size=1, max_size=30),
    data=st.data(),
)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_any_run_is_drawn_inside_the_picture(metrics, agents, values, data):
    subsets = st.lists(st.sampled_from(agents), unique=True) if agents else st.just([])
    lines = [
        replace(metrics, frame=3 * n + 7, ud_px2=value, active=tuple(data.draw(subsets)), quiet_px2=None)
        for n, value in enumerate(values)
    ]
    events = [Activated(7, "1", agent, "square", cause(200, 400)) for agent in agents]
    root = ET.fromstring(draw_timeline(events, lines).encode("utf-8"))
    width, height = float(root.attrib["width"]), float(root.attrib["height"])
    for rect in root.iter(f"{SVG}rect"):
        x, y, w, h = (float(rect.attrib.get(key, 0)) for key in ("x", "y", "width", "height"))
        assert x >= 0 and y >= 0 and w > 0 and h > 0 and x + w <= width and y + h <= height
    for curve in root.iter(f"{SVG}polyline"):
        for point in curve.attrib["points"].split():
            x, y = map(float, point.split(","))
            assert LEFT <= x <= WIDTH - RIGHT and 0 < y < height
    assert not list(root.iter(f"{SVG}script"))
