"""Detections given to targets before they are weighed: exact, exclusive, by looks, with bad detectors."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.outcome import Outcome, State
from bayesnet_track.engine.step import first_look, make_engine, step
from bayesnet_track.graph.checks.run import check, check_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.events.lives import BirthsRefused, TargetDied, TargetStarted
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.observation.detector import NOTHING, Detections
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.detection_files import FileDetector, file_detector

WIDTH, HEIGHT = 320, 240
GRAY = np.zeros((HEIGHT, WIDTH, 3), np.uint8)


def play(graph, detector, frames, picture=lambda n: GRAY, seed=0):
    engine = make_engine(graph, seed, detectors={"detections": detector})
    seen = [Frame(n, float(n), picture(n), True, float(n)) for n in range(frames)]
    outcomes = [first_look(engine, Outcome(State(), Lines(), ()), seen[0])]
    for frame in seen[1:]:
        outcomes.append(step(engine, outcomes[-1].state, frame))
    return outcomes


def plain(**birth):
    """The plain tracker, with other settings of its births."""
    spec = load_graph("kalman_detections").spec
    kind = spec.targets["target"]
    changed = kind.model_copy(update={"birth": kind.birth.model_copy(update=birth)})
    return check(spec.model_copy(update={"targets": {"target": changed}}))


def found(*boxes, score=0.9):
    if not boxes:
        return NOTHING
    return Detections(np.array(boxes, dtype=float), np.full(len(boxes), score), ("",) * len(boxes))


# ------------------------------------------------------------------------------------ exact


def kalman(start, measured):
    """A constant-velocity filter by the book: start in the box `start`, then a box or None in each frame."""
    move = np.eye(6)
    move[0, 4] = move[1, 5] = 1.0
    noise = np.diag([0.0, 0, 64, 16, 0, 0])
    for position, velocity in ((0, 4), (1, 5)):
        noise[np.ix_([position, velocity], [position, velocity])] += 0.49 * np.array(
            [[1 / 3, 1 / 2], [1 / 2, 1]]
        )
    observe = np.eye(4, 6)
    mean, covariance = np.concatenate([start, np.zeros(2)]), np.diag([0.0, 0, 0, 0, 25, 25])
    states = []
    for z in measured:
        mean, covariance = move @ mean, move @ covariance @ move.T + noise
        if z is not None:
            error = np.diag((0.06 * np.array([z[2], z[3], z[2], z[3]])) ** 2)
            gain = covariance @ observe.T @ np.linalg.inv(observe @ covariance @ observe.T + error)
            mean = mean + gain @ (z - observe @ mean)
            covariance = (np.eye(6) - gain @ observe) @ covariance
        states.append((mean, covariance))
    return states


def test_the_graph_is_a_kalman_filter_for_each_target(tmp_path):
    """Two targets, misses and clutter: every mean and covariance as by hand, with the same assignments."""
    rng = np.random.default_rng(4)
    paths = [np.array([60.0, 70, 40, 80]), np.array([250.0, 160, 50, 90])]
    speeds = [np.array([4.0, 1, 0, 0]), np.array([-4.0, -1, 0, 0])]
    frames, missed = 24, {(0, 9), (0, 10), (1, 15)}
    boxes = [[], []]
    lines = []
    for n in range(frames):
        for k in (0, 1):
            box = paths[k] + n * speeds[k] + rng.normal(scale=1.5, size=4)
            corner = np.round(np.concatenate([box[:2] - (box[2:] - 1) / 2, box[2:]]), 3)
            centre = np.concatenate([corner[:2] + (corner[2:] - 1) / 2, corner[2:]])
            boxes[k].append(None if (k, n) in missed else centre)
            if (k, n) not in missed:
                lines.append(f"{n + 1},-1,{','.join(map(str, corner))},0.9")
        if n % 5 == 4:
            lines.append(f"{n + 1},-1,{20 + 9 * n},5,20,20,0.5")
    path = tmp_path / "found.txt"
    path.write_text("\n".join(lines) + "\n")
    outcomes = play(load_graph("kalman_detections"), file_detector(path), frames)
    born = [event for outcome in outcomes for event in outcome.events if isinstance(event, TargetStarted)]
    assert [(event.target, event.frame) for event in born] == [("1", 2), ("2", 2)]
    whose = {"1": 0, "2": 1} if born[0].box[0] < 150 else {"1": 1, "2": 0}
    for target, k in whose.items():
        states = kalman(boxes[k][2], boxes[k][3:])
        for outcome, (mean, covariance) in zip(outcomes[3:], states, strict=True):
            belief = outcome.state.targets[target].belief
            np.testing.assert_allclose(belief.mean, mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(belief.covariance, covariance, rtol=1e-9, atol=1e-9)
            (line,) = [one for one in outcome.metrics if one.target == target]
            np.testing.assert_allclose(line.centre_box, mean[:4], rtol=1e-9)
            assert line.silent == (("seen",) if (k, line.frame) in missed else ())


# ------------------------------------------------------------------------------------ whose it is


def test_one_detection_is_nobodys_twice():
    """Two targets side by side, then one detection between them: one of them hears it, the other predicts."""
    both = found([100, 100, 30, 60], [120, 100, 30, 60])
    one = found([110, 100, 30, 60])
    says = {n: both for n in range(6)} | {6: one}
    outcomes = play(load_graph("kalman_detections"), FileDetector(says), 7)
    assert len(outcomes[5].metrics) == 2
    assert sorted(len(line.silent) for line in outcomes[6].metrics) == [0, 1]


def dancers(n):
    """Centres x of two that walk up to each other and turn round at frame 12."""
    away = 2.0 * abs(n - 12) + 2.0
    return 160.0 - away, 160.0 + away


def red_and_blue(n):
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for x, colour in zip(dancers(n), ((30, 30, 220), (220, 60, 30)), strict=True):
        image[90:150, round(x) - 14 : round(x) + 15] = colour
    return image


@pytest.mark.parametrize(("name", "kept"), [("kalman_detections", False), ("people_detections", True)])
def test_looks_keep_identities_that_place_alone_swaps(name, kept):
    """They turn, unseen, where they should pass each other: the plain tracker takes one for the other."""
    says = {n: found(*([x, 119.5, 29, 60] for x in dancers(n))) for n in range(25) if abs(n - 12) > 3}
    outcomes = play(load_graph(name), FileDetector(says), 25, red_and_blue)
    first = {line.target: line.centre_box[0] < 160 for line in outcomes[4].metrics}
    last = {line.target: line.centre_box[0] < 160 for line in outcomes[-1].metrics}
    assert len(first) == len(last) == 2
    assert (first == last) == kept


def test_a_lost_target_is_given_its_detection_again():
    """Unseen for six frames, which is lost; where it is expected it goes on with its number, tracking."""
    says = {n: found([60 + 4 * n, 100, 30, 60]) for n in range(24) if not 9 <= n <= 14}
    outcomes = play(load_graph("kalman_detections"), FileDetector(says), 24)
    status = [line.status for outcome in outcomes[2:] for line in outcome.metrics]
    assert {line.target for outcome in outcomes for line in outcome.metrics} == {"1"}
    assert "lost" in status and status[-1] == "tracking"
    assert outcomes[-1].metrics[0].centre_box[0] == pytest.approx(60 + 4 * 23, abs=1.0)


def test_between_looks_every_target_predicts():
    says = {n: found([60 + 4 * n, 100, 30, 60]) for n in range(13)}
    outcomes = play(plain(every=3), FileDetector(says), 13)
    heard = [
        line.frame for outcome in outcomes for line in outcome.metrics if line.frame > 6 and not line.silent
    ]
    assert heard == [9, 12]


@pytest.mark.parametrize("every", [2, 4, 5])
@pytest.mark.parametrize("name", ["kalman_detections", "jpda", "people_detections", "bytetrack"])
def test_a_frame_in_which_nobody_looks_is_no_miss(name, every):
    """A walker that every look finds is never lost between looks, is no other one, and keeps its place."""
    written = load_graph(name).spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    plate["birth"]["every"] = every
    plate["death"] = {"unseen_frames": 3} if name != "jpda" else {}
    says = {n: found([60 + 2 * n, 100, 30, 60]) for n in range(61)}
    outcomes = play(load_graph(written), FileDetector(says), 61)
    lines = [line for outcome in outcomes for line in outcome.metrics]
    assert {line.target for line in lines} == {"1"} and lines[-1].frame == 60
    assert {line.status for line in lines} == {"tracking"}
    assert all(abs(line.centre_box[0] - 60 - 2 * line.frame) < 5 for line in lines[-30:])


def test_misses_of_looks_count_where_not_every_frame_is_looked_at():
    """Gone after three looks without a detection, and ended after as many as `unseen_frames` says."""
    written = load_graph("kalman_detections").spec.model_dump(exclude_unset=True)
    plate = written["targets"]["target"]
    plate["birth"]["every"], plate["death"] = 4, {"unseen_frames": 5}
    says = {n: found([60 + 2 * n, 100, 30, 60]) for n in range(30)}
    outcomes = play(load_graph(written), FileDetector(says), 61)
    changes = [event for out in outcomes for event in out.events if isinstance(event, StatusChanged)]
    died = [event for out in outcomes for event in out.events if isinstance(event, TargetDied)]
    assert [(one.frame, one.status) for one in changes] == [(40, "lost")]
    assert [(one.frame, one.unseen_frames or one.frames) for one in died] == [(48, 5)]


# ------------------------------------------------------------------------------------ detectors that go wrong


def test_a_thousand_boxes_a_frame_fill_the_plate_and_no_more():
    rng = np.random.default_rng(0)
    says = {
        n: found(
            *np.column_stack([rng.uniform([0, 0], [WIDTH, HEIGHT], (1000, 2)), np.full((1000, 2), 24.0)])
        )
        for n in range(8)
    }
    outcomes = play(plain(max_targets=6), FileDetector(says), 8)
    assert max(len(outcome.metrics) for outcome in outcomes) == 6
    assert all(len(one) <= 12 for outcome in outcomes for one in outcome.state.history.candidates.values())
    refusals = [
        event.refused for outcome in outcomes for event in outcome.events if isinstance(event, BirthsRefused)
    ]
    assert refusals and len(refusals) <= 3  # at the 1st, 10th, 100th


def test_no_detection_no_target_no_event():
    outcomes = play(load_graph("kalman_detections"), FileDetector({}), 5)
    assert not any(outcome.metrics or outcome.events for outcome in outcomes)


def test_the_same_object_twice_is_one_target():
    says = {n: found([60 + 4 * n, 100, 30, 60], [61 + 4 * n, 101, 31, 58]) for n in range(30)}
    outcomes = play(load_graph("kalman_detections"), FileDetector(says), 30)
    assert max(len(outcome.metrics) for outcome in outcomes) == 1


def test_an_agent_that_measures_by_detections_needs_births():
    nodes = {
        "s": {"motion": {"random_walk": {"sd_px": {"x": 9}}}},
        "a": {"parent": "s", "agent": "detection"},
    }
    with pytest.raises(GraphError, match="detection without birth, whose detector would give it detections"):
        check_graph({"name": "g", "targets": {"t": {"nodes": nodes}}})
