"""Who is hidden, against enumeration of a hidden Markov chain."""

import numpy as np
import pytest

from bayesnet_track.adapt.joins import (
    HIDDEN,
    LASTS,
    detection_of,
    expect_hidden,
    learn_hidden,
    share_hidden,
)


def test_at_the_beginning_covered_targets_are_detected_as_often_as_they_are_on_average():
    share = share_hidden(0.9, 0.4)
    np.testing.assert_allclose(detection_of(0.9, np.ones(1), np.full(1, share)), 0.4)
    np.testing.assert_allclose(detection_of(0.9, np.zeros(1), np.full(1, share)), 0.9)
    assert share_hidden(0.02, 0.5) == share_hidden(0.02, 0.02) == 0.0  # nothing tells one from the other


@pytest.mark.parametrize("looks", ["0000", "1111", "0010", "1000"])
def test_misses_on_end_say_that_a_covered_target_is_hidden(looks):
    """Against the forward sums of a chain that is drawn anew with probability 1 - LASTS."""
    most, share = 0.8, 0.6
    hidden = np.full(1, share)
    alpha = np.array([share, 1 - share])
    stay = LASTS * np.eye(2) + (1 - LASTS) * np.array([[share, 1 - share]] * 2)
    for one in looks:
        hidden = expect_hidden(hidden, np.ones(1), share)
        hidden = learn_hidden(hidden, np.full(1, float(one)), most)
        says = np.array([HIDDEN, most]) if one == "1" else 1 - np.array([HIDDEN, most])
        alpha = alpha @ stay * says
        alpha /= alpha.sum()
        assert hidden[0] == pytest.approx(alpha[0])


def test_what_was_known_ends_with_the_cover():
    assert expect_hidden(np.full(2, 0.99), np.array([0.0, 1.0]), 0.3).tolist() == pytest.approx([0.3, 0.9555])
