"""A cut changes colours and structure; exposure, a moving view and a blank frame are no cut."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.vision.planes import SceneChange, compare_scenes, describe_scene

RNG = np.random.default_rng(7)


def blobs(seed, size=(120, 160)):
    """A smooth random image in colours of its own."""
    import cv2

    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 160, (6, 8, 3)) * rng.uniform(0.4, 1.0, 3)
    return cv2.resize(coarse.astype(np.uint8), size[::-1], interpolation=cv2.INTER_CUBIC)


def distance(before, after):
    return compare_scenes(describe_scene(before), describe_scene(after)).distance


@pytest.mark.parametrize("seed", range(5))
def test_another_scene_is_far_and_the_same_one_near(seed):
    image = blobs(seed)
    noisy = np.clip(image + RNG.normal(0, 5, image.shape), 0, 255).astype(np.uint8)
    assert distance(image, blobs(seed + 100)) > 0.3
    assert distance(image, noisy) < 0.1
    assert distance(image, np.roll(image, (6, -10), axis=(0, 1))) < 0.15
    assert distance(image, (image * 0.4).astype(np.uint8)) < 0.1


def test_a_uniform_middle_is_no_proof_of_the_same_structure():
    card = np.full((120, 160, 3), (150, 40, 40), np.uint8)
    card[:20] = card[-20:] = 10
    assert distance(blobs(2), card) > 0.3 and distance(card, blobs(2)) > 0.3


def test_a_frame_that_shows_nothing_is_no_scene():
    assert describe_scene(np.zeros((48, 64, 3), np.uint8)) is None
    assert describe_scene(np.full((48, 64, 3), 130, np.uint8)) is None
    flash = blobs(1)
    flash[:60] = 255
    assert describe_scene(flash) is None
    assert describe_scene(blobs(1)) is not None


def test_both_colours_and_structure_have_to_differ():
    assert SceneChange(1.0, 0.0).distance == SceneChange(0.0, 1.0).distance == 0.0
    assert SceneChange(0.9, 0.4).distance == pytest.approx(0.6)


def test_the_size_of_the_image_does_not_matter():
    import cv2

    image = blobs(3, (480, 640))
    half = cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA)
    assert distance(image, half) < 0.05
