"""The page of a comparison: it escapes, loads nothing, and its chart says what the runs say."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import pytest

from bayesnet_track.journal.compare import compare
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.journal.text.compare_text import compare_text, settings_apart
from bayesnet_track.view.compare_page import compare_page

HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)>'
VOID = {"meta"}


class Checked(HTMLParser):
    """Tags closed in order, and what they could load or run."""

    def __init__(self, text):
        super().__init__()
        self.open, self.active, self.ids, self.links = [], [], set(), []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.active += [(tag, key) for key, value in attrs if key in ("src", "style") or key.startswith("on")]
        self.active += [(tag, "")] if tag in ("script", "img", "iframe", "link", "object") else []
        self.ids |= {value for key, value in attrs if key == "id"}
        self.links += [value for key, value in attrs if key == "href"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture
def few_metrics(metrics):
    """A hand-made line -> 20 frames of it."""
    return lambda: [replace(metrics, frame=frame, centre_box=(9.0, 9.0, 4.0, 4.0)) for frame in range(20)]


def runs(make_metrics, name="a"):
    cause = Cause("ud_px2", 200.0, 210.0, 1, 210.0, 210.0, 1.0)
    events = [TargetStarted(0, "1", "plate", (9.0, 9.0, 4.0, 4.0), (name,))]
    first = SimpleNamespace(
        name=f"runs/{name}", events=events, metrics=make_metrics(), seconds={}, costs_ms={}
    )
    on = Activated(12, "1", name, "root", cause)
    moved = [replace(one, centre_box=(12.0, 9.0, 4.0, 4.0)) for one in first.metrics]
    second = SimpleNamespace(**{**vars(first), "events": [*events, on], "metrics": moved})
    return first, second, compare(first, second)


def test_it_tells_the_parting_and_draws_it(few_metrics):
    first, second, compared = runs(few_metrics)
    page = compare_page(first, second, compared, ["seed: 0 → 1"])
    assert "They first diverge at frame 12, a" in page
    assert "UD 210 px² &gt; 200" in page
    checked = Checked(page)
    assert checked.active == []
    # The line of the chart, and the heading, so that its address can be copied.
    assert checked.links == ["#moment-0", "#moment-0"] and "moment-0" in checked.ids
    assert page.count('class="parting first"') == 1
    # The lines are links, with a name and room for a finger; an image would hide them from a screen reader.
    assert re.search(
        r'<svg class="chart" role="group".*<a href="#moment-0"><title>B .*class="hit"', page, re.S
    )
    assert 'polyline points="' in page and ">3</text>" in page  # the estimates are 3 px apart


def test_hostile_names_stay_text_and_the_policy_forbids_everything_else(few_metrics):
    first, second, compared = runs(few_metrics, HOSTILE)
    page = compare_page(first, second, compared, [HOSTILE])
    assert Checked(page).active == []
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1)
    assert policy.startswith("default-src 'none'; style-src 'sha256-") and "unsafe" not in policy


def test_runs_that_never_part(few_metrics):
    first, _, _ = runs(few_metrics)
    page = compare_page(first, first, compare(first, first), [])
    assert "Their decisions never diverge" in page and ">never</text>" in page and "parting first" not in page


def test_a_page_tells_of_so_many_partings_and_links_no_others(few_metrics, monkeypatch):
    first, second, _ = runs(few_metrics)
    for module in ("compare_page", "compare_charts"):
        monkeypatch.setattr(f"bayesnet_track.view.{module}.MOST_MOMENTS", 1)
    second.events.append(replace(second.events[-1], frame=18))
    compared = compare(first, second)
    assert len(compared.moments) == 2
    checked = Checked(compare_page(first, second, compared, []))
    assert set(checked.links) == {"#moment-0"} and "moment-0" in checked.ids


def test_a_partial_run_says_so_beside_its_name(few_metrics):
    first, _, _ = runs(few_metrics)
    started = RunStarted(2, "general", "0" * 64, 7, "video.mp4", 320, 240, True, 40, 0.04)
    whole = SimpleNamespace(
        **{**vars(first), "events": [started, *first.events, RunEnded(40, 40, True, "end_of_source")]}
    )
    cut = SimpleNamespace(
        **{
            **vars(first),
            "name": "runs/cut",
            "events": [started, *first.events, RunEnded(20, 40, False, "interrupted")],
        }
    )
    killed = SimpleNamespace(**{**vars(cut), "events": [started, *first.events]})
    page = compare_page(whole, cut, compare(whole, cut), [])
    assert page.count("partial run") == 1
    assert (
        'runs/cut<span class="soft"> · general · seed 7</span><span class="badge">partial run: interrupted'
        in page
    )
    assert "on video.mp4 · 320 × 240 px" in page
    assert "B  runs/cut (partial run: interrupted)" in compare_text(whole, cut, compare(whole, cut), [])
    assert "partial run: not ended" in compare_page(whole, killed, compare(whole, killed), [])


def test_a_smoothed_run_says_so_beside_its_name(few_metrics):
    first, _, _ = runs(few_metrics)
    started = RunStarted(2, "general", "0" * 64, 7, "video.mp4", 320, 240, True, 40, 0.04)
    events = [*first.events, RunEnded(40, 40, True, "end_of_source")]
    tracked = SimpleNamespace(**{**vars(first), "events": [started, *events]})
    smoothed = SimpleNamespace(
        **{**vars(first), "name": "runs/sm", "events": [replace(started, smoothed=True), *events]}
    )
    settings = settings_apart(tracked.events[0], smoothed.events[0])
    text = compare_text(tracked, smoothed, compare(tracked, smoothed), settings)
    assert text.startswith(
        "A  runs/a\nB  runs/sm (smoothed)\n\ndiffer in\n  estimates: filtered → smoothed\n"
    )
    assert compare_text(smoothed, tracked, compare(smoothed, tracked), []).startswith(
        "A  runs/sm (smoothed)\n"
    )
    page = compare_page(tracked, smoothed, compare(tracked, smoothed), settings)
    assert page.count('<span class="badge">smoothed</span>') == 1


def test_a_whole_target_among_the_differences_is_folded(few_metrics):
    first, second, compared = runs(few_metrics)
    whole = "targets.car: not written → {" + "motion: random_walk, " * 20 + "}"
    page = compare_page(first, second, compared, ["seed: 0 → 1", whole])
    assert page.index("They first diverge") < page.index("<li>seed: 0 → 1</li>")
    assert f"…</summary>{whole}</details>" in page
    assert whole not in compare_text(first, second, compared, [whole])
    assert whole in compare_text(first, second, compared, [whole], shown=2**62)


def test_targets_are_named_by_their_type_where_both_runs_agree_on_it(few_metrics):
    first, second, compared = runs(few_metrics)
    page = compare_page(first, second, compared, [])
    assert '<p class="soft">plate 1: estimates 3 px apart' in page and "target 1" not in page
    assert "plate 1: estimates" in compare_text(first, second, compared, [])
    first.events = [replace(first.events[0], template="<b>")]
    second.events = [replace(second.events[0], template="<b>"), *second.events[1:]]
    hostile = compare_page(first, second, compare(first, second), [])
    assert "&lt;b&gt; 1: estimates" in hostile and "<b> 1" not in hostile
    second.events = [replace(second.events[0], template="car"), *second.events[1:]]
    assert "target 1: estimates" in compare_page(first, second, compare(first, second), [])
