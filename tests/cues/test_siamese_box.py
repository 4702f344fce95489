"""The box of a Siamese network: which proposal is chosen, how sure it is said to be, and the graph `deep`."""

import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.engine.second_steps import APART_BOX, CORNERS
from bayesnet_track.graphs import find_graph
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.journal.events.switches import Scheduled
from bayesnet_track.journal.net import Switch
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.vision.siamese_crops import WIDE, Memory
from bayesnet_track.vision.siamese_networks import STRIDE, Networks, Response

SIDE = 40.0
BOX = np.array([159.5, 119.5, SIDE, SIDE])
NOISE = np.random.default_rng(8).integers(0, 256, (240, 320, 3), np.uint8)


def network(probable, size=1.0, shown=None):
    """A network that proposes boxes: `probable` has how many cells right of the middle, and how probable."""

    def compare(template, crop, expected):
        cells = (len(crop) + 1) // STRIDE
        if shown is not None:
            shown.append(len(crop))
        probabilities = np.full((cells, cells), 1e-6, np.float32)
        for right, probability in probable:
            if right < cells // 2:
                probabilities[cells // 2, cells // 2 + right] = probability
        sides = np.empty((4, cells, cells), np.float32)
        sides[:] = np.tile(size * expected / 2, 2)[:, None, None]
        return Response(probabilities, sides, STRIDE)

    return Memory(Networks(lambda crop: np.zeros(0, np.float32), compare))


@pytest.fixture
def measured(ask):
    """(what the network proposes, size, parameters) -> the measurement around BOX."""

    def measure(probable, size=1.0, shown=None, boxes=BOX[None], weights=None, **parameters):
        asked = ask("siamese_box", **parameters)
        object.__setattr__(asked.cue, "memory", network(probable, size, shown))
        pair = FramePair(Frame(1, 1.0, NOISE), None)
        return asked.measure(pair, boxes, asked.learn(pair, BOX), weights=weights)

    return measure


def test_it_measures_the_most_probable_box(measured):
    found = measured([(0, 0.2), (1, 0.99)])
    assert found.fields == ("x", "y", "w", "h")
    cell = STRIDE * 80.0 / 127.0  # the template shows a square of twice the side
    np.testing.assert_allclose(found.mean, BOX + [cell, 0, 0, 0], atol=1.0)
    assert found.confidence == pytest.approx(0.99)


def test_a_near_box_is_preferred_to_a_slightly_more_probable_one_far_away(measured):
    assert measured([(0, 0.9), (6, 0.99)]).mean[0] < 165
    assert measured([(0, 0.9), (6, 0.99)], window=0.0).mean[0] > 190


def test_the_less_probable_the_less_sure(measured):
    sure, unsure = (measured([(0, p)]).covariance[0, 0] for p in (0.99, 0.7))
    assert unsure > 1.5 * sure
    grown = measured([(0, 0.99)], size=2.0).covariance[0, 0]
    assert grown > 4.0 * sure  # twice the side, and a penalty for the change


@pytest.mark.parametrize(
    ("probable", "looks"),
    [([(1, 0.995)], [159]), ([(1, 0.9)], [159, 255]), ([], [159, 255]), ([(6, 0.995)], [159, 255])],
)
def test_a_smaller_crop_is_enough_where_it_shows_something_sure(measured, probable, looks):
    shown = []
    found = measured(probable, shown=shown, crop_px=159, sure_probability=0.95)
    usual = measured(probable)
    assert shown == looks
    if probable:
        np.testing.assert_allclose(found.mean, usual.mean, atol=1.0)  # whole pixels are cut out
    else:
        assert found is None


def test_where_nothing_near_is_sure_the_prediction_counts_less(measured):
    """Near the prediction something resembles the target, and farther away it is."""
    assert measured([(0, 0.8), (5, 0.99)]).mean[0] < 165
    assert measured([(0, 0.8), (5, 0.99)], sure_probability=0.95).mean[0] > 190
    assert measured([(0, 0.96), (5, 0.99)], sure_probability=0.95).mean[0] < 165
    assert measured([(0, 0.8), (5, 0.94)], sure_probability=0.95).mean[0] < 165  # neither is sure


@pytest.mark.parametrize(
    ("probable", "looks", "right"),
    [
        ([(6, 0.99), (0, 0.97)], [255, 159], 6),
        ([(6, 0.6), (0, 0.5)], [255, 159], 6),
        ([(6, 0.4)], [255], None),
        ([(6, 0.99)], [255, 159], None),
    ],
    ids=["sure", "coarsely less", "hardly", "not from near"],
)
def test_where_the_hypotheses_are_far_apart_a_wide_crop_shows_where_to_look(measured, probable, looks, right):
    shown = []
    corners = BOX + SIDE * np.array([[-2, -2, 0, 0], [2, 2, 0, 0]])
    found = measured(probable, shown=shown, boxes=corners, crop_px=159)
    assert shown == looks
    if right is None:
        assert found is None
    else:
        cell = STRIDE * 80.0 / 127.0  # the template shows a square of twice the side
        np.testing.assert_allclose(found.mean, BOX + [WIDE * right * cell, 0, 0, 0], atol=1.0)
        assert found.confidence == pytest.approx(probable[1][1])


def test_what_a_wide_crop_led_to_counts_only_if_it_is_sure(measured):
    corners = BOX + SIDE * np.array([[-2, -2, 0, 0], [2, 2, 0, 0]])
    for near, counts in ((0.94, False), (0.96, True)):
        found = measured([(6, 0.99), (0, near)], boxes=corners, crop_px=159, sure_probability=0.95)
        assert (found is not None) == counts


@pytest.mark.parametrize("aspect", [0.125, 0.25, 1.0, 4.0, 8.0])
def test_a_target_is_looked_for_elsewhere_in_a_wide_crop(measured, aspect):
    """As the engine asks, with hypotheses in the corners of a place."""
    w, h = SIDE * np.array([aspect, 1.0 / aspect]) ** 0.5
    corners = np.array([*BOX[:2], w, h]) + np.pad(0.5 * APART_BOX * SIDE * CORNERS, ((0, 0), (0, 2)))
    shown = []
    measured([(0, 0.99)], shown=shown, boxes=corners, crop_px=159, sure_probability=0.95)
    assert shown == [255, 159]


@pytest.mark.parametrize(
    ("apart", "weights", "looks"),
    [
        (120.0, [0.5, 0.5], [159]),
        (122.0, [0.5, 0.5], [255, 159]),  # the usual crop's side is 255 / 127 of 80 px, the box's 40 px
        (300.0, [0.99, 0.01], [159]),
    ],
    ids=["held", "not held", "one far away that hardly counts"],
)
def test_hypotheses_that_the_usual_crop_holds_are_near(measured, apart, weights, looks):
    shown, boxes = [], BOX + np.array([[0, 0, 0, 0], [0, apart, 0, 0]])
    given = {"boxes": boxes, "weights": np.array(weights)}
    measured([(0, 0.99)], shown=shown, **given, crop_px=159, sure_probability=0.95)
    assert shown == looks


def test_nothing_probable_is_not_seen(measured):
    assert measured([]) is None
    assert measured([(0, 0.05)]) is None
    assert measured([(0, 0.05)], min_probability=0.01) is not None


@pytest.fixture
def tracker(tmp_path, scene):
    """`deep` in the first frame of the scene, with plain pixels, which are less sure than a network."""
    graph = tmp_path / "deep.yaml"
    text = find_graph("deep").read_text("utf-8").replace("without_files: refuse", "without_files: plain")
    graph.write_text(text.replace("sure_probability: 0.95", "sure_probability: 0.6"), encoding="utf-8")
    tracker = Tracker(graph, seed=0)
    x, y, w, h = scene.box()
    tracker.init(scene.image(scene.start), (x - w / 2 + 0.5, y - h / 2 + 0.5, w, h))
    return tracker


def test_deep_follows_a_target_by_plain_pixels_in_the_networks_place(tracker, scene):
    for k in range(1, 16):
        _, found = tracker.update(scene.image(scene.start + np.array([2, 1]) * k))
    centre = np.array(found[:2]) + np.array(found[2:]) / 2 - 0.5
    assert np.abs(centre - scene.start - np.array([30, 15])).max() < 5.0


def test_in_deep_a_copy_carries_the_box_between_the_runs_of_the_network(tracker, scene):
    runs, events = [], []
    for k in range(1, 31):
        _, found = tracker.update(scene.image(scene.start + np.array([2, 1]) * k))
        runs += [k] if "network" in tracker.metrics.kl else []
        events += tracker.events
    centre = np.array(found[:2]) + np.array(found[2:]) / 2 - 0.5
    assert np.abs(centre - scene.start - np.array([60, 30])).max() < 5.0
    assert 5 <= len(runs) <= 12 and runs[0] == 1
    scheduled = [event for event in events if isinstance(event, Scheduled)]
    assert {event.frame for event in scheduled} <= set(runs)
    assert not [event for event in events if isinstance(event, Switch)]


def test_deep_loses_its_target_in_black_frames_and_finds_it_again(tracker, scene):
    status, scores = [], []
    for k in range(1, 31):
        place = scene.start + np.array([2, 1]) * k
        image = scene.image(place)
        _, found = tracker.update(np.zeros_like(image) if 8 <= k < 18 else image)
        status.append(tracker.status)
        scores.append(tracker.score)
        if k >= 19:
            centre = np.array(found[:2]) + np.array(found[2:]) / 2 - 0.5
            assert np.abs(centre - place).max() < 5.0
    assert max(scores[7:17]) < 0.1  # from the first black frame on
    assert status[9:17] == ["lost"] * 8
    # Plain pixels are less sure than a network: the score is near the level of `uncertain` all the time.
    assert status[20] == status[29] == "tracking" and "lost" not in status[20:]


def test_deep_finds_a_lost_target_again_at_another_place(tracker, scene):
    """It is away for ten frames, and returns where the crop around the last place does not reach."""
    elsewhere = scene.start + np.array([120, 30])
    events, status = [], []
    for k in range(1, 41):
        shown = scene.background if 8 <= k < 18 else scene.image(scene.start if k < 8 else elsewhere)
        _, found = tracker.update(shown)
        events += [event for event in tracker.events if isinstance(event, Reappeared)]
        status.append(tracker.status)
    centre = np.array(found[:2]) + np.array(found[2:]) / 2 - 0.5
    assert np.abs(centre - elsewhere).max() < 5.0
    assert status[16] == "lost" != status[-1]
    (event,) = events
    assert event.by == "network" and event.frame > 18
