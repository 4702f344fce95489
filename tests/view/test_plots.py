"""Plots of a run: what they draw into an axis, asked of a stand-in, for matplotlib is an extra."""

import math
from collections import defaultdict
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.load import Shed, TakenBack
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.view import notebook


class Axis:
    """Writes down what is called."""

    def __init__(self):
        self.called = defaultdict(list)
        self.yaxis_inverted = lambda: False
        self.get_legend_handles_labels = lambda: ([], [])

    def plot(self, *values, **look):
        self.called["plot"].append((values, look))
        return [SimpleNamespace(get_color=lambda: "C0")]

    def __getattr__(self, name):
        return lambda *values, **look: self.called[name].append((values, look))


@pytest.fixture
def run(metrics):
    """20 frames: lost in 5 and 6, motion on in 10 to 14."""
    lines = [
        replace(
            metrics,
            frame=frame,
            centre_box=(10.0 + frame, 9.0, 4.0, 4.0),
            status="lost" if frame in (5, 6) else "tracking",
            active=("color", "motion") if 10 <= frame < 15 else ("color",),
            kl={"color": 0.1},
        )
        for frame in range(20)
    ]
    cause = Cause("ud_px2", 200.0, 210.0, 1, 210.0, 210.0, 1.0)
    events = [
        TargetStarted(0, "1", "plate", (10.0, 9.0, 4.0, 4.0), ("color",)),
        Activated(9, "1", "motion", "root", cause),
    ]
    return SimpleNamespace(name="a", events=events, metrics=lines, seconds={}, costs_ms={})


def test_uncertainty_with_switches_levels_and_loss(run):
    ax = Axis()
    assert notebook.plot_uncertainty(ax, run) is ax
    ((frames, uds), _) = ax.called["semilogy"][0]
    assert frames == list(range(20)) and set(uds) == {212.4}
    (((at, values, mark), look),) = ax.called["plot"]
    assert (at, values, mark, look["label"]) == ([9], [212.4], "^", "agent on")
    assert [values for values, _ in ax.called["axhline"]] == [(200.0,)]
    assert [values for values, _ in ax.called["axvspan"]] == [(4.5, 6.5)]


def test_a_level_in_other_units_is_drawn_in_px2(run):
    scales = ((9, 100.0), (15, 80.0))
    run.events[1:] = [
        Activated(at, "1", "motion", "root", Cause("ud_baseline", 2.0, 2.1, 1, 2.1, 2.1 * scale, scale))
        for at, scale in scales
    ]
    ax = Axis()
    notebook.plot_uncertainty(ax, run)
    assert [values for values, _ in ax.called["step"]] == [([0, 15, 19], [200.0, 160.0, 160.0])]
    ax = Axis()
    del run.events[2]
    notebook.plot_uncertainty(ax, run)
    assert [values for values, _ in ax.called["axhline"]] == [(200.0,)]


def test_switches_that_no_rule_made_are_drawn_too(run):
    run.events[1:] = [
        Shed(4, "1", "motion", 50.0, 40.0, 3, 10, 45.0, {"motion": 0.2}),
        TakenBack(9, "1", "motion", 20.0, 30.0, 40.0, 50),
    ]
    ax = Axis()
    notebook.plot_uncertainty(ax, run)
    assert [(values[0], values[2]) for values, _ in ax.called["plot"]] == [([9], "^"), ([4], "v")]


def test_kl_has_gaps_where_an_agent_said_nothing(run):
    ax = Axis()
    notebook.plot_kl(ax, run)
    named = {look["label"]: values[1] for values, look in ax.called["plot"]}
    assert named["color"] == [0.1] * 20 and all(math.isnan(value) for value in named["motion"])


def test_bars_of_active_agents(run):
    ax = Axis()
    notebook.plot_active(ax, run)
    bars = [values[0] for values, _ in ax.called["broken_barh"]]
    assert bars == [[(-0.5, 20.0)], [(9.5, 5.0)]]


def test_tracks_go_through_the_centres_with_a_gap_where_lost(run):
    ax = Axis()
    truth = np.array([[8.5 + frame, 7.5, 4.0, 4.0] for frame in range(20)])
    notebook.plot_tracks(ax, run, image=np.zeros((20, 30, 3), np.uint8), truth=truth)
    seen, lost, box, true = [values for values, _ in ax.called["plot"]]
    assert np.isnan(seen[0][5:7]).all() and seen[0][4] == 14.0
    assert list(lost[0][5:7]) == [15.0, 16.0] and np.isnan(lost[0][:5]).all()
    np.testing.assert_allclose(true[0], 10.0 + np.arange(20))  # the same convention as the estimates
    assert (min(box[0]), max(box[0])) == (27.0, 31.0)
    assert not ax.called["invert_yaxis"]


def test_score(run):
    ax = Axis()
    notebook.plot_score(ax, run)
    assert ax.called["set"][0][1]["ylabel"] == "score, uncalibrated"


@pytest.mark.parametrize(
    "plot", [notebook.plot_uncertainty, notebook.plot_kl, notebook.plot_active, notebook.plot_score]
)
def test_a_target_that_is_not_there(plot, run):
    with pytest.raises(ValueError, match=r"no target '7'.*there are 1"):
        plot(Axis(), run, "7")


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_all_of_them_with_matplotlib_itself(run):
    figure = pytest.importorskip("matplotlib.figure")
    nothing = SimpleNamespace(name="a", events=[], metrics=[], seconds={}, costs_ms={})
    run.metrics[3] = replace(run.metrics[3], ud_px2=math.inf)
    for plot in (
        notebook.plot_uncertainty,
        notebook.plot_kl,
        notebook.plot_active,
        notebook.plot_score,
        notebook.plot_tracks,
    ):
        axes = figure.Figure().subplots()
        plot(axes, run)
        assert axes.has_data()
    silent = SimpleNamespace(
        **{**vars(run), "metrics": [replace(one, active=(), kl={}) for one in run.metrics]}
    )
    for plot, empty in (
        (notebook.plot_kl, silent),
        (notebook.plot_active, silent),
        (notebook.plot_tracks, nothing),
    ):
        axes = figure.Figure().subplots()
        plot(axes, empty)
        assert not axes.get_lines() and not axes.collections
