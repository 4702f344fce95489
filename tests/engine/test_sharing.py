"""The field's trackers as graphs: tentative tracks, passes by score and the re-update, worked by hand."""

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.adapt.association import GAP, UNASSIGNED, PartColumns, first_observed
from bayesnet_track.engine.lifecycle.assigning import TENTATIVE, name_owners
from bayesnet_track.engine.lifecycle.sharing import (
    Predict,
    TrackArrays,
    follow_owners,
    own_detections,
    re_update,
    start_tentative,
    update_tentative,
)
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import make_engine, step
from bayesnet_track.graph.spec import Confirm
from bayesnet_track.journal.events.lives import CandidateConfirmed, TargetDied
from bayesnet_track.observation.cue import OWN_DETECTION, AssociationRule
from bayesnet_track.observation.detector import NOTHING, Detections
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.detection_files import FileDetector, parse_detections

IMAGE = np.zeros((480, 640, 3), np.uint8)
RULE = AssociationRule(0, 0, 1.0, 0.3, 0.0, sd_place_px=1.0, sd_size_px=2.0, similarity="iou", re_update=True)
MOVE = np.eye(8) + np.eye(8, k=4)
NOISE = np.diag([0.1, 0.1, 0.4, 0.4, 0.1, 0.1, 0.4, 0.4])
R = np.diag([1.0, 1, 4, 4])


def over(means, covariances, dt):
    move = np.eye(8) + dt * np.eye(8, k=4)
    return means @ move.T, move @ covariances @ move.T + dt * NOISE


predict = Predict(1.0, over)


def book_update(mean, covariance, z):
    """A Kalman update by the book."""
    spread = covariance[:4, :4] + R
    gain = np.linalg.solve(spread, covariance[:4]).T
    return mean + gain @ (z - mean[:4]), covariance - gain @ spread @ gain.T


def test_a_gap_is_filtered_anew_along_the_line_between_two_detections():
    mean = np.array([100.0, 50, 20, 40, 1, 0, 0, 0])
    covariance = np.diag([1.0, 1, 4, 4, 2, 2, 1, 1])
    last, new = np.array([100.0, 50, 20, 40]), np.array([103.0, 56.0, 23.0, 40.0])
    row, layout = first_observed(RULE, last[None], 8)[0], PartColumns.of(RULE, 8)
    row[GAP], row[layout.mean], row[layout.covariance] = 2.0, mean, covariance.ravel()
    found = re_update(RULE, row, new, 8, predict)
    for virtual in (last + (new - last) / 3, last + 2 * (new - last) / 3):  # the two frames that were missed
        mean, covariance = MOVE @ mean, MOVE @ covariance @ MOVE.T + NOISE
        mean, covariance = book_update(mean, covariance, virtual)
    np.testing.assert_allclose(found[0], mean, rtol=1e-12)
    np.testing.assert_allclose(found[1], covariance, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("gap", "elapsed"), [(2.0, 1.0), (2.4, 6.6), (1.5, 0.5), (0.4, 0.1)])
def test_a_gap_is_filtered_anew_over_its_time(gap, elapsed):
    """A target that moves as its motion says stays where it is, whenever frames come, as does its speed."""
    mean, layout = np.array([100.0, 50, 20, 40, 2, 1, 0, 0]), PartColumns.of(RULE, 8)
    row = first_observed(RULE, mean[None, :4], 8)[0]
    row[GAP], row[layout.mean], row[layout.covariance] = gap, mean, np.eye(8).ravel()
    new, _ = over(mean[None], np.eye(8)[None], gap + elapsed)
    found, _ = re_update(RULE, row, new[0, :4], 8, Predict(elapsed, over))
    np.testing.assert_allclose(found, over(mean[None], np.eye(8)[None], gap)[0][0], atol=1e-12)


def test_only_tracks_seen_again_are_filtered_anew():
    layout = PartColumns.of(RULE, 8)
    observed = first_observed(RULE, np.tile([100.0, 50, 20, 40], (3, 1)), 8)
    observed[1:, GAP] = 3.0
    observed[1:, layout.mean] = [100.0, 50, 20, 40, 0, 0, 0, 0]
    observed[1:, layout.covariance] = np.eye(8).ravel()
    before = TrackArrays(
        np.tile([140.0, 50, 20, 40, 9, 0, 0, 0], (3, 1)), np.tile(np.eye(8), (3, 1, 1)), observed
    )
    expected = TrackArrays(*predict(before.mean, before.covariance), observed)
    owner = np.array([0, 1, UNASSIGNED])
    seen = np.tile([100.0, 50, 20, 40], (2, 1))
    after, changed = follow_owners(
        RULE, before, expected, owner, own_detections(owner, seen, np.ones(2)), predict
    )
    assert list(changed) == [1]
    assert after.mean[:, 0].round(6).tolist() == [149.0, 100.0, 149.0]
    assert after.observed[:, GAP].tolist() == [0.0, 0.0, 4.0]


def test_a_tentative_track_is_filtered_and_given_up():
    moments = np.array([100.0, 50, 20, 40, 0, 0, 0, 0]), 10 * np.eye(8)
    one = start_tentative(RULE, moments[0][:4], 0.8, (5, "birth"), moments)
    own = np.array([[102.0, 50, 20, 40, 0.6]])
    expected = predict(one.mean[None], one.covariance[None])
    after = TrackArrays(*expected, one.observed[None])
    variances = np.array([[1.0, 1, 4, 4]])
    (seen,) = update_tentative([one], after, own, variances, Confirm(hits=3, of=3))
    mean, covariance = book_update(expected[0][0], expected[1][0], own[0, :4])
    np.testing.assert_allclose(seen.mean, mean, rtol=1e-12)
    np.testing.assert_allclose(seen.covariance, covariance, rtol=1e-9, atol=1e-12)
    assert (seen.looks, seen.first_frame, seen.box.tolist()) == ((0.8, 0.6), 5, own[0, :4].tolist())
    assert update_tentative([one], after, np.zeros((1, 5)), variances, Confirm(hits=3, of=3)) == ()
    (unseen,) = update_tentative([one], after, np.zeros((1, 5)), variances, None)  # nobody looked
    assert unseen.looks == (0.8,)


def test_detections_are_named_by_their_owners_tentative_tracks_come_last():
    owner = np.array([2, UNASSIGNED, 0])
    assert name_owners(owner, ["7", "9"], 4) == (TENTATIVE, None, "7", None)


# ------------------------------------------------------------------------------------ whole graphs


def play(graph, found, frames):
    engine = make_engine(load_graph(graph), 0, detectors={"detections": FileDetector(found)})
    done = []
    for index in range(frames):
        frame = Frame(index=index, time=float(index), time_s=index / 25, image=IMAGE)
        done.append(
            step(engine, done[-1].state, frame)
            if done
            else start_targets(load_graph(graph), engine, frame, ())
        )
    return done


def detections(*lines):
    """Detections (x, score) of people 20 x 40 px, the best first."""
    lines = sorted(lines, key=lambda one: -one[1])
    boxes = np.array([[x, 100.0, 20.0, 40.0] for x, _ in lines]).reshape(-1, 4)
    return Detections(boxes, np.array([score for _, score in lines]), ("",) * len(lines))


def events(done, kind):
    return [(one.frame, one.target) for outcome in done for one in outcome.events if isinstance(one, kind)]


@pytest.mark.parametrize(("graph", "hits"), [("sort", 3), ("bytetrack", 2), ("oc_sort", 4)])
def test_a_target_starts_after_detections_in_a_row(graph, hits):
    # One is missed once before it is confirmed, and starts anew.
    found = {k: detections((100.0 + 2 * k, 0.9), *([] if k == 1 else [(300.0, 0.9)])) for k in range(9)}
    done = play(graph, found, 9)
    assert events(done, CandidateConfirmed) == [(hits - 1, "1"), (hits + 1, "2")]
    assert not done[0].metrics


@pytest.mark.parametrize(("graph", "least"), [("sort", 0.25), ("bytetrack", 0.7), ("oc_sort", 0.6)])
def test_births_need_a_score(graph, least):
    for score, born in ((least, 1), (least - 0.01, 0)):
        done = play(graph, {k: detections((100.0, score)) for k in range(6)}, 6)
        assert len(events(done, CandidateConfirmed)) == born


def own(outcome, target="1"):
    return outcome.state.targets[target].references["seen"][OWN_DETECTION]


def test_low_scores_keep_a_target_of_bytetrack_and_start_none():
    found = {k: detections((100.0, 0.9)) for k in range(3)} | {3: detections((101.0, 0.3), (300.0, 0.3))}
    last = play("bytetrack", found, 4)[-1]
    assert own(last)[0, [0, 4]].tolist() == [101.0, 0.3]
    assert list(last.state.targets) == ["1"]
    found[3] = detections((103.0, 0.7), (100.0, 0.5))  # the better one comes first, though it fits less
    assert own(play("bytetrack", found, 4)[-1])[0, 0] == 103.0
    assert own(play("sort", found, 4)[-1])[0, 0] == 100.0


@pytest.mark.parametrize("graph", ["sort", "bytetrack", "oc_sort"])
def test_a_target_ends_after_31_frames_without_a_detection(graph):
    # Frames without a line in the file are empty; the target starts no later than in frame 4.
    found = {k: detections((100.0, 0.9)) for k in range(5)}
    done = play(graph, found, 37)
    assert events(done, TargetDied) == [(35, "1")]
    assert not done[-1].metrics


def test_oc_sort_turns_with_what_it_sees_after_a_gap():
    # A target that went right by 2 px a frame is 10 px to the left after four: found by its last detection.
    found = {k: detections((100.0 + 2 * k, 0.9)) for k in range(8)}
    found |= {k: NOTHING for k in range(8, 11)}
    found |= {11: detections((104.0, 0.9))}
    (target,) = play("oc_sort", found, 12)[-1].state.targets.values()
    assert target.belief.mean[4] < 0.5
    assert target.references["seen"][OWN_DETECTION][0, 0] == 104.0


def test_lines_out_of_order_and_without_confidence_are_the_same_tracks():
    lines = [f"{k + 1},-1,{100 + 2 * k},100,20,40" for k in range(6)]
    sorted_file = parse_detections("\n".join(lines))
    shuffled = parse_detections("\n".join(lines[::-1]))
    for graph in ("sort", "bytetrack", "oc_sort"):
        one, other = play(graph, sorted_file, 6), play(graph, shuffled, 6)
        assert events(one, CandidateConfirmed) == events(other, CandidateConfirmed) != []
        # Without a confidence every detection counts as sure: score 1, so nothing is left to a second pass.
        assert own(one[-1])[0, 4] == 1.0
