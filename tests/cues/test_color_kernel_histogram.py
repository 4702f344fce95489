"""The colour histogram under a kernel: against the chapter's equations written out, and its sampling."""

import numpy as np
import pytest

from bayesnet_track.observation.planes import Region


def histogram(asked, pair, box):
    """3.83-3.85 pixel by pixel; pixels outside the frame have a colour of their own, the last cell."""
    planes = asked.planes(pair, Region(0, 0, pair.current.width, pair.current.height))
    cells = planes[asked.cue.needs[0]]
    shares = np.zeros(asked.cue.needs[0].size + 1)
    x, y, rx, ry = box[0], box[1], max(box[2] / 2, 1.0), max(box[3] / 2, 1.0)
    for row in range(int(y - ry) - 2, int(y + ry) + 3):
        for column in range(int(x - rx) - 2, int(x + rx) + 3):
            weight = 1.0 - ((column - x) / rx) ** 2 - ((row - y) / ry) ** 2
            inside = 0 <= row < cells.shape[0] and 0 <= column < cells.shape[1]
            shares[cells[row, column] if inside else -1] += max(weight, 0.0)
    return shares / shares.sum()


@pytest.mark.parametrize("space", ["rgb", "hsv"])
def test_the_likelihood_is_the_chapters(ask, scene, space):
    """Equation by equation, on boxes within, across and beyond the border."""
    asked = ask("color_kernel_histogram", space=space, floor=1e-6, sd_log_area=1e6, sd_log_aspect=1e6)
    pair = scene.pair()
    reference = asked.learn(pair, scene.box())
    model = histogram(asked, pair, scene.box())
    np.testing.assert_allclose(reference["shares"], model[:-1], atol=1e-12)
    rng = np.random.default_rng(4)
    boxes = np.column_stack(
        [rng.uniform(-20, 340, 25), rng.uniform(-20, 260, 25), rng.uniform(1, 70, (25, 2))]
    )
    boxes[:10, :2] = scene.start + rng.uniform(-15, 15, (10, 2))
    rho = [np.sqrt(histogram(asked, pair, box) * model)[:-1].sum() for box in boxes]
    expected = np.log(1e-6 + (1 - 1e-6) * np.exp((np.array(rho) - 1.0) / (2 * 0.02)))
    np.testing.assert_allclose(asked.score(pair, boxes, reference), expected, atol=1e-9)


def test_a_large_box_is_sampled_on_the_frames_lattice(ask, scene):
    """A quarter of the pixels moves rho by .02 on average at most, by .05 anywhere; regions change no bit."""
    whole, part = ask("color_kernel_histogram"), ask("color_kernel_histogram", pixels=500)
    pair = scene.pair()
    boxes = scene.around(scene.start, 20, 5) + 0.3
    values = []
    for asked in (whole, part):
        reference = asked.learn(pair, scene.box())
        tight = asked.planes(pair, Region(60, 50, 260, 200))
        wide = asked.planes(pair, Region(0, 0, scene.width, scene.height))
        rho = asked.cue.coefficients(tight, boxes, reference)
        np.testing.assert_array_equal(rho, asked.cue.coefficients(wide, boxes, reference))
        values.append(rho)
    assert np.abs(values[0] - values[1]).max() < 0.05
    assert 0 < np.abs(values[0] - values[1]).mean() < 0.02


def test_shades_of_one_hue_are_told_apart(ask, scene):
    """Two squares of one hue, one darker: the hue histogram takes either, this one does not."""
    image = np.full((scene.height, scene.width, 3), 128, np.uint8)
    image[100:140, 60:100] = (20, 40, 220)
    image[100:140, 200:240] = (10, 20, 110)
    pair = scene.pair_of(image, image)
    boxes = np.array([[79.5, 119.5, 40, 40], [219.5, 119.5, 40, 40]])
    gap = {}
    for name in ("color_histogram", "color_kernel_histogram"):
        asked = ask(name)
        values = asked.score(pair, boxes, asked.learn(pair, boxes[0]))
        gap[name] = values[0] - values[1]
    assert gap["color_histogram"] < 0.1 and gap["color_kernel_histogram"] > 2.0


def test_colours_near_the_rim_count_least(ask, scene):
    """A stripe of another colour costs the less the further out it lies."""
    image = np.full((scene.height, scene.width, 3), (20, 40, 220), np.uint8)
    box = np.array([150.0, 120.0, 61.0, 61.0])
    asked = ask("color_kernel_histogram")
    reference = asked.learn(scene.pair_of(image, image), box)
    scores = []
    for column in (120, 132, 147):
        striped = image.copy()
        striped[:, column : column + 6] = (200, 200, 20)
        scores.append(asked.score(scene.pair_of(striped, striped), box[None], reference)[0])
    assert scores[0] > scores[1] > scores[2]


def test_what_was_never_seen_says_the_same_of_all_until_something_is(ask, scene):
    asked, pair = ask("color_kernel_histogram"), scene.pair()
    nothing = asked.learn(pair, np.array([-100.0, -100.0, 20.0, 20.0]))
    assert not nothing["shares"].any()
    assert np.ptp(asked.score(pair, scene.around(scene.start), nothing)) == 0
    seen = asked.learn(pair, scene.box())
    assert asked.cue.blend(nothing, seen, 0.1) is seen
    assert asked.cue.blend(seen, nothing, 0.1) is seen


def test_local_action_sharpens(ask, scene):
    asked, pair = ask("color_kernel_histogram", floor=1e-6), scene.pair()
    reference = asked.learn(pair, scene.box())
    off = scene.box((6, 0))[None]
    sharper = asked.cue.adapt(reference, 1)
    assert asked.score(pair, off, sharper)[0] < asked.score(pair, off, reference)[0]
    assert asked.cue.adapt(sharper, 4) is None
