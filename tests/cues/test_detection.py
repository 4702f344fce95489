"""The detection agent: it measures what it was given, and is silent when it was given nothing."""

import numpy as np
import pytest

from bayesnet_track.cues.detection import DetectionParameters
from bayesnet_track.observation.cue import OBSERVED, OWN_DETECTION, AssociatingCue


def test_it_measures_the_detection_that_the_target_was_given(ask, scene):
    asked = ask("detection", sd_place=0.1, sd_size=0.05, floor=0.03)
    assert isinstance(asked.cue, AssociatingCue)
    reference = asked.learn(scene.pair(), scene.box())
    claim = np.array([[150.0, 110.0, 40.0, 80.0, 0.7]])
    measured = asked.measure(scene.pair(), scene.box()[None], {**reference, OWN_DETECTION: claim})
    assert measured.fields == ("x", "y", "w", "h") and measured.floor == 0.03
    np.testing.assert_array_equal(measured.mean, claim[0, :4])
    np.testing.assert_allclose(measured.covariance, np.diag([4.0, 8.0, 2.0, 4.0]) ** 2)


def test_without_a_detection_it_is_silent(ask, scene):
    asked = ask("detection")
    reference = asked.learn(scene.pair(), scene.box())
    for given in (reference, {**reference, OWN_DETECTION: np.empty((0, 5))}):
        assert asked.measure(scene.pair(), scene.box()[None], given) is None


def test_what_was_given_in_a_frame_is_not_learnt(ask, scene):
    asked = ask("detection")
    learnt = asked.learn(scene.pair(), scene.box())
    assert OWN_DETECTION not in asked.cue.blend({**learnt, OWN_DETECTION: np.ones((1, 5))}, learnt, 0.5)


def test_several_detections_are_choices_with_their_probabilities(ask, scene):
    own = np.array([[10.0, 20, 30, 60, 0.9, 0.6], [16, 20, 30, 60, 0.5, 0.3]])
    measured = ask("detection").measure(scene.pair(), scene.box()[None], {OWN_DETECTION: own})
    assert [weight for weight, _ in measured.choices] == [0.6, 0.3]
    assert measured.missed == pytest.approx(0.1)
    np.testing.assert_allclose(measured.mean, [12, 20, 30, 60])
    np.testing.assert_allclose([one.mean for _, one in measured.choices], own[:, :4])


def test_what_is_remembered_of_former_detections_outlives_learning(ask, scene):
    asked = ask("detection", similarity="iou", recover=True)
    learnt = asked.learn(scene.pair(), scene.box())
    assert asked.cue.blend({OBSERVED: np.ones(6)}, learnt, 0.5)[OBSERVED].tolist() == [1.0] * 6


def test_errors_in_px_add_to_those_in_shares(ask, scene):
    asked = ask("detection", sd_place=0.1, sd_place_px=3, sd_size=0, sd_size_px=2)
    claim = np.array([[150.0, 110.0, 40.0, 80.0, 0.7]])
    measured = asked.measure(scene.pair(), scene.box()[None], {OWN_DETECTION: claim})
    np.testing.assert_allclose(np.diag(measured.covariance), [16 + 9, 64 + 9, 4, 4])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"sd_place": 0}, "sd_place and sd_place_px are both 0"),
        ({"similarity": "iou", "appearance": 0.5}, "take similarity: density"),
        ({"direction": 0.2}, "direction compares overlaps; take similarity: iou"),
        ({"recover": True}, "recover compares overlaps"),
    ],
)
def test_parameters_that_have_no_effect_together_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        DetectionParameters(**wrong)
