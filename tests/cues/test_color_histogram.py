"""Hue histograms against OpenCV, their circular distance, and what the cue makes of them."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.kernels.color_kernels import hue_of_bgr
from bayesnet_track.vision.kernels.histogram_kernels import (
    color_distances,
    count_by_integral,
    count_directly,
    count_in_boxes,
)
from bayesnet_track.vision.planes import Hue, HueBins

ORANGE, GREEN, BLUE, GRAY = (0, 128, 255), (0, 255, 0), (255, 0, 0), (90, 90, 90)


def picture(rows, columns, background=GRAY):
    image = np.empty((rows, columns, 3), np.uint8)
    image[:] = background
    return image


def still(image):
    return FramePair(Frame(0, 0.0, image), None)


def distance(asked, pair, boxes, reference):
    """The distance that the log-likelihood stands for, solved from it."""
    p = asked.cue.parameters
    share = np.exp(asked.score(pair, boxes, reference))
    likelihood = (share - p.floor) / (1 - p.floor) * (1 / (1 + np.exp(-4)))
    return reference["alpha"] * (1 + np.log(1 / likelihood - 1) / 4)


def test_hue_is_that_of_opencv_wherever_there_is_colour():
    image = np.random.default_rng(0).integers(0, 256, (400, 500, 3), dtype=np.uint8)
    hue = hue_of_bgr(image, 30)
    chroma = image.max(axis=2).astype(int) - image.min(axis=2)
    assert np.array_equal(hue == -1, chroma < 30)
    opencv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV_FULL)[..., 0]
    assert np.array_equal(hue[hue >= 0], opencv[hue >= 0])


def test_bins_are_equal_parts_of_the_circle():
    image = np.random.default_rng(1).integers(0, 256, (60, 70, 3), dtype=np.uint8)
    region = Region(0, 0, 70, 60)
    planes = PlaneCache(still(image)).planes([Hue(20), HueBins(12, 20)], region)
    hue, bins = planes[Hue(20)], planes[HueBins(12, 20)]
    assert np.array_equal(bins, np.where(hue < 0, 12, hue.astype(int) * 12 // 256))


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), bins=st.sampled_from([4, 6, 32, 128]), empty=st.booleans())
def test_both_ways_of_counting_agree_with_bincount(seed, bins, empty):
    rng = np.random.default_rng(seed)
    rows, columns = (0, 0) if empty else rng.integers(1, 40, 2)
    binned = rng.integers(0, bins + 1, (rows, columns)).astype(np.uint8)
    x, y = (np.sort(rng.integers(0, n + 1, (9, 2)), axis=1) for n in (columns, rows))
    corners = np.column_stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]])
    expected = [np.bincount(binned[d:f, c:e].ravel(), minlength=bins + 1)[:bins] for c, d, e, f in corners]
    for count in (count_directly, count_by_integral, count_in_boxes):
        assert np.array_equal(count(binned, corners, bins), expected)


def test_sums_modulo_two_to_the_sixteen_are_exact():
    binned = np.zeros((700, 700), np.uint8)  # sums reach 490,000
    small, large = np.array([[433, 433, 688, 688]]), np.array([[0, 0, 700, 700], [0, 0, 256, 256]])
    assert count_by_integral(binned, small, 4)[0, 0] == 255 * 255
    assert count_by_integral(binned, large, 4)[:, 0].tolist() == [490_000, 65_536]


def circular_distance(counts, shares):
    """Between two histograms of hues alone, with every pixel inside."""
    pixels = np.array([float(counts.sum())])
    reference = np.append(shares / shares.sum(), 0.0)
    return color_distances(counts[None].astype(np.int32), pixels, pixels, reference, 1.0)[0][0]


def test_circular_distance_is_the_least_cost_of_moving_mass():
    bins = 16
    rng = np.random.default_rng(2)
    f, g = rng.integers(0, 20, (2, bins))
    difference = np.cumsum(f / f.sum() - g / g.sum())
    brute = min(np.abs(difference - cut).sum() for cut in difference)  # least over where the circle is cut
    assert circular_distance(f, g) == pytest.approx(2 / bins * brute, abs=1e-12)


@pytest.mark.parametrize("start", range(8))
@pytest.mark.parametrize("apart", range(5))
def test_circular_distance_of_two_hues_does_not_depend_on_where_hue_starts(start, apart):
    one, other = np.zeros((2, 8))
    one[start] = 5
    other[(start + apart) % 8] = 1
    assert circular_distance(one, other) == pytest.approx(
        apart / 4
    )  # opposite hues, 4 bins of 8 apart, are at distance 1


def test_alpha_is_half_the_mean_distance_of_the_half_overlapping_boxes(ask):
    asked = ask("color_histogram")
    image = picture(120, 160)
    image[40:80, 60:100] = ORANGE
    box = np.array([79.5, 59.5, 40, 40])
    reference = asked.learn(still(image), box)
    assert reference["shares"][2] == pytest.approx(1.0)  # orange is 30 degrees of 360, bin 2 of 32
    # each of the four has lost half of its colour: distance 0.5 * achromatic_distance = 0.25
    assert reference["alpha"] == pytest.approx(0.125)
    shifted = np.array([[89.5, 59.5, 40, 40]])  # a quarter lost: distance 0.125 = alpha
    half = asked.score(still(image), shifted, reference)[0]
    floor = asked.cue.parameters.floor
    assert np.exp(half) == pytest.approx(floor + (1 - floor) * 0.5 * (1 + np.exp(-4)))


def test_a_part_of_a_one_colour_target_is_not_perfect(ask):
    asked = ask("color_histogram", sd_log_area=1e6, sd_log_aspect=1e6)
    image = picture(120, 160)
    image[40:80, 60:100] = ORANGE
    reference = asked.learn(still(image), np.array([79.5, 59.5, 40, 40]))
    boxes = np.array([[79.5, 59.5, 40, 40], [69.5, 59.5, 40, 40], [64.5, 59.5, 40, 40]])
    assert (np.diff(asked.score(still(image), boxes, reference)) < 0).all()


def test_full_scale_does_not_depend_on_the_hue(ask):
    asked = ask("color_histogram")
    found = []
    for color in ((0, 0, 255), ORANGE, GREEN, BLUE):
        image = picture(120, 160)
        image[40:80, 60:100] = color
        reference = asked.learn(still(image), np.array([79.5, 59.5, 40, 40]))
        found.append(asked.score(still(image), np.array([[85.0, 55.0, 40, 40]]), reference)[0])
    assert np.ptp(found) < 1e-12


def test_pixels_outside_the_frame_cost_the_full_distance(ask):
    asked = ask("color_histogram", alpha_min=0.5)
    image = picture(100, 100, GREEN)
    reference = asked.learn(still(image), np.array([50.0, 50, 20, 20]))
    boxes = np.array([[-0.5, 50, 20, 20], [4.5, 50, 20, 20]])
    assert distance(asked, still(image), boxes, reference) == pytest.approx([0.5, 0.25])


def test_a_box_half_gray_half_opposite_hue(ask):
    asked = ask("color_histogram", alpha_min=0.5)
    image = picture(100, 100, (255, 0, 255))
    image[:, :20] = GREEN
    image[:, 60:80] = GRAY
    reference = asked.learn(still(image), np.array([9.5, 50, 20, 20]))
    reference = {**reference, "alpha": np.array(0.5)}
    # half the mass turns gray (0.5 * 0.5), half goes to the opposite hue (0.5 * 1)
    box = np.array([[59.5, 50, 20, 20]])
    assert distance(asked, still(image), box, reference) == pytest.approx([0.75])


def test_size_penalty(ask):
    asked = ask("color_histogram")
    image = picture(100, 100, GREEN)
    reference = asked.learn(still(image), np.array([50.0, 50, 20, 20]))
    boxes = np.array(
        [[50.0, 50, 20, 20], [50, 50, 40, 40], [50, 50, 10, 10], [50, 50, 28, 14], [50, 50, 14, 28]]
    )
    values = asked.score(still(image), boxes, reference)
    assert values[0] == pytest.approx(0, abs=1e-12)
    assert values[1] == pytest.approx(values[2])  # twice and half the size cost the same
    assert values[3] == pytest.approx(values[4])
    assert (values[1:] < -0.5).all()


def test_blend_mixes_shares_and_sizes(ask):
    asked = ask("color_histogram")
    green, blue = still(picture(100, 100, GREEN)), still(picture(100, 100, BLUE))
    old = asked.learn(green, np.array([50.0, 50, 20, 20]))
    new = asked.learn(blue, np.array([50.0, 50, 40, 20]))
    between = asked.cue.blend(old, new, 0.25)
    assert between["shares"] == pytest.approx(0.75 * old["shares"] + 0.25 * new["shares"])
    assert between["size"] == pytest.approx([20 * 2**0.25, 20])


def test_alpha_is_learnt_inside_the_frame(ask):
    asked = ask("color_histogram")
    image = picture(120, 160)
    image[40:80, :40] = ORANGE  # the box to its left would lie half outside, at distance 0.5
    reference = asked.learn(still(image), np.array([19.5, 59.5, 40, 40]))
    assert reference["alpha"] == pytest.approx(0.125)
