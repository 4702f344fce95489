"""The detection agent: it measures what it was given, and is silent when it was given nothing."""

import numpy as np
import pytest

from bayesnet_track.observation.cue import OWN_DETECTION, AssociatingCue


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
