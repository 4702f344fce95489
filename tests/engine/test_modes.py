"""A target behind a pillar: probably hidden, so lost and not learnt, and written down with its numbers."""

from __future__ import annotations

import re
from itertools import pairwise
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, Tracker, load_graph, track
from bayesnet_track.belief.motion.modes import make_modes
from bayesnet_track.engine.modes import ModeState, with_modes
from bayesnet_track.graph import spec
from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.beliefs import ModeChanged
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.text.sentences import why
from bayesnet_track.sources.scenes import make_scene

FRAMES = 40
BEHIND = slice(21, 29)
"""Frames in which at most a tenth of the ball can be seen."""


@pytest.fixture(scope="module")
def scene():
    return make_scene("flying_ball", 3)


@pytest.fixture(scope="module", params=["gaussian", "particles"])
def followed(request, scene):
    """The lines and events of a graph on the scene."""
    belief = {"gaussian": {"filter": "kalman", "samples": 20}, "particles": {"size": 400}}[request.param]
    nodes = {
        "ball": {
            "belief": {request.param: belief},
            "motion": {"constant_velocity": {"sd_velocity_px": 1, "start_velocity_sd_px": 6}},
            "modes": {"seen": {"mean_frames": 60}, "behind": {"mean_frames": 15, "hidden": {}}},
            "estimate": "mean",
            "ud_fields": ["x", "y"],
            "learn": {"below": {"ud_px2": 1000}, "rate_max": 0.1},
            "lost": {"above": {"ud_px2": 2000}},
        },
        "place": {"parent": "ball", "agent": {"mean_shift": {"seen_above": 0.7}}},
    }
    tracker = Tracker(load_graph({"bayesnet": 1, "name": "g", "targets": {"ball": {"nodes": nodes}}}))
    images = iter(scene.frames)
    tracker.init(next(images), scene.start_box)
    lines, events = [tracker.targets[0]], []
    for _ in range(FRAMES - 1):
        tracker.update(next(images))
        lines.append(tracker.targets[0])
        events += tracker.events
    return lines, events


@pytest.mark.slow
def test_the_target_is_probably_hidden_while_the_pillar_hides_it(followed, scene):
    lines, _ = followed
    hidden = np.array([line.hidden for line in lines])
    assert (scene.visible[BEHIND] < 0.1).all()
    assert (hidden[BEHIND] > 0.9).all()
    assert (hidden[:18] < 0.05).all() and (hidden[36:] < 0.05).all()
    for line in lines:
        assert sum(line.modes.values()) == pytest.approx(1.0)
        assert line.modes["behind"] == pytest.approx(line.hidden)


def test_it_is_lost_and_nothing_is_learnt_while_it_is_probably_hidden(followed):
    lines, _ = followed
    for before, line in pairwise(lines[1:]):
        if before.hidden > 0.5:
            assert line.status == ("hidden" if line.hidden > 0.5 else "lost") and line.is_gone
        if line.hidden > 0.5:
            assert line.learn_rate == 0.0 and line.score < 0.5
    assert lines[10].status == "tracking" and lines[-1].status == "tracking"
    assert any(line.learn_rate > 0 for line in lines[1:18])


def test_the_tracker_says_hidden_and_that_the_box_does_not_show_it(scene):
    tracker, images = Tracker(load_graph("hidden_ball"), seed=1), iter(scene.frames)
    tracker.init(next(images), scene.start_box)
    said = {}
    for _ in range(FRAMES - 1):
        ok, _ = tracker.update(next(images))
        said.setdefault(tracker.status, set()).add(ok)
    assert said["hidden"] == {False} and said["tracking"] == {True}


def test_a_frame_is_accounted_for_by_prior_evidence_and_posterior(followed):
    lines, events = followed
    there = next(event for event in events if isinstance(event, ModeChanged))
    line = lines[there.frame]
    text = next(row for row in why(events, lines, there.frame).splitlines() if row.startswith("  modes"))
    found = re.findall(r"(\w+) predicted (\S+), evidence (\S+) nats, now (\S+?)(?:;|$)", text)
    assert [mode for mode, *_ in found] == ["seen", "behind"]
    for mode, predicted, _, now in found:
        assert float(predicted) == pytest.approx(line.modes_predicted[mode], rel=0.01)
        assert float(now) == pytest.approx(line.modes[mode], rel=0.01)
    prior = np.array([float(one[1]) for one in found]) * np.exp([float(one[2]) for one in found])
    assert prior / prior.sum() == pytest.approx([line.modes[one[0]] for one in found], abs=0.01)


def test_it_is_told_why(followed):
    lines, events = followed
    there, back = [event for event in events if isinstance(event, ModeChanged)]
    assert (there.before, there.mode, back.mode) == ("seen", "behind", "seen")
    assert there.probability == pytest.approx(lines[there.frame].hidden, abs=1e-6)
    assert there.nats > there.turning
    lost = next(event for event in events if isinstance(event, StatusChanged))
    assert "→ target 1 hidden; would have stayed at lost_above" in lost.describe()
    assert lost.frame == there.frame and lost.hidden.hidden == pytest.approx(there.hidden)


def test_lines_survive_and_say_hidden(followed):
    lines, _ = followed
    line = lines[25]
    again = from_json(to_json(line))
    assert again.modes == pytest.approx(line.modes) and again.hidden == pytest.approx(line.hidden)
    assert line.mode == "behind"
    assert repr(line).startswith("<target 1 in frame 25: hidden, probability 0.99, score")


def test_the_box_goes_on_as_predicted(followed, scene):
    lines, _ = followed
    truth = scene.truth[25, :2] + scene.truth[25, 2:] / 2
    assert abs(lines[25].cxcywh[0] - truth[0]) < 15.0


def test_a_graph_without_modes_writes_none(scene):
    tracker = Tracker("kalman_ball")
    tracker.init(next(iter(scene.frames)), scene.start_box)
    (line,) = tracker.targets
    assert line.hidden is None and line.mode == ""
    assert '"modes"' not in to_json(line) and '"hidden"' not in to_json(line)
    assert with_modes(line, None) is line


def test_probabilities_are_never_zero():
    """A probability of exactly 0 is not written, and would be read as None: as of a graph without modes."""
    modes = make_modes({"seen": spec.Mode(mean_frames=9), "behind": spec.Mode(mean_frames=9, hidden={})})
    certain = SimpleNamespace(mode_probabilities=np.array([1.0, 0.0]))
    state = ModeState.of(modes, certain, certain, 1.0)
    assert 0.0 < state.hidden < 1e-9
    assert state.changes(3, "1") == ()


@pytest.mark.slow
def test_a_part_tells_of_being_hidden_what_its_whole_would(tmp_path):
    """A part off by sd 1.5 and seen with sd 2, as its whole seen with sd 2.5, and as Bayes' rule."""
    rng = np.random.default_rng(3)
    places = np.array([100.0, 90.0]) + np.arange(26)[:, None] * [2.0, 0.0] + rng.normal(0, 2, (26, 2))
    places[15:] = rng.uniform((200, 150), (300, 230), (11, 2))
    (tmp_path / "images").mkdir()
    for k in range(20):
        cv2.imwrite(str(tmp_path / "images" / f"{k:03}.png"), np.zeros((240, 320, 3), np.uint8))

    def hidden(of_part):
        rows = [f"{k},{x:.3f},{y - 10 * of_part:.3f}" for k, (x, y) in enumerate(places[:20]) if k > 0]
        file = tmp_path / f"{of_part}.csv"
        file.write_text("\n".join(["frame,x,y", *rows]), encoding="utf-8")
        sd = 2.0 if of_part else 2.5
        nodes = {
            "ball": {
                "belief": {"particles": {"size": 3000}},
                "motion": {"constant_velocity": {"sd_velocity_px": 0.5, "start_velocity_sd_px": 3}},
                "fuse": "product",
                "modes": {
                    "seen": {"mean_frames": 30},
                    "behind": {"mean_frames": 10, "hidden": {"mistaken": 0.9, "missed": 0.1}},
                },
            },
            "top": {
                "parent": "ball",
                "fuse": {"latent": {"given": {"offset_box": {"y": -0.5}, "sd_px": {"x": 1.5, "y": 1.5}}}},
            },
            "radio": {
                "parent": "top" if of_part else "ball",
                "agent": {"readings": {"file": str(file), "sd": {"x": sd, "y": sd}}},
            },
        }
        kept = nodes if of_part else {name: node for name, node in nodes.items() if name != "top"}
        graph = load_graph({"bayesnet": 1, "name": "g", "targets": {"ball": {"nodes": kept}}})
        results = track(graph, str(tmp_path / "images"), [Start((90, 80, 20, 20))], seed=1)
        return np.array([result.targets[0].hidden for result in results])

    whole, part = hidden(False), hidden(True)
    assert part[15:] == pytest.approx(whole[15:], abs=0.02)
    before = whole[14] * 9 / 10 + (1 - whole[14]) / 30
    assert part[15] == pytest.approx(before / (before + (1 - before) * 0.1), abs=0.02)
    assert part[19] > 0.9
