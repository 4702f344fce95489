"""A run that is watched: what the page is told, what it may ask for, and that the run stays what it is."""

import json
import socket
import threading
import time

import pytest

from bayesnet_track import Start, load_graph, open_run, track
from bayesnet_track.journal.codec import to_json
from bayesnet_track.runtime.live_view.controls import Controls, Refused
from bayesnet_track.runtime.live_view.view import LiveView
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.view.page_data import read_timings

FILES = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "inputs.jsonl")
FRAMES = 12


def written(path):
    return {name: (path / name).read_bytes() for name in FILES if (path / name).exists()}


def source():
    scene = make_scene("two_squares", seed=3)
    return SceneSource(scene, "scene", FRAMES), scene.start_box


def play(out, **more):
    opened, box = source()
    return track("two_squares", opened, box, out=out, **more)


def page_state(view):
    """Everything that a page which comes now is told."""
    lines, status = [], {"version": 0}
    while True:
        answer = json.loads(view.feed(len(lines), status["version"]))
        status, lines = answer["status"], lines + answer["lines"]
        if len(lines) == len(view._feed.lines):
            return lines, status


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """A run in which a person pauses, switches, steps and releases."""
    out = tmp_path_factory.mktemp("watched") / "run"
    phases, waits = [], []
    with LiveView() as view:
        controls, ask = view.controls, view.controls.ask
        enter = controls.to
        controls.to = lambda phase: (waits.append(phase) if phase == "paused" else None, enter(phase))

        def ask_when_it_waits(what):
            before = len(waits)

            def wait():
                with controls.news:
                    controls.news.wait_for(lambda: len(waits) > before)
                ask(what)

            threading.Thread(target=wait, daemon=True).start()

        view.shows(load_graph("two_squares"))
        for result in play(out, sinks=[view], inputs=view):
            if result.frame.index == 2:
                ask({"do": "pause"})
                ask({"do": "switch", "target": "1", "agent": "motion", "on": True})
                ask({"do": "switch", "target": "1", "agent": "color", "on": False})
                ask_when_it_waits({"do": "step"})
            if result.frame.index == 3:
                ask_when_it_waits({"do": "go"})
            if result.frame.index == 6:
                ask({"do": "release", "target": "1", "agent": "color"})
            before = len(waits)
            assert not view.hold()
            phases.append((controls.phase, len(waits) > before))
        view.controls.to("ended")
        lines, status = page_state(view)
    return out, lines, status, phases


def alike(one, other):
    """Whether they are the same to six digits: files have seven, the page has more while a run goes on."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return one == pytest.approx(other, rel=1e-6, abs=1e-9)
    return one == other


def test_the_page_is_told_of_targets_by_their_type(watched):
    _, lines, _, _ = watched
    rows = [line["event"] for line in lines if "event" in line]
    assert rows[0]["what"].startswith("square 1 starts, centre ")


def test_a_paused_run_waits_and_takes_one_frame_at_a_time(watched):
    _, _, _, phases = watched
    assert [waited for _, waited in phases[:6]] == [False, False, True, True, False, False]
    assert phases[2][0] == "paused" and phases[4][0] == "running"


def test_the_page_is_told_every_event_and_every_frame_in_order(watched):
    out, lines, status, _ = watched
    assert list(lines[0]) == ["header"] and lines[0]["header"]["plates"]
    frames = [line["frames"] for line in lines if "frames" in line]
    assert [one[0]["frame"] for one in frames] == list(range(FRAMES))
    on_disk = [json.loads(to_json(line)) for line in open_run(out).metrics]
    assert alike([one for each in frames for one in each], on_disk)
    events = [line["event"] for line in lines if "event" in line]
    journal = open_run(out).events
    assert len(events) == len(journal) - 2
    assert list(lines[-1]) == ["ended"] and lines[-1]["ended"]["complete"]
    assert (status["phase"], status["frames"], status["trouble"]) == ("ended", FRAMES, "")
    by_hand = [(e["kind"], e["frame"], e["what"]) for e in events if e["kind"] in ("toggled", "released")]
    assert by_hand == [
        ("toggled", 3, "motion on by hand"),
        ("toggled", 3, "color off by hand"),
        ("released", 7, "color given back to the rules"),
    ]


def test_a_run_that_goes_on_tells_the_page_what_was_before(watched):
    out, lines, _, _ = watched
    timings = read_timings(out / "timings.jsonl")
    events, metrics = open_run(out).events, open_run(out).metrics
    with LiveView() as view:
        view.shows(load_graph("two_squares"))
        view.recall(events[:-1], metrics, timings)
        again, status = page_state(view)
    assert status["frames"] == FRAMES and status["pictured"] == -1
    assert alike(again, lines[:-1])


def test_repeating_it_from_its_inputs_gives_the_same_bytes(watched, tmp_path):
    out = watched[0]
    assert (out / "inputs.jsonl").stat().st_size > 0
    list(play(tmp_path / "again", inputs=out / "inputs.jsonl"))
    assert written(tmp_path / "again") == written(out)


def test_who_only_watches_changes_nothing(tmp_path):
    list(play(tmp_path / "alone"))
    with LiveView() as view:
        for _ in play(tmp_path / "seen", sinks=[view], inputs=view):
            view.hold()
        assert page_state(view)[0][0]["header"]["plates"] == {}
    assert written(tmp_path / "seen") == written(tmp_path / "alone")


def test_a_stopped_run_is_closed_in_order(tmp_path):
    with LiveView() as view:
        results = play(tmp_path / "run", sinks=[view], inputs=view)
        for result in results:
            if result.frame.index == 4:
                view.controls.ask({"do": "stop"})
            if view.hold():
                break
        results.close()
        assert page_state(view)[0][-1] == {"ended": {"complete": False, "reason": "interrupted"}}
    assert open_run(tmp_path / "run").events[-1].frames == 5


def test_a_page_that_reads_nothing_does_not_slow_the_run():
    with LiveView() as view:
        feed = view._feed
        for _ in range(3000):
            feed._write("x" * 2000)
        host, token = view.address.split("/")[2:4]
        ask = f"GET /{token}/feed?from=0 HTTP/1.1\r\nHost: {host}\r\n\r\n"
        slow = [socket.create_connection(("127.0.0.1", view._server.port)) for _ in range(8)]
        for one in slow:
            one.sendall(ask.encode())
        time.sleep(0.1)
        began = time.monotonic()
        for _ in range(1000):
            feed._write("y" * 2000)
        assert time.monotonic() - began < 1.0
        assert len(feed.lines) == 4000
        for one in slow:
            one.close()


def test_boxes_are_checked_and_the_person_told_what_is_wrong():
    graph = load_graph("two_squares")
    opened, box = source()
    with LiveView() as view:
        found = []
        first = next(iter(opened))
        chooser = threading.Thread(target=lambda: found.append(view.choose(graph, opened, first)))
        chooser.start()
        while view.controls.phase != "choosing":
            time.sleep(0.001)
        ask = view.controls.ask
        for wrong, reason in [
            ([], "draw a box"),
            ([{"box": [1, 2, 3]}], "four numbers"),
            ([{"box": [1, 2, 3, True]}], "four numbers"),
            ([{"box": [1, 2, 10**400, 3]}], "numbers"),
            ([{"box": [1, 2, 0, 5]}], "at least 1 px"),
            ([{"box": [900, 2, 9, 5]}], "outside"),
            ([{"box": [1, 2, 9, 5], "plate": "square2"}], "no plate 'square2'"),
        ]:
            with pytest.raises(Refused, match=reason):
                ask({"do": "start", "boxes": wrong})
        assert chooser.is_alive()
        ask({"do": "start", "boxes": [{"box": list(box), "plate": "square"}, {"box": [1, 2, 30, 40.5]}]})
        chooser.join(5)
        assert found == [(Start(tuple(map(float, box)), "square"), Start((1.0, 2.0, 30.0, 40.5)))]
        with pytest.raises(Refused, match="begun already"):
            ask({"do": "start", "boxes": [{"box": list(box)}]})


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({}, "no such thing"),
        ({"do": "hold"}, "no such thing"),
        ({"do": ["pause"]}, "no such thing"),
        ({"do": "leave"}, "the run goes on"),
        ({"do": "switch", "target": "1", "agent": "motion"}, "on or off"),
        ({"do": "switch", "target": 1, "agent": "motion", "on": True}, "which agent"),
        ({"do": "release", "target": "1", "agent": "motion"}, "has not begun"),
    ],
)
def test_what_makes_no_sense_is_refused(what, reason):
    with pytest.raises(Refused, match=reason):
        Controls().ask(what)


def test_a_repeated_run_takes_no_switches():
    controls = Controls()
    controls.can_switch = False
    controls.to("running")
    with pytest.raises(Refused, match="repeats an earlier one"):
        controls.ask({"do": "switch", "target": "1", "agent": "motion", "on": True})


def test_waiting_ends_when_it_is_given_up():
    controls = Controls()
    controls.ask({"do": "pause"})
    assert controls.hold(lambda: True) is False
    assert controls.choose(lambda starts: None, lambda: True) is None
