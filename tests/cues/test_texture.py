"""Histograms of texture: codes against their definitions, shares pixel by pixel, what they tell apart."""

import numpy as np
import pytest

from bayesnet_track.vision.kernels.patch_kernels import binary_patterns, gradient_directions
from bayesnet_track.vision.planes import TextureCodes


def codes_of(kernel, gray, *settings):
    codes = np.empty((gray.shape[0] - 2, gray.shape[1] - 2), np.uint8)
    kernel(gray, *settings, codes)
    return codes


def test_directions_are_those_of_the_arctangent():
    gray = np.random.default_rng(0).integers(0, 256, (40, 50)).astype(np.uint8)
    wide = gray.astype(float)
    dx, dy = wide[1:-1, 2:] - wide[1:-1, :-2], wide[2:, 1:-1] - wide[:-2, 1:-1]
    expected = np.rint(np.arctan2(dy, dx) / (np.pi / 4)).astype(int) % 8
    expected[np.abs(dx) + np.abs(dy) <= 20] = 8
    np.testing.assert_array_equal(codes_of(gradient_directions, gray, 20), expected)


def test_patterns_are_counted_round_the_pixel_and_do_not_turn():
    gray = np.random.default_rng(1).integers(0, 256, (30, 30)).astype(np.uint8)
    codes = codes_of(binary_patterns, gray, 10)
    ring = [(-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1)]
    for y in range(1, 29, 3):
        for x in range(1, 29, 3):
            bits = [int(gray[y + j, x + i]) > int(gray[y, x]) + 10 for j, i in ring]
            changes = sum(bits[k] != bits[k - 1] for k in range(8))
            assert codes[y - 1, x - 1] == (sum(bits) if changes <= 2 else 9)
    turned = codes_of(binary_patterns, np.ascontiguousarray(np.rot90(gray)), 10)
    np.testing.assert_array_equal(turned, np.rot90(codes))


@pytest.mark.parametrize("form", ["gradients", "patterns"])
def test_the_likelihood_is_that_of_the_counted_codes(ask, scene, form):
    """Boxes of whole cells, within and across the border: counted one by one, outside pixels are no match."""
    asked = ask("texture", form=form, floor=1e-6, sd_log_area=1e6, sd_log_aspect=1e6)
    pair, p = scene.pair(), asked.cue.parameters
    whole = np.array([[(scene.width - 1) / 2, (scene.height - 1) / 2, scene.width, scene.height]])
    codes = TextureCodes(form, p.noise_gray).grid(pair.current, whole, np.ones(2)).values
    box = np.array([150.0, 120.0, 45.0, 33.0])
    reference = asked.learn(pair, box)

    def shares(x, y):
        found = np.zeros_like(reference["shares"])
        for i in range(33):
            for j in range(45):
                row, column = int(y) - 16 + i, int(x) - 22 + j
                if 0 <= row < scene.height and 0 <= column < scene.width:
                    found[i // 11, j // 15, codes[row, column]] += 1 / (11 * 15)
        return found

    np.testing.assert_allclose(reference["shares"], shares(150, 120), atol=1e-12)
    boxes = np.array(
        [[x, y, 45.0, 33.0] for x, y in ((158, 121), (150, 125), (100, 60), (3, 50), (310, 235))]
    )
    rho = np.array([np.sqrt(shares(x, y) * reference["shares"]).sum() / p.cells**2 for x, y, _, _ in boxes])
    alpha = float(reference["alpha"])
    ratio = (1 + np.exp(-4)) / (1 + np.exp(4 * (np.sqrt(1 - rho) - alpha) / alpha))
    np.testing.assert_allclose(
        asked.score(pair, boxes, reference), np.log(1e-6 + (1 - 1e-6) * ratio), atol=1e-9
    )


def stripes(scene, upright_at, lying_at):
    """Upright and lying stripes of the same brightness on gray."""
    image = np.full((scene.height, scene.width, 3), 110, np.uint8)
    wave = np.where(np.arange(40) // 4 % 2, 180, 60)[None, :].repeat(40, axis=0)
    for (x, y), patch in ((upright_at, wave), (lying_at, wave.T)):
        image[y - 20 : y + 20, x - 20 : x + 20] = patch[..., None]
    return scene.pair_of(image, image)


@pytest.mark.parametrize(("form", "tells"), [("gradients", True), ("patterns", False)])
def test_only_gradients_tell_a_turned_target(ask, scene, form, tells):
    """To patterns that turn along, the lying stripes are the upright ones."""
    asked, pair = ask("texture", form=form, cells=1), stripes(scene, (80, 100), (200, 100))
    boxes = np.array([[79.5, 99.5, 36.0, 36.0], [199.5, 99.5, 36.0, 36.0]])
    own, turned = asked.score(pair, boxes, asked.learn(pair, boxes[0]))
    assert own == 0.0
    assert (turned < -2.0) == tells
    if not tells:
        assert turned > -0.2


def test_light_does_not_matter(ask, scene):
    """Brighter by 30 levels nothing changes: gradients are differences."""
    asked, pair = ask("texture"), scene.pair()
    darker = np.minimum(pair.current.image, 200)
    brighter = darker + np.uint8(30)
    reference = asked.learn(scene.pair_of(darker, darker), scene.box())
    boxes = scene.around(scene.start)
    # OpenCV rounds brightness in fixed point, which a constant moves past a rounding border in no pixel.
    np.testing.assert_allclose(
        asked.score(scene.pair_of(brighter, brighter), boxes, reference),
        asked.score(scene.pair_of(darker, darker), boxes, reference),
        atol=1e-12,
    )


def test_each_attempt_takes_from_boxes_that_are_off_and_ends(ask, scene):
    asked, pair = ask("texture", floor=1e-4), scene.pair()
    reference, off = asked.learn(pair, scene.box()), (scene.box() + [4, 0, 0, 0])[None]
    values = [asked.score(pair, off, reference)[0]]
    for attempt in (1, 2, 3):
        reference = asked.cue.adapt(reference, attempt)
        values.append(asked.score(pair, off, reference)[0])
    assert np.all(np.diff(values) < 0)
    assert asked.cue.adapt(reference, 1) is None


def test_a_target_never_seen_says_nothing(ask, scene):
    asked, pair = ask("texture"), scene.pair()
    reference = asked.learn(pair, np.array([-100.0, 50.0, 30.0, 30.0]))
    assert not asked.score(pair, scene.around(scene.start), reference).any()
    assert asked.cue.adapt(reference, 1) is None
