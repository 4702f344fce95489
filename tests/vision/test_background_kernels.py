"""The mixture of each pixel: worked by hand on one pixel with three modes."""

import numpy as np
import pytest

from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.kernels.color_kernels import BACKGROUND, SHADOW, update_mixture

MEANS = [(100.0, 100.0, 100.0), (150.0, 150.0, 150.0), (20.0, 20.0, 20.0)]


def update(value, gain=1.0, weights=(0.6, 0.3, 0.1), darkest=0.5, chroma=25.0, rate=0.1, least=30.0):
    """Evidence, weights, means and variances after one pixel of this value; variances are 100 before."""
    image = for_reading(np.array(value, np.uint8).reshape(1, 1, 3))
    w = np.array(weights, np.float32).reshape(1, 1, 3)
    m = np.array(MEANS, np.float32).reshape(1, 1, 3, 3)
    v = np.full((1, 1, 3), 100.0, np.float32)
    evidence = np.full((1, 1), 77, np.uint8)
    update_mixture(image, gain, rate, w, m, v, 16.0, 0.8, least, 400.0, darkest, chroma, evidence)
    return int(evidence[0, 0]), w[0, 0], m[0, 0], v[0, 0]


def test_a_pixel_of_the_first_mode_is_background_and_is_learnt():
    evidence, weights, means, variances = update((110, 100, 104))  # 116 / 100 < 16
    assert evidence == BACKGROUND
    np.testing.assert_allclose(weights, [0.64, 0.27, 0.09], rtol=1e-6)
    own = 0.1 / 0.64
    np.testing.assert_allclose(means[0], [100 + 10 * own, 100, 100 + 4 * own], rtol=1e-6)
    np.testing.assert_allclose(variances[0], (1 - own) * (100 + own * 116 / 3), rtol=1e-6)
    np.testing.assert_array_equal(means[1:], MEANS[1:])
    np.testing.assert_array_equal(variances[1:], 100)


def test_the_variance_has_a_lower_bound():
    assert update((100, 100, 100), least=90.0)[3][0] == 90.0
    np.testing.assert_allclose(update((100, 100, 100))[3][0], 100 * (1 - 0.1 / 0.64), rtol=1e-6)


def test_a_mode_that_overtakes_another_changes_places_with_it():
    evidence, weights, means, variances = update((150, 150, 156), weights=(0.5, 0.48, 0.02), least=95.0)
    assert evidence == BACKGROUND  # the mode before it has less than 0.8
    np.testing.assert_allclose(weights, [0.532, 0.45, 0.018], rtol=1e-5)
    own = 0.1 / 0.532
    np.testing.assert_allclose(means[:2], [(150, 150, 150 + 6 * own), (100, 100, 100)], rtol=1e-6)
    np.testing.assert_allclose(variances[:2], [95.0, 100.0])


def test_a_mode_beyond_the_backgrounds_share_is_foreground():
    evidence, weights, means, _ = update((20, 20, 20), darkest=1.0)
    assert evidence == min(int(128 * np.sqrt(3 * 80**2 / 100 / 16)), 255) == 255
    np.testing.assert_allclose(weights, [0.54, 0.27, 0.19], rtol=1e-6)
    np.testing.assert_array_equal(means, MEANS)


def test_what_no_mode_explains_starts_one_instead_of_the_weakest():
    evidence, weights, means, variances = update((125, 125, 150), darkest=1.0)
    # 25^2 + 25^2 + 0 from the second mode, the nearest: 12.5 variances, a match; 13 px off it is not
    assert evidence == BACKGROUND
    evidence, weights, means, variances = update((125, 120, 150), darkest=1.0)
    nearest = (25**2 + 30**2) / 100
    assert nearest < 16 and evidence == BACKGROUND
    evidence, weights, means, variances = update((120, 120, 149), darkest=1.0)
    nearest = (30**2 + 30**2 + 1) / 100
    assert evidence == int(128 * np.sqrt(nearest / 16))
    np.testing.assert_allclose(weights, np.array([0.54, 0.27, 0.1]) / 0.91, rtol=1e-5)
    np.testing.assert_array_equal(means, [*MEANS[:2], (120, 120, 149)])
    np.testing.assert_allclose(variances, [100, 100, 400])


@pytest.mark.parametrize(
    ("value", "is_shadow"),
    [
        ((55, 55, 55), True),
        ((50, 50, 50), True),  # half as bright: the darkest of them
        ((49, 49, 49), False),
        ((45, 55, 65), False),  # coloured: 200 away, 75 allowed
        ((50, 55, 60), True),  # 50 away
    ],
)
def test_a_shadow_is_darker_and_of_the_same_colour(value, is_shadow):
    assert (update(value)[0] == SHADOW) == is_shadow
    assert update(value, darkest=1.0)[0] >= 128


def test_the_gain_of_the_camera_is_for_comparing_and_not_for_learning():
    evidence, _, means, _ = update((200, 200, 200), gain=2.0)
    own = 0.1 / 0.64
    assert evidence == BACKGROUND
    np.testing.assert_allclose(means[0], 100 + 100 * own, rtol=1e-6)
    assert update((255, 255, 255), gain=1.7)[0] == BACKGROUND  # 150 * 1.7 is the camera's 255


def one_pixel(value, weights, share=0.8, rate=0.1, chroma=25.0, gain=1.0, match=16.0):
    """As `update`, of the kernel's other settings."""
    image = for_reading(np.array(value, np.uint8).reshape(1, 1, 3))
    w, v = np.array(weights, np.float32).reshape(1, 1, 3), np.full((1, 1, 3), 100.0, np.float32)
    m, evidence = np.array(MEANS, np.float32).reshape(1, 1, 3, 3), np.full((1, 1), 77, np.uint8)
    update_mixture(image, gain, rate, w, m, v, match, share, 30.0, 400.0, 0.5, chroma, evidence)
    return int(evidence[0, 0]), w[0, 0], m[0, 0], v[0, 0]


def test_a_mode_without_weight_is_none():
    """Its mean is what a pixel once was; the pixel starts a new mode there, with the first variance."""
    evidence, weights, _, variances = one_pixel((20, 20, 20), (0.7, 0.3, 0.0))
    assert evidence == 255 and variances[2] == 400.0
    np.testing.assert_allclose(weights, [0.63, 0.27, 0.1], rtol=1e-6)


def test_a_pixel_at_the_limit_of_a_mode_is_not_its_own():
    evidence, _, means, _ = one_pixel((140, 100, 100), (0.9, 0.05, 0.05), share=0.5)
    assert evidence == 128 and means[0].tolist() == [100, 100, 100]  # 40^2 / 100 is 16, not below
    assert one_pixel((139, 100, 100), (0.9, 0.05, 0.05), share=0.5)[0] == BACKGROUND


def test_a_mode_that_begins_at_the_backgrounds_share_is_beyond_it():
    assert one_pixel((20, 20, 20), (0.5, 0.25, 0.25), share=0.75)[0] == 255
    assert one_pixel((20, 20, 20), (0.5, 0.25, 0.25), share=0.76)[0] == BACKGROUND


def test_what_is_as_bright_as_the_background_is_no_shadow():
    """140 + 60 + 100 along (1, 1, 1) is just the background's brightness; a gray level less is below it."""
    assert one_pixel((140, 60, 100), (0.9, 0.05, 0.05), share=0.5, chroma=2000.0)[0] >= 128
    assert one_pixel((140, 59, 100), (0.9, 0.05, 0.05), share=0.5, chroma=2000.0)[0] == SHADOW


def test_a_shadow_differs_in_colour_by_less_than_the_limit():
    """(5, 5, -10) off the line of grays: a mean square of 50."""
    assert one_pixel((55, 55, 40), (0.6, 0.3, 0.1), chroma=50.0)[0] >= 128
    assert one_pixel((55, 55, 40), (0.6, 0.3, 0.1), chroma=50.1)[0] == SHADOW


def test_a_shadow_is_compared_with_the_background_under_the_gain():
    """110 is darker than 200 = 2 * 100, though not than 100; at most 255 is seen of 3 * 100."""
    assert one_pixel((110, 110, 110), (0.9, 0.05, 0.05), share=0.5, gain=2.0, match=4.0)[0] == SHADOW
    assert one_pixel((130, 130, 130), (0.9, 0.05, 0.05), share=0.5, gain=3.0, match=4.0)[0] == SHADOW


def test_modes_of_one_weight_keep_their_places_and_a_strong_one_comes_first():
    _, weights, means, _ = one_pixel((150, 150, 150), (0.5, 0.5, 0.0), rate=0.0)
    assert means.tolist() == [list(mean) for mean in MEANS]
    _, weights, means, variances = one_pixel((240, 0, 0), (0.4, 0.35, 0.25), rate=0.5)
    np.testing.assert_allclose(weights, np.array([0.5, 0.2, 0.175]) / 0.875, rtol=1e-6)
    assert means.tolist() == [[240, 0, 0], list(MEANS[0]), list(MEANS[1])]
    assert variances.tolist() == [400, 100, 100]
